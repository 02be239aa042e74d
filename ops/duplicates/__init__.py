"""This package finds takes that hold the same recording: alignments by equal words, verified by joint positions.

It finds copies of a recording or of parts of it; `ops.distances.near_duplicates` finds clips that merely resemble one
another.
"""
