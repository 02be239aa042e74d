"""The history of a store: what its pipeline runs changed, and pipeline files that run them again."""
