"""One stage a file; each reads a store and commits what it made. No stage imports another."""
