"""This package defines the SQL views and macros of a store, with their descriptions."""
