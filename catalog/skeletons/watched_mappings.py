"""Mappings that record the last request of a reader, so that a mapping can be proposed for a file that is rejected."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path

from kinedex.catalog.skeletons.evidence import Evidence
from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.catalog.skeletons.skeleton_fit import Fit, Format


@dataclass
class Question:
    """The body for which a reader last requested a mapping.

    Attributes
    ----------
    form : str, optional
        The format; None if the reader requested nothing.
    nodes : dict of str to int
        Node name → index.
    evidence : Evidence, optional
        Tree and places of the nodes.
    fit : Fit, optional
        The answer; None if no body was recognised.
    """

    form: Format | None = None
    nodes: dict[str, int] = field(default_factory=dict)
    evidence: Evidence | None = None
    fit: Fit | None = None


@dataclass(frozen=True)
class WatchedMappings(Mappings):
    """Mappings that record the last request of a reader, and their answer."""

    question: Question = field(default_factory=Question)

    @classmethod
    def of_mappings(cls, mappings: Mappings) -> WatchedMappings:
        """Return mappings that behave like the given mappings."""
        return cls(**{one.name: getattr(mappings, one.name) for one in fields(Mappings)})

    def exact(self, source: str | Path, form: Format, nodes: Mapping[str, int]) -> Fit | None:
        """Record the nodes, and return the fit of the mapping whose nodes all occur among them; None for no mapping."""
        self.question.form, self.question.nodes, self.question.fit = form, dict(nodes), None
        self.question.fit = super().exact(source, form, nodes)
        return self.question.fit

    def recognised(self, source: str | Path, form: Format, evidence: Evidence) -> Fit:
        """Record the evidence, and return the fit that recognition makes."""
        self.question.form, self.question.evidence = form, evidence
        self.question.fit = super().recognised(source, form, evidence)
        return self.question.fit
