"""Embed motions in a page for its player: joint positions, packed to a few bytes per frame."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from kinedex.ops.arrays import I64
from kinedex.ops.body.joint_tree import JOINT_PARENTS
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.wording import name_list
from kinedex.pipelines.engine.display import Progress, no_progress
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store

MAX_BYTES = 12_000_000
"""Largest size in bytes of the motions of a page, unless more are requested; pages then have less than 20 MB."""

MARGIN = 15
"""Number of frames that are embedded before and after an interval of a take that is not embedded as a whole."""

FINEST_M = 0.002
"""The unit of coordinates in metres, a quarter of a pixel of the player; a take may need a larger unit."""

UNSEEN = -32_768
"""The number that stands for an unknown coordinate."""

PACKED_STEP = 2
"""Every second frame is embedded, 15 per second; the player interpolates."""

_TOGETHER = 16  # takes that are read at once
_MAX_INTEGER = 32_000

Embed = Literal["auto", "all", "none"] | list[str]


@dataclass(frozen=True)
class EmbeddedMotion:
    """A take, or a piece of a take, in the form that the player reads.

    Attributes
    ----------
    take : str
        Name of the take.
    first, frames : int
        The first analysis frame, and the number of analysis frames.
    total : int
        Number of analysis frames of the whole take.
    step : int
        Every step-th frame is stored.
    rate_hz : float
        Stored frames per second.
    unit_m : float
        Metres per unit of the coordinates.
    data : str
        Base64 of zlib-compressed little-endian int16 (3 J, T'): x, y and z of every joint in units, each row as
        differences over time.
    """

    take: str
    first: int
    frames: int
    total: int
    step: int
    rate_hz: float
    unit_m: float
    data: str


@dataclass(frozen=True)
class EmbeddedMotions:
    """The motions of a page.

    Attributes
    ----------
    motions : tuple of EmbeddedMotion
        Takes and pieces of takes.
    joints : tuple of str
        The joints in their order.
    parents : tuple of int
        The index of the parent of each joint, −1 for none.
    remark : str
        A sentence about the takes that are embedded.
    near : tuple of (int, tuple of int)
        Nearest examples. Each has the index of a motion, and the analysis frames of that motion at the stored frames of
        the interval: the first frame, then the differences between successive frames.
    """

    motions: tuple[EmbeddedMotion, ...]
    joints: tuple[str, ...]
    parents: tuple[int, ...]
    remark: str
    near: tuple[tuple[int, tuple[int, ...]], ...] = ()

    @classmethod
    def none(cls, store: Store) -> EmbeddedMotions:
        """Return an empty collection with the joints of a store that the player draws."""
        joints = tuple(joint for joint in store.feature_set.joints if joint in JOINT_PARENTS)
        return cls((), joints, parents_of(joints), "")

    def has(self, take: str, start: int, stop: int) -> bool:
        """Return whether an interval of a take can be played."""
        return self._find(take, start, stop) is not None

    def _find(self, take: str, start: int, stop: int) -> int | None:
        """Return the index of a motion that covers an interval; None if there is none."""
        return next(
            (
                place
                for place in self._of_take.get(take, ())
                if self.motions[place].first <= start and stop <= self.motions[place].first + self.motions[place].frames
            ),
            None,
        )

    @cached_property
    def _of_take(self) -> dict[str, list[int]]:
        """Return the indices of the motions of each take."""
        found: dict[str, list[int]] = {}
        for place, one in enumerate(self.motions):
            found.setdefault(one.take, []).append(place)
        return found

    def with_pieces(
        self, store: Store, intervals: Iterable[tuple[str, int, int]], margin: int = MARGIN, most: int | None = None
    ) -> EmbeddedMotions:
        """Add the motions of further intervals.

        Parameters
        ----------
        store : Store
            The store of the takes.
        intervals : iterable of (take, start, stop)
            The intervals; those that can be played already are skipped.
        margin : int
            Number of frames to add before and after each interval.
        most : int or None
            Largest size in bytes of all motions of the page; the first intervals that fit are added. None for no limit.
        """
        missing = {one: None for one in intervals if not self.has(*one)}
        packed = dict(_pieces(store, self.joints, list(missing), margin))
        size = sum(len(one.data) for one in self.motions)
        found = [*self.motions]
        for one in missing:
            size += len(packed[one].data)
            if most is not None and size > most:
                break
            found.append(packed[one])
        return replace(self, motions=tuple(found))

    def with_near(self, store: Store, examples: Iterable[tuple[str, int, int, I64]]) -> EmbeddedMotions:
        """Add nearest examples, each given as take, start, stop and frames relative to the start."""
        examples = list(examples)
        found = self.with_pieces(store, (one[:3] for one in examples), margin=0)
        near = []
        for take, start, stop, frames in examples:
            place = found._find(take, start, stop)
            assert place is not None
            near.append((place, tuple(np.diff(start + frames[::PACKED_STEP], prepend=0).tolist())))
        return replace(found, near=tuple(near))

    def beside(self, motions: Sequence[EmbeddedMotion]) -> EmbeddedMotions:
        """Add other motions over the same frames, as examples that are played beside these motions."""
        first = len(self.motions)
        near = ((first + i, (0, *[PACKED_STEP] * (-(-one.frames // PACKED_STEP) - 1))) for i, one in enumerate(motions))
        return replace(self, motions=(*self.motions, *motions), near=(*self.near, *near))


def embed(
    store: Store,
    takes: Sequence[str] | Mapping[str, Sequence[str]],
    wanted: Embed = "auto",
    stage: str = "report",
    progress: Progress = no_progress,
) -> EmbeddedMotions:
    """Pack the motions of takes.

    Parameters
    ----------
    store : Store
        The store of the takes.
    takes : sequence of str, or mapping of str to sequence of str
        The takes with a timeline, in the order of the page. A mapping gives, for each of them, the takes of the store
        of which it is composed.
    wanted : {"auto", "all", "none"} or list of str
        "auto" packs as many of the first takes as fit into `MAX_BYTES`; a list names the takes to pack.
    stage : str
        Name of the stage that has the parameter `wanted`, for the remark.
    progress : callable
        Makes a progress bar of a description and a number of takes.

    Returns
    -------
    EmbeddedMotions
        The packed motions.

    Raises
    ------
    KinedexError
        If a take of the list has no timeline.
    """
    parts = takes if isinstance(takes, Mapping) else {name: (name,) for name in takes}
    if isinstance(wanted, list):
        unknown = [name for name in wanted if name not in takes]
        if unknown:
            raise KinedexError(
                f"embed: no take with a timeline is named '{unknown[0]}'{did_you_mean(unknown[0], takes)}"
            )
    chosen = [] if wanted == "none" else list(wanted) if isinstance(wanted, list) else list(takes)
    none = EmbeddedMotions.none(store)
    packed: list[EmbeddedMotion] = []
    size = 0
    with progress("motions", len(chosen)) as bar:
        for motion in _whole(store, none.joints, {name: parts[name] for name in chosen}):
            if wanted == "auto" and size + len(motion.data) > MAX_BYTES:
                break
            packed.append(motion)
            size += len(motion.data)
            bar.advance()
    remark = _remark(packed, len(takes), wanted, size, f"{stage}.embed")
    return replace(none, motions=tuple(packed), remark=remark)


def parents_of(joints: Sequence[str]) -> tuple[int, ...]:
    """Return the index of the parent of each joint; −1 if the parent is not among the joints."""
    return tuple(joints.index(parent) if (parent := JOINT_PARENTS[joint]) in joints else -1 for joint in joints)


def _whole(store: Store, joints: Sequence[str], takes: Mapping[str, Sequence[str]]) -> Iterator[EmbeddedMotion]:
    """Yield the motion of each take; a take that consists of several takes of the store is concatenated."""
    names = list(takes)
    for first in range(0, len(names), _TOGETHER):
        some = names[first : first + _TOGETHER]
        read = store.frames_of({part for name in some for part in takes[name]})
        positions = {part: joint_positions(table, joints) for part, table in read}
        for name in some:
            yield pack(name, np.concatenate([positions[part] for part in takes[name]], axis=2), store.rate_hz)


def _pieces(
    store: Store, joints: Sequence[str], intervals: Sequence[tuple[str, int, int]], margin: int
) -> Iterator[tuple[tuple[str, int, int], EmbeddedMotion]]:
    """Yield intervals with their motions, take by take."""
    of_take: dict[str, list[tuple[str, int, int]]] = {}
    for one in intervals:
        of_take.setdefault(one[0], []).append(one)
    for take, table in store.frames_of(of_take):
        for one in of_take[take]:
            first, last = max(0, one[1] - margin), min(table.num_rows, one[2] + margin)
            positions = joint_positions(table.slice(first, last - first).combine_chunks(), joints)
            yield one, pack(take, positions, store.rate_hz, first, table.num_rows)


def pack(
    take: str, positions: npt.NDArray[np.floating], rate_hz: float, first: int = 0, total: int | None = None
) -> EmbeddedMotion:
    """Pack the positions of a take or of a piece of it.

    Parameters
    ----------
    take : str
        Name of the take.
    positions : float array (J, 3, T)
        Metres, Y up; NaN where unknown.
    rate_hz : float
        Frames per second.
    first : int
        Frame of the take at which the piece begins.
    total : int or None
        Number of frames of the take; None if `positions` is the whole take.
    """
    kept = np.asarray(positions, np.float64)[:, :, ::PACKED_STEP]
    known = np.isfinite(kept)
    largest = float(np.abs(kept[known]).max()) if known.any() else 0.0
    unit_m = max(FINEST_M, largest / _MAX_INTEGER)
    whole = np.where(known, np.round(np.where(known, kept, 0.0) / unit_m), UNSEEN).astype(np.int16)
    rows = whole.reshape(-1, whole.shape[2])
    steps = np.diff(rows, axis=1, prepend=np.int16(0))  # int16 wraps around, as in the player
    data = base64.b64encode(zlib.compress(steps.astype("<i2").tobytes(), 9)).decode("ascii")
    frames = positions.shape[2]
    return EmbeddedMotion(
        take, first, frames, frames if total is None else total, PACKED_STEP, rate_hz / PACKED_STEP, unit_m, data
    )


def motions_json(motions: EmbeddedMotions | None) -> Markup:
    """Return the motions as JSON for a script element."""
    return Markup("") if motions is None else script_json(asdict(motions))


def script_json(content: object) -> Markup:
    """Return JSON for a script element, escaped so that it cannot contain a tag."""
    text = json.dumps(content, ensure_ascii=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c"))


def _remark(carried: Sequence[EmbeddedMotion], shown: int, wanted: Embed, size: int, key: str) -> str:
    if not carried:
        return f"No motion is embedded; `--set {key}=all` embeds all that have a timeline."
    megabytes = f"{size / 1e6:.1f} MB"
    if len(carried) == shown:
        return f"Click a segment to see the motion. It is embedded for every take with a timeline ({megabytes})."
    why = "as requested" if wanted != "auto" else "the first ones, as many as fit into the page"
    return (
        f"Click a segment to see the motion. It is embedded for {len(carried)} of the {shown} takes with a timeline "
        f"({name_list([one.take for one in carried])}), {why} ({megabytes}); set `--set {key}=all` or a list of names "
        "for "
        "others."
    )
