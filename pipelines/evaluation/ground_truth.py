"""Ground truth: parameters select label files or classes of takes, whose segments are assigned to evaluated takes."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import polars as pl
import pyarrow as pa
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.classes import Classes
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.wording import name_list
from kinedex.pipelines.engine.digests import files_digest
from kinedex.pipelines.engine.file_parameters import NamesFile
from kinedex.pipelines.labels.file_segments import edges_in, with_take_names
from kinedex.pipelines.labels.unmatched_labels import UnmatchedLabels, unmatched_labels
from kinedex.storage.formats.labels.file_labels import LabelFile, ManualSegment
from kinedex.storage.formats.labels.formats import any_ground_truth, ground_truth_files, read_labels
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store

Statement = tuple[str, str, int, int]
"""A take, a class, and the source frames [start, stop) of a segment."""

UnknownLabels = Literal["error", "miss", "ignore"]


NONE, OWN_CLASS = "none", "class"


class GroundTruthParameters(BaseModel):
    """The parameters that select ground truth."""

    model_config = ConfigDict(extra="forbid")

    ground_truth: str = Field(
        "**/ground_truth.csv",
        description="label files, read by their ending: .csv (take, class, start, stop in source frames), .json, "
        ".eaf (ELAN), .vtt (WebVTT), .txt (Audacity); a glob below the takes' source folders, or an absolute path; "
        "'class': each take's own class for all of it; 'none': there is none. Where none is given and this one finds "
        "no file, takes that have a class, such as one that their paths name, are evaluated by it as with 'class'",
    )
    source: Annotated[str | None, NamesFile("data")] = Field(
        None, description="the folder that ground_truth is relative to; by default the takes' source folders"
    )
    unknown_labels: UnknownLabels = Field(
        "error",
        description="a label that is neither a class nor a subclass: 'error'; 'miss' counts it as not found; 'ignore' "
        "excludes it, and reports that",
    )


@dataclass(frozen=True)
class Manual:
    """A manual segment on a take of the store, in analysis frames [start, stop), with its class."""

    take_id: int
    take: str
    label: str
    start: int
    stop: int
    source_start: int
    source_stop: int
    origin: str

    @property
    def statement(self) -> Statement:
        """The take, class and source frames of the segment; segments with equal statements count once."""
        return self.take, self.label, self.source_start, self.source_stop


@dataclass(frozen=True)
class GroundTruth:
    """The manual segments of the evaluated takes.

    Attributes
    ----------
    segments : tuple of Manual
        The segments.
    takes : tuple of str
        The names of the takes, sorted; a take without a segment (it was labelled as empty, or all of its labels are
        excluded) has nothing to find.
    remarks : tuple of str
        Remarks on labels and takes that were excluded.
    unmatched : tuple of UnmatchedLabels
        The labels that match no take, file by file.
    """

    segments: tuple[Manual, ...]
    takes: tuple[str, ...]
    remarks: tuple[str, ...] = ()
    unmatched: tuple[UnmatchedLabels, ...] = ()


def place_ground_truth(
    files: Sequence[LabelFile],
    takes: pl.DataFrame,
    archive: Iterable[str],
    classes: Classes,
    unknown_labels: UnknownLabels = "error",
) -> GroundTruth:
    """Assign manual segments of label files to the annotated takes, in analysis frames.

    A take that a file names without any segment is evaluated as one with nothing to find. Segments with the same class,
    start and stop (in source frames) count once, even if they are in several files.

    Parameters
    ----------
    files : sequence of LabelFile
        Segments in source frames, or in seconds, which are rounded to source frames; touching ones stay separate.
    takes : polars.DataFrame
        Rows of the annotated takes.
    archive : iterable of str
        The names of all takes of the store.
    classes : Classes
        The classes of the evaluation.
    unknown_labels : {"error", "miss", "ignore"}
        The treatment of a label that is neither a class nor a subclass: raise an error; count it as missed; or
        exclude it with a remark, and evaluate its take nevertheless.

    Raises
    ------
    SourceError
        A segment ends beyond its take.
    KinedexError
        A label is unknown, or no take of the files was annotated.
    """
    by_name = {row["name"]: row for row in takes.iter_rows(named=True)}
    known_takes = set(archive)
    here = [segment for file in files for segment in file.segments if segment.take in by_name]
    looked_at = {take for file in files for take in file.takes}
    absent = sorted(looked_at - known_takes)
    unmatched = unmatched_labels(files, known_takes)
    remarks = list(map(str, unmatched))
    evaluated = looked_at & set(by_name)
    if not evaluated:
        count = sum(len(file.segments) for file in files)
        hint = did_you_mean(absent[0], known_takes) if absent else "; none of its takes was annotated"
        raise KinedexError(
            f"none of the {count} manual segments is on a take that was annotated"
            + (f": no take is named '{absent[0]}'{hint}" if absent else hint)
        )
    silent = sorted(set(by_name) - evaluated)
    if silent:
        remarks.append(f"annotated takes without ground truth, not evaluated: {name_list(silent)}")
    labels = _labels(here, classes, unknown_labels)
    remarks += _of_no_class(labels, classes)
    empty = sorted(evaluated - {segment.take for segment in here})
    if empty:
        text = "takes of label files that have no segment of them, in which nothing is to be found"
        remarks.append(f"{text}: {name_list(empty)}")
    known = [
        (manual, segment.where)
        for segment in here
        if (manual := _placed(segment, by_name[segment.take], labels[segment.label])) is not None
    ]
    firsts: dict[Statement, Manual] = {}
    once = [(manual, where) for manual, where in known if firsts.setdefault(manual.statement, manual) is manual]
    placed = [manual for manual, _ in once if manual.start < manual.stop]
    between = [where for manual, where in once if manual.start >= manual.stop]
    remarks += [f"{where}: no analysis frame lies in this segment, excluded" for where in between]
    remarks += _of_several_files(files, [manual for manual, _ in known], firsts, evaluated)
    bare = sorted(evaluated - {segment.take for segment in placed} - set(empty))
    if bare:
        remarks.append(f"takes in which nothing is left to be found, evaluated as such: {name_list(bare)}")
    return GroundTruth(tuple(placed), tuple(sorted(evaluated)), tuple(remarks), unmatched)


def _of_no_class(labels: Mapping[str, str | None], classes: Classes) -> list[str]:
    """Return remarks on labels that belong to no class."""
    ignored = sorted(label for label, name in labels.items() if name is None)
    missed = sorted(label for label, name in labels.items() if name == label and classes.class_of(label) is None)
    treated = [("excluded", ignored), ("counted as missed", missed)]
    return [f"labels of no class, {how}: {name_list(names)}" for how, names in treated if names]


def _of_several_files(
    files: Sequence[LabelFile],
    segments: Sequence[Manual],
    firsts: Mapping[Statement, Manual],
    evaluated: Container[str],
) -> list[str]:
    """Return remarks on repeated segments, and on takes that several files label differently.

    `firsts` has the first segment of each statement.
    """
    pairs = ((firsts[one.statement], one) for one in segments)
    again = Counter((first.origin, one.origin) for first, one in pairs if first is not one)
    remarks = []
    if again:
        doubles = [f"{n} in {b} " + ("itself" if a == b else f"that {a} has as well") for (a, b), n in again.items()]
        remarks.append(f"the same segments again, counted once: {name_list(doubles)}")
    by_take: dict[str, dict[str, set[Statement]]] = defaultdict(dict)
    for file in files:
        for take in file.takes:
            by_take[take][file.path] = set()
    for one in segments:
        by_take[one.take][one.origin].add(one.statement)
    unlike = [
        f"{take} ({', '.join(of_file)})"
        for take, of_file in sorted(by_take.items())
        if take in evaluated and len({frozenset(own) for own in of_file.values()}) > 1
    ]
    if unlike:
        remarks.append(f"takes that files label differently, all of it counted: {name_list(unlike)}")
    return remarks


def ground_truth_of_classes(takes: pl.DataFrame, classes: Classes) -> GroundTruth:
    """Return the class of each take as the ground truth of all of its frames.

    Raises
    ------
    KinedexError
        No take has a class.
    """
    labelled = takes.filter(pl.col("class").is_not_null())
    known = [(row, classes.class_of(row["class"])) for row in labelled.iter_rows(named=True)]
    if not known:
        raise KinedexError("none of the annotated takes has a class; ground_truth must be a CSV file instead")
    segments = [
        Manual(row["take_id"], row["name"], name, 0, row["frames"], 0, row["source_frames"], "take class")
        for row, name in known
        if name is not None
    ]
    remarks = []
    if labelled.height < takes.height:
        remarks.append(f"{takes.height - labelled.height} annotated takes have no class and are not evaluated")
    outside = sorted({row["class"] for row, name in known if name is None})
    if outside:
        remarks.append(f"takes of subclasses in no class, not evaluated: {name_list(outside)}")
    return GroundTruth(tuple(segments), tuple(sorted(segment.take for segment in segments)), tuple(remarks))


def _labels(segments: Sequence[ManualSegment], classes: Classes, unknown: UnknownLabels) -> dict[str, str | None]:
    """Return the class of each label, or None if it is excluded."""
    result: dict[str, str | None] = {}
    for segment in segments:
        name = classes.class_of(segment.label)
        if name is None and unknown == "error":
            labels = {*classes.names, *classes.of_subclass()}
            fault = segment.error(
                f"'{segment.label}' is neither a class nor a subclass of this evaluation"
                f"{did_you_mean(segment.label, labels)} (`unknown_labels: miss` counts it as missed, `ignore` leaves "
                "it out; where labels name classes of several subclasses, `--set classes=FILE` names them)"
            )
            fault.way_out = ("unknown_labels", "miss")
            raise fault
        result[segment.label] = segment.label if name is None and unknown == "miss" else name
    return result


def _placed(segment: ManualSegment, take: Mapping[str, Any], label: str | None) -> Manual | None:
    (first, start), (last, stop) = edges_in(segment, take)
    if label is None:
        return None
    return Manual(take["take_id"], segment.take, label, start, stop, first, last, segment.path)


def ground_truth_rows(truth: GroundTruth, run: str) -> pa.Table:
    """Return ground truth as results of the kind `ground_truth`, sorted by take and start."""
    ordered = sorted(truth.segments, key=lambda one: (one.take, one.start, one.stop, one.label))
    rows = [{**vars(one), "run": run, "class": one.label} for one in ordered]
    return pa.Table.from_pylist(rows, schema=result_schema("ground_truth"))


def ground_truth_digest(params: GroundTruthParameters, store: Store | None) -> str:
    """Return a hash of the label files.

    If the files cannot be found, the hash is a constant, so that the stage runs and reports the error.
    """
    if params.ground_truth in (NONE, OWN_CLASS):
        return ""
    known: set[str] = set(store.takes()["source_root"]) if store else set()
    roots = sorted(root for root in known if Path(root).is_dir())
    try:
        if not_labelled(params, roots):
            return "nobody's labels"
        return files_digest(truth_files(params, roots))
    except KinedexError:
        return "none to be read"


def with_own_classes(params: GroundTruthParameters, takes: pl.DataFrame) -> GroundTruthParameters:
    """Return parameters that evaluate takes by their own classes if no other ground truth is given or found.

    Parameters
    ----------
    params : GroundTruthParameters
        The parameters; returned unchanged if they give a ground truth, a file matches the default, or no take
        has a class.
    takes : polars.DataFrame
        Rows of the annotated takes.
    """
    if "ground_truth" in params.model_fields_set or not takes["class"].is_not_null().any():
        return params
    if any_ground_truth(params.ground_truth, _roots(params, takes["source_root"].unique())):
        return params
    return params.model_copy(update={"ground_truth": OWN_CLASS})


def not_labelled(params: GroundTruthParameters, roots: Iterable[str]) -> bool:
    """Return whether takes have no ground truth: "none" is given, or nothing is given and no file matches the default.

    Parameters
    ----------
    params : GroundTruthParameters
        The parameters.
    roots : iterable of str
        The source folders of the takes.
    """
    if params.ground_truth == NONE:
        return True
    if "ground_truth" in params.model_fields_set or params.ground_truth == OWN_CLASS:
        return False
    return not any_ground_truth(params.ground_truth, _roots(params, roots))


def ground_truth(store: Store, params: GroundTruthParameters, takes: pl.DataFrame, classes: Classes) -> GroundTruth:
    """Read the ground truth of takes and assign it to them."""
    if params.ground_truth == OWN_CLASS:
        return ground_truth_of_classes(takes, classes)
    paths = truth_files(params, takes["source_root"].unique())
    files, remarks = with_take_names(store, list(map(read_labels, paths)))
    truth = place_ground_truth(files, takes, store.takes()["name"], classes, params.unknown_labels)
    return replace(truth, remarks=(*remarks, *truth.remarks))


def truth_files(params: GroundTruthParameters, roots: Iterable[str]) -> list[Path]:
    """Return the label files below `source`, or by default below the source folders of takes."""
    return ground_truth_files(params.ground_truth, _roots(params, roots))


def _roots(params: GroundTruthParameters, roots: Iterable[str]) -> Sequence[str]:
    return [params.source] if params.source else sorted(roots)
