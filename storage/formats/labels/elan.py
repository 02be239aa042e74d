"""Read and write ELAN's annotation files (.eaf, version 3.0): tiers of annotations between time slots, in XML."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from kinedex.catalog.limbs import LIMBS
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.labels.file_labels import ERROR, Label, LabelFile, LabelsOfTake, ManualSegment
from kinedex.storage.formats.labels.texts import LONGEST_SECONDS, label_bytes, refuse_long, refuse_many, shown

DEEPEST = 100
"""The largest depth of nested elements; EAF files have six levels."""

_TAKE = "kinedex take"
_HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<ANNOTATION_DOCUMENT AUTHOR="kinedex" DATE="{date}" FORMAT="3.0" VERSION="3.0" \
xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" \
xsi:noNamespaceSchemaLocation="http://www.mpi.nl/tools/elan/EAFv3.0.xsd">
    <HEADER MEDIA_FILE="" TIME_UNITS="milliseconds">
        <PROPERTY NAME="{name}">{take}</PROPERTY>
        <PROPERTY NAME="lastUsedAnnotationId">{last}</PROPERTY>
    </HEADER>
"""
_TYPE = '    <LINGUISTIC_TYPE GRAPHIC_REFERENCES="false" LINGUISTIC_TYPE_ID="class" TIME_ALIGNABLE="true"/>\n'


def write(labels: LabelsOfTake) -> str:
    """Return an EAF file: a tier for each class, because annotations of one tier must not overlap.

    The value of every annotation is its class. Errors of limbs have a tier for each limb and annotator, such as
    `lshank` or `A1:lshank`; the tier of a limb that was examined without finding an error is empty. If labels of one
    tier overlap, the later one is moved to a further tier, whose name ends in a number.
    """
    tiers = _tiers(labels.labels)
    for limb, annotator in labels.without_errors:
        if limb:
            tiers.setdefault(_limb_tier(limb, annotator), [])
    placed = [one for members in tiers.values() for one in members]
    edges = [labels.milliseconds(edge) for one in placed for edge in (one.start, one.stop)]
    # each annotation has its own slots, ordered by time: ELAN would move a shared slot for both annotations
    order = sorted(range(len(edges)), key=lambda place: (edges[place], place))
    slot = {place: f"ts{number}" for number, place in enumerate(order, 1)}
    head = _HEAD.format(date=labels.made, name=_TAKE, take=_escaped(labels.take), last=len(placed))
    lines = [head, "    <TIME_ORDER>\n"]
    lines += [f'        <TIME_SLOT TIME_SLOT_ID="{slot[place]}" TIME_VALUE="{edges[place]}"/>\n' for place in order]
    lines += ["    </TIME_ORDER>\n"]
    number = 0
    for tier, members in tiers.items():
        lines.append(f'    <TIER LINGUISTIC_TYPE_REF="class" TIER_ID="{_escaped(tier)}">\n')
        for one in members:
            lines.append(
                f'        <ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a{number + 1}" '
                f'TIME_SLOT_REF1="{slot[2 * number]}" TIME_SLOT_REF2="{slot[2 * number + 1]}">'
                f"<ANNOTATION_VALUE>{_escaped(one.label)}</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION>\n"
            )
            number += 1
        lines.append("    </TIER>\n")
    return "".join([*lines, _TYPE, "</ANNOTATION_DOCUMENT>\n"])


def _tiers(labels: Sequence[Label]) -> dict[str, list[Label]]:
    """Divide labels into tiers without overlaps; the first tier of a class or limb is named after the class or limb."""
    classes = {_tier_of(one) for one in labels}
    rows: dict[str, list[list[Label]]] = {name: [] for name in sorted(classes)}
    for one in sorted(labels, key=lambda one: (one.start, one.stop)):
        free = next((row for row in rows[_tier_of(one)] if row[-1].stop <= one.start), None)
        if free is None:
            rows[_tier_of(one)].append([one])
        else:
            free.append(one)
    tiers: dict[str, list[Label]] = {}
    for name, groups in rows.items():
        for number, row in enumerate(groups, 1):
            tier, again = name if number == 1 else f"{name} ({number})", number
            while tier in tiers or (tier in classes and tier != name):
                again += 1
                tier = f"{name} ({again})"
            tiers[tier] = row
    return tiers


def _tier_of(one: Label) -> str:
    """Return the name of the tier for a label: its class or, for the error of a limb, annotator and limb."""
    if one.label != ERROR or not one.limb:
        return one.label
    return _limb_tier(one.limb, one.annotator)


def _limb_tier(limb: str, annotator: str) -> str:
    return f"{annotator}:{limb}" if annotator else limb


@dataclass
class _Annotation:
    line: int
    tier: str
    slots: tuple[str, str]
    name: str
    value: str = ""


@dataclass
class _Document:
    """The content of an EAF file while it is parsed; the XML parser calls the methods."""

    path: str
    parser: expat.XMLParserType
    take: str = ""
    root: str = ""
    tier: str | None = None
    covered: list[tuple[str, str]] = field(default_factory=list)
    slots: dict[str, int | None] = field(default_factory=dict)
    annotations: list[_Annotation] = field(default_factory=list)
    text: list[str] | None = None
    letters: int = 0
    depth: int = 0
    open: _Annotation | None = None

    def error(self, message: str, line: int | None = None) -> SourceError:
        return SourceError(self.path, message, line=self.parser.CurrentLineNumber if line is None else line)

    def doctype(self, *_: object) -> None:
        raise self.error("has a document type declaration, which an EAF file does not need; it is not read")

    def start(self, name: str, given: dict[str, str]) -> None:
        self.depth += 1
        if self.depth > DEEPEST:
            raise self.error(f"has elements in more than {DEEPEST} levels, and EAF files have six")
        if not self.root:
            self.root = name
            if name != "ANNOTATION_DOCUMENT":
                raise self.error(f"is no EAF file: expected the element ANNOTATION_DOCUMENT, got {shown(name)}")
        elif name == "HEADER":
            unit = given.get("TIME_UNITS", "milliseconds")
            if unit != "milliseconds":
                raise self.error(f"TIME_UNITS must be milliseconds, got '{shown(unit)}'")
        elif name == "PROPERTY" and given.get("NAME") == _TAKE:
            self.text, self.letters = [], 0
        elif name == "TIME_SLOT":
            refuse_many(self.path, len(self.slots) // 2, self.parser.CurrentLineNumber)
            self.slots[self._attribute(name, given, "TIME_SLOT_ID")] = self._time(given)
        elif name == "TIER":
            # a tier that depends on another tier adds details to the annotations of that tier
            own = self._attribute(name, given, "TIER_ID")
            refuse_long(self.path, len(own), self.parser.CurrentLineNumber, "TIER_ID")
            self.tier = None if given.get("PARENT_REF") else own
            annotator, limb = _limb_of_tier(own)
            if self.tier is not None and limb:
                refuse_many(self.path, len(self.covered) + 1, self.parser.CurrentLineNumber)
                self.covered.append((limb, annotator))
        elif name == "ALIGNABLE_ANNOTATION" and self.tier is not None:
            ends = (self._attribute(name, given, "TIME_SLOT_REF1"), self._attribute(name, given, "TIME_SLOT_REF2"))
            own = given.get("ANNOTATION_ID", f"number {len(self.annotations) + 1}")
            self.open = _Annotation(self.parser.CurrentLineNumber, self.tier, ends, shown(own))
        elif name == "ANNOTATION_VALUE" and self.open is not None:
            self.text, self.letters = [], 0

    def characters(self, text: str) -> None:
        if self.text is not None:
            self.letters += len(text)
            refuse_long(self.path, self.letters, self.parser.CurrentLineNumber)
            self.text.append(text)

    def end(self, name: str) -> None:
        self.depth -= 1
        if name == "PROPERTY" and self.text is not None:
            self.take, self.text = "".join(self.text).strip(), None
        elif name == "ANNOTATION_VALUE" and self.open is not None:
            self.open.value, self.text = "".join(self.text or ()).strip(), None
        elif name == "ALIGNABLE_ANNOTATION" and self.open is not None:
            refuse_many(self.path, len(self.annotations) + 1, self.open.line)
            self.annotations.append(self.open)
            self.open = None
        elif name == "TIER":
            self.tier = None

    def _attribute(self, element: str, given: dict[str, str], name: str) -> str:
        if not given.get(name):
            raise self.error(f"{element} has no {name}")
        return given[name]

    def _time(self, given: dict[str, str]) -> int | None:
        text = given.get("TIME_VALUE")
        if text is None:
            return None
        if not (text.isascii() and text.isdecimal()) or len(text) > 15 or int(text) > 1000 * LONGEST_SECONDS:
            raise self.error(f"TIME_VALUE must be milliseconds, a whole number from 0, got '{shown(text)}'")
        return int(text)

    def labels(self) -> LabelFile:
        """Return the annotations as labelled segments, sorted by time."""
        take = self.take or Path(self.path).stem
        found = sorted((self._segment(take, one) for one in self.annotations), key=lambda one: (one.start, one.stop))
        return LabelFile.of_take(self.path, take, found, self.covered)

    def _segment(self, take: str, one: _Annotation) -> ManualSegment:
        times = []
        for name in one.slots:
            if name not in self.slots:
                raise self.error(
                    f"annotation {one.name} names the time slot {shown(name)}, which is not there", one.line
                )
            time = self.slots[name]
            if time is None:
                raise self.error(
                    f"annotation {one.name} ends at the time slot {shown(name)}, which has no time", one.line
                )
            times.append(time)
        start, stop = times
        if start >= stop:
            raise self.error(f"annotation {one.name}: start {start} ms must be before stop {stop} ms", one.line)
        label = one.value or one.tier.strip()
        if not label:
            raise self.error(
                f"annotation {one.name} has no class: write it as the value, or as the name of the tier", one.line
            )
        annotator, limb = _limb_of_tier(one.tier) if label == ERROR else ("", "")
        place = f"annotation {one.name}"
        return ManualSegment(
            take, label, start / 1000, stop / 1000, self.path, one.line, True, place, limb, annotator
        )  # fmt: skip


def _limb_of_tier(tier: str) -> tuple[str, str]:
    """Return the annotator and the limb that a tier names, such as A1:lshank or lshank (2); missing ones are empty."""
    annotator, _, limb = re.sub(r" \([0-9]{1,6}\)$", "", tier).rpartition(":")
    return (annotator.strip(), limb.strip()) if limb.strip() in LIMBS else ("", "")


def read(path: str | Path) -> LabelFile:
    """Read the annotations of an EAF file.

    The class of an annotation is its value, or the name of its tier if the value is empty. Both files with a tier for
    each class and files with one tier for all classes are thus read correctly. An annotation with the value `error` in
    a tier that is named after a limb, or after an annotator and a limb (`A1:lshank`), is about that limb; such a tier
    without annotations records that the limb was examined. Tiers that depend on another tier (PARENT_REF) only add
    details to the annotations of that tier, and are ignored. The take is named by a property that kinedex writes, or
    else by the name of the file.

    Parameters
    ----------
    path : str or Path
        The file.

    Raises
    ------
    SourceError
        The file is not XML or not EAF, it has a document type declaration (which is never processed), a time is missing
        or out of order, or the file exceeds a limit of `storage.formats.labels.texts`; the error names the line.
    """
    data = label_bytes(path)
    parser = expat.ParserCreate()
    document = _Document(str(path), parser)
    parser.buffer_text = True
    parser.StartDoctypeDeclHandler = document.doctype
    parser.StartElementHandler = document.start
    parser.EndElementHandler = document.end
    parser.CharacterDataHandler = document.characters
    try:
        parser.Parse(data, True)
    except expat.ExpatError as fault:
        raise SourceError(path, f"is not XML: {expat.ErrorString(fault.code)}", line=fault.lineno) from None
    except (ValueError, LookupError) as fault:
        raise SourceError(path, f"is in an encoding that is not read: {fault}; save it as UTF-8") from None
    return document.labels()


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace('"', "&quot;")
