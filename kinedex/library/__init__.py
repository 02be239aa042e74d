"""The public classes and functions of kinedex, thin over the services by subject; users import them from `kinedex`."""
