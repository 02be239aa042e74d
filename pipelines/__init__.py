"""The flow: stages and their configuration, plan, runner and executors, and the services by subject."""
