"""Text and tables as Markdown: what users name stands there as they wrote it, whatever signs are in it."""

from __future__ import annotations

import re
from collections.abc import Sequence

_SIGNS = re.compile(r"[\\`*\[\]<>|&~]|(?<![^\W_])_|_(?![^\W_])")
"""What Markdown (CommonMark, and GitHub's tables) would read as more than itself; `_` only at the edge of a word."""


def plain(text: str) -> str:
    """Text that Markdown shows as it is, in one line."""
    return _SIGNS.sub(r"\\\g<0>", " ".join(text.split()))


def grid(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A Markdown table of plain texts, and an empty line."""
    cells = [[plain(text) for text in line] for line in (header, *rows)]
    return [
        "| " + " | ".join(cells[0]) + " |",
        "|" + "|".join(["---", *["--:"] * (len(header) - 1)]) + "|",
        *("| " + " | ".join(line) + " |" for line in cells[1:]),
        "",
    ]
