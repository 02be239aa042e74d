"""The engine: pipeline files, the plan, the runner and the executors."""
