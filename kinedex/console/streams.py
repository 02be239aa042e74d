"""Configure standard output and standard error: escaped text on a terminal, UTF-8 in files and pipes."""

from __future__ import annotations

import codecs
import sys
from collections.abc import Iterable
from io import TextIOWrapper
from typing import Any, TextIO

from kinedex.ops.wording import visible_text


class EscapedStream:
    """A stream that escapes the plain text written to a terminal by `print`, log records, warnings and usage errors.

    Parameters
    ----------
    stream : TextIO
        The terminal; all methods except `write` and `writelines` are passed on to it.
    """

    def __init__(self, stream: TextIO) -> None:
        self.unescaped = stream

    def write(self, text: str) -> int:
        """Write a text; line breaks are kept, and all other control characters are escaped as `visible` does."""
        self.unescaped.write(visible_text(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write texts one after the other."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.unescaped, name)


def unescaped(stream: TextIO) -> TextIO:
    """Return the stream that an `EscapedStream` wraps, for output of rich, whose ESC sequences must not be escaped."""
    return stream.unescaped if isinstance(stream, EscapedStream) else stream


def escape_streams() -> None:
    """Escape all output to terminals; write UTF-8 to files and pipes, with file names byte for byte."""
    codecs.register_error("kinedex-names", _encode_name)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(encoding="utf-8", errors="kinedex-names")
        if stream is not None and stream.isatty():
            setattr(sys, name, EscapedStream(stream))


def _encode_name(fault: UnicodeError) -> tuple[str | bytes, int]:
    """Encode a byte of a file name that is not UTF-8 as this byte, and escape any other surrogate."""
    try:
        return codecs.lookup_error("surrogateescape")(fault)
    except UnicodeError:
        return codecs.lookup_error("backslashreplace")(fault)
