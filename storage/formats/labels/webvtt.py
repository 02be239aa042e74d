"""Read and write WebVTT, the subtitles of video players; each cue is a label."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator
from pathlib import Path

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.labels.file_labels import LabelFile, LabelsOfTake, ManualSegment
from kinedex.storage.formats.labels.texts import (
    LONGEST_SECONDS,
    MAX_LABELS,
    open_lines,
    refuse_long,
    refuse_many,
    shown,
)

_TIME = r"(?:([0-9]{2,6}):)?([0-5][0-9]):([0-5][0-9])\.([0-9]{3})"
_TIMING = re.compile(rf"{_TIME}[ \t]+-->[ \t]+{_TIME}(?:[ \t].*)?", re.ASCII)
_TAG = re.compile(r"<[^<>]*>")
_TAKE = "kinedex take: "


def write(labels: LabelsOfTake) -> str:
    """Return a WebVTT file with a numbered cue for each label, and the take's name in a note."""
    blocks = ["WEBVTT\n", f"NOTE\n{_TAKE}{_escaped(labels.take)}\n"]
    blocks += [
        f"{number}\n{_clock(labels.milliseconds(one.start))} --> {_clock(labels.milliseconds(one.stop))}\n"
        f"{_escaped(one.label)}\n"
        for number, one in enumerate(labels.labels, 1)
    ]
    return "\n".join(blocks)


def read(path: str | Path) -> LabelFile:
    """Read the cues of a WebVTT file; each line of a cue is a label, whose class is the text without tags.

    The take is named by a note that kinedex writes, or else by the file's name. Other notes, styles and
    regions are ignored.

    Parameters
    ----------
    path : str or Path
        The file.

    Raises
    ------
    SourceError
        The first line is not WEBVTT, a cue has no times or no text, times are out of order, or the file exceeds a limit
        of `storage.formats.labels.texts`; the error names the line.
    """
    take, found = Path(path).stem, list[ManualSegment]()
    for line, block in _blocks(path, open_lines(path)):
        if re.match(r"NOTE(?:\s|$)", block[0]):
            own = [text for text in block[1:] if text.startswith(_TAKE)]
            take = _unescaped(path, own[0].removeprefix(_TAKE), line) or take if own else take
        elif line > 1 and not re.fullmatch(r"(?:STYLE|REGION)[ \t]*", block[0]):
            found += _cue(path, take, block, line)
            refuse_many(path, len(found), line)
    return LabelFile.of_take(path, take, found)


def _blocks(path: str | Path, lines: Iterator[str]) -> Iterator[tuple[int, list[str]]]:
    """Yield, for every block between blank lines, the number of its first line and its lines."""
    block = [next(lines, "").removesuffix("\n")]
    if not re.fullmatch(r"WEBVTT(?:[ \t].*)?", block[0]):
        raise SourceError(path, "is no WebVTT file: its first line must be WEBVTT", line=1)
    number = 1
    for number, line in enumerate(lines, 2):
        if line.strip():
            block.append(line.removesuffix("\n"))
            if len(block) > MAX_LABELS:
                raise SourceError(path, f"has more than {MAX_LABELS:,} lines without a blank one", line=number)
        elif block:
            yield number - len(block), block
            block = []
    if block:
        yield number + 1 - len(block), block


def _unescaped(path: str | Path, text: str, line: int) -> str:
    refuse_long(path, len(text), line)
    try:
        return html.unescape(text).strip()
    except ValueError:
        raise SourceError(path, f"a reference has thousands of digits: '{shown(text)}'", line=line) from None


def _cue(path: str | Path, take: str, block: list[str], line: int) -> list[ManualSegment]:
    first = 0 if "-->" in block[0] else 1
    timing = _TIMING.fullmatch(block[first].strip()) if first < len(block) else None
    if timing is None:
        got = shown(block[min(first, len(block) - 1)])
        raise SourceError(path, f"expected times such as 00:01.000 --> 00:02.500, got '{got}'", line=line + first)
    start, stop = (_seconds(timing.groups()[place : place + 4]) for place in (0, 4))
    line += first
    if not start < stop <= LONGEST_SECONDS:
        raise SourceError(path, f"start {start:g} s must be before stop {stop:g} s", line=line)
    texts = [_unescaped(path, _TAG.sub("", text), line + at) for at, text in enumerate(block[first + 1 :], 1)]
    if not any(texts):
        raise SourceError(path, "the cue has no text, which would be its class", line=line)
    return [
        ManualSegment(take, text, start, stop, str(path), line + number, in_seconds=True)
        for number, text in enumerate(texts, 1)
        if text
    ]


def _seconds(parts: tuple[str | None, ...]) -> float:
    hours, minutes, seconds, thousandths = (int(part or 0) for part in parts)
    return (3_600_000 * hours + 60_000 * minutes + 1000 * seconds + thousandths) / 1000


def _clock(milliseconds: int) -> str:
    seconds, rest = divmod(milliseconds, 1000)
    return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}.{rest:03d}"


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
