"""The template of a subclass, with the provenance that the store keeps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kinedex.ops.templates.templates import Kind, Learned, Template

LEARNED = "learned"
"""The origin of a template that was learned from clips of its own class."""


@dataclass(frozen=True)
class SubclassTemplate:
    """A template with its provenance: the names of its clips, its origin, and remarks on the clips."""

    subclass: str
    kind: Kind
    learned: Learned
    clips: tuple[str, ...]
    origin: str = LEARNED
    remarks: tuple[str, ...] = ()


def template_of(row: dict[str, Any]) -> SubclassTemplate:
    """Return the template in a row of the results `templates`."""
    counts = row["feature_weights"]
    template = Template(
        np.array(row["values"]).reshape(row["columns"], row["features"]),
        np.array(row["weights"]),
        None if counts is None else np.array(counts),
    )
    learned = Learned(template, row["rounds"], tuple(row["costs"]), tuple(row["clip_costs"]))
    return SubclassTemplate(
        row["subclass"], row["kind"], learned, tuple(row["clips"]), row["origin"], tuple(row["remarks"])
    )
