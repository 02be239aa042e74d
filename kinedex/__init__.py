"""kinedex: a motion archive that can be queried.

import kinedex
store = kinedex.open_store("my-store")
store.takes("actor = 'bk'")                            # polars data frame
store.sql("SELECT * FROM runs_where('lknee_bent', 1)") # Arrow table
store.words().take(0)                                  # numpy array: the words of the first take
kinedex.run_pipeline("annotate", Path("my-store"), assignments={"source": "/my/archive"})
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if not (Path(__file__).parent / "ops" / "__init__.py").is_file():
    raise ImportError(
        f"{Path(__file__).parent}: 'ops' should be a link to the folder '../ops', and is not one. Git made this "
        "checkout without symbolic links. Allow them and check the links out again: "
        "git config core.symlinks true && git checkout -- kinedex "
        "(on Windows, switch on Developer Mode first). An installed wheel needs no links."
    )

if TYPE_CHECKING:
    from kinedex.catalog.features import FeatureSet, load_feature_set
    from kinedex.ops.errors import ConfigError, KinedexError, ParameterError, SourceError, StoreError
    from kinedex.ops.words import TakeWords
    from kinedex.pipelines.engine.runner import Outcome, run_pipeline
    from kinedex.storage.store.store import Store, open_store

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

_HOMES = {
    "ConfigError": "ops.errors",
    "FeatureSet": "catalog.features",
    "KinedexError": "ops.errors",
    "Outcome": "pipelines.engine.runner",
    "ParameterError": "ops.errors",
    "SourceError": "ops.errors",
    "Store": "storage.store.store",
    "StoreError": "ops.errors",
    "TakeWords": "ops.words",
    "load_feature_set": "catalog.features",
    "open_store": "storage.store.store",
    "run_pipeline": "pipelines.engine.runner",
}
"""The module of each public name; it is imported when the name is first used, so that `import kinedex` is quick."""


def __getattr__(name: str) -> object:
    """Import a public name when it is first used (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module 'kinedex' has no attribute '{name}'")
    value = getattr(import_module(f"kinedex.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names, imported or not."""
    return sorted({*globals(), *__all__})
