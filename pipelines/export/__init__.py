"""Data sets that leave a store as files: what is cut out, in which form, and the record of where it comes from."""
