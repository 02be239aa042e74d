"""kinedex: a motion archive that can be queried.

>>> take = kinedex.read(motion_file)                           # a motion file: positions, words, features
>>> store = kinedex.open_store(store_path)                     # an archive
>>> hits = store.rank(kinedex.Template.from_clip(take, 0, 30)) # which motions resemble the first second of the take?
>>> runs = store.runs("lknee_bent", min_seconds=0.5)           # when is the left knee bent?

docs/python.md shows ten tasks, docs/stability.md lists the interfaces that stay stable.
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
    from kinedex.library.annotation import Evaluation, annotate, evaluate
    from kinedex.library.labels import Labels
    from kinedex.library.new_takes import features, read
    from kinedex.library.pages import write_page
    from kinedex.library.pipeline import ingest, run_pipeline
    from kinedex.library.query import Query
    from kinedex.library.store import Store, open_store
    from kinedex.library.take import Take
    from kinedex.library.template import Difference, Picture, Template
    from kinedex.library.tracking import Reconstructor, reconstruct, stabilise, track
    from kinedex.ops.errors import ConfigError, KinedexError, ParameterError, SourceError, StoreError
    from kinedex.pipelines.engine.runner import Outcome

    __version__: str

__all__ = [
    "ConfigError",
    "Difference",
    "Evaluation",
    "FeatureSet",
    "KinedexError",
    "Labels",
    "Outcome",
    "ParameterError",
    "Picture",
    "Query",
    "Reconstructor",
    "SourceError",
    "Store",
    "StoreError",
    "Take",
    "Template",
    "__version__",
    "annotate",
    "evaluate",
    "features",
    "ingest",
    "load_feature_set",
    "open_store",
    "read",
    "reconstruct",
    "run_pipeline",
    "stabilise",
    "track",
    "write_page",
]

_HOMES = {
    "ConfigError": "ops.errors",
    "Difference": "library.template",
    "Evaluation": "library.annotation",
    "FeatureSet": "catalog.features",
    "KinedexError": "ops.errors",
    "Labels": "library.labels",
    "Outcome": "pipelines.engine.runner",
    "ParameterError": "ops.errors",
    "Picture": "library.template",
    "Query": "library.query",
    "Reconstructor": "library.tracking",
    "SourceError": "ops.errors",
    "Store": "library.store",
    "StoreError": "ops.errors",
    "Take": "library.take",
    "Template": "library.template",
    "annotate": "library.annotation",
    "evaluate": "library.annotation",
    "features": "library.new_takes",
    "ingest": "library.pipeline",
    "load_feature_set": "catalog.features",
    "open_store": "library.store",
    "read": "library.new_takes",
    "reconstruct": "library.tracking",
    "run_pipeline": "library.pipeline",
    "stabilise": "library.tracking",
    "track": "library.tracking",
    "write_page": "library.pages",
}
"""A dict from public name to module; modules are imported on first use, so that `import kinedex` is fast."""


def __getattr__(name: str) -> object:
    """Import a public name when it is first used (PEP 562)."""
    if name == "__version__":
        value: object = _installed_version()
    elif name in _HOMES:
        value = getattr(import_module(f"kinedex.{_HOMES[name]}"), name)
    else:
        raise AttributeError(f"module 'kinedex' has no attribute '{name}'")
    globals()[name] = value
    return value


def _installed_version() -> str:
    """Return the version of the installed distribution, or "0+unknown" if none is installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("kinedex")
    except PackageNotFoundError:
        return "0+unknown"


def __dir__() -> list[str]:
    """Return the public names, imported or not."""
    return sorted({*globals(), *__all__})
