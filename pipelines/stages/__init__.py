"""Stages, one in each module; a stage reads a store, and commits its results. No stage imports another."""
