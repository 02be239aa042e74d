"""The commands of the command line, by what people use them for: one function a command."""
