"""The index: word runs, feature runs and vocabulary of a store's takes, in one DuckDB file per published generation.

Its rows lie in shards, each made from the words of some frames parts. A new generation is a copy of the one before in
which only the shards change whose parts have changed. Beside the DuckDB file every shard has a file with the bit slices
of its words, which keyframe search maps into memory.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from kinedex.storage.index.generations import (
    BUILD,
    BUILDING,
    GENERATION,
    INDEX_VERSION,
    Generation,
    current,
    file_digest,
    files,
    missing,
    read_generation,
    wrong_sizes,
)
from kinedex.storage.index.slices import ShardSlices, open_slices

if TYPE_CHECKING:
    from kinedex.storage.index.builder import build
    from kinedex.storage.index.tables import features_table, help_table

__all__ = [
    "BUILD",
    "BUILDING",
    "GENERATION",
    "INDEX_VERSION",
    "Generation",
    "ShardSlices",
    "build",
    "current",
    "features_table",
    "file_digest",
    "files",
    "help_table",
    "missing",
    "open_slices",
    "read_generation",
    "wrong_sizes",
]


def __getattr__(name: str) -> object:
    """What needs DuckDB comes when it is asked for: a search of the bit slices need not wait until that is loaded."""
    homes = {"build": "builder", "features_table": "tables", "help_table": "tables"}
    if name not in homes:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{homes[name]}"), name)
