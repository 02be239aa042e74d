"""The history of a store: list and compare its pipeline runs, and write pipeline files that repeat them."""
