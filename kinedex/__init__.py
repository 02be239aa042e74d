"""kinedex: a motion archive that can be queried.

>>> take = kinedex.read(motion_file)                           # a motion file: positions, words, features
>>> store = kinedex.open_store(store_path)                     # an archive
>>> hits = store.rank(kinedex.Template.from_clip(take, 0, 30)) # what is like the first second of the take?
>>> runs = store.runs("lknee_bent", min_seconds=0.5)           # when is the left knee bent?

docs/python.md shows ten tasks, docs/stability.md documents what is stable.
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
    from kinedex.pipelines.api.annotation import Evaluation, annotate, evaluate
    from kinedex.pipelines.api.labels import Labels
    from kinedex.pipelines.api.new_takes import features, read
    from kinedex.pipelines.api.pages import write_page
    from kinedex.pipelines.api.picture import Picture
    from kinedex.pipelines.api.pipeline import ingest, run_pipeline
    from kinedex.pipelines.api.query import Query
    from kinedex.pipelines.api.reconstruction import Reconstructor, reconstruct
    from kinedex.pipelines.api.store import Store, open_store
    from kinedex.pipelines.api.take import Take
    from kinedex.pipelines.api.template import Difference, Template
    from kinedex.pipelines.api.tracking import stabilise, track
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
    "Difference": "pipelines.api.template",
    "Evaluation": "pipelines.api.annotation",
    "FeatureSet": "catalog.features",
    "KinedexError": "ops.errors",
    "Labels": "pipelines.api.labels",
    "Outcome": "pipelines.engine.runner",
    "ParameterError": "ops.errors",
    "Picture": "pipelines.api.picture",
    "Query": "pipelines.api.query",
    "Reconstructor": "pipelines.api.reconstruction",
    "SourceError": "ops.errors",
    "Store": "pipelines.api.store",
    "StoreError": "ops.errors",
    "Take": "pipelines.api.take",
    "Template": "pipelines.api.template",
    "annotate": "pipelines.api.annotation",
    "evaluate": "pipelines.api.annotation",
    "features": "pipelines.api.new_takes",
    "ingest": "pipelines.api.pipeline",
    "load_feature_set": "catalog.features",
    "open_store": "pipelines.api.store",
    "read": "pipelines.api.new_takes",
    "reconstruct": "pipelines.api.reconstruction",
    "run_pipeline": "pipelines.api.pipeline",
    "stabilise": "pipelines.api.tracking",
    "track": "pipelines.api.tracking",
    "write_page": "pipelines.api.pages",
}
"""The module of each public name; it is imported when the name is first used, so that `import kinedex` is quick."""


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
    """Return the version of the installed distribution; that of an unknown one is 0."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("kinedex")
    except PackageNotFoundError:
        return "0+unknown"


def __dir__() -> list[str]:
    """Return the public names, imported or not."""
    return sorted({*globals(), *__all__})
