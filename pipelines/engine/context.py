"""The context that a stage runs in: the store, the executor, the display, and the stage's place in its pipeline."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import pyarrow as pa
from pydantic import BaseModel

from kinedex.catalog.features import FeatureSet, load_feature_set
from kinedex.pipelines.engine.display import Display, ProgressBar
from kinedex.pipelines.engine.executors import Executor
from kinedex.storage.lock import NO_WAIT, Wait
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter

if TYPE_CHECKING:
    from kinedex.pipelines.labels.unmatched_labels import UnmatchedLabels

Parameters = TypeVar("Parameters", bound=BaseModel)

SHIPPED_FEATURES = "body40"

_log = logging.getLogger("kinedex.stages")


def feature_set_for(store: Store | None, given: str | None = None) -> FeatureSet:
    """Return the feature set that a stage works with: the given set, else that of the store, else the shipped set.

    A store that was made with the shipped set gets the currently shipped set, so that a change of the shipped set is
    noticed. A store that was made with a user's set keeps this set.

    Parameters
    ----------
    store : Store or None
        The store, where it exists.
    given : str or None
        The feature set that the user has named: a shipped name, or a path to a .yaml file.

    Raises
    ------
    ConfigError
        A feature file is not valid.
    """
    if given is None and store is not None and store.feature_set.name != SHIPPED_FEATURES:
        return store.feature_set
    return load_feature_set(given or SHIPPED_FEATURES)


@dataclass(frozen=True)
class StageContext:
    """One stage in one run of a pipeline.

    Attributes
    ----------
    store_path : Path
        The directory of the store.
    feature_set : FeatureSet
        The features of the store, or those that it will have.
    pipeline : str
        The name of the pipeline.
    stage : str
        The name of the stage in the pipeline.
    run : str
        The id of the run; a column of every row of results.
    executor : Executor
        Spreads tasks over workers.
    terminal : Display
        Shows messages, tables and progress.
    uses : str
        The kind of stage.
    inputs : dict of str to str
        Input role → the name of the stage that fills it, such as {"templates": "learn_templates"}.
    params : dict of str to BaseModel
        The validated parameters of every stage of the pipeline, by its name there.
    code : str
        A hash of the code that the stage runs, for stages that reuse earlier work; empty if unknown.
    anew : bool
        True if everything is to be done again, including work that is up to date (`--force`).
    wait : Wait
        The time to wait for another writer.
    unmatched : list of UnmatchedLabels
        The labels of files that match no take, as far as the stage has reported them.
    """

    store_path: Path
    feature_set: FeatureSet
    pipeline: str
    stage: str
    run: str
    executor: Executor
    terminal: Display
    uses: str = ""
    inputs: dict[str, str] = field(default_factory=dict)
    params: dict[str, BaseModel] = field(default_factory=dict)
    code: str = ""
    anew: bool = False
    wait: Wait = NO_WAIT
    unmatched: list[UnmatchedLabels] = field(default_factory=list)

    def params_of(self, role: str, kind: type[Parameters]) -> Parameters:
        """Return the parameters of the stage that fills an input role."""
        params = self.params[self.inputs[role]]
        assert isinstance(params, kind)
        return params

    @property
    def report_dir(self) -> Path:
        """The folder of this pipeline's reports inside the store; it is created on access."""
        folder = self.store_path / "results" / "reports" / self.pipeline
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def report_file(self, name: str) -> Path:
        """Return the path of a report; the stage's name is prefixed if it differs from the name of its kind."""
        own = self.uses and self.stage != self.uses
        return self.report_dir / (f"{self.stage}.{name}" if own else name)

    def key(self, stage: str | None = None) -> str:
        """Return the key of a stage's record in the store, "<pipeline>/<stage>"."""
        return f"{self.pipeline}/{stage or self.stage}"

    def open(self) -> Store:
        """Return a read-only snapshot of the store as it is now."""
        return open_store(self.store_path, at="newest")

    def writer(self) -> StoreWriter:
        """Return the store's writer, a context manager that holds its lock."""
        return StoreWriter.open(self.store_path, self.feature_set, wait=self.wait)

    def put_results(self, **tables: pa.Table | Iterable[pa.Table]) -> None:
        """Store the results of the stage in one commit: one table, or several pieces of a table, for each kind."""
        with self.writer() as writer:
            for kind, table in tables.items():
                writer.put_results(kind, table, stage=self.key(), run=self.run)
            writer.commit()

    def report_unmatched(self, found: Iterable[UnmatchedLabels]) -> None:
        """Record labels of files that match no take; the run lists them at its end and exits with status 3.

        Every stage that reads label files calls this, and shows its own messages about them.
        """
        self.unmatched.extend(found)

    def progress(self, description: str, total: int | None = None) -> ProgressBar:
        """Return a progress bar, to be used in a `with` statement."""
        return self.terminal.progress(description, total)

    def message(self, *texts: str) -> None:
        """Show lines below the heading of the stage, and log them."""
        fields = {"pipeline": self.pipeline, "stage": self.stage, "store": str(self.store_path), "run_id": self.run}
        for text in texts:
            _log.info("%s", text, extra={**fields, "event": "message"})
            self.terminal.message(text)
