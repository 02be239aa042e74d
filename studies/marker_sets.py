"""`python -m studies.marker_sets DATA`: compare bodies from marker sets with the Acclaim bodies of the same people.

DATA is a folder with `hdm05`, `cmu`, `c3d` and `wild`. Each row is a file, read by the weights of `hdm05-c3d`, which
were fitted to one actor, or by the landmarks of its markers; the last rows are Acclaim takes, of the actor and of other
people. Lengths are medians; `hand above neck` is the share of frames in which F3 or F4 holds.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import Mappings, load_mappings, load_skeleton
from kinedex.ops.body import features
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.reader import Body
from kinedex.storage.formats.motion.reader_table import read_body

F64 = npt.NDArray[np.float64]
FEATURES = load_feature_set()
JOINTS = FEATURES.joints
WAIST = {"LFWT": ("LASI",), "RFWT": ("RASI",), "LBWT": ("LPSI",), "RBWT": ("RPSI",)}
HANDS = 0b1100  # F3 and F4


def bodies(data: Path) -> Iterator[tuple[str, str, Body]]:
    """Yield file, way of reading and body: markers by fitted weights and by landmarks, then Acclaim takes."""
    auto = load_mappings("auto", JOINTS)
    fitted = replace(load_skeleton("hdm05-c3d", JOINTS), aliases=WAIST)
    by_weights = Mappings({"c3d": (fitted,)}, forced=("c3d",))
    by_landmarks = Mappings({"c3d": ()})
    for path in [*sorted((data / "c3d").glob("*.c3d")), *sorted((data / "wild").glob("*/*.c3d"))]:
        for way, mappings in (("weights", by_weights), ("landmarks", by_landmarks)):
            try:
                yield path.name, way, read_body(path, None, mappings, JOINTS)
            except SourceError:
                continue
    for skeleton in sorted(data.glob("hdm05/*/*.asf")) + sorted(data.glob("cmu/[0-9]*/*.asf")):
        name = skeleton.stem.removeprefix("HDM_")
        takes = sorted(path for path in skeleton.parent.rglob("*.amc") if name in path.stem)
        if takes:
            yield takes[0].stem, "Acclaim", read_body(takes[0], skeleton, auto, JOINTS)


def measures(body: Body) -> list[str]:
    """Return lengths of a body, each the median over valid frames, and how often a hand is above the neck."""
    valid = np.ones(body.frames, bool) if body.valid is None else body.valid
    at = dict(zip(JOINTS, body.positions[:, :, valid], strict=True))
    up = at["neck"] - at["root"]
    length = np.linalg.norm(up, axis=0)

    def above(joint: str) -> float:
        """Return by how much a joint is above the root along the trunk, cm."""
        return float(np.median(100 * ((at[joint] - at["root"]) * up).sum(axis=0) / length))

    leg = np.median(
        np.linalg.norm(at["lhip"] - at["lknee"], axis=0) + np.linalg.norm(at["lknee"] - at["lankle"], axis=0)
    )
    words = features.words(body.positions[:, :, valid], body.orientation[:, valid], body.rate_hz, FEATURES.rules)
    lowered = (above("lshoulder") + above("rshoulder")) / 2 - above("neck")
    hands = 100 * np.mean((words & np.uint64(HANDS)) > 0)
    shown = [above("neck"), above("neck") / leg / 100, lowered, above("head") - above("neck"), above("lhip"), hands]
    return [f"{value:.2f}" if i == 1 else f"{value:.1f}" for i, value in enumerate(shown)]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    table = Table(
        "file", "read by", "neck above root, cm", "in legs", "shoulders above neck", "head above neck",
        "hips above root", "hand above neck, %",
    )  # fmt: skip
    for name, way, body in bodies(parser.parse_args().data):
        table.add_row(name, way, *measures(body))
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
