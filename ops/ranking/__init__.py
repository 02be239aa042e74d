"""Ranking: the places in an archive where a template fits best, found exactly without computing all of them."""
