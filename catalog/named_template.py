"""A motion template with the name of what it represents."""

from __future__ import annotations

from dataclasses import dataclass

from kinedex.ops.templates.templates import Template


@dataclass(frozen=True)
class NamedTemplate:
    """A template with its name, which is the subclass that it represents."""

    name: str
    template: Template
    description: str = ""
