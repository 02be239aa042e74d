"""One version of a store as files: its manifest, the Parquet parts that the manifest names, and their schemas."""
