"""Format text and tables as Markdown, with special characters in users' names escaped."""

from __future__ import annotations

import re
from collections.abc import Sequence

_SIGNS = re.compile(r"[\\`*\[\]<>|&~]|(?<![^\W_])_|_(?![^\W_])")
"""Characters that CommonMark or GitHub's tables would interpret; `_` only at the edge of a word."""


def plain(text: str) -> str:
    """Return text in one line, escaped so that Markdown shows it literally."""
    return _SIGNS.sub(r"\\\g<0>", " ".join(text.split()))


def grid(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table with literal texts, followed by an empty line."""
    cells = [[plain(text) for text in line] for line in (header, *rows)]
    return [
        "| " + " | ".join(cells[0]) + " |",
        "|" + "|".join(["---", *["--:"] * (len(header) - 1)]) + "|",
        *("| " + " | ".join(line) + " |" for line in cells[1:]),
        "",
    ]
