"""Stabilise takes of a store for a command, with the templates and examples in the store."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.code_digest import code_digest
from kinedex.pipelines.engine.display import Display
from kinedex.pipelines.engine.executors import Executor
from kinedex.pipelines.engine.run_id import new_run_id
from kinedex.pipelines.engine.stage import load_stage
from kinedex.pipelines.recordings.runs import Outcome, Place, renew_index
from kinedex.pipelines.templates.learning import SubclassTemplate, TrainingClips, learn_templates
from kinedex.pipelines.templates.stored_templates import stored_templates
from kinedex.pipelines.templates.training import TemplateParameters, training_material
from kinedex.pipelines.tracking.parameters import StabiliseParameters, TrackParameters
from kinedex.pipelines.tracking.runs import Archive, require_takes, stabilise
from kinedex.pipelines.tracking.tracked_takes import stabilised_name
from kinedex.storage.lock import NO_WAIT, Wait
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter

STAGE = "stabilise/stabilise"
"""The stage of the results: that of the shipped pipeline, so that pipeline and command share results."""


@dataclass(frozen=True)
class Explanation:
    """The priors of one stabilised take.

    Attributes
    ----------
    take : str
        The take that was stabilised.
    stabilised : str
        The resulting take.
    priors : pyarrow.Table
        Its rows of `priors`.
    row : dict
        Its row of `tracks`.
    moved_mm : float
        The mean distance by which joints were moved, in millimetres.
    """

    take: str
    stabilised: str
    priors: pa.Table
    row: dict[str, Any]
    moved_mm: float


def stabilise_stored(
    path: Path,
    takes: Sequence[str],
    params: StabiliseParameters,
    tracker: TrackParameters,
    executor: Executor,
    terminal: Display,
    wait: Wait = NO_WAIT,
    anew: bool = False,
) -> Outcome:
    """Stabilise takes of a store, and commit each.

    Parameters
    ----------
    path : Path
        The store.
    takes : sequence of str
        The takes.
    params : StabiliseParameters
        The priors.
    tracker : TrackParameters
        The tracker.
    executor : Executor
        Spreads takes over workers.
    terminal : Display
        Shows messages and progress.
    wait : Wait, optional
        The time to wait for another writer.
    anew : bool, optional
        True to stabilise takes that are up to date as well.

    Raises
    ------
    KinedexError
        A take is not in the store, or the store has no templates and nothing to learn them from.
    """
    opened = open_store(path, at="newest")
    require_takes(opened, takes)
    code = code_digest(type(load_stage("stabilise")))  # the same digest as in the pipeline
    place = Place(STAGE, new_run_id(), executor, terminal.say, terminal.progress, code, anew)
    with StoreWriter.open(path, opened.feature_set, opened.rate_hz, wait) as writer:
        archive = store_archive(writer.store, params, executor)
        done = stabilise(writer, params, tracker, list(dict.fromkeys(takes)), archive, place)
    renew_index(path, wait)
    return done


def store_archive(store: Store, params: StabiliseParameters, executor: Executor) -> Archive:
    """Return the templates of a store, or those learned from its takes with a class, with their example clips."""
    stored = stored_templates(store) if store.manifest.results.get("templates") else []
    found = [one.one for one in stored if one.one.kind == params.templates]
    try:
        clips = training_material(store, TemplateParameters.model_validate({})).clips
    except KinedexError:
        if not found:
            raise KinedexError(
                f"{store.path} has neither templates nor takes whose class is known, so that nothing can lend priors; "
                "ingest example clips with a pattern that names their class, as in: kinedex ingest "
                f"{shlex.quote(str(store.path))} CLIPS --set \"ingest.patterns=['(?P<class>[^/]+)/']\". Without an "
                "archive, `kinedex track` smooths a take and fills its gaps: a recordings file with `track: TAKE`"
            ) from None
        clips = []
    if found:
        return Archive(found, _learned_from(found, clips))
    learned = learn_templates(clips, [params.templates], len(store.feature_set.features), executor)
    return Archive(sorted((one for group in learned for one in group), key=lambda one: one.subclass), clips)


def _learned_from(templates: Sequence[SubclassTemplate], clips: Sequence[TrainingClips]) -> list[TrainingClips]:
    """Return the clips that templates were learned from; all clips of a class whose template names none."""
    names = {one.subclass: {*one.clips} for one in templates}
    chosen = []
    for one in clips:
        own = [at for at, name in enumerate(one.names) if name in names.get(one.subclass, ())]
        if own and len(own) < len(one.names):
            parts = {key: tuple(getattr(one, key)[at] for at in own) for key in ("names", "words", "takes")}
            one = replace(one, names=parts["names"], words=parts["words"], takes=parts["takes"])
        chosen.append(one)
    return chosen


def explanations(store: Store, takes: Sequence[str]) -> list[Explanation]:
    """Return the priors of stabilised takes, given the names before stabilisation."""
    found = []
    for take in takes:
        name = stabilised_name(take)
        rows = {kind: _rows(store, kind, name) for kind in ("tracks", "priors", "track_frames")}
        moved = [sum(one) / len(one) for one in rows["track_frames"].column("moved_mm").to_pylist() if one]
        priors = rows["priors"].drop_columns(["run", "take_id", "take"])
        row = rows["tracks"].to_pylist()[0]
        found.append(Explanation(take, name, priors, row, sum(moved) / len(moved) if moved else 0.0))
    return found


def _rows(store: Store, kind: str, take: str) -> pa.Table:
    """Return the rows of a take in the results that the command and the shipped pipeline share."""
    parts = [part for part in store.manifest.results.get(kind, ()) if part.stage == STAGE]
    tables = [one.filter(pc.equal(one.column("take"), take)) for one in store.result_pieces(kind, parts)]
    return pa.concat_tables([result_schema(kind).empty_table(), *tables])
