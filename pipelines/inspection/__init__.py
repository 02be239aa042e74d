"""Inspection of one motion file: what it holds, what becomes of it, and a picture."""
