"""Find the example that a page plays beside a hit: the nearest clip of its template, or the example of the search."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from kinedex.ops.templates.nearest_clip import nearest_clips
from kinedex.pipelines.templates.stored_clips import words_of
from kinedex.storage.store.store import Store

Place = tuple[str, int, int]
"""A take, and the frames [start, stop) of it."""


class HasExamples(Protocol):
    """An interval with the name of its examples."""

    @property
    def take(self) -> str: ...

    @property
    def start(self) -> int: ...

    @property
    def stop(self) -> int: ...

    @property
    def examples(self) -> str: ...


Hit = TypeVar("Hit", bound=HasExamples)


@dataclass(frozen=True)
class Nearest:
    """An example, and for each frame of a hit the aligned frame of the example, counted from its start."""

    take: str
    start: int
    stop: int
    frames: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Examples:
    """Intervals that serve as examples, by name: the clips of each template, for instance."""

    of: Mapping[str, Sequence[Place]]

    def nearest(self, store: Store, hits: Iterable[Hit]) -> dict[Hit, Nearest | None]:
        """Return the nearest example of each hit; None where the store has no example of its name."""
        hits = list(hits)
        found: dict[Hit, Nearest | None] = dict.fromkeys(hits)
        named: dict[str, list[Hit]] = {}
        for hit in hits:
            if self.of.get(hit.examples) and hit.start < hit.stop:
                named.setdefault(hit.examples, []).append(hit)
        takes = {hit.take for own in named.values() for hit in own}
        takes |= {interval[0] for name in named for interval in self.of[name]}
        words = words_of(store, sorted(takes))
        for name, own in named.items():
            clips = [words[take][start:stop] for take, start, stop in self.of[name]]
            parts = [words[hit.take][hit.start : hit.stop] for hit in own]
            for hit, one in zip(own, nearest_clips(clips, parts, len(store.feature_set.features)), strict=True):
                found[hit] = Nearest(*self.of[name][one.clip], one.frames)
        return found
