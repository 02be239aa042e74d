"""What a stage is given to work with: the store, the executor, a terminal, and its place in the pipeline."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from pydantic import BaseModel

from kinedex.catalog.features import FeatureSet, load_feature_set
from kinedex.pipelines.console.terminal import Progress, Terminal
from kinedex.pipelines.engine.executors import Executor
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter

SHIPPED_FEATURES = "body40"


def feature_set_for(store: Store | None, given: str | None = None) -> FeatureSet:
    """The features that a stage speaks of: those given, else those of a store, else the shipped ones.

    A store that was made with the shipped set is held against today's text of it, so that a set that has changed since
    is noticed; of a set of the user's own the store knows all that is needed.

    Raises
    ------
    ConfigError: a file of features is wrong.
    """
    if given is None and store is not None and store.feature_set.name != SHIPPED_FEATURES:
        return store.feature_set
    return load_feature_set(given or SHIPPED_FEATURES)


@dataclass(frozen=True)
class StageContext:
    """One stage of one run of one pipeline.

    stage: the instance's name; uses: the kind of stage. run: the run's id, a column of every results row.
    inputs: role → the stage instance that plays it, for instance {"templates": "learn_templates"}.
    params: the validated parameters of every stage of the pipeline, by instance name, for stages that repeat another
    one's work.
    code: a hash of the sources that the stage runs, for stages that keep what they did before; empty where not known.
    anew: all is done again, whatever was done before (`--force`).
    """

    store_path: Path
    feature_set: FeatureSet
    pipeline: str
    stage: str
    run: str
    executor: Executor
    terminal: Terminal
    uses: str = ""
    inputs: dict[str, str] = field(default_factory=dict)
    params: dict[str, BaseModel] = field(default_factory=dict)
    code: str = ""
    anew: bool = False

    @property
    def report_dir(self) -> Path:
        """The folder of this pipeline's reports inside the store; made when asked for."""
        folder = self.store_path / "results" / "reports" / self.pipeline
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def report_file(self, name: str) -> Path:
        """Where a file of this stage's reports goes; a second stage of one kind puts its own name in front."""
        own = self.uses and self.stage != self.uses
        return self.report_dir / (f"{self.stage}.{name}" if own else name)

    def key(self, stage: str | None = None) -> str:
        """The name under which a stage instance of this pipeline is recorded: "<pipeline>/<stage>"."""
        return f"{self.pipeline}/{stage or self.stage}"

    def open(self) -> Store:
        """A read-only snapshot of the store as it stands now."""
        return open_store(self.store_path)

    def writer(self) -> StoreWriter:
        """The store's writer, a context manager that holds its lock."""
        return StoreWriter.open(self.store_path, self.feature_set)

    def progress(self, description: str, total: int | None = None) -> Progress:
        """A progress bar on the terminal; `advance(n)` moves it."""
        return self.terminal.progress(description, total)

    def say(self, text: str) -> None:
        """Print one line, below the stage's heading."""
        self.terminal.say(text)
