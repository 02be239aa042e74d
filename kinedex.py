"""Public Python API of kinedex: `kinedex.open_store(path)` and what it returns."""
