"""Run SQL over a store: set up DuckDB, and define every view and macro on a connection."""
