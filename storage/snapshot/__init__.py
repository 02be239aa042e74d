"""Read one version of a store as files: its manifest, the Parquet parts that it names, and their schemas."""
