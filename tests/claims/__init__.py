"""Every command that the project prints, and how it is run: `python -m tests.claims` (`make check-claims`)."""
