"""Load functions that draw pages by their names, so that stages need not import the code that draws."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any


def drawn_by(place: str) -> Callable[..., Any]:
    """Return the function that a text "module:name" names; the code digest of a stage with the text covers it."""
    module, _, name = place.partition(":")
    found: Callable[..., Any] = getattr(import_module(module), name)
    return found
