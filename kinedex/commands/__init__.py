"""The commands of `kinedex`, in modules by subject; each command is one function."""
