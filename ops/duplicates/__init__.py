"""The same motion twice: alignments of takes by equal runs of words, judged by the places of their joints.

It finds copies of a recording, also parts of it; `ops.distances.near_duplicates` finds clips that merely resemble one
another.
"""
