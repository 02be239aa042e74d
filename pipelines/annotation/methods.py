"""Annotation methods: the protocol of methods, and the two built-in methods.

A method is a frozen dataclass with three class attributes (`name`, `label`, `uses_thresholds`). `prepare` makes an
instance from templates and training clips; `annotate` labels takes. An instance is sent to workers, so it must be
picklable. The fields of an instance are hashed to find annotations that are up to date, so they must hold everything
that the segments depend on. A method that defines `restricted` can also label takes that lack features; other methods
do not label such takes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar, Protocol, Self

import numpy as np

from kinedex.catalog.plugins import Plugins
from kinedex.ops.annotation.background import background
from kinedex.ops.annotation.decoding import Decoding, concatenated_columns, explain, frames_of, least_costs, margins
from kinedex.ops.annotation.promising_ranges import loose_ranges, template_groups
from kinedex.ops.annotation.segments import Matches, Segment, annotate
from kinedex.ops.arrays import F64, I64, U64
from kinedex.ops.distances.costs import encode
from kinedex.ops.distances.pruning import CoarseBound, coarse_bounds
from kinedex.ops.distances.range_minima import minima_within
from kinedex.ops.errors import KinedexError
from kinedex.ops.templates.templates import QuantisedTemplate, Template
from kinedex.ops.words import MAX_FEATURES, TakeWords, compacted, known_bits

NARROW = 4
"""Lower bounds of distances are used for a template that is matched in more than one of this number of frames.

For a template that is matched in fewer frames, computing bounds takes more time than they save.
"""


@dataclass(frozen=True)
class ClassTemplates:
    """The templates of an annotation, assigned to classes.

    Attributes
    ----------
    learned : tuple of Template, length S
        The learned templates, with values in [0, 1].
    quantised : tuple of QuantisedTemplate, length S
        The same templates quantised to 0, 1 and wildcards.
    class_index : int64 array (S,)
        The class of each template.
    thresholds : float64 array (P,)
        The threshold τ of each class.
    """

    learned: tuple[Template, ...]
    quantised: tuple[QuantisedTemplate, ...]
    class_index: I64
    thresholds: F64


class AnnotationMethod(Protocol):
    """A method that labels the frames of takes by templates.

    Attributes
    ----------
    name : str
        The value of the parameter `method` that selects it.
    label : str
        The value of the column `method` of annotations.
    uses_thresholds : bool
        True if segments depend on the thresholds τ.
    """

    name: ClassVar[str]
    label: ClassVar[str]
    uses_thresholds: ClassVar[bool]

    @classmethod
    def prepare(cls, templates: ClassTemplates, clips: Callable[[], Sequence[U64]]) -> Self:
        """Make the method from templates.

        Parameters
        ----------
        templates : ClassTemplates
            The templates to label with.
        clips : callable
            Reads and returns the words of the training clips, uint64 (L,) each.
        """
        ...

    def annotate(self, words: TakeWords, ranges: Sequence[I64]) -> list[list[Segment]]:
        """Label the frames of takes.

        Parameters
        ----------
        words : TakeWords
            The words of T takes, concatenated.
        ranges : sequence of int64 arrays (R, 2), length S
            The frames that each template may label, as ascending half-open ranges of the words.

        Returns
        -------
        list of list of Segment, length T
            The segments of each take in the order of their starts, in frames of the take.
        """
        ...


@dataclass(frozen=True)
class ThesisMethod:
    """Labels each frame with the class of the smallest distance below its threshold (thesis, Section 5.2)."""

    name: ClassVar[str] = "thesis"
    label: ClassVar[str] = "templates"
    uses_thresholds: ClassVar[bool] = True

    templates: tuple[QuantisedTemplate, ...]
    class_index: I64
    thresholds: F64

    @classmethod
    def prepare(cls, templates: ClassTemplates, clips: Callable[[], Sequence[U64]]) -> ThesisMethod:
        """Return the method for the given templates; the clips are not used."""
        return cls(templates.quantised, templates.class_index, templates.thresholds)

    def restricted(self, known: int, templates: Sequence[QuantisedTemplate], chosen: I64) -> ThesisMethod:
        """Return the method for takes in which only some features are known.

        Parameters
        ----------
        known : int
            The mask of the known features, with the bits of a word.
        templates : sequence of QuantisedTemplate, length C
            The templates that can be applied, restricted to these features.
        chosen : int64 array (C,)
            The indices of these templates among all templates.
        """
        return ThesisMethod(tuple(templates), self.class_index[chosen], self.thresholds)

    def annotate(self, words: TakeWords, ranges: Sequence[I64]) -> list[list[Segment]]:
        """Label takes; see `AnnotationMethod.annotate`."""
        return annotate(self.matches(words, ranges), self.class_index, words.offsets, self.thresholds)

    def matches(self, words: TakeWords, ranges: Sequence[I64]) -> Matches:
        """Return the minima of each template's distance curve below its threshold, with their warping paths."""
        # The neighbours of a minimum are not lower, whatever they cost, so minima are exact without whole curves.
        taus = self.thresholds[self.class_index]
        coded = encode(words.words)
        wide = [s for s, own in enumerate(ranges) if NARROW * int((own[:, 1] - own[:, 0]).sum()) > len(words.words)]
        coarse: list[CoarseBound | None] = [None] * len(ranges)
        bounds = coarse_bounds([self.templates[s] for s in wide], coded, taus[wide], whole_takes(words))
        for s, bound in zip(wide, bounds, strict=True):
            coarse[s] = bound
        return minima_within(self.templates, words.words, taus, ranges, coded, coarse)


@dataclass(frozen=True)
class BestMethod:
    """Labels all frames of a take together, by the most probable sequence of templates and background.

    The postures in `usual`, which are common in training clips, describe the background. If a mask `known` is given,
    templates and postures have only the features in the mask.
    """

    name: ClassVar[str] = "best"
    label: ClassVar[str] = "templates in a row"
    uses_thresholds: ClassVar[bool] = False

    templates: tuple[Template, ...]
    quantised: tuple[QuantisedTemplate, ...]
    class_index: I64
    usual: F64
    decoding: Decoding
    known: int | None = None

    @classmethod
    def prepare(cls, templates: ClassTemplates, clips: Callable[[], Sequence[U64]]) -> BestMethod:
        """Make the method; the common postures of the clips serve as background."""
        usual = background(clips(), templates.learned[0].values.shape[1])
        learned = tuple(with_usual_values(one, usual) for one in templates.learned)
        return cls(learned, templates.quantised, templates.class_index, usual, Decoding())

    def restricted(self, known: int, templates: Sequence[QuantisedTemplate], chosen: I64) -> BestMethod:
        """Return the method for takes in which only some features are known; see `ThesisMethod.restricted`."""
        bits = known_bits(known, self.usual.shape[1])
        learned = tuple(Template(self.templates[s].values[:, bits], self.templates[s].weights) for s in chosen.tolist())
        usual = np.ascontiguousarray(self.usual[:, bits])
        return BestMethod(learned, tuple(templates), self.class_index[chosen], usual, self.decoding, known)

    def own_words(self, words: TakeWords) -> U64:
        """Return the words of takes, reduced to the features of the templates."""
        return words.words if self.known is None else compacted(words.words, self.known, MAX_FEATURES)

    def annotate(
        self, words: TakeWords, ranges: Sequence[I64], promising: Sequence[I64] | None = None
    ) -> list[list[Segment]]:
        """Label takes; the cost of a segment is its smallest distance, or NaN if no warping path ends in the segment.

        `promising` holds the `promising_ranges` of each take, if they are known.
        """
        columns = concatenated_columns(self.templates, self.usual, self.decoding)
        whole = whole_takes(words)
        within = None
        if not all(own is whole or np.array_equal(own, whole) for own in ranges):
            within = [_ranges_by_take(own, words.offsets) for own in ranges]
        takes, standing_out = [], []
        laid = self.own_words(words)
        groups = None if promising or within else template_groups(self.templates, self.usual, self.decoding)
        for take, (start, stop) in enumerate(pairwise(words.offsets.tolist())):
            own = frames_of(laid[start:stop], self.usual, self.decoding)
            allowed = None if within is None else [by_take[take] for by_take in within]
            known = None if promising is None else promising[take]
            loose = None if groups is None else loose_ranges(groups, own, self.decoding)
            found = explain(self.templates, self.usual, own, self.decoding, allowed, columns, known, loose)
            known = loose if known is None else known
            standing_out.append(
                margins(
                    found, self.templates, self.class_index, self.usual, own, self.decoding, columns, known
                ).tolist()
            )
            takes.append(found)
        every = [
            (one.template, one.start + first, one.stop + first)
            for found, first in zip(takes, words.offsets.tolist(), strict=False)
            for one in found
        ]
        costs = least_costs(self.quantised, words.words, ranges, *np.array(every, np.int64).reshape(-1, 3).T)
        costs[np.isinf(costs)] = np.nan
        cost, index = iter(costs.tolist()), self.class_index.tolist()
        return [
            [
                Segment(one.start, one.stop, index[one.template], next(cost), one.template, margin, one.value)
                for one, margin in zip(found, own, strict=True)
            ]
            for found, own in zip(takes, standing_out, strict=True)
        ]


METHODS: Plugins[type[AnnotationMethod]] = Plugins(
    "kinedex.annotation_methods",
    "annotation method",
    {
        "thesis": "kinedex.pipelines.annotation.methods:ThesisMethod",
        "best": "kinedex.pipelines.annotation.methods:BestMethod",
    },
)
"""All methods by name, both built-in ones and those of plugins."""


def annotation_method(name: str) -> type[AnnotationMethod]:
    """Return the annotation method with the given name.

    Raises
    ------
    KinedexError
        No method has this name, or the plugin that provides it cannot be used.
    """
    found = METHODS.load(name)
    lacking = [part for part in ("label", "uses_thresholds", "prepare", "annotate") if not hasattr(found, part)]
    if lacking or getattr(found, "name", None) != name:
        raise KinedexError(
            f"the annotation method '{name}' of {METHODS.distribution(name)} must be a class with name = '{name}', "
            "label, uses_thresholds, prepare and annotate (kinedex.pipelines.annotation.methods.AnnotationMethod)"
        )
    return found


def with_usual_values(template: Template, usual: F64) -> Template:
    """Return a template in which features of weight 0, such as unknown ones, have their average over the postures."""
    if template.feature_weights is None:
        return template
    return replace(template, values=np.where(template.feature_weights == 0, usual.mean(axis=0), template.values))


def whole_takes(words: TakeWords) -> I64:
    """Return the range of each take in concatenated words, int64 (T, 2)."""
    return np.stack([words.offsets[:-1], words.offsets[1:]], axis=1)


def _ranges_by_take(ranges: I64, offsets: I64) -> list[I64]:
    """Divide ranges of concatenated words at the ends of takes; return them for each take, in frames of the take."""
    firsts = np.searchsorted(ranges[:, 1], offsets[:-1], side="right")
    lasts = np.searchsorted(ranges[:, 0], offsets[1:], side="left")
    return [
        np.clip(ranges[first:last] - start, 0, stop - start)
        for first, last, (start, stop) in zip(firsts.tolist(), lasts.tolist(), pairwise(offsets.tolist()), strict=True)
    ]
