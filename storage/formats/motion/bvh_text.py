"""Parse the text of a BVH file before its frames word by word, and locate faults."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from kinedex.ops.errors import SourceError

LINE_END = re.compile(rb"\r\n?|\n")
"""The end of a line, as Windows, Unix or an old Macintosh writes it."""

_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_TOKEN = re.compile(rb"[{}]|[^\s{}]+")
_TOLINE_END = re.compile(rb"[^\r\n]*")
_NAME = re.compile(rb"[^\r\n{}]*")


@dataclass
class BvhText:
    """The bytes of a file, and the position up to which they are parsed."""

    path: Path
    data: bytes
    pos: int = 0
    at: int = field(default=0, init=False)  # byte at which the last word began
    settings: list[tuple[int, int]] = field(default_factory=list, init=False)  # byte ranges of Frames and of Frame Time

    def line(self, at: int) -> int:
        """Return the line number of a byte, from 1."""
        return 1 + len(LINE_END.findall(self.data, 0, at))

    def error(self, message: str, at: int | None = None) -> SourceError:
        """Return an error that names the line of a byte, by default of the last word."""
        return SourceError(self.path, message, line=self.line(self.at if at is None else at))

    def word(self) -> str | None:
        """Return the next word or brace, skipping comments (# or // to the line's end); None at the end of the file."""
        while found := _TOKEN.search(self.data, self.pos):
            self.at, self.pos = found.span()
            if not found[0].startswith((b"#", b"//")):
                return decoded(found[0])
            self.pos = self._match(_TOLINE_END).end()
        self.at = self.pos = len(self.data)
        return None

    def rest(self) -> str:
        """Return the text up to the next brace or the end of the line."""
        found = self._match(_NAME)
        self.pos = found.end()
        return decoded(found[0]).strip()

    def _match(self, pattern: re.Pattern[bytes]) -> re.Match[bytes]:
        found = pattern.match(self.data, self.pos)
        assert found is not None  # both patterns match the empty text
        return found

    def number(self, what: str) -> float:
        """Parse a finite number; the error states what was expected."""
        word = self.word()
        value = float(word) if word is not None and _NUMBER.fullmatch(word) else np.nan
        if not np.isfinite(value):
            raise self.error(f"{what} must be a number, got {shown(word)}")
        return value


def decoded(text: bytes) -> str:
    """Decode a name: UTF-8 in some files, any code page in others."""
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError:
        return text.decode("latin-1")


def shown(word: str | None) -> str:
    """Return a word in the form in which messages show it."""
    return "the end of the file" if word is None else repr(word[:40])
