"""All commands of the program, for tests that try every one; the program itself imports one when it is asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import typer

from kinedex.commands.cli import app


def commands() -> Iterator[tuple[str, Callable[..., None]]]:
    """Yield the words and the function of every command."""
    yield from _of(typer.main.get_command(app), "")


def _of(one: Any, words: str) -> Iterator[tuple[str, Callable[..., None]]]:
    if not hasattr(one, "commands"):
        yield words, one.callback.__wrapped__  # what Typer calls with the parsed words
        return
    for name, inner in one.commands.items():
        yield from _of(inner, f"{words} {name}".strip())
