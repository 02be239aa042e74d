"""Annotators: the templates, classes, keyframe queries and method of an annotation, which are sent to workers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from kinedex.catalog.classes import Classes
from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.ops.annotation.confidence import Confidence
from kinedex.ops.arrays import I64, U64
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.templates.derived_templates import restricted_template
from kinedex.ops.templates.templates import QuantisedTemplate, Template, quantise
from kinedex.ops.wording import counted, name_list
from kinedex.pipelines.annotation.methods import AnnotationMethod, LabelledMotion, Material, Motions, Setting
from kinedex.pipelines.annotation.template_methods import ThesisMethod
from kinedex.pipelines.keyframes.applicability import Applicability, applicability, remarks_on
from kinedex.pipelines.keyframes.preselected_frames import known_queries, widest_margins
from kinedex.pipelines.templates.template_learning import SubclassTemplate

VAGUE = 1.0
"""Fixed entries per column, on average, below which a template hardly distinguishes motions.

At δ = 0.05 the templates of HDM05's clip classes have 16 to 36 fixed entries, of forty, in a column.
"""


@dataclass(frozen=True)
class Annotator:
    """The templates, queries and method that annotate words.

    Attributes
    ----------
    feature_set : FeatureSet
        The features of the words.
    classes : tuple of str, length P
        The names of the classes.
    subclasses : tuple of str, length S
        The names of the subclasses, each with its template.
    class_index : int64 array (S,)
        The class of each subclass.
    templates : tuple of QuantisedTemplate, length S
        The templates that distance curves are computed with; empty if the method needs none, and no query preselects.
    queries : tuple of tuple of KeyframeQuery, length S
        The queries that preselect frames for each template. A template without queries is matched in all frames.
    method : AnnotationMethod
        The method that labels frames.
    min_frames : int
        Shorter segments are dropped.
    remarks : tuple of str
        Remarks on templates that are excluded, or that match almost any motion.
    confidence : Confidence, optional
        The model that gives each segment the probability that its label is right; None for segments without it.
    """

    feature_set: FeatureSet
    classes: tuple[str, ...]
    subclasses: tuple[str, ...]
    class_index: I64
    templates: tuple[QuantisedTemplate, ...]
    queries: tuple[tuple[KeyframeQuery, ...], ...]
    method: AnnotationMethod
    min_frames: int = 0
    remarks: tuple[str, ...] = ()
    confidence: Confidence | None = None

    @property
    def shapes(self) -> tuple[list[int], list[float]]:
        """The number of columns of each template, and its mean fraction of fixed features per column."""
        features = len(self.feature_set.features)
        return [len(one) for one in self.templates], [one.fixed / features for one in self.templates]

    @cached_property
    def margins(self) -> tuple[tuple[tuple[int, int], ...], ...]:
        """The frames before and after a hit in which each template is matched, for each of its queries.

        A query with alternatives has the widest margins of all alternatives, because any of these may have found a hit.
        """
        found = []
        for place, queries in enumerate(self.queries):
            columns = self.templates[place].values(len(self.feature_set.features)) if queries else np.empty((0, 0))
            found.append(tuple(widest_margins(query, columns, self.feature_set) for query in queries))
        return tuple(found)

    def restricted(self, known: int) -> tuple[Annotator | None, I64]:
        """Return the annotator for takes in which only some features are known.

        Parameters
        ----------
        known : int
            The mask of the known features, with the bits of a word.

        Returns
        -------
        Annotator or None
            The annotator with templates and queries restricted to the known features, without templates that need too
            many other features. A template is matched in all frames if none of its queries can be applied. The result
            is None if no template is left, or if the method needs all features.
        chosen : int64 array (C,)
            The indices of the kept templates among all templates.
        """
        if self.method.needs.templates == "none" and hasattr(self.method, "restricted"):
            queries = self.queries
            if any(queries):
                pairs = zip(queries, self.margins, strict=True)
                queries = tuple(known_queries(*pair, self.feature_set, known) for pair in pairs)
            every = np.arange(len(self.subclasses))
            return replace(self, queries=queries, method=self.method.restricted(known, self.templates, every)), every
        kept = {s: own for s, one in enumerate(self.templates) if (own := restricted_template(one, known)) is not None}
        chosen = np.array(list(kept), np.int64)
        make = getattr(self.method, "restricted", None)
        if not kept or make is None:
            return None, np.empty(0, np.int64)
        restricted = replace(
            self,
            subclasses=tuple(self.subclasses[s] for s in kept),
            class_index=self.class_index[chosen],
            templates=tuple(kept.values()),
            queries=tuple(known_queries(self.queries[s], self.margins[s], self.feature_set, known) for s in kept),
            method=make(known, list(kept.values()), chosen),
        )
        return restricted, chosen

    def with_learned(self, queries: Sequence[KeyframeQuery], classes: Classes) -> Annotator:
        """Return the annotator with further queries, which preselect in addition to its own and never replace them."""
        more = _queries_of(self.subclasses, queries, classes)
        return replace(self, queries=tuple((*own, *new) for own, new in zip(self.queries, more, strict=True)))

    def partly_known(self, known: Mapping[int, int]) -> list[Applicability]:
        """Return how templates and queries apply to takes that lack features; `known` has their masks by take_id."""
        templates = dict(zip(self.subclasses, self.templates, strict=False))
        queries = (query for own in self.queries for query in own)
        return applicability(self.feature_set, known.values(), templates, queries)

    def remarks_on(self, known: Mapping[int, int]) -> list[str]:
        """Return remarks on templates and queries that are not applied to takes that lack features.

        `known` has the masks of these takes by take_id.
        """
        takes = counted(len(known), "take")
        if known and not hasattr(self.method, "restricted"):
            what = "joints" if self.method.needs.positions else "features"
            return [
                f"the method '{self.method.name}' needs all {what}: {takes} whose bodies lack joints have no annotation"
            ]
        if known and self.method.needs.templates == "none":
            return [
                f"{takes} whose bodies lack joints ({name_list(self._lacking(known.values()))}) are labelled by the "
                "joints that they have; without a pair of hips or shoulders, or without a whole leg, they have no label"
            ]
        return remarks_on(self.partly_known(known), known)

    def _lacking(self, masks: Iterable[int]) -> list[str]:
        """Return the joints whose features are all unknown in some take."""
        joints, every = self.feature_set.joints, self.feature_set.every_bit
        unknown = {joint: every & ~self.feature_set.known([joint]) for joint in joints}
        different = set(masks)
        return [joint for joint in joints if any(unknown[joint] and not unknown[joint] & mask for mask in different)]

    @property
    def label(self) -> str:
        """The value of the column `method` of annotations."""
        return f"{self.method.label} within keyframe hits" if any(self.queries) else self.method.label


def make_annotator(
    feature_set: FeatureSet,
    templates: Sequence[SubclassTemplate],
    classes: Classes,
    delta: float,
    tau: float | Mapping[str, float],
    queries: Sequence[KeyframeQuery] = (),
    method: type[AnnotationMethod] = ThesisMethod,
    clips: Material | Callable[[], Sequence[U64]] = tuple,
) -> Annotator:
    """Make an annotator: quantise the templates, assign them and the queries to classes, and fit the method.

    Parameters
    ----------
    feature_set : FeatureSet
        The features of the words.
    templates : sequence of SubclassTemplate
        The templates. A template is excluded if its subclass is in no class, or if it has no fixed entries, so that it
        matches anything at no cost. A template with fewer than `VAGUE` fixed entries per column is kept, with a remark.
    classes : Classes
        The classes to label with.
    delta : float
        Entries of a template within delta of 0 or 1 count; the others are wildcards.
    tau : float or mapping of str to float
        The threshold of all classes, or of each.
    queries : sequence of KeyframeQuery
        The queries that preselect frames. A query whose target is a subclass is used for this subclass; a query whose
        target is a class is used for the subclasses of the class that have no query themselves. Queries with other
        targets are excluded (see `unknown_targets`).
    method : type of AnnotationMethod
        The method that labels frames.
    clips : Material, or callable
        What the method is fitted with; or a function that returns the words of the training clips, if it needs no more.

    Returns
    -------
    Annotator
        An annotator with at least one template, which keeps segments of any length.

    Raises
    ------
    KinedexError
        No template belongs to any class, or none has a fixed entry.
    """
    material = clips if isinstance(clips, Material) else Material(Motions(partial(_unnamed_examples, clips)))
    outline = _outline(templates, classes, delta, queries, material if method.needs.templates == "none" else None)
    of_subclass = classes.of_subclass()
    subclasses, learned = outline.subclasses, outline.learned
    setting = Setting(
        classes=classes.names,
        subclasses=subclasses,
        class_index=np.array([classes.names.index(of_subclass[one]) for one in subclasses], np.int64),
        joints=feature_set.joints,
        features=len(feature_set.features),
        rate_hz=material.rate_hz,
        templates=learned,
        quantised=outline.quantised if learned else (),
        thresholds=np.array([tau[name] if isinstance(tau, Mapping) else tau for name in classes.names], np.float64),
        delta=delta,
        feature_weights=material.feature_weights,
        mirror=material.mirror,
    )
    fitted = method.fit(material.examples, material.unlabelled, setting)
    return Annotator(
        feature_set,
        classes.names,
        subclasses,
        setting.class_index,
        outline.quantised,
        outline.queries,
        fitted,
        remarks=(*outline.remarks, *fitted.remarks),
    )


def _unnamed_examples(clips: Callable[[], Sequence[U64]]) -> list[LabelledMotion]:
    """Return words of clips as examples of which no more is known."""
    return [LabelledMotion(words=words, label="") for words in clips()]


class _Outline(NamedTuple):
    """The subclasses to label with, their templates and queries, and remarks on templates."""

    subclasses: tuple[str, ...]
    learned: tuple[Template, ...]
    quantised: tuple[QuantisedTemplate, ...]
    queries: tuple[tuple[KeyframeQuery, ...], ...]
    remarks: tuple[str, ...]


def _outline(
    templates: Sequence[SubclassTemplate],
    classes: Classes,
    delta: float,
    queries: Sequence[KeyframeQuery],
    taught: Material | None,
) -> _Outline:
    """Return the subclasses that have templates; or those that have examples, for a method that needs no templates.

    The templates of the latter serve queries, whose margins depend on them; a subclass without one has no query.
    """
    if taught is None:
        used, remarks = _usable_templates(templates, classes, delta)
        names = tuple(one.subclass for one, _ in used)
        learned, quantised = tuple(one.learned.template for one, _ in used), tuple(one for _, one in used)
        return _Outline(names, learned, quantised, _queries_of(names, queries, classes), remarks)
    labels = {one.label for one in taught.examples if one.positive}
    names = tuple(sorted(labels.intersection(classes.of_subclass())))
    if not names:
        raise KinedexError(
            f"none of the classes {', '.join(classes.names)} has an example; there are examples of: "
            f"{name_list(sorted(labels)) or 'nothing'}"
        )
    if not queries:
        return _Outline(names, (), (), ((),) * len(names), ())
    known = {one.subclass: own for one, own in _usable_templates(templates, classes, delta)[0]}
    chosen = zip(names, _queries_of(names, queries, classes), strict=True)
    within = tuple(own if one in known else () for one, own in chosen)
    return _Outline(names, (), tuple(known.get(one, _ANYTHING) for one in names), within, ())


_ANYTHING = QuantisedTemplate(np.zeros(1, np.uint64), np.zeros(1, np.uint64))


def _usable_templates(
    templates: Sequence[SubclassTemplate], classes: Classes, delta: float
) -> tuple[list[tuple[SubclassTemplate, QuantisedTemplate]], tuple[str, ...]]:
    """Return the templates of some classes that have fixed entries, also quantised, and remarks on the others."""
    of_subclass = classes.of_subclass()
    known = [one for one in templates if one.subclass in of_subclass]
    if not known:
        names = name_list([one.subclass for one in templates])
        raise KinedexError(f"none of the classes {', '.join(classes.names)} has a template; there are: {names}")
    quantised = {one.subclass: quantise(one.learned.template, delta) for one in known}
    used = [(one, quantised[one.subclass]) for one in known if quantised[one.subclass].fixed > 0]
    if not used:
        raise KinedexError(
            f"at delta = {delta:g} every template is wildcards alone and would fit anything: in no column is a feature "
            "within delta of 0 or 1; raise `delta`, or learn from clips that have more in common"
        )
    return used, _remarks({one.subclass: quantised[one.subclass].fixed for one in known})


def _queries_of(
    subclasses: Sequence[str], queries: Sequence[KeyframeQuery], classes: Classes
) -> tuple[tuple[KeyframeQuery, ...], ...]:
    """Return the queries of each subclass; a subclass that is not the target of any query has those of its class."""
    by_target: dict[str, list[KeyframeQuery]] = {}
    for query in queries:
        by_target.setdefault(query.target, []).append(query)
    of_subclass = classes.of_subclass()
    return tuple(tuple(by_target.get(one) or by_target.get(of_subclass[one]) or ()) for one in subclasses)


def _remarks(fixed: Mapping[str, float]) -> tuple[str, ...]:
    """Return remarks on templates with few or no fixed entries per column."""
    empty = [subclass for subclass, entries in fixed.items() if not entries]
    vague = [f"{subclass} ({entries:.2g})" for subclass, entries in fixed.items() if 0 < entries < VAGUE]
    remarks = []
    if empty:
        remarks.append(f"templates of wildcards alone, which would fit anything, excluded: {name_list(empty)}")
    if vague:
        remarks.append(
            f"templates with less than {VAGUE:g} fixed entry a column on average, which fit almost anything: "
            + name_list(vague)
        )
    return tuple(remarks)


def unknown_targets(queries: Sequence[KeyframeQuery], classes: Classes) -> list[str]:
    """Return the targets of queries that are neither a class nor a subclass.

    Raises
    ------
    KinedexError
        There are queries, and all have an unknown target; the message names the nearest label.
    """
    unknown = sorted({query.target for query in queries if classes.class_of(query.target) is None})
    if queries and all(query.target in unknown for query in queries):
        labels = {*classes.names, *classes.of_subclass()}
        raise KinedexError(
            f"no keyframe query is for a class of this archive; the first is for '{queries[0].target}'"
            f"{did_you_mean(queries[0].target, labels)}"
        )
    return unknown
