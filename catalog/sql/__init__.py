"""The SQL views and macros of a store, with the words that document them."""
