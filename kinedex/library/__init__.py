"""The public classes and functions of kinedex, thin layers over the other packages; import them from `kinedex`."""
