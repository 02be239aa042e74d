"""This module formats counts, lists of names, values and durations as text for the terminal, pages and messages.

It also escapes control characters and invisible characters. A terminal would execute ESC sequences in a file's name,
and a right-to-left override would display a different name. All output of the command line is escaped by this module;
CSV, JSON and Parquet in files and pipes keep the original values.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

_MAX_NAMES = 8
_MAX_RANGES = 8

_ODD = (
    "\x00-\x1f\x7f-\x9f"  # C0 and C1 control characters
    "\u00ad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb\U000e0000-\U000e0fff"  # invisible
    "\ud800-\udfff"  # bytes of file names that are not UTF-8
)
_ESCAPED = re.compile(f"[{_ODD}]")
_ESCAPED_IN_LINES = re.compile(f"(?!\n)[{_ODD}]")
_SHORT = {"\n": "\\n", "\r": "\\r", "\t": "\\t"}


def name_list(names: Sequence[str]) -> str:
    """Join names with commas; for more than eight names, give the first eight and the number of the others."""
    return ", ".join(names[:_MAX_NAMES]) + (f" and {len(names) - _MAX_NAMES} more" if len(names) > _MAX_NAMES else "")


def listed_frames(frames: Sequence[int]) -> str:
    """Format ascending frames as ranges such as "3, 7–12"; only the first ones if there are many."""
    ranges: list[list[int]] = []
    for t in frames:
        if ranges and ranges[-1][1] == t - 1:
            ranges[-1][1] = t
        else:
            ranges.append([t, t])
    texts = [str(first) if first == last else f"{first}–{last}" for first, last in ranges[:_MAX_RANGES]]
    more = f" and {len(ranges) - _MAX_RANGES} more ranges" if len(ranges) > _MAX_RANGES else ""
    return ", ".join(texts) + more


def two_digits(value: float | None) -> str:
    """Format a value with two digits after the point, or as a dash for None and NaN."""
    return "–" if value is None or math.isnan(value) else f"{value:.2f}"


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """Return a count with its noun: "1 take", "2,000 takes"."""
    return f"{number:,} {noun if number == 1 else plural or noun + 's'}"


def duration(seconds: float) -> str:
    """Return a duration in its two largest units: "40 s", "3 min 20 s", "2 h 5 min"."""
    whole = max(1, round(seconds))
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 60:
        return f"{minutes} min {rest} s" if minutes < 10 and rest else f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60} min"


def visible(text: str) -> str:
    """Return a one-line text with control and invisible characters escaped: ``\x1b``, ``\u202e``."""
    return text if text.isascii() and text.isprintable() else _ESCAPED.sub(_escape, text)


def visible_text(text: str) -> str:
    """Return a text escaped as by `visible`, but with its line breaks kept."""
    return text if text.isascii() and text.isprintable() else _ESCAPED_IN_LINES.sub(_escape, text)


def visible_lines(text: str) -> str:
    """Return a message escaped as by `visible`, with line breaks kept and all lines but the first indented.

    The indent, of two spaces or more, shows that a name with a line break does not begin a new message.
    """
    return re.sub(r"\n(?!  |\n|$)", "\n  ", visible_text(text))


def json_escaped(text: str) -> str:
    """Escape control and invisible characters in JSON text, so that its values stay the same."""
    # DEL is the only control character that JSON does not escape
    return text if text.isascii() and "\x7f" not in text else _ESCAPED_IN_LINES.sub(_json_escape, text)


def _escape(found: re.Match[str]) -> str:
    letter = found[0]
    code = ord(letter)
    return _SHORT.get(letter) or (
        f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
    )


def _json_escape(found: re.Match[str]) -> str:
    pairs = found[0].encode("utf-16-be", "surrogatepass").hex()
    return "".join(f"\\u{pairs[place : place + 4]}" for place in range(0, len(pairs), 4))
