"""The pipelines: stages, configuration, plan, runner and executors, and the code that stages share, by topic."""
