"""Read people's labels of wrong limbs and assign them to takes; return those of a stage for label files."""

from __future__ import annotations

import shlex
from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from kinedex.catalog.limbs import LIMB_NAMES
from kinedex.ops.errors import KinedexError, SourceError, did_you_mean
from kinedex.ops.intervals import source_frame
from kinedex.ops.wording import counted, name_list
from kinedex.pipelines.inertial.limb_error_curves import ERRORS, RUNS, JudgedLimb, judged_limbs
from kinedex.pipelines.labels.file_segments import with_take_names
from kinedex.pipelines.labels.unmatched_labels import UnmatchedLabels, unmatched_labels
from kinedex.storage.formats.labels.file_labels import ERROR, Label, LabelFile, LabelsOfTake, ManualSegment
from kinedex.storage.formats.labels.formats import read_labels
from kinedex.storage.snapshot.stored_labels import is_of_limbs
from kinedex.storage.snapshot.visible_results import pipeline_of, pipelines_by_use
from kinedex.storage.store.store import Store

UNNAMED = "unnamed"
"""The annotator of labels that name none."""

WITHOUT_LIMBS = {".vtt": "WebVTT", ".txt": "Audacity labels"}
"""File endings of the label formats that cannot store a limb."""


@dataclass(frozen=True)
class LimbLabels:
    """The labels of limb errors in label files, or in a store.

    Attributes
    ----------
    segments : dict of (str, str, str) to list of ManualSegment
        Annotator, take and limb → the segments.
    looked_at : dict of str to set of str
        Annotator → the takes that the annotator has examined: those that the annotator's files or labels name.
    remarks : list of str
        Remarks on excluded labels, and on labels that belong to several takes.
    unmatched : tuple of UnmatchedLabels
        The labels of files that match no take.
    """

    segments: dict[tuple[str, str, str], list[ManualSegment]] = field(default_factory=dict)
    looked_at: dict[str, set[str]] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)
    unmatched: tuple[UnmatchedLabels, ...] = ()

    @property
    def annotators(self) -> list[str]:
        """The names of the annotators, sorted."""
        return sorted(self.looked_at)


def read_limb_labels(store: Store, paths: Iterable[Path]) -> LimbLabels:
    """Read labels of limb errors from label files.

    Parameters
    ----------
    store : Store
        The store of the takes that the files name.
    paths : iterable of Path
        CSV or JSON files with `limb`, or ELAN files with a tier for each limb.

    Raises
    ------
    SourceError
        A file is damaged, its format has no place for limbs, or a label of the class `error` names no known limb.
    """
    files: list[LabelFile] = []
    for path in paths:
        form = WITHOUT_LIMBS.get(path.suffix.lower())
        if form is not None:
            raise SourceError(
                path, f"{form} has no place for the limb of a label; use CSV or JSON with `limb`, or ELAN with tiers "
                "named after limbs, such as lshank or A1:lshank"
            )  # fmt: skip
        files.append(read_labels(path))
    files, remarks = with_take_names(store, files)
    unmatched = unmatched_labels(files, store.take_ids)
    labels = LimbLabels(remarks=[*remarks, *map(str, unmatched)], unmatched=unmatched)
    others = set[str]().union(*(_add(labels, file) for file in files))
    if others:
        labels.remarks.append(f"labels of other classes than {ERROR} are excluded: {name_list(sorted(others))}")
    return labels


def _add(labels: LimbLabels, file: LabelFile) -> set[str]:
    """Add the labels of a file; return the classes other than `error` in it."""
    own = [one for one in file.segments if one.label == ERROR]
    for one in own:
        if one.limb not in LIMB_NAMES:
            raise one.error(_unknown_limb(one))
        place = (one.annotator or UNNAMED, one.take, one.limb)
        labels.segments.setdefault(place, []).append(one)
    # a file without labels shows that somebody has examined its takes
    for annotator, takes in (file.looked_at or {"": set(file.takes)}).items():
        labels.looked_at.setdefault(annotator or UNNAMED, set()).update(takes)
    return {one.label for one in file.segments} - {ERROR}


def stored_limb_labels(store: Store) -> LimbLabels:
    """Return the labels of limb errors in a store.

    Raises
    ------
    KinedexError
        A label names a limb that does not exist.
    """
    labels = LimbLabels()
    rows = {str(row["name"]): row for row in store.takes().iter_rows(named=True)}
    changed = set()
    for one in filter(is_of_limbs, store.labels().to_pylist()):
        take, annotator = one["take"], one["annotator"] or UNNAMED
        if take not in rows:
            continue
        labels.looked_at.setdefault(annotator, set()).add(take)
        if one["checksum"] not in (None, rows[take]["checksum"]):
            changed.add(take)
        if one["verdict"] == "positive":
            rates = rows[take]["source_rate_hz"], rows[take]["rate_hz"], rows[take]["source_frames"]
            start, stop = (source_frame(one[edge], *rates) for edge in ("start", "stop"))
            segment = ManualSegment(
                take, ERROR, start, stop, one["source"] or f"label {one['id']}", limb=one["limb"], annotator=annotator
            )
            if one["limb"] not in LIMB_NAMES:
                remove = f"`kinedex labels remove {shlex.quote(str(store.path))} {one['id']}` takes the label back"
                raise KinedexError(f"label {one['id']} of {take}: {_unknown_limb(segment)}; {remove}")
            labels.segments.setdefault((annotator, take, one["limb"]), []).append(segment)
    if changed:
        labels.remarks.append(
            f"labels may have moved, since files were changed after they were labelled: {name_list(sorted(changed))}"
        )
    return labels


def _unknown_limb(one: ManualSegment) -> str:
    if one.limb:
        hint = did_you_mean(one.limb, LIMB_NAMES)
        return f"no limb is named '{one.limb}'{hint}; the limbs are {', '.join(LIMB_NAMES)}"
    return (
        f"the label '{ERROR}' names no limb; CSV and JSON have `limb` for it, in ELAN the tier is named after the "
        "limb, such as lshank, or after annotator and limb, such as A1:lshank"
    )


@dataclass(frozen=True)
class PlacedLabel:
    """A label in the source frames [start, stop) of an evaluated limb."""

    judged: JudgedLimb
    annotator: str
    start: int
    stop: int
    file: str


def placed_labels(labels: LimbLabels, take: Sequence[JudgedLimb]) -> list[PlacedLabel]:
    """Return the distinct labels of a take's evaluated limbs, sorted by annotator, limb and start.

    Raises
    ------
    SourceError
        A label ends beyond its take.
    """
    found: dict[tuple[str, str, int, int], PlacedLabel] = {}
    for annotator in labels.annotators:
        for judged in take:
            for one in labels.segments.get((annotator, judged.take, judged.limb), ()):
                start, stop = one.source_frames(judged.rate_hz)
                if one.in_seconds and stop == len(judged.error) + 1:
                    stop -= 1  # the last frame ends half a frame before the time, which is rounded up
                if stop > len(judged.error):
                    length = counted(len(judged.error), "source frame")
                    raise one.error(f"the label ends at source frame {stop}, beyond {judged.take}, which has {length}")
                if start < stop:
                    place = (annotator, judged.limb, start, stop)
                    found.setdefault(place, PlacedLabel(judged, annotator, start, stop, one.path))
    return [found[place] for place in sorted(found)]


def unused_labels(labels: LimbLabels, judged: Collection[tuple[str, str]], takes: Collection[str]) -> list[str]:
    """Return the remarks of `labels`, and further ones on takes or limbs that have labels or sensors, but not both.

    Parameters
    ----------
    labels : LimbLabels
        The labels.
    judged : collection of (str, str)
        The takes and limbs that were compared with sensors.
    takes : collection of str
        The takes that were compared with sensors.
    """
    named = {take for looked_at in labels.looked_at.values() for take in looked_at}
    named -= {take for one in labels.unmatched for take in one.takes}
    limbs = sorted(
        {f"{take} {limb}" for _, take, limb in labels.segments if take in takes and (take, limb) not in judged}
    )
    remarks = [*labels.remarks]
    if named - set(takes):
        remarks.append(f"labels of takes without sensors are excluded: {name_list(sorted(named - set(takes)))}")
    if limbs:
        remarks.append(f"labels of limbs without sensors are excluded: {name_list(limbs)}")
    silent = sorted(set(takes) - named)
    if silent:
        remarks.append(f"takes with sensors that nobody has labelled are not evaluated: {name_list(silent)}")
    return remarks


def limb_error_stage(store: Store, wanted: str | None = None) -> str:
    """Return the stage whose intervals of wrong limbs the user has requested.

    Parameters
    ----------
    store : Store
        The store to read.
    wanted : str, optional
        "<pipeline>/<stage>", the name of the pipeline, or the id of the run; by default, the stage of the pipeline that
        the view `limb_error_runs` shows.

    Raises
    ------
    KinedexError
        No limb was compared with a sensor, or none by this stage, or several stages match.
    """
    stages = sorted({part.stage for part in store.manifest.results.get(ERRORS, ())})
    if not stages:
        command = f"kinedex run limb-errors --store {shlex.quote(str(store.path))} --set source=… --set recordings=…"
        raise KinedexError(f"{store.path}: no limb was compared with a sensor; `{command}` does it")
    asked = wanted or next(name for name in pipelines_by_use(store.manifest) if name in map(pipeline_of, stages))
    records = store.manifest.stages
    fitting = [
        name
        for name in stages
        if asked in (name, pipeline_of(name)) or (name in records and asked == records[name].run)
    ]
    if not fitting:
        raise KinedexError(f"no stage '{asked}' has compared limbs with sensors{did_you_mean(asked, stages)}")
    if len(fitting) > 1:
        raise KinedexError(
            f"several stages of '{asked}' have compared limbs with sensors: {name_list(fitting)}; choose one with "
            "--stage"
        )
    return fitting[0]


def limb_error_labels(
    store: Store, stage: str, takes: Sequence[str] = (), where: str | None = None
) -> list[LabelsOfTake]:
    """Return the runs in which limbs are wrong as labels of the class `error`, for each take; jumps are excluded.

    All compared limbs are listed as covered, so that label files also show the limbs without such a run.

    Parameters
    ----------
    store : Store
        The store to read.
    stage : str
        "<pipeline>/<stage>".
    takes : sequence of str
        The names of the takes to return; by default all takes that have sensors.
    where : str, optional
        A SQL filter over the columns of takes.

    Raises
    ------
    KinedexError
        A take was not compared with sensors, or the filter selects no take that was compared.
    """
    record = store.manifest.stages.get(stage)
    runs: dict[str, list[Label]] = defaultdict(list)
    for row in store.result(RUNS, stage=stage).to_pylist():
        if row["kind"] == "distance":
            runs[row["take"]].append(Label(ERROR, row["start"], row["stop"], limb=row["limb"]))
    live = {str(row["name"]) for row in store.takes(where).iter_rows(named=True)}
    found: dict[str, LabelsOfTake] = {}
    for limbs in judged_limbs(store, stage):
        one = limbs[0]
        own = tuple(sorted(runs[one.take], key=lambda label: (label.start, label.stop, label.limb)))
        made = LabelsOfTake.made if record is None else record.finished
        covered = tuple((judged.limb, "") for judged in limbs)
        found[one.take] = LabelsOfTake(one.take, one.rate_hz, len(one.error), own, made, covered)
    unknown = sorted(set(takes) - set(found))
    if unknown:
        raise KinedexError(
            f"stage {stage} did not compare '{unknown[0]}' with sensors{did_you_mean(unknown[0], found)}"
        )
    chosen = [found[name] for name in sorted(found) if name in live and (not takes or name in takes)]
    if not chosen:
        raise KinedexError(f"{store.path}: no take that stage {stage} has compared with sensors is selected")
    return chosen
