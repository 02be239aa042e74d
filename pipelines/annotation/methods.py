"""Annotation methods: the form that all of them have, and the table of methods by name.

A method is a frozen dataclass that derives from `AnnotationMethod`. `fit` makes it from examples, unlabelled takes and
a setting; `annotate` labels takes. It declares what it needs (`Needs`), which is all that is read and computed for it,
and what else it can do (`Offers`); no code asks for the name or the type of a method. An instance is sent to workers,
so it must be picklable. The fields of an instance are hashed to find annotations that are up to date, so they must hold
everything that the segments depend on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, ClassVar, Generic, Literal, Protocol, Self, TypeVar, overload

import numpy as np

from kinedex.catalog.plugins import Plugins
from kinedex.ops.annotation.segments import Segment
from kinedex.ops.arrays import F64, I64, U64, Bool
from kinedex.ops.errors import KinedexError
from kinedex.ops.templates.templates import QuantisedTemplate, Template
from kinedex.ops.words import ALL_KNOWN, NO_WORD, TakeWords

PAGE = "docs/extending/method.md"
"""The page that documents the form of methods, with an example."""


@dataclass(frozen=True)
class Needs:
    """The needs of a method, which are all that is read and computed for it.

    Attributes
    ----------
    words : bool
        The words of examples, unlabelled takes and takes.
    positions : bool
        Their joint positions.
    templates : {"none", "outlines", "learned"}
        "learned": the templates of all classes. Its examples are then the clips that these were learned from, without
        mirrored and rejected ones. "outlines": the same templates where they exist anyway, and templates of one clip of
        each class where they would be learned for this method alone; they say which classes there are.
    thresholds : bool
        The threshold τ of each class.
    ranges : bool
        The frames that keyframe queries preselect for each class.
    """

    words: bool = False
    positions: bool = False
    templates: Literal["none", "outlines", "learned"] = "none"
    thresholds: bool = False
    ranges: bool = False


@dataclass(frozen=True)
class Offers:
    """The abilities of a method beyond labelling takes.

    Attributes
    ----------
    probabilities : bool
        The margins of its segments are probabilities that their labels are right, and become their confidences. The
        confidences of other methods are calibrated with examples that are left out.
    matches : bool
        Its segments follow from matches of single templates, so that the explorer can keep the matches of templates
        that an edit does not change: `matches(words, ranges)` finds them, `of_matches(matches, words)` makes segments
        of them, and `only(places)` is the method with some of its templates.
    keeps_ranges : bool
        `promising(words, earlier)` returns the ranges of takes that its `keys` could label. They are stored, and given
        to `annotate` again, as `Takes.promising`.
    feature_weights : bool
        Its costs depend on the weights of features, and not only on whether a weight is 0.
    each_example : str
        The method, as "module:class", that makes each example a template (`each_example`); empty if there is none.
    """

    probabilities: bool = False
    matches: bool = False
    keeps_ranges: bool = False
    feature_weights: bool = False
    each_example: str = ""


@dataclass(frozen=True, kw_only=True)
class Motion:
    """A take, or a part of one, with what the method needs of it.

    Attributes
    ----------
    words : uint64 array (L,)
        Its words, `NO_WORD` for invalid frames; empty if the method does not need words.
    positions : float64 array (L, J, 3)
        Its joints in metres, Y up, NaN where they are not known; empty if the method does not need positions.
    known : int
        The mask of the features that are known, with the bits of a word.
    ranges : tuple of int64 arrays (R, 2), length S
        The frames that each subclass may label, as ascending half-open ranges; empty if the method does not need them.
    """

    words: U64 = field(default_factory=lambda: np.empty(0, np.uint64))
    positions: F64 = field(default_factory=lambda: np.empty((0, 0, 3)))
    known: int = int(ALL_KNOWN)
    ranges: tuple[I64, ...] = ()

    @property
    def valid(self) -> Bool:
        """True for the frames that are known, bool (L,): those with a word and with every joint that the take has."""
        found: Bool = self.words != NO_WORD if len(self.words) else np.ones(len(self.positions), np.bool_)
        if len(self.positions):
            joints: Bool = np.isfinite(self.positions[:, :, 0])
            found = found & joints[:, joints.any(axis=0)].all(axis=1) & joints.any(axis=1)
        return found


@dataclass(frozen=True, kw_only=True)
class LabelledMotion(Motion):
    """An example: a part of a take that shows a class, or that a person has rejected for the class.

    Attributes
    ----------
    label : str
        The subclass that it shows (`Setting.subclasses`).
    take : str
        The name of the take.
    start, stop : int
        Its frames in the take, [start, stop).
    positive : bool
        False for an example that a person has rejected.
    mirrored : bool
        True for the mirror image of an example.
    """

    label: str
    take: str = ""
    start: int = 0
    stop: int = 0
    positive: bool = True
    mirrored: bool = False


Kind = TypeVar("Kind", bound=Motion, covariant=True)
Result = TypeVar("Result")


class Motions(Sequence[Kind], Generic[Kind]):
    """Motions that are read when a method first looks at them, and not at all if it does not.

    Parameters
    ----------
    read : callable
        Returns the motions.
    """

    def __init__(self, read: Callable[[], Iterable[Kind]] = tuple) -> None:
        self._read: Callable[[], Iterable[Kind]] = read
        self._held: tuple[Kind, ...] | None = None
        self._found: dict[object, Any] = {}

    @property
    def _motions(self) -> tuple[Kind, ...]:
        if self._held is None:
            self._held = tuple(self._read())
        return self._held

    def __len__(self) -> int:
        return len(self._motions)

    @overload
    def __getitem__(self, place: int) -> Kind: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[Kind]: ...
    def __getitem__(self, place: int | slice) -> Kind | Sequence[Kind]:
        """Return a motion, or some of them."""
        return self._motions[place]

    def once(self, compute: Callable[..., Result], *arguments: object) -> Result:
        """Return `compute(motions, *arguments)`, which is kept for the next fit with the same motions."""
        key = (compute, *arguments)
        if key not in self._found:
            self._found[key] = compute(self._motions, *arguments)
        result: Result = self._found[key]
        return result


@dataclass(frozen=True)
class Setting:
    """The classes to label with, and what the pipeline has learned of them.

    Attributes
    ----------
    classes : tuple of str, length P
        The names of the classes.
    subclasses : tuple of str, length S
        The names of their subclasses, one for each template: a segment refers to one of them.
    class_index : int64 array (S,)
        The class of each subclass.
    joints : tuple of str, length J
        The names of the joints, the root first.
    features : int
        The number f of features of a word.
    rate_hz : float
        Frames per second of all motions.
    templates : tuple of Template, length S
        The learned templates, with values in [0, 1]; empty if the method needs none.
    quantised : tuple of QuantisedTemplate, length S
        The same templates quantised to 0, 1 and wildcards.
    thresholds : float64 array (P,)
        The threshold τ of each class.
    delta : float
        Entries of a template within delta of 0 or 1 count.
    feature_weights : float64 array (f,), optional
        The weights of features in costs; None if all are equal.
    mirror : mapping of str to str
        Subclass → the subclass of its mirror images.
    """

    classes: tuple[str, ...]
    subclasses: tuple[str, ...]
    class_index: I64
    joints: tuple[str, ...]
    features: int
    rate_hz: float
    templates: tuple[Template, ...]
    quantised: tuple[QuantisedTemplate, ...]
    thresholds: F64
    delta: float
    feature_weights: F64 | None = None
    mirror: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Takes:
    """T takes that a method labels; iteration yields them one by one.

    Attributes
    ----------
    words : TakeWords
        Their words, concatenated.
    ranges : sequence of int64 arrays (R, 2), length S
        The frames that each subclass may label, as ascending half-open ranges of the concatenated words.
    positions : sequence of float64 arrays (L, J, 3), length T
        The positions of each take; empty if the method does not need them.
    promising : sequence of int64 arrays, length T, optional
        What `promising` has returned, for a method that keeps ranges.
    """

    words: TakeWords
    ranges: Sequence[I64]
    positions: Sequence[F64] = ()
    promising: Sequence[I64] | None = None

    def __len__(self) -> int:
        return len(self.words)

    def __iter__(self) -> Iterator[Motion]:
        every = [ranges_by_take(own, self.words.offsets) for own in self.ranges]
        positions = self.positions or [np.empty((0, 0, 3))] * len(self)
        for index, own in enumerate(positions):
            known = ALL_KNOWN if self.words.known is None else self.words.known[index]
            ranges = tuple(by_take[index] for by_take in every)
            yield Motion(words=self.words.take(index), positions=own, known=int(known), ranges=ranges)


class AnnotationMethod(Protocol):
    """A method that labels the frames of takes by what examples teach.

    A method that also has `restricted(known, templates, chosen)` labels takes that lack features: it returns the method
    for takes that know the features of the mask `known`, with the restricted templates that are applied, and their
    places among all. Takes that lack features have no annotation by other methods.

    Attributes
    ----------
    name : str
        The value of the parameter `method` that selects it.
    label : str
        The value of the column `method` of annotations.
    needs : Needs
        What it reads.
    offers : Offers
        What else it can do.
    remarks : tuple of str
        Remarks on what it was fitted with, which are shown to the user.
    """

    name: ClassVar[str]
    label: ClassVar[str]
    needs: ClassVar[Needs]
    offers: ClassVar[Offers] = Offers()
    remarks: tuple[str, ...] = ()

    @classmethod
    def fit(cls, examples: Motions[LabelledMotion], unlabelled: Motions[Motion], setting: Setting) -> Self:
        """Make the method.

        Parameters
        ----------
        examples : Motions of LabelledMotion
            The examples, read when the method first looks at them.
        unlabelled : Motions of Motion
            Takes of the archive, whatever they show, read in the same way; of positions, a bounded number of frames.
        setting : Setting
            The classes, and what else the method needs.
        """
        ...

    def annotate(self, takes: Takes) -> list[list[Segment]]:
        """Label the frames of takes; the labels of a take must not depend on other takes.

        Parameters
        ----------
        takes : Takes
            T takes.

        Returns
        -------
        list of list of Segment, length T
            The segments of each take in the order of their starts, in frames of the take.
        """
        ...


@dataclass(frozen=True)
class Material:
    """The examples and unlabelled takes of an archive, with which methods are fitted.

    Attributes
    ----------
    examples : Motions of LabelledMotion
        The examples.
    unlabelled : Motions of Motion
        Takes of the archive.
    rate_hz : float
        Frames per second.
    feature_weights : float64 array (f,), optional
        The weights of features in costs.
    mirror : mapping of str to str
        Subclass → the subclass of its mirror images.
    """

    examples: Motions[LabelledMotion] = field(default_factory=Motions)
    unlabelled: Motions[Motion] = field(default_factory=Motions)
    rate_hz: float = 30.0
    feature_weights: F64 | None = None
    mirror: Mapping[str, str] = field(default_factory=dict)


METHODS: Plugins[type[AnnotationMethod]] = Plugins(
    "kinedex.annotation_methods",
    "annotation method",
    {
        "thesis": "kinedex.pipelines.annotation.template_methods:ThesisMethod",
        "best": "kinedex.pipelines.annotation.template_methods:BestMethod",
        "numeric": "kinedex.pipelines.annotation.numeric_method:NumericMethod",
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
    if hasattr(found, "prepare") and not hasattr(found, "fit"):
        raise KinedexError(
            f"the annotation method '{name}' of {METHODS.distribution(name)} has the former form of methods "
            f'(`prepare`), which is not used any more; {PAGE} says how to change it ("A method of the former form")'
        )
    lacking = [part for part in ("label", "needs", "offers", "fit", "annotate") if not hasattr(found, part)]
    if lacking or getattr(found, "name", None) != name:
        raise KinedexError(
            f"the annotation method '{name}' of {METHODS.distribution(name)} must be a class that derives from "
            f"kinedex.pipelines.annotation.methods.AnnotationMethod, with name = '{name}', label, needs, fit and "
            f"annotate; {PAGE} has an example"
        )
    return found


def best_known(motions: Sequence[Kind]) -> Sequence[Kind]:
    """Return the motions with all features known, or all motions if there are none."""
    return [one for one in motions if one.known == ALL_KNOWN] or motions


def ranges_by_take(ranges: I64, offsets: I64) -> list[I64]:
    """Divide ranges of concatenated words at the ends of takes; return them for each take, in frames of the take."""
    firsts = np.searchsorted(ranges[:, 1], offsets[:-1], side="right")
    lasts = np.searchsorted(ranges[:, 0], offsets[1:], side="left")
    return [
        np.clip(ranges[first:last] - start, 0, stop - start)
        for first, last, (start, stop) in zip(firsts.tolist(), lasts.tolist(), pairwise(offsets.tolist()), strict=True)
    ]


def whole_takes(words: TakeWords) -> I64:
    """Return the range of each take in concatenated words, int64 (T, 2)."""
    return np.stack([words.offsets[:-1], words.offsets[1:]], axis=1)
