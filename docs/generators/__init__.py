"""Generators of the reference pages, `python -m docs.generators.reference` and `docs.generators.sql_reference`."""
