"""Stages that draw a page of what others stored, one in each module; no stage imports another."""
