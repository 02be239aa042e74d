"""The annotation method of the thesis with a cache of the matches of unchanged templates."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from threading import Lock

import numpy as np
import numpy.typing as npt

from kinedex.ops.annotation.segments import TOLERANCE, Matches
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import U64, TakeWords
from kinedex.pipelines.annotation.methods import ClassTemplates, ThesisMethod

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]
I32 = npt.NDArray[np.int32]

Found = tuple[I64, I64, F64]
"""Starts, ends and costs, as in `Matches`."""

Key = tuple[object, ...]

MOST_BYTES = 200_000_000
"""Maximum number of bytes of cached matches, of which the least recently used are dropped; 28 templates in 100 h take
110 MB.
"""


@dataclass(frozen=True)
class Held:
    """The matches of a template below a threshold; they contain the matches below every lower threshold."""

    tau: float
    starts: I32
    ends: I32
    costs: F64

    @property
    def nbytes(self) -> int:
        """The size in bytes."""
        return self.starts.nbytes + self.ends.nbytes + self.costs.nbytes

    def below(self, tau: float) -> Found:
        """Return the matches below a threshold that is not above that of these."""
        starts, ends, costs = self.starts, self.ends, self.costs
        if tau < self.tau:
            chosen = costs < tau - TOLERANCE
            starts, ends, costs = starts[chosen], ends[chosen], costs[chosen]
        return starts.astype(np.int64), ends.astype(np.int64), costs


class MatchMemory:
    """A bounded LRU cache of the matches of templates in the words of takes. Several threads may use it.

    Parameters
    ----------
    most_bytes : int, optional
        The most bytes of all matches in the cache.
    """

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self._most_bytes = most_bytes
        self._held: OrderedDict[Key, Held] = OrderedDict()
        self._bytes = 0
        self._lock = Lock()

    def get(self, key: Key, tau: float) -> Found | None:
        """Return the matches of a key below a threshold, None where they are not kept."""
        with self._lock:
            held = self._held.get(key)
            if held is None or held.tau < tau:
                return None
            self._held.move_to_end(key)
        return held.below(tau)

    def put(self, key: Key, tau: float, found: Found) -> None:
        """Keep the matches of a key; they replace those that were kept for a lower threshold."""
        starts, ends, costs = found
        held = Held(tau, starts.astype(np.int32), ends.astype(np.int32), costs)
        with self._lock:
            before = self._held.pop(key, None)
            self._bytes += held.nbytes - (0 if before is None else before.nbytes)
            self._held[key] = held
            while self._bytes > self._most_bytes and len(self._held) > 1:
                self._bytes -= self._held.popitem(last=False)[1].nbytes


@dataclass(frozen=True)
class RememberingThesisMethod(ThesisMethod):
    """Label frames as `ThesisMethod` does, with matches that are cached from one annotation to the next.

    Attributes
    ----------
    memory : MatchMemory
        The cache of matches.
    scope : tuple
        The store and its version, which are part of the cache's keys, because take ids are unique within these only.
    """

    memory: MatchMemory = field(default_factory=MatchMemory, compare=False)
    scope: tuple[object, ...] = ()

    @classmethod
    def prepare(cls, templates: ClassTemplates, clips: Callable[[], Sequence[U64]]) -> RememberingThesisMethod:
        """Return the method for some templates, with a new empty cache."""
        return cls(templates.quantised, templates.class_index, templates.thresholds)

    def matches(self, words: TakeWords, ranges: Sequence[I64]) -> Matches:
        """Return the minima of the distance curve of each template in whole takes; see `ThesisMethod.matches`."""
        taus = self.thresholds[self.class_index]
        takes = words.take_ids.tobytes()
        keys = [(*self.scope, takes, *content_of(one)) for one in self.templates]
        found = {
            place: own
            for place, (key, tau) in enumerate(zip(keys, taus.tolist(), strict=True))
            if (own := self.memory.get(key, tau)) is not None
        }
        missing = [place for place in range(len(keys)) if place not in found]
        if missing:
            some = ThesisMethod(
                tuple(self.templates[place] for place in missing), np.arange(len(missing)), taus[missing]
            )
            parts = some.matches(words, [ranges[place] for place in missing]).parts()
            for place, own in zip(missing, parts, strict=True):
                found[place] = own
                self.memory.put(keys[place], float(taus[place]), own)
        return Matches.of([found[place] for place in range(len(keys))])


def content_of(template: QuantisedTemplate) -> tuple[bytes, bytes, bytes]:
    """Return what the matches of a template in whole takes depend on, besides threshold and words, for cache keys."""
    weights = b"" if template.feature_weights is None else template.feature_weights.tobytes()
    return template.mask.tobytes(), template.value.tobytes(), weights
