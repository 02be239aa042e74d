"""The terminal: progress and messages, tables, and the SQL prompt."""
