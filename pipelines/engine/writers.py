"""Writers of pages by name: a stage that computes and also draws names the function that draws, in a room above."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any


def drawn_by(place: str) -> Callable[..., Any]:
    """Return the function that a text "module:name" names; a stage with this text depends on its code."""
    module, _, name = place.partition(":")
    found: Callable[..., Any] = getattr(import_module(module), name)
    return found
