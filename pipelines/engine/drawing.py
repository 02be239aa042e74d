"""Drawing by name: stages that compute and also draw name the function that draws, which lies in a room above."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any


def drawn_by(place: str) -> Callable[..., Any]:
    """Return the function that a text "module:name" names; a stage with this text depends on its code."""
    module, _, name = place.partition(":")
    found: Callable[..., Any] = getattr(import_module(module), name)
    return found
