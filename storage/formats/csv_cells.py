"""Write lines of CSV in which a spreadsheet takes no cell for a formula.

A spreadsheet evaluates a cell that begins with = + - @, a tab or a carriage return, and a take's name can begin so. An
apostrophe in front makes the cell a text; readers of kinedex remove it again. Numbers stay numbers.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable

_FORMULA = re.compile(r"'*[=+\-@\t\r]")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


def csv_line(cells: Iterable[object]) -> str:
    """Return a line of CSV; texts are guarded, None becomes an empty cell, and other values are written unchanged."""
    line = io.StringIO()
    # with this line terminator the csv module quotes cells that contain either of its characters
    writer = csv.writer(line, lineterminator="\r\n")
    writer.writerow(guarded(cell) if isinstance(cell, str) else cell for cell in cells)
    return line.getvalue().removesuffix("\r\n") + "\n"


def guarded(text: str) -> str:
    """Return a text with an apostrophe in front if a spreadsheet would evaluate it."""
    return f"'{text}" if _FORMULA.match(text) and not _NUMBER.fullmatch(text) else text


def unguarded(cell: str) -> str:
    """Return the text from which `guarded` made this cell."""
    return cell[1:] if cell.startswith("'") and guarded(cell[1:]) == cell else cell
