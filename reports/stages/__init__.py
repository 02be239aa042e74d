"""Stages that draw a page from the results of other stages, one in each module; no stage imports another."""
