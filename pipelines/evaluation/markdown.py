"""Text and tables as Markdown, with all signs of users' names escaped."""

from __future__ import annotations

import re
from collections.abc import Sequence

_SIGNS = re.compile(r"[\\`*\[\]<>|&~]|(?<![^\W_])_|_(?![^\W_])")
"""Signs that CommonMark and GitHub's tables would interpret; `_` only at the edge of a word."""


def plain(text: str) -> str:
    """Return text that Markdown shows as it is, in one line."""
    return _SIGNS.sub(r"\\\g<0>", " ".join(text.split()))


def grid(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return a Markdown table of plain texts, and an empty line."""
    cells = [[plain(text) for text in line] for line in (header, *rows)]
    return [
        "| " + " | ".join(cells[0]) + " |",
        "|" + "|".join(["---", *["--:"] * (len(header) - 1)]) + "|",
        *("| " + " | ".join(line) + " |" for line in cells[1:]),
        "",
    ]
