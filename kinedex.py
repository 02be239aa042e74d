"""kinedex: a motion archive that can be queried.

import kinedex
store = kinedex.open_store("my-store")
store.takes("actor = 'bk'")                            # polars data frame
store.sql("SELECT * FROM runs_where('lknee_bent', 1)") # Arrow table
store.words().take(0)                                  # numpy array: the words of the first take
kinedex.run_pipeline("annotate", Path("my-store"), assignments={"source": "/my/archive"})
"""

from __future__ import annotations

from catalog.features import FeatureSet, load_feature_set
from ops.errors import ConfigError, KinedexError, ParameterError, SourceError, StoreError
from ops.words import TakeWords
from pipelines.runner import Outcome, run_pipeline
from storage.store import Store, open_store

__all__ = [
    "ConfigError",
    "FeatureSet",
    "KinedexError",
    "Outcome",
    "ParameterError",
    "SourceError",
    "Store",
    "StoreError",
    "TakeWords",
    "load_feature_set",
    "open_store",
    "run_pipeline",
]

if __name__ == "__main__":  # python -m kinedex does what the command does
    from pipelines.cli import main

    main()
