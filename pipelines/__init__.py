"""The flow: stages and their configuration, plan, runner, executors, reports, the command line."""
