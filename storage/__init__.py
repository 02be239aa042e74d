"""The matter: file formats, Arrow schemas, Parquet parts, the manifest, the DuckDB index."""
