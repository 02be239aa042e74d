"""Cuts of BVH files: an interval of their frames, with their own skeleton, rate and numbers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from kinedex.storage.formats.motion.bvh import Person, persons_of
from kinedex.storage.formats.motion.bvh_parser import BvhFile, Layout
from kinedex.storage.formats.motion.channel_cuts import Stamp, check_interval, check_source, stamp_of, write_bytes
from kinedex.storage.formats.motion.figures import chosen_person
from kinedex.storage.formats.motion.source_cut import SourceCut
from kinedex.storage.formats.motion.text_blocks import after_last_line
from kinedex.storage.formats.motion.text_rows import TextRows


def write_bvh_cut(paths: Sequence[Path], cut: SourceCut) -> None:
    """Write an interval of a BVH file as a BVH file.

    The hierarchy, the frame time and all numbers are the text of the source; the number of frames is that of the cut.
    Of a file of several persons the cut holds the person of the take.

    Parameters
    ----------
    paths : sequence of Path
        The file to write.
    cut : SourceCut
        The interval.

    Raises
    ------
    SourceError
        The source is damaged, was changed, or has no such frames.
    KinedexError
        The file cannot be written.
    """
    check_source(cut)
    source = _opened(cut.source, stamp_of(cut.source))
    check_interval(cut, len(source.rows))
    rows = source.rows.read(cut.start, cut.stop)
    if cut.person:
        person = source.person(cut.person)
        head = person_text(source.file.layout, person, len(rows))
        rows = [b" ".join(row) + source.rows.newline for row in person_tokens(rows, person)]
    else:
        head = with_count(source.file.layout, len(rows))
    write_bytes(paths[0], [head, source.rows.head[len(source.file.layout.text) :], *rows])


class BvhSource:
    """A BVH file that is cut: its hierarchy, and the places of its frames."""

    def __init__(self, path: Path) -> None:
        self.file = BvhFile(path)
        self.rows = TextRows(path, len(self.file.layout.text), False, after_last_line)

    def person(self, name: str | None) -> Person:
        """Return the person of a take; a SourceError lists those of the file if it is not clear which."""
        persons = persons_of(self.file)
        return persons[chosen_person(self.file.path, name or "", [person.name for person in persons])]


@lru_cache(maxsize=4)  # The clips of a take are cut one after the other.
def _opened(path: Path, _stamp: Stamp) -> BvhSource:
    return BvhSource(path)


def with_count(layout: Layout, frames: int) -> bytes:
    """Return the text before the frames with another number of frames."""
    start, stop = layout.frames
    gap = b"" if layout.text[start - 1 : start].isspace() else b" "
    return layout.text[:start] + gap + b"%d" % frames + layout.text[stop:]


def person_text(layout: Layout, person: Person, frames: int) -> bytes:
    """Return the text before the frames with the tree of one root only."""
    text, first = with_count(layout, frames), person.members[0]
    starts, stops = zip(*layout.joints, strict=True)
    return text[: min(starts)] + text[starts[first] : stops[first]] + text[max(stops) :]


def person_tokens(rows: Sequence[bytes], person: Person) -> list[list[bytes]]:
    """Return the numbers of a person's channels in every row, as text."""
    columns = [step.column for node in person.nodes for step in node.steps]
    first, stop = min(columns, default=0), max(columns, default=-1) + 1
    return [row.split(maxsplit=stop)[first:stop] for row in rows]
