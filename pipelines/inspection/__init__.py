"""Inspection of one motion file: its content, how it is read, and a picture."""
