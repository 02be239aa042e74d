"""The thesis's method with a memory: the matches of templates that have not changed since are not computed again."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from threading import Lock

import numpy as np
import numpy.typing as npt

from kinedex.ops.annotation.segments import Matches
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import U64, TakeWords
from kinedex.pipelines.annotation.methods import ClassTemplates, ThesisMethod

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

Found = tuple[I64, I64, F64]
"""Starts, ends and costs, as in `Matches`."""

Key = tuple[bytes, bytes, bytes, float, bytes]

MOST_MATCHES = 500
"""The matches of so many templates are kept, those that were needed last."""


class MatchMemory:
    """The matches of templates in the words of some takes, within a bound. Several threads may use it."""

    def __init__(self) -> None:
        self._held: OrderedDict[Key, Found] = OrderedDict()
        self._lock = Lock()

    def get(self, key: Key) -> Found | None:
        """Return the matches of a key, None where they are not kept."""
        with self._lock:
            if key in self._held:
                self._held.move_to_end(key)
            return self._held.get(key)

    def put(self, key: Key, found: Found) -> None:
        """Keep the matches of a key."""
        with self._lock:
            self._held[key] = found
            if len(self._held) > MOST_MATCHES:
                self._held.popitem(last=False)


@dataclass(frozen=True)
class RememberingThesisMethod(ThesisMethod):
    """Label frames as `ThesisMethod` does, with matches that are kept from one annotation to the next.

    Attributes
    ----------
    memory : MatchMemory
        The matches. Takes are told apart by their ids, so it serves one version of a store.
    """

    memory: MatchMemory = field(default_factory=MatchMemory, compare=False)

    @classmethod
    def prepare(cls, templates: ClassTemplates, clips: Callable[[], Sequence[U64]]) -> RememberingThesisMethod:
        """Make the method with a memory of its own."""
        return cls(templates.quantised, templates.class_index, templates.thresholds)

    def matches(self, words: TakeWords, ranges: Sequence[I64]) -> Matches:
        """Return the minima of the distance curve of each template; see `ThesisMethod.matches`."""
        taus = self.thresholds[self.class_index]
        takes = words.take_ids.tobytes()
        keys = [key_of(one, float(tau), takes) for one, tau in zip(self.templates, taus, strict=True)]
        found = {place: own for place, key in enumerate(keys) if (own := self.memory.get(key)) is not None}
        missing = [place for place in range(len(keys)) if place not in found]
        if missing:
            some = ThesisMethod(
                tuple(self.templates[place] for place in missing), np.arange(len(missing)), taus[missing]
            )
            parts = some.matches(words, [ranges[place] for place in missing]).parts()
            for place, own in zip(missing, parts, strict=True):
                found[place] = own
                self.memory.put(keys[place], own)
        return Matches.of([found[place] for place in range(len(keys))])


def key_of(template: QuantisedTemplate, tau: float, takes: bytes) -> Key:
    """Return all that the matches of a template in whole takes depend on."""
    weights = b"" if template.feature_weights is None else template.feature_weights.tobytes()
    return template.mask.tobytes(), template.value.tobytes(), weights, tau, takes
