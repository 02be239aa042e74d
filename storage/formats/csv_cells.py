"""Lines of CSV files, in which no cell is one that a spreadsheet would take for a formula.

A spreadsheet computes a cell that begins with = + - @, a tab or a carriage return, and a take's name can be such a
text. An apostrophe in front makes it a text; readers of kinedex remove it again. Numbers stay numbers.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable

_FORMULA = re.compile(r"'*[=+\-@\t\r]")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


def csv_line(cells: Iterable[object]) -> str:
    """Return a line of CSV; texts are guarded, None is an empty cell, everything else is written as it is."""
    line = io.StringIO()
    # with this line terminator Python puts cells with either of its characters between quotes
    writer = csv.writer(line, lineterminator="\r\n")
    writer.writerow(guarded(cell) if isinstance(cell, str) else cell for cell in cells)
    return line.getvalue().removesuffix("\r\n") + "\n"


def guarded(text: str) -> str:
    """Return a text with an apostrophe in front where a spreadsheet would compute it."""
    return f"'{text}" if _FORMULA.match(text) and not _NUMBER.fullmatch(text) else text


def unguarded(cell: str) -> str:
    """Return the text of which `guarded` made this cell."""
    return cell[1:] if cell.startswith("'") and guarded(cell[1:]) == cell else cell
