"""This package finds takes that hold the same recording, by aligning equal words and comparing joint positions.

It finds copies of a recording or of parts of it; `ops.distances.near_duplicates` finds clips that merely resemble one
another.
"""
