"""The built-in method `numeric`, which recognises motions by joint positions; this module alone calls the recogniser.

Examples teach the recogniser the subclasses, and unlabelled takes its background. No template and no threshold matters.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinedex.catalog.mirrored_classes import mirrored_class
from kinedex.ops.annotation.segments import Segment
from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.ops.numeric.channels import channels
from kinedex.ops.numeric.recogniser import LEAST_FRAMES, Recogniser, TaughtMotion
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.wording import name_list
from kinedex.ops.words import ALL_KNOWN
from kinedex.pipelines.annotation.methods import (
    AnnotationMethod,
    LabelledMotion,
    Motion,
    Motions,
    Needs,
    Offers,
    Setting,
    Takes,
)


@dataclass(frozen=True)
class NumericMethod(AnnotationMethod):
    """Labels the spans of a take that look like the examples of a class by numbers of joint positions.

    Attributes
    ----------
    recogniser : Recogniser
        What the examples have taught.
    subclasses : tuple of int
        The subclass of each of its classes.
    class_index : int64 array (S,)
        The class of each subclass.
    remarks : tuple of str
        Remarks on examples that are left out.
    """

    name: ClassVar[str] = "numeric"
    label: ClassVar[str] = "numbers"
    needs: ClassVar[Needs] = Needs(positions=True, ranges=True)
    offers: ClassVar[Offers] = Offers(probabilities=True)

    recogniser: Recogniser
    subclasses: tuple[int, ...]
    class_index: I64
    remarks: tuple[str, ...] = ()

    @classmethod
    def fit(cls, examples: Motions[LabelledMotion], unlabelled: Motions[Motion], setting: Setting) -> NumericMethod:
        """Learn the subclasses from examples; those that are short, or lack a heading or a size, are left out.

        The mirror image of an example is a further example of the mirrored subclass: the one that the setting names, or
        else the one whose name has left for right, if it is another and has examples.

        Raises
        ------
        KinedexError
            No example is left.
        """
        known = set(setting.subclasses)
        shown = [one for one in examples if one.positive and one.label in known]
        own = {one.label for one in shown if not one.mirrored}
        shown = [one for one in shown if not (one.mirrored and one.label in own)]
        used = [one for one in shown if _is_usable(one, setting)]
        if not used:
            raise KinedexError(
                f"no example has {LEAST_FRAMES} frames or more with the root, a pair of hips or shoulders and a whole "
                f"leg, as `method: numeric` needs: {name_list([_named(one) for one in shown])}; learn from other "
                "clips, or use `method: best`"
            )
        motions = [TaughtMotion(one.positions, one.label, one.take) for one in used]
        background = unlabelled.once(_whole_motions)
        mirror = {name: mirrored_class(name, known) for name in own} | dict(setting.mirror)
        mirror = {name: other for name, other in mirror.items() if name != other or name in setting.mirror}
        try:
            taught = Recogniser.fit(motions, background, setting.joints, setting.rate_hz, mirror)
        except ParameterError as fault:
            raise KinedexError(f"the examples cannot teach `method: numeric`: {fault}") from fault
        places = tuple(setting.subclasses.index(name) for name in taught.classes)
        return cls(taught, places, setting.class_index, (*_remarks(shown, used), *taught.remarks))

    def restricted(self, known: int, templates: Sequence[QuantisedTemplate], chosen: I64) -> NumericMethod:
        """Return the method for takes that lack joints, which is the same; see `AnnotationMethod`."""
        return self

    def annotate(self, takes: Takes) -> list[list[Segment]]:
        """Label takes one by one; a span that lies mostly outside the ranges of its subclass gets no label."""
        found = []
        for index, take in enumerate(takes):
            try:
                found.append(self._segments(take))
            except ParameterError as fault:
                if not np.isfinite(take.positions).any(axis=(0, 2)).all():  # a remark says which bodies have no label
                    found.append([])
                    continue
                take_id = int(takes.words.take_ids[index])
                raise KinedexError(
                    f"the take with take_id {take_id} cannot be labelled by `method: numeric`: {fault}; leave it out "
                    f"with `where: take_id <> {take_id}`"
                ) from fault
        return found

    def _segments(self, take: Motion) -> list[Segment]:
        """Return the segments of a take; its invalid frames divide it."""
        inside = np.zeros((len(take.ranges), len(take.positions) + 1), np.int64)
        for row, own in zip(inside, take.ranges, strict=True):
            for start, stop in own.tolist():
                row[start + 1 : stop + 1] = 1
        inside = inside.cumsum(axis=1)
        if len(inside) and not inside[:, -1].any():
            return []
        found = []
        for first, last in runs(take.valid):
            for one in self.recogniser.label(take.positions[first:last]) if last - first >= LEAST_FRAMES else ():
                start, stop = first + one.start, first + one.stop
                place = self.subclasses[self.recogniser.classes.index(one.label)]
                if 2 * (inside[place, stop] - inside[place, start]) >= stop - start:
                    kind = int(self.class_index[place])
                    found.append(Segment(start, stop, kind, np.nan, place, float(one.probability)))
        return found


def runs(true: Bool) -> Iterator[tuple[int, int]]:
    """Yield the ranges [start, stop) of frames that are true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(np.int8)))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _whole_motions(takes: Sequence[Motion]) -> list[F64]:
    """Return the positions of takes whose bodies have all joints, without invalid frames."""
    return [
        one.positions[start:stop]
        for one in takes
        if one.known == ALL_KNOWN
        for start, stop in runs(one.valid)
        if stop - start >= LEAST_FRAMES
    ]


def _is_usable(one: LabelledMotion, setting: Setting) -> bool:
    """Return whether an example is long enough, and has a heading and a size."""
    if len(one.positions) < LEAST_FRAMES or not np.isfinite(one.positions[:, 0]).all():
        return False
    try:
        channels(one.positions, setting.joints, setting.rate_hz)
    except ParameterError:
        return False
    return True


def _named(one: LabelledMotion) -> str:
    return f"{one.take}[{one.start}:{one.stop}]"


def _remarks(shown: Sequence[LabelledMotion], used: Sequence[LabelledMotion]) -> Iterator[str]:
    """Yield remarks on examples that are not used."""
    gone = [_named(one) for one in shown if not any(one is other for other in used)]
    if gone:
        yield (
            f"examples with fewer than {LEAST_FRAMES} frames, or too few joints for a heading and a size, left out: "
            f"{name_list(gone)}"
        )
    lost = sorted({one.label for one in shown} - {one.label for one in used})
    if lost:
        yield f"classes that are left without an example, which nothing can be labelled with: {name_list(lost)}"
