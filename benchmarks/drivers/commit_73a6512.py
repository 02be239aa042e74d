"""Do the work at commit 73a6512, which had a public API for pipelines alone: the rest is called inside of it."""

# ruff: noqa: I001, TID251
from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
from ops.distances.background import background
from ops.templates.templates import quantise
from ops.words import bits
from pipelines.annotation.annotating import annotate_takes
from pipelines.annotation.annotators import make_annotator
from pipelines.executors import make_executor
from pipelines.ingesting.analysis import analyse
from pipelines.retrieval.ranking import Searched, rank_store, ranking_table
from pipelines.searching.search import load_query_file, search_store
from pipelines.templates.templates import stored_templates
from pipelines.terminal import Terminal
from rich.console import Console
from storage.bodies import Body, read_body

import kinedex
from catalog.classes import load_classes
from catalog.features import load_feature_set
from catalog.skeletons import load_mappings


def read(path: Path) -> object:
    """Read a motion file to its positions and words, as the ingest read each file."""
    joints = load_feature_set().joints
    named = path.with_name(f"markers-{path.suffix[1:]}.yaml")  # names that exports have, and this commit does not know
    mappings = load_mappings(str(named) if named.is_file() else "auto", joints)
    asf = path.with_suffix(".asf") if path.suffix == ".amc" else None
    return analyse(read_body(path, asf, mappings, joints), load_feature_set(), 30.0)


def features(positions: npt.ArrayLike, orientation: npt.ArrayLike, rate_hz: float) -> object:
    """Compute the features of positions."""
    whole, turned = np.asarray(positions, np.float64), np.asarray(orientation, np.float64)
    body = Body(
        np.ascontiguousarray(whole.transpose(1, 2, 0)), np.ascontiguousarray(turned.T), rate_hz, "1 m", "", (), ()
    )
    return bits(analyse(body, load_feature_set(), rate_hz)[2], 40)


def run_pipeline(pipeline: str | Path, store: Path, source: Path) -> None:
    """Run a pipeline over a folder, in this process."""
    unseen = Terminal(Console(file=io.StringIO()))
    kinedex.run_pipeline(pipeline, store, assignments={"source": str(source)}, terminal=unseen)


def search(store: Path, queries: str) -> Callable[[], object]:
    """Return a search of an open store."""
    opened = kinedex.open_store(store)
    return lambda: search_store(opened, load_query_file(queries, opened.feature_set))


def rank(store: Path, learned: Path, top: int | None, tau: float) -> Callable[[], object]:
    """Return a ranking of an open store by all templates of another, in one thread."""
    opened = kinedex.open_store(store)
    templates = [one for one in stored_templates(kinedex.open_store(learned)) if one.one.kind == "soft"]

    def work() -> object:
        searched = [Searched(one.one.subclass, quantise(one.one.learned.template, 0.1)) for one in templates]
        return ranking_table(rank_store(opened, searched, tau, top, workers=1), opened.rate_hz)

    return work


def annotate(store: Path, learned: Path, method: str) -> Callable[[], object]:
    """Return an annotation of an open store by all templates of another."""
    opened, source = kinedex.open_store(store), kinedex.open_store(learned)
    templates = [one.one for one in stored_templates(source) if one.one.kind == "soft"]
    clips = source.words(source.takes("class IS NOT NULL")["take_id"].to_list())

    def work() -> object:
        usual = None
        if method == "best":
            usual = background([clips.take(i) for i in range(len(clips))], len(opened.feature_set.features))
        classes = load_classes("own", [one.subclass for one in templates])
        annotator = make_annotator(opened.feature_set, templates, classes, 0.05, 0.13, (), usual)
        return list(annotate_takes(opened.path, annotator, opened.takes(), make_executor("serial"), False))

    return work
