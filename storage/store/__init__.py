"""Change and check a store: a directory of Parquet parts, and a manifest for each version that names them."""
