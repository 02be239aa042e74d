"""Define classes for features and word sets, and the registry of the primitives from which features are computed."""

from __future__ import annotations

from dataclasses import dataclass

from kinedex.catalog.plugins import Plugins
from kinedex.ops.body.feature_rules import JOINTS_OF, Primitive, Rule

PRIMITIVES: Plugins[Primitive] = Plugins("kinedex.primitives", "primitive", dict.fromkeys(JOINTS_OF, ""))
"""All primitives of features by name: those of `JOINTS_OF`, and those of plugins."""


@dataclass(frozen=True)
class Feature:
    """A feature with its number (its bit is number − 1), name, description and rule."""

    number: int
    name: str
    description: str
    rule: Rule


@dataclass(frozen=True)
class WordSet:
    """A range of consecutive features whose bits form one kind of word; `first` is the lowest feature number."""

    name: str
    first: int
    count: int

    @property
    def numbers(self) -> range:
        """Return the numbers of the set's features."""
        return range(self.first, self.first + self.count)

    @property
    def mask(self) -> int:
        """The mask of the set's features, with the bits of a whole word."""
        return ((1 << self.count) - 1) << (self.first - 1)
