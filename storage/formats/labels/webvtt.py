"""WebVTT: subtitles of which every cue is a label, which video players show."""

from __future__ import annotations

import html
import re
from pathlib import Path

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.labels.segments import LabelFile, ManualSegment, TakeLabels
from kinedex.storage.formats.labels.texts import LONGEST_SECONDS, lines_of, read_text, shown

_TIME = r"(?:([0-9]{2,6}):)?([0-5][0-9]):([0-5][0-9])\.([0-9]{3})"
_TIMING = re.compile(rf"{_TIME}[ \t]+-->[ \t]+{_TIME}(?:[ \t].*)?", re.ASCII)
_TAG = re.compile(r"<[^<>]*>")
_TAKE = "kinedex take: "


def write(labels: TakeLabels) -> str:
    """Return a WebVTT file: a numbered cue for each label, and the take's name in a note."""
    blocks = ["WEBVTT\n", f"NOTE\n{_TAKE}{_escaped(labels.take)}\n"]
    blocks += [
        f"{number}\n{_clock(labels.milliseconds(one.start))} --> {_clock(labels.milliseconds(one.stop))}\n"
        f"{_escaped(one.label)}\n"
        for number, one in enumerate(labels.labels, 1)
    ]
    return "\n".join(blocks)


def read(path: str | Path) -> LabelFile:
    """Read the cues of a WebVTT file: their text, without tags, is the class; each line of a cue is a label.

    The take is that of kinedex's own note, or else the one that the file is named after. Other notes, styles and
    regions are ignored.

    Parameters
    ----------
    path : str or Path
        The file.

    Raises
    ------
    SourceError
        The first line is not WEBVTT, a cue has no times or no text, or times are out of order; the error names the
        line.
    """
    lines = lines_of(read_text(path))
    if not re.fullmatch(r"WEBVTT(?:[ \t].*)?", lines[0]):
        raise SourceError(path, "is no WebVTT file: its first line must be WEBVTT", line=1)
    take, found, at = Path(path).stem, list[ManualSegment](), 0
    while at < len(lines):
        if not lines[at].strip():
            at += 1
            continue
        end = next((place for place in range(at, len(lines)) if not lines[place].strip()), len(lines))
        block = lines[at:end]
        if re.match(r"NOTE(?:\s|$)", block[0]):
            own = [line for line in block[1:] if line.startswith(_TAKE)]
            take = html.unescape(own[0].removeprefix(_TAKE)).strip() or take if own else take
        elif at > 0 and not re.fullmatch(r"(?:STYLE|REGION)[ \t]*", block[0]):
            found += _cue(path, take, block, at + 1)
        at = end
    return LabelFile.of_take(path, take, found)


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
    texts = [html.unescape(_TAG.sub("", text)).strip() for text in block[first + 1 :]]
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
