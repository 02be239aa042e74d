"""Read and write the data: file formats, Arrow schemas, Parquet parts, the manifest and the DuckDB index."""
