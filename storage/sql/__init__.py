"""SQL over a store: how DuckDB is set up, and the connection on which every view and macro stands."""
