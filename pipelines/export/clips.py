"""The clips of a data set: intervals with margins and surroundings, mirrored twins, and the names of their files."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted
from kinedex.pipelines.export.request import CLIPS, How
from kinedex.pipelines.export.selection import Interval
from kinedex.storage.formats.labels.file_names import file_names
from kinedex.storage.store.store import Store

_SIDES = {"left": "right", "right": "left", "l": "r", "r": "l"}
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")


@dataclass(frozen=True)
class Clip:
    """A clip of a data set.

    Attributes
    ----------
    interval : Interval
        The interval that was chosen.
    start, stop : int
        The frames that are meant: the interval with its margins, in analysis frames of the take.
    first, last : int
        The frames [first, last) that the file holds: those that are meant, with their surroundings.
    label : str or None
        The class; of a mirrored twin that of the other side.
    mirrored : bool
        True for a twin with left and right exchanged.
    folder : str
        The folder of the file in the data set: that of its split.
    name : str
        Name of the file without its ending.
    """

    interval: Interval
    start: int
    stop: int
    first: int
    last: int
    label: str | None
    mirrored: bool = False
    folder: str = CLIPS
    name: str = ""

    @property
    def take(self) -> str:
        """Name of the take."""
        return self.interval.take


def clips_of(store: Store, intervals: Sequence[Interval], how: How) -> list[Clip]:
    """Return the clips of intervals, without those that are shorter than asked for.

    Margins and surroundings end where the take ends. Intervals of a class that are one clip with their margins are one
    clip.

    Parameters
    ----------
    store : Store
        The store of the takes.
    intervals : sequence of Interval
        The intervals, by take and start.
    how : How
        The margins, the surroundings and the least length.

    Raises
    ------
    KinedexError
        No interval is long enough.
    """
    rate, lengths = store.rate_hz, store.take_frames
    margin, context = _frames(how.margin, rate), _frames(how.context, rate)
    clips: dict[tuple[str, int, int, str | None], Clip] = {}
    for one in intervals:
        if (one.stop - one.start) / rate < how.min_length - 1e-9:
            continue
        length = lengths[store.take_ids[one.take]]
        start, stop = max(0, one.start - margin), min(length, one.stop + margin)
        clip = Clip(one, start, stop, max(0, start - context), min(length, stop + context), one.label)
        clips.setdefault((one.take, start, stop, one.label), clip)
    if not clips:
        longest = max(one.stop - one.start for one in intervals) / rate
        raise KinedexError(
            f"nothing to export: none of {counted(len(intervals), 'interval')} lasts {how.min_length:g} s; the longest "
            f"lasts {longest:.2f} s"
        )
    return list(clips.values())


def _frames(seconds: float, rate_hz: float) -> int:
    return math.floor(seconds * rate_hz + 0.5)


def with_twins(clips: Sequence[Clip], known: Iterable[str] = ()) -> list[Clip]:
    """Return clips, each with its mirrored twin behind it.

    Parameters
    ----------
    clips : sequence of Clip
        The clips.
    known : iterable of str
        Classes that there are (`mirrored_class`).
    """
    classes = frozenset(known)
    images = {label: mirrored_class(label, classes) for label in {clip.label for clip in clips} if label is not None}
    return [
        one
        for clip in clips
        for one in (clip, replace(clip, mirrored=True, label=None if clip.label is None else images[clip.label]))
    ]


def mirrored_class(name: str, known: Collection[str] = ()) -> str:
    """Return the class of a mirrored motion: the words left and right, and L and R, of its name exchanged.

    Words end at capital letters and at everything that is no letter: "kickLFront1Reps" becomes "kickRFront1Reps", and
    "wave-left-hand" becomes "wave-right-hand". A small l or r counts where it stands alone. A word that begins with L
    or R, as in "startLelbow", is another side only where "startRelbow" is a class that there is.

    Parameters
    ----------
    name : str
        The class.
    known : collection of str
        Classes that there are.
    """

    def exchanged(match: re.Match[str]) -> str:
        word, text = match[0], match.string
        other = _SIDES.get(word.lower())
        alone = not text[: match.start()][-1:].isalnum() and not text[match.end() :][:1].isalnum()
        if other is None or (word in ("l", "r") and not alone):
            return word
        return other.upper() if word.isupper() else other.capitalize() if word[0].isupper() else other

    # a letter before a word that begins with a capital one is a word of its own, as in LFront
    image = _WORD.sub(exchanged, re.sub(r"(?<![A-Z])([LR])(?=[A-Z][a-z])", "\\1\0", name)).replace("\0", "")
    if image == name:
        other = re.sub(r"(?<![A-Z])[LR](?=[a-z])", lambda match: _SIDES[match[0].lower()].upper(), name)
        return other if other in known else name
    return image


def with_names(clips: Sequence[Clip], whole: bool) -> list[Clip]:
    """Return clips with the names of their files, which every system can have and no two share.

    A whole take has its own name; an interval that of its take, its frames and its class; a twin ends in "_mirrored".

    Parameters
    ----------
    clips : sequence of Clip
        The clips.
    whole : bool
        True where the clips are whole takes.
    """
    raw: list[str] = []
    used: set[str] = set()
    for clip in clips:
        one = clip.interval
        name = one.take if whole else f"{one.take}_{clip.start:05d}-{clip.stop:05d}"
        name += f"_{clip.label}" if clip.label and not whole else ""
        name += "_mirrored" if clip.mirrored else ""
        while name in used:
            name += "+"
        used.add(name)
        raw.append(name)
    return [replace(clip, name=name) for clip, name in zip(clips, file_names(raw), strict=True)]
