"""Annotate takes with templates, and evaluate annotations; input and output are data frames."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl

from kinedex.catalog.classes import OWN, Classes, MotionClass, load_classes
from kinedex.library.arguments import checked
from kinedex.library.query import Query, resolved_queries
from kinedex.library.store import Store
from kinedex.library.take import Take
from kinedex.library.template import Template
from kinedex.ops.arrays import F64
from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted
from kinedex.ops.words import ALL_KNOWN, NO_WORD, TakeWords
from kinedex.pipelines.annotation.annotation_tables import annotations_table
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator
from kinedex.pipelines.annotation.batches import TakeAnnotation, annotate_words, split_takes
from kinedex.pipelines.annotation.confidence_calibration import uncalibrated
from kinedex.pipelines.annotation.material import unlabelled_pieces, unlabelled_takes
from kinedex.pipelines.annotation.methods import LabelledMotion, Material, Motion, Motions, Needs, annotation_method
from kinedex.pipelines.annotation.parameters import least_frames
from kinedex.pipelines.evaluation.annotation_scores import evaluate as compare_with_truth
from kinedex.pipelines.evaluation.annotation_scores import metrics_rows
from kinedex.pipelines.evaluation.ground_truth import GroundTruth, Manual, place_ground_truth
from kinedex.pipelines.keyframes.applicability import known_masks
from kinedex.storage.formats.labels.formats import read_labels
from kinedex.storage.store.store import data_frame


@checked
def annotate(
    takes: Store | Take | Iterable[Take],
    templates: Template | str | Iterable[Template | str] | Mapping[str, Iterable[Take]],
    method: str = "best",
    *,
    classes: str | Path = OWN,
    delta: float = 0.05,
    tau: float = 0.13,
    min_seconds: float = 0.0,
    queries: Query | Iterable[Query] = (),
    where: str | None = None,
) -> pl.DataFrame:
    """Annotate takes with the classes of templates; the takes need not be in a store.

    Parameters
    ----------
    takes : Store, Take, or iterable of Take
        The takes to annotate; of a store, those that `where` selects.
    templates : Template, str, an iterable of them, or mapping of str to iterable of Take
        One template for each class (subclass); a text is the name of a template that pipelines of the store have
        learned. Or a dict from class to its examples: whole takes, or intervals such as ``take[30:90]``.
    method : str
        "best" finds the best sequence of templates and background for all frames of a take; "thesis" labels the
        frames where a template has a distance below tau; "numeric" compares joint positions with those of the
        examples, or of the clips that the templates were learned from; or the name of a plugin's method.
    classes : str or Path, optional
        "own" makes every template a separate class; otherwise the shipped name or the path of a class file.
    delta : float, optional
        Entries of a template within delta of 0 or 1 count; the others are wildcards.
    tau : float, optional
        The threshold of the method "thesis": intervals with a distance below tau are annotated.
    min_seconds : float, optional
        The shortest duration of an annotation.
    queries : Query or sequence of Query, optional
        A template is matched only within the hits of the queries for its class, or in all frames if there are no
        queries for its class.
    where : str, optional
        A SQL filter over the columns of takes, for a store; by default all takes are annotated.

    Returns
    -------
    polars.DataFrame
        One row per annotated segment, by take name and start: take, take_id (null outside of a store), class, subclass,
        start, stop (frames, stop excluded), start_seconds, stop_seconds, cost, confidence (calibrated on other
        archives; the pipeline calibrates it on yours), method, margin.

    Raises
    ------
    KinedexError
        There is no take or no template, two takes or templates have the same name, or their features differ.
    ConfigError
        The class file is invalid; the message names the line.

    Warns
    -----
    UserWarning
        All or nearly all entries of a template are wildcards; or a template or query is not applied to takes whose
        bodies lack too many of the joints that it needs.

    Examples
    --------
    >>> found = kinedex.annotate(take, [Template.from_clip(take, 0, 30, name="begin")])
    >>> found.select("take", "class", "start").columns
    ['take', 'class', 'start']
    """
    chosen_method = annotation_method(method)
    chosen = _StoredWords(takes, where) if isinstance(takes, Store) else _LoadedWords(takes)
    needs, wanted = chosen_method.needs, resolved_queries(queries, chosen.feature_set, chosen.rate_hz)
    if isinstance(templates, Mapping):
        shown = {name: list(own) for name, own in templates.items()}
        learned = wanted or needs.templates != "none"
        given = [Template.learn(own, name) for name, own in shown.items()] if learned else []
        every = [(name, take) for name, own in shown.items() for take in own]
        _check_features(chosen.feature_set.digest, [(f"an example of '{name}'", take) for name, take in every])
    else:
        given = _templates_of(takes, templates)
        _check_features(chosen.feature_set.digest, [(f"template '{one.name}'", one) for one in given])
        shown = {one.name: [] for one in given}
        every = None
    material = Material(
        Motions(lambda: [_example(name, take, needs) for name, take in every or _clips_of(given)]),
        Motions(partial(chosen.unlabelled, needs)),
        chosen.rate_hz,
    )
    annotator = make_annotator(
        chosen.feature_set,
        [one.learned for one in given],
        load_classes(classes, set(shown) | (set() if classes == OWN else chosen.labels)),
        delta,
        tau,
        wanted,
        method=chosen_method,
        clips=material,
    )
    annotator = replace(
        annotator,
        min_frames=least_frames(min_seconds, chosen.rate_hz),
        confidence=uncalibrated(method, len(annotator.classes)),
    )
    for remark in [*annotator.remarks, *annotator.remarks_on(chosen.known())]:
        warnings.warn(remark, stacklevel=2)
    return _table(chosen.annotate(annotator), annotator, chosen)


class _LoadedWords:
    """The words of takes that are given as `Take` objects, whether they are in a store or not."""

    def __init__(self, takes: Take | Iterable[Take]) -> None:
        self.takes = sorted([takes] if isinstance(takes, Take) else takes, key=lambda take: take.label)
        names = [take.label for take in self.takes]
        if not names:
            raise KinedexError("no take to annotate: `takes` is empty")
        if len(set(names)) < len(names):
            double = next(name for name in names if names.count(name) > 1)
            raise KinedexError(f"two takes are named '{double}'; give them different names")
        if len({(take.feature_set.digest, take.rate_hz) for take in self.takes}) > 1:
            raise KinedexError("the takes have different feature sets or rates; annotate them one by one")
        self.feature_set, self.rate_hz = self.takes[0].feature_set, self.takes[0].rate_hz
        self.names = dict(enumerate(names))
        self.ids = {place: take.take_id for place, take in enumerate(self.takes)}

    @property
    def labels(self) -> set[str]:
        """Return the classes of the takes that have a class."""
        return {str(take.info["class"]) for take in self.takes if take.info.get("class")}

    def words(self, positions: Sequence[int]) -> TakeWords:
        """Return the words of the takes with the given indices."""
        every = [self.takes[place].words() for place in positions]
        offsets = np.cumsum([0, *map(len, every)]).astype(np.int64)
        masks = np.array([self.takes[place].known for place in positions], np.uint64)
        known = None if (masks == ALL_KNOWN).all() else masks
        return TakeWords(np.array(positions, np.int64), offsets, np.concatenate(every), known)

    def annotate(self, annotator: Annotator) -> Iterator[TakeAnnotation]:
        """Annotate the takes batch by batch."""
        for batch in split_takes(self.names, map(len, self.takes)):
            positions = None
            if annotator.method.needs.positions:
                positions = [_positions(self.takes[place]) for place in batch]
            yield from annotate_words(annotator, self.words(batch), positions=positions)

    def known(self) -> dict[int, int]:
        """Return a dict from index to mask of known features, for the takes that lack features."""
        return {place: take.known for place, take in enumerate(self.takes) if take.known != ALL_KNOWN}

    def unlabelled(self, needs: Needs) -> list[Motion]:
        """Return the takes as motions; of positions, a bounded number of frames."""
        if not needs.positions:
            return [Motion(words=take.words(), known=take.known) for take in self.takes]
        pieces = unlabelled_pieces(list(self.names), {place: len(take) for place, take in enumerate(self.takes)})
        parts = [self.takes[place][start:stop] for place, start, stop in pieces]
        return [Motion(words=one.words(), positions=_positions(one), known=one.known) for one in parts]


class _StoredWords:
    """The words of the takes that a filter selects in a store."""

    def __init__(self, store: Store, where: str | None) -> None:
        takes = store.takes(where)
        if not takes.height:
            raise KinedexError(f"no take to annotate: the filter `{where}` selects none of the {len(store)} takes")
        self.store, self.frames = store, takes["frames"].to_list()
        self.feature_set, self.rate_hz = store.feature_set, store.rate_hz
        self.names = dict(takes.select("take_id", "name").iter_rows())
        self.ids: dict[int, int | None] = {take_id: take_id for take_id in self.names}

    @property
    def labels(self) -> set[str]:
        """Return the classes of all takes of the store."""
        return set(self.store.takes()["class"].drop_nulls())

    def annotate(self, annotator: Annotator) -> Iterator[TakeAnnotation]:
        """Annotate the takes batch by batch."""
        stored = self.store.stored
        for batch in split_takes(self.names, self.frames):
            yield from annotate_words(annotator, stored.words(batch), store=stored)

    def known(self) -> dict[int, int]:
        """Return a dict from take id to mask of known features, for the takes that lack features."""
        return known_masks(self.store.stored.known, self.names)

    def unlabelled(self, needs: Needs) -> Iterable[Motion]:
        """Return all takes of the store, annotated or not, as motions."""
        return unlabelled_takes(self.store.stored, needs)


def _templates_of(takes: object, templates: Template | str | Iterable[Template | str]) -> list[Template]:
    wanted = [templates] if isinstance(templates, Template | str) else list(templates)
    names = [one for one in wanted if isinstance(one, str)]
    if names and not isinstance(takes, Store):
        raise KinedexError(f"'{names[0]}' is the name of a template, which only a store knows: store.template(…)")
    given = [takes.template(one) if isinstance(one, str) else one for one in wanted]  # type: ignore[attr-defined]
    if not given:
        raise KinedexError("no template to annotate with: `templates` is empty")
    called = [one.name for one in given]
    if len(set(called)) < len(called):
        double = next(name for name in called if called.count(name) > 1)
        raise KinedexError(f"two templates are named '{double}'; learn one from the clips of both")
    return given


def _check_features(digest: str, found: Iterable[tuple[str, Template | Take]]) -> None:
    for name, one in found:
        if one.feature_set.digest != digest:
            raise KinedexError(f"{name} has other features ({one.feature_set.name}) than the takes")


def _clips_of(templates: Sequence[Template]) -> list[tuple[str, Take]]:
    """Return the clips of templates with their classes, each clip once."""
    return list({name: (one.name, take) for one in templates for name, take in one.examples().items()}.values())


def _example(label: str, take: Take, needs: Needs) -> LabelledMotion:
    """Return a take or an interval as an example, without invalid frames at its ends."""
    words = take.words()
    valid = np.flatnonzero(words != NO_WORD)
    first, last = (int(valid[0]), int(valid[-1]) + 1) if len(valid) else (0, 0)
    start = take.interval[0] if take.interval else 0
    made = LabelledMotion(
        label=label, take=take.name, start=start + first, stop=start + last, words=words[first:last], known=take.known
    )
    return replace(made, positions=_positions(take)[first:last]) if needs.positions else made


def _positions(take: Take) -> F64:
    return take.positions.astype(np.float64)


def _table(found: Iterable[TakeAnnotation], annotator: Annotator, chosen: _LoadedWords | _StoredWords) -> pl.DataFrame:
    frame = data_frame(annotations_table(found, annotator, chosen.names, chosen.rate_hz, ""))
    ids = pl.col("take_id").replace_strict(chosen.ids, return_dtype=pl.Int64)
    return frame.drop("run").with_columns(ids).select("take", "take_id", pl.exclude("take", "take_id"))


class Evaluation:
    """The comparison of annotations with ground truth.

    A notebook shows its table. A measure is undefined (None) if there was nothing to find or nothing was found.

    Attributes
    ----------
    table : polars.DataFrame
        One row for all takes ("pooled"), for each class and for each take: scope, name, p1, r1 and f1 (precision,
        recall and F over frames), p2, r2 and f2 (over segments), and the counts from which they are computed.
    takes : tuple of str
        The takes that were compared.
    remarks : tuple of str
        Labels that could not be used, one sentence each.

    Examples
    --------
    >>> evaluation = kinedex.evaluate(annotations, annotations)
    >>> evaluation.f_frames
    1.0
    """

    def __init__(self, table: pl.DataFrame, takes: Sequence[str], remarks: Sequence[str]) -> None:
        self.table = table
        self.takes = tuple(takes)
        self.remarks = tuple(remarks)

    @property
    def f_frames(self) -> float | None:
        """Return F (frames) over all takes and classes.

        Returns
        -------
        float or None
            The harmonic mean of precision and recall over pairs of frame and class.
        """
        return self._pooled("f1")

    @property
    def f_segments(self) -> float | None:
        """Return F (segments) over all takes and classes.

        Returns
        -------
        float or None
            The harmonic mean of precision and recall over segments. An annotated segment is correct if it overlaps a
            segment of the same class in the ground truth, and the other way round.
        """
        return self._pooled("f2")

    def _pooled(self, measure: str) -> float | None:
        value: float | None = self.table.filter(pl.col("scope") == "pooled")[measure][0]
        return value

    def __repr__(self) -> str:
        shown = ["–" if value is None else f"{value:.3f}" for value in (self.f_frames, self.f_segments)]
        return f"Evaluation({counted(len(self.takes), 'take')}, F (frames) {shown[0]}, F (segments) {shown[1]})"

    def _repr_html_(self) -> str:
        return self.table._repr_html_()


@checked
def evaluate(
    annotations: pl.DataFrame,
    ground_truth: pl.DataFrame | str | Path | Sequence[str | Path],
    *,
    takes: Store | Take | Iterable[Take] | None = None,
) -> Evaluation:
    """Compare annotations with ground truth, over frames and over segments (thesis, Section 5.4).

    Parameters
    ----------
    annotations : polars.DataFrame
        Segments with the columns take, class, start and stop, such as `annotate` returns.
    ground_truth : polars.DataFrame, str, Path, or a sequence of paths
        Segments with the same columns in the same frames, or label files (CSV, JSON, ELAN, WebVTT, Audacity). A row of
        the data frame whose class is null states that its take was labelled and has no segment.
    takes : Store, Take or iterable of Take, optional
        The takes that were annotated. They are required for label files, which count seconds or frames of the source
        file; for a data frame, they limit the comparison to these takes.

    Returns
    -------
    Evaluation
        Precision, recall and F. Only takes that the ground truth names are compared; classes that were never annotated
        count as missed.

    Raises
    ------
    KinedexError
        A column is missing, label files are given without takes, or no take has ground truth.
    SourceError
        A label file is invalid, or a segment ends after the end of its take; the message names file and line.

    Examples
    --------
    >>> truth = annotations.select("take", "class", "start", "stop")
    >>> kinedex.evaluate(annotations, truth).f_segments
    1.0
    """
    _check_columns("annotations", annotations)
    if isinstance(ground_truth, pl.DataFrame):
        truth = _truth_of_frame(ground_truth, None if takes is None else set(_takes_table(takes)["name"]))
    else:
        if takes is None:
            raise KinedexError("label files count source frames or seconds: pass `takes`, a store or the takes")
        paths = [ground_truth] if isinstance(ground_truth, str | Path) else list(ground_truth)
        truth = _truth_of_files(paths, takes, annotations)
    classes = annotations["class"].unique().sort().to_list()
    found = compare_with_truth("annotations", annotations.to_arrow(), truth, classes)
    table = data_frame(metrics_rows(found, ""))
    return Evaluation(table.drop("run", "evaluation"), truth.takes, truth.remarks)


def _check_columns(name: str, frame: pl.DataFrame) -> None:
    if not isinstance(frame, pl.DataFrame):
        raise KinedexError(f"{name}: must be a polars data frame, as `annotate` returns, got {type(frame).__name__}")
    missing = [column for column in ("take", "class", "start", "stop") if column not in frame.columns]
    if missing:
        raise KinedexError(f"{name}: the data frame must have a column '{missing[0]}', got {', '.join(frame.columns)}")


def _truth_of_frame(frame: pl.DataFrame, annotated: set[str] | None) -> GroundTruth:
    _check_columns("ground_truth", frame)
    names = set(frame["take"]) if annotated is None else annotated & set(frame["take"])
    if not names:
        raise KinedexError("ground_truth: no segment is of a take that was annotated")
    segments = [
        Manual(-1, row["take"], row["class"], row["start"], row["stop"], row["start"], row["stop"], "data frame")
        for row in frame.select("take", "class", "start", "stop").unique(maintain_order=True).iter_rows(named=True)
        if row["take"] in names and row["class"] is not None
    ]
    return GroundTruth(tuple(segments), tuple(sorted(names)))


def _truth_of_files(
    paths: Sequence[str | Path], takes: Store | Take | Iterable[Take], annotations: pl.DataFrame
) -> GroundTruth:
    files = [read_labels(path) for path in paths]
    every = _takes_table(takes)
    table = every.filter(pl.col("name").is_in([take for file in files for take in file.takes]))
    labels = sorted({*annotations["class"].unique(), *(one.label for file in files for one in file.segments)})
    classes = Classes(tuple(MotionClass(label, "", (label,)) for label in labels))
    return place_ground_truth(files, table, every["name"], classes, "miss")


def _takes_table(takes: Store | Take | Iterable[Take]) -> pl.DataFrame:
    """Return name, take_id, source_frames, source_rate_hz and rate_hz of takes."""
    columns = ["take_id", "name", "source_frames", "source_rate_hz", "rate_hz"]
    if isinstance(takes, Store):
        return takes.takes().select(columns)
    every = [takes] if isinstance(takes, Take) else list(takes)
    rows = [
        {**{column: take.info.get(column) for column in columns}, "take_id": place, "name": take.label}
        for place, take in enumerate(every)
    ]
    return pl.DataFrame(rows, infer_schema_length=None)
