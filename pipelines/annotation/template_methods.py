"""The built-in methods of templates: that of the thesis, and the templates in a row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar

import numpy as np

from kinedex.ops.annotation.background import background
from kinedex.ops.annotation.decoding import Decoding, concatenated_columns, explain, frames_of, least_costs, margins
from kinedex.ops.annotation.promising_ranges import loose_ranges, template_groups
from kinedex.ops.annotation.segments import Matches, Segment, annotate
from kinedex.ops.arrays import F64, I64, U64
from kinedex.ops.distances.costs import encode
from kinedex.ops.distances.pruning import CoarseBound, coarse_bounds
from kinedex.ops.distances.range_minima import minima_within
from kinedex.ops.templates.templates import QuantisedTemplate, Template
from kinedex.ops.words import MAX_FEATURES, TakeWords, compacted, known_bits
from kinedex.pipelines.annotation.methods import (
    AnnotationMethod,
    LabelledMotion,
    Motion,
    Motions,
    Needs,
    Offers,
    Setting,
    Takes,
    best_known,
    ranges_by_take,
    whole_takes,
)

NARROW = 4
"""Lower bounds of distances are used for a template that is matched in more than one of this number of frames.

For a template that is matched in fewer frames, computing bounds takes more time than they save.
"""


@dataclass(frozen=True)
class ThesisMethod(AnnotationMethod):
    """Labels each frame with the class of the smallest distance below its threshold (thesis, Section 5.2)."""

    name: ClassVar[str] = "thesis"
    label: ClassVar[str] = "templates"
    needs: ClassVar[Needs] = Needs(words=True, templates="learned", thresholds=True, ranges=True)
    offers: ClassVar[Offers] = Offers(matches=True, feature_weights=True)

    templates: tuple[QuantisedTemplate, ...]
    class_index: I64
    thresholds: F64

    @classmethod
    def fit(cls, examples: Motions[LabelledMotion], unlabelled: Motions[Motion], setting: Setting) -> ThesisMethod:
        """Return the method for the templates of a setting; examples and unlabelled takes are not read."""
        return cls(setting.quantised, setting.class_index, setting.thresholds)

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

    def only(self, places: Sequence[int]) -> ThesisMethod:
        """Return the method with some of its templates."""
        return ThesisMethod(tuple(self.templates[s] for s in places), self.class_index[list(places)], self.thresholds)

    def annotate(self, takes: Takes) -> list[list[Segment]]:
        """Label takes; see `AnnotationMethod.annotate`."""
        return self.of_matches(self.matches(takes.words, takes.ranges), takes.words)

    def of_matches(self, matches: Matches, words: TakeWords) -> list[list[Segment]]:
        """Return the segments of takes that follow from matches."""
        return annotate(matches, self.class_index, words.offsets, self.thresholds)

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
class BestMethod(AnnotationMethod):
    """Labels all frames of a take together, by the most probable sequence of templates and background.

    The postures in `usual`, which are common in training clips, describe the background. If a mask `known` is given,
    templates and postures have only the features in the mask.
    """

    name: ClassVar[str] = "best"
    label: ClassVar[str] = "templates in a row"
    needs: ClassVar[Needs] = Needs(words=True, templates="learned", ranges=True)
    offers: ClassVar[Offers] = Offers(each_example="kinedex.pipelines.annotation.single_examples:SingleExamples")

    templates: tuple[Template, ...]
    quantised: tuple[QuantisedTemplate, ...]
    class_index: I64
    usual: F64
    decoding: Decoding
    known: int | None = None

    @classmethod
    def fit(cls, examples: Motions[LabelledMotion], unlabelled: Motions[Motion], setting: Setting) -> BestMethod:
        """Make the method with the common postures of the examples (of all takes if there are none) as background."""
        usual = background([one.words for one in best_known(examples or unlabelled)], setting.features)
        learned = tuple(with_usual_values(one, usual) for one in setting.templates)
        return cls(learned, setting.quantised, setting.class_index, usual, Decoding())

    def restricted(self, known: int, templates: Sequence[QuantisedTemplate], chosen: I64) -> BestMethod:
        """Return the method for takes in which only some features are known; see `ThesisMethod.restricted`."""
        bits = known_bits(known, self.usual.shape[1])
        learned = tuple(Template(self.templates[s].values[:, bits], self.templates[s].weights) for s in chosen.tolist())
        usual = np.ascontiguousarray(self.usual[:, bits])
        return BestMethod(learned, tuple(templates), self.class_index[chosen], usual, self.decoding, known)

    def own_words(self, words: TakeWords) -> U64:
        """Return the words of takes, reduced to the features of the templates."""
        return words.words if self.known is None else compacted(words.words, self.known, MAX_FEATURES)

    def annotate(self, takes: Takes) -> list[list[Segment]]:
        """Label takes; the cost of a segment is its smallest distance, or NaN if no warping path ends in the segment.

        `Takes.promising` holds the `promising_ranges` of each take, if they are known.
        """
        words, ranges, promising = takes.words, takes.ranges, takes.promising
        columns = concatenated_columns(self.templates, self.usual, self.decoding)
        whole = whole_takes(words)
        within = None
        if not all(own is whole or np.array_equal(own, whole) for own in ranges):
            within = [ranges_by_take(own, words.offsets) for own in ranges]
        explained, standing_out = [], []
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
            explained.append(found)
        every = [
            (one.template, one.start + first, one.stop + first)
            for found, first in zip(explained, words.offsets.tolist(), strict=False)
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
            for found, own in zip(explained, standing_out, strict=True)
        ]


def with_usual_values(template: Template, usual: F64) -> Template:
    """Return a template in which features of weight 0, such as unknown ones, have their average over the postures."""
    if template.feature_weights is None:
        return template
    return replace(template, values=np.where(template.feature_weights == 0, usual.mean(axis=0), template.values))
