"""Build and read the index: word runs, feature runs and vocabulary of takes, one DuckDB file per generation.

A generation is a published state of the index. Its rows are divided into shards, each made from the words of some
frames parts. A new generation is a copy of the previous one in which only the shards whose parts have changed are
replaced. Every shard also has a file with the bit slices of its words, which keyframe search maps into memory.
"""
