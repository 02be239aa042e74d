"""The numbers: numpy in, numpy out; compiled kernels. No files, no SQL, no configuration, no logging."""
