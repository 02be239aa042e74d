"""Attacks on a store that must find it unchanged, or fail with an error: `python -m tests.attacks`."""
