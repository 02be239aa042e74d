"""The index: word runs, feature runs and vocabulary of a store's takes, in one DuckDB file per published generation.

The rows lie in shards, each made from the words of some frames parts. A new generation is a copy of the one before in
which only the shards change whose parts have changed. Beside the DuckDB file every shard has a file with the bit slices
of its words, which keyframe search maps into memory.
"""
