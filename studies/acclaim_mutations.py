"""Mutations of Acclaim motion, AMC files with their ASF, for `studies.mutations`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

FRAMES = 240
"""Most frames of a recording."""

_PAIRS = (("cmu/01/01_01.amc", "cmu/01/01.asf"), ("cmu/86/86_09.amc", "cmu/86/86.asf"),
          ("hdm05/takes/HDM_mm*.amc", "hdm05/takes/HDM_mm.asf"))  # fmt: skip
"""Motions with their skeletons."""


@dataclass(frozen=True)
class AcclaimText:
    """The texts of a motion and its skeleton, and the names of the files."""

    name: str
    skeleton_name: str
    motion: str
    skeleton: str


@dataclass(frozen=True)
class AcclaimMutation:
    """A motion and skeleton in which one thing is changed, what it is, and whether the files alone can show it."""

    name: str
    what: str
    file: AcclaimText
    knowable: bool = True


def acclaim_files(data: Path, apart: bool = False) -> list[AcclaimText]:
    """Read motions of a folder of real data, cut to `FRAMES`: those named here, or one for each other skeleton."""
    named = [(next(iter(sorted(data.glob(motion))), None), data / skeleton) for motion, skeleton in _PAIRS]
    used = {skeleton.name for _, skeleton in named}
    pairs = named
    if apart:
        others = sorted(path for path in data.rglob("*.asf") if path.name not in used)
        pairs = [(next(iter(sorted(path.parent.rglob(f"{path.stem}_*.amc"))), None), path) for path in others]
    found = []
    for amc, asf in pairs:
        if amc is not None and asf.is_file():
            cut = re.split(r"(?m)^(?=\d+\s*$)", amc.read_text(encoding="latin-1"))[: FRAMES + 1]
            found.append(AcclaimText(amc.name, asf.name, "".join(cut), asf.read_text(encoding="latin-1")))
    return found


def write(folder: Path, made: AcclaimText) -> Path:
    """Write both files into an empty folder, and return the motion's."""
    for old in folder.iterdir():
        old.unlink()
    (folder / made.skeleton_name).write_text(made.skeleton, encoding="latin-1")
    path = folder / made.name
    path.write_text(made.motion, encoding="latin-1")
    return path


def acclaim_mutations(made: AcclaimText, others: list[AcclaimText]) -> Iterator[AcclaimMutation]:
    """Yield mutations of a motion with its skeleton; `others` lend theirs."""
    bones = re.findall(r"(?m)^\s*name\s+(\w+)\s*$", made.skeleton)
    for i, bone in enumerate(bones):
        whole = rf"(?m)\b{bone}\b"
        renamed = replace(
            made, skeleton=re.sub(whole, f"xq{i}z", made.skeleton), motion=re.sub(whole, f"xq{i}z", made.motion)
        )
        yield AcclaimMutation("joint renamed", bone, renamed)
        yield AcclaimMutation("joint renamed in one file", bone, replace(renamed, motion=made.motion))
        empty = re.sub(rf"(name\s+{bone}\s+direction[^\n]*\n\s*length\s+)\S+", r"\g<1>0", made.skeleton)
        if empty != made.skeleton:
            yield AcclaimMutation("bone of no length", bone, replace(made, skeleton=empty))
    for factor in (0.01, 0.0254, 0.3937, 2.54, 100.0):
        scaled = re.sub(
            r"(?m)^(\s*length\s+)(\S+)",
            lambda one, by=factor: f"{one[1]}{float(one[2]) * by:.8g}",
            made.skeleton,
            count=1,
        )
        yield AcclaimMutation("unit lying", f"{factor:g}", replace(made, skeleton=scaled))
        yield AcclaimMutation("root in another unit than offsets", f"{factor:g}", _moved(made, factor))
    for other in others:
        if other.skeleton_name != made.skeleton_name:
            lent = replace(made, skeleton=other.skeleton)
            yield AcclaimMutation(
                "neighbour's skeleton", other.skeleton_name, replace(lent, skeleton_name=other.skeleton_name)
            )
            yield AcclaimMutation("neighbour's skeleton, own name", other.skeleton_name, lent, knowable=False)


def _moved(made: AcclaimText, factor: float) -> AcclaimText:
    """Return a motion whose root is placed by a factor."""

    def scaled(line: re.Match[str]) -> str:
        return " ".join([line[1], *(f"{float(part) * factor:.8g}" for part in line[2].split())])

    return replace(made, motion=re.sub(r"(?m)^(root)((?:\s+\S+){3})(?=\s)", scaled, made.motion))
