"""What annotates: templates, thresholds, classes and keyframe queries, as they are sent to workers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from kinedex.catalog.classes import Classes
from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.ops.annotation.decoding import Decoding
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.templates.templates import QuantisedTemplate, Template, quantise
from kinedex.pipelines.console.wording import few
from kinedex.pipelines.search.preselection import template_window
from kinedex.pipelines.templates.learning import SubclassTemplate

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

VAGUE = 1.0
"""Fixed entries a column, on average, below which a template hardly tells motions apart: one feature of forty. (At
δ = 0.05 the templates of HDM05's clip classes have 16 to 36.)"""


@dataclass(frozen=True)
class Row:
    """What labels all frames of a take together: see `ops.annotation.decoding.explain`.

    templates: S templates as learned. usual: float64 (K, f), the usual postures.
    """

    templates: tuple[Template, ...]
    usual: F64
    decoding: Decoding


@dataclass(frozen=True)
class Annotator:
    """All that is needed to annotate words.

    classes: names of the P classes. subclasses: names of the S templates; class_index: int64 (S,), their classes.
    queries: for each template the keyframe queries that preselect frames for it, none for all frames.
    remarks: templates that say too little, in words.
    row: what labels all frames of a take together; None: each frame gets the label of the nearest template (thesis).
    taus: float64 (P,), thresholds of the classes; None: `tau` is that of all.
    min_frames: shorter segments are left out.
    """

    feature_set: FeatureSet
    classes: tuple[str, ...]
    subclasses: tuple[str, ...]
    class_index: I64
    templates: tuple[QuantisedTemplate, ...]
    queries: tuple[tuple[KeyframeQuery, ...], ...]
    tau: float
    remarks: tuple[str, ...] = ()
    row: Row | None = None
    taus: F64 | None = None
    min_frames: int = 0

    @property
    def thresholds(self) -> F64:
        """The threshold of each class, float64 (P,)."""
        return np.full(len(self.classes), self.tau) if self.taus is None else self.taus

    @cached_property
    def reach(self) -> tuple[tuple[tuple[int, int], ...], ...]:
        """How far each template reaches out of the hits of each of its queries, to the left and to the right.

        The hits of a query with alternatives get the widest of their margins, since any of them may have found a hit.
        """
        found = []
        for template, queries in zip(self.templates, self.queries, strict=True):
            columns = template.values(len(self.feature_set.features)) if queries else np.empty((0, 0))
            own = []
            for query in queries:
                windows = [template_window(chain, columns, self.feature_set) for chain in query.chains]
                own.append((max(one.left for one in windows), max(one.right for one in windows)))
            found.append(tuple(own))
        return tuple(found)

    @property
    def method(self) -> str:
        """How annotations of this annotator are found, for the results."""
        how = "templates" if self.row is None else "templates in a row"
        return f"{how} within keyframe hits" if any(self.queries) else how


def make_annotator(
    feature_set: FeatureSet,
    templates: Sequence[SubclassTemplate],
    classes: Classes,
    delta: float,
    tau: float,
    queries: Sequence[KeyframeQuery] = (),
    usual: F64 | None = None,
    learned: Sequence[KeyframeQuery] = (),
) -> Annotator:
    """Quantise templates and sort them and the queries into classes.

    Parameters
    ----------
    templates: those of subclasses without a class are left out, and those of wildcards alone: they would fit anything
        at no cost. Those with fewer than `VAGUE` fixed entries a column stay, with a remark.
    queries: a query whose target is a subclass preselects for it, one whose target is a class for those of its
        subclasses that have no query of their own; other queries are left out (see `targets_unknown`).
    usual: float64 (K, f), the usual postures (`ops.annotation.background.background`): all frames of a take are
    labelled
        together, by the explanation of the greatest value. None: frame by frame, as in the thesis.
    learned: further queries, which are sorted by themselves: they preselect besides `queries`, never in their place.

    Raises
    ------
    KinedexError: no template belongs to any class, or all of them are wildcards alone.
    """
    of_subclass = classes.of_subclass()
    known = [one for one in templates if one.subclass in of_subclass]
    if not known:
        names = few([one.subclass for one in templates])
        raise KinedexError(f"none of the classes {', '.join(classes.names)} has a template; there are: {names}")
    quantised = {one.subclass: quantise(one.learned.template, delta) for one in known}
    used = [one for one in known if quantised[one.subclass].fixed > 0]
    if not used:
        raise KinedexError(
            f"at delta = {delta:g} every template is wildcards alone and would fit anything: in no column is a feature "
            "within delta of 0 or 1; raise `delta`, or learn from clips that have more in common"
        )
    own, further = (_queries_of([one.subclass for one in used], some, of_subclass) for some in (queries, learned))
    return Annotator(
        feature_set,
        classes.names,
        tuple(one.subclass for one in used),
        np.array([classes.names.index(of_subclass[one.subclass]) for one in used], np.int64),
        tuple(quantised[one.subclass] for one in used),
        tuple((*written, *found) for written, found in zip(own, further, strict=True)),
        tau,
        _remarks({one.subclass: quantised[one.subclass].fixed for one in known}),
        None if usual is None else Row(tuple(one.learned.template for one in used), usual, Decoding()),
    )


def _queries_of(
    subclasses: Sequence[str], queries: Sequence[KeyframeQuery], of_subclass: Mapping[str, str]
) -> list[tuple[KeyframeQuery, ...]]:
    """For each subclass its queries, or else those of its class."""
    by_target: dict[str, list[KeyframeQuery]] = {}
    for query in queries:
        by_target.setdefault(query.target, []).append(query)
    return [tuple(by_target.get(one) or by_target.get(of_subclass[one]) or ()) for one in subclasses]


def _remarks(fixed: Mapping[str, float]) -> tuple[str, ...]:
    """What to say of templates by their fixed entries a column."""
    empty = [subclass for subclass, entries in fixed.items() if not entries]
    vague = [f"{subclass} ({entries:.2g})" for subclass, entries in fixed.items() if 0 < entries < VAGUE]
    remarks = []
    if empty:
        remarks.append(f"templates of wildcards alone, which would fit anything, left out: {few(empty)}")
    if vague:
        remarks.append(
            f"templates with less than {VAGUE:g} fixed entry a column on average, which fit almost anything: "
            + few(vague)
        )
    return tuple(remarks)


def targets_unknown(queries: Sequence[KeyframeQuery], classes: Classes) -> list[str]:
    """The queries' targets that are neither a class nor a subclass.

    Raises
    ------
    KinedexError: all of them; the message names the nearest label.
    """
    unknown = sorted({query.target for query in queries if classes.class_of(query.target) is None})
    if queries and all(query.target in unknown for query in queries):
        labels = {*classes.names, *classes.of_subclass()}
        raise KinedexError(
            f"no keyframe query is for a class of this archive; the first is for '{queries[0].target}'"
            f"{did_you_mean(queries[0].target, labels)}"
        )
    return unknown
