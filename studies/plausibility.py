"""`python -m studies.plausibility DIR…`: takes that are broken on purpose, and how many of them are warned of.

Each take below the folders is read, judged as it is (a warning is a false one), and judged again with each fault, that
is, as a wrong reading would have it. The tables count warnings by fault, and print ranges and limits of the figures.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.quality import quality_warnings
from kinedex.catalog.quality_figures import FIGURES
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.body.plausibility import Plausibility, plausibility
from kinedex.ops.errors import KinedexError
from kinedex.storage.formats.motion.reader_table import read_body
from kinedex.storage.formats.motion.sources import scan

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Take:
    """A take in metres: positions (J, 3, T), the names of its joints, and its rate."""

    positions: F64
    joints: tuple[str, ...]
    rate_hz: float

    def warnings(self) -> list[str]:
        """Return the warnings on it."""
        return quality_warnings(self.figures(), self.rate_hz)

    def figures(self) -> Plausibility:
        """Return its figures."""
        return plausibility(self.positions, self.joints, self.rate_hz)


Fault = Callable[[Take], Take]


def _placed(change: Callable[[F64], F64]) -> Fault:
    return lambda take: Take(change(take.positions), take.joints, take.rate_hz)


def _scaled(factor: float) -> Fault:
    return _placed(lambda positions: positions * factor)


def _turned(*rows: tuple[int, int, int]) -> Fault:
    return _placed(lambda positions: np.einsum("ab,jbt->jat", np.array(rows, float), positions))


def _swapped(*parts: str) -> Fault:
    """Return the fault that exchanges left and right of some joints, of all where none is named."""

    def change(take: Take) -> Take:
        order = list(range(len(take.joints)))
        for i, joint in enumerate(take.joints):
            if joint[0] == "l" and (not parts or joint[1:] in parts):
                other = take.joints.index("r" + joint[1:])
                order[i], order[other] = other, i
        return Take(take.positions[order], take.joints, take.rate_hz)

    return change


def _shifted(joint: str, metres: float) -> Fault:
    """Return the fault that moves a joint towards the root of the trunk, or out of it where `metres` is negative."""

    def change(take: Take) -> Take:
        moved = take.positions.copy()
        trunk = moved[take.joints.index("neck")] - moved[take.joints.index("root")]
        moved[take.joints.index(joint)] -= metres * trunk / np.sqrt((trunk * trunk).sum(axis=0))
        return Take(moved, take.joints, take.rate_hz)

    return change


def _rated(factor: float) -> Fault:
    return lambda take: Take(take.positions, take.joints, take.rate_hz * factor)


def _frozen(share: float) -> Fault:
    """Return the fault that keeps the last good frame for a fraction of the take."""

    def change(positions: F64) -> F64:
        frames = positions.shape[2]
        return positions[:, :, np.minimum(np.arange(frames), int((1 - share) * frames))]

    return _placed(change)


def _spiked(joint: str, turned: tuple[str, ...]) -> Fault:
    """Return the fault that turns a limb by 160° about the vertical axis of its joint, in the frame in the middle."""

    def change(take: Take) -> Take:
        moved = take.positions.copy()
        t, centre = moved.shape[2] // 2, moved[take.joints.index(joint), :, moved.shape[2] // 2]
        c, s = np.cos(np.radians(160.0)), np.sin(np.radians(160.0))
        for name in turned:
            arm = moved[take.joints.index(name), :, t] - centre
            moved[take.joints.index(name), :, t] = centre + np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ arm
        return Take(moved, take.joints, take.rate_hz)

    return change


def _stuck(joint: str, share: float) -> Fault:
    """Return the fault that leaves one joint where it is for a fraction of the take."""

    def change(take: Take) -> Take:
        frames = take.positions.shape[2]
        moved = take.positions.copy()
        row = take.joints.index(joint)
        moved[row] = moved[row][:, np.minimum(np.arange(frames), int((1 - share) * frames))]
        return Take(moved, take.joints, take.rate_hz)

    return change


def _bent_forwards(take: Take) -> Take:
    """Mirror each shank at its thigh, so that the knees bend forwards."""
    moved = take.positions.copy()
    for side in "lr":
        hip, knee = (moved[take.joints.index(side + name)] for name in ("hip", "knee"))
        thigh = (knee - hip) / np.linalg.norm(knee - hip, axis=0)
        for name in ("ankle", "toes"):
            arm = moved[take.joints.index(side + name)] - knee
            along = (arm * thigh).sum(axis=0) * thigh
            moved[take.joints.index(side + name)] = knee + 2.0 * along - arm
    return Take(moved, take.joints, take.rate_hz)


def _trembling(metres: float) -> Fault:
    return _placed(lambda positions: positions + np.random.default_rng(0).normal(0, metres, positions.shape))


FAULTS: dict[str, Fault] = {
    "Z up, read as Y up": _turned((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "X up, read as Y up": _turned((0, 1, 0), (-1, 0, 0), (0, 0, 1)),
    "upside down": _turned((-1, 0, 0), (0, -1, 0), (0, 0, 1)),
    "an axis mirrored": _turned((-1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "left and right exchanged": _swapped(),
    "left and right arms exchanged": _swapped("clavicle", "shoulder", "elbow", "wrist", "fingers"),
    "left and right legs exchanged": _swapped("hip", "knee", "ankle", "toes"),
    "left and right knees exchanged": _swapped("knee"),
    "unit × 10": _scaled(10.0),
    "unit × 2.54": _scaled(2.54),
    "unit / 2.54": _scaled(1 / 2.54),
    "unit / 10": _scaled(0.1),
    "unit / 1000": _scaled(0.001),
    "neck 12 cm too low": _shifted("neck", 0.12),
    "neck 8 cm too low": _shifted("neck", 0.08),
    "left knee 20 cm too high": _shifted("lknee", -0.2),
    "left knee 10 cm too high": _shifted("lknee", -0.1),
    "left elbow 15 cm too low": _shifted("lelbow", 0.15),
    "lowered by 2.26 m": _placed(lambda positions: positions - np.array([0.0, 2.26, 0.0])[:, None]),
    "rate × 4": _rated(4.0),
    "rate × 2": _rated(2.0),
    "rate / 4": _rated(0.25),
    "frame time 1.0": lambda take: Take(take.positions, take.joints, 1.0),
    "frozen": _frozen(1.0),
    "frozen from the middle": _frozen(0.5),
    "one arm turned by 160° for one frame": _spiked("lshoulder", ("lelbow", "lwrist", "lfingers")),
    "a wrist that stays from the middle on": _stuck("lwrist", 0.5),
    "knees that bend forwards": _bent_forwards,
    "noise of 2 cm": _trembling(0.02),
    "every frame four times": _placed(lambda positions: positions.repeat(4, axis=2)),
}
"""Faults of readings, by what they do."""


def takes(folder: Path) -> Iterator[tuple[str, Take]]:
    """Yield the name and the take of each file below a folder that has all joints; a line reports each other one."""
    joints = load_feature_set().joints
    mappings = load_mappings("auto", joints)
    found = scan(folder)
    for motion in found.motions:
        try:
            skeleton = found.skeleton_of(motion).absolute if motion.format == "amc" else None
            body = read_body(motion.absolute, skeleton, mappings, joints)
        except KinedexError as fault:
            print(f"not read: {fault}")
            continue
        known = body.positions if body.valid is None else body.positions[:, :, body.valid]
        if not body.unknown:
            yield motion.path, Take(known, joints, body.rate_hz)


def main() -> None:
    """Print the tables for the folders of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR")
    folders: list[Path] = parser.parse_args().folders
    found: dict[str, Counter[str]] = {}
    ranges: dict[str, dict[str, list[float]]] = {}
    spent: Counter[str] = Counter()  # seconds of processor time
    for folder in folders:
        counts, values = found.setdefault(folder.name, Counter()), ranges.setdefault(folder.name, {})
        for name, take in takes(folder):
            counts["takes"] += 1
            take.figures()  # once before the clock starts, so that nothing is compiled within it
            begin = time.thread_time()
            figures = take.figures()
            spent[folder.name] += time.thread_time() - begin
            for figure in FIGURES:
                if figure.type == "DOUBLE" and (value := getattr(figures, figure.name)) == value:
                    values.setdefault(figure.name, []).append(value)
            for warning in take.warnings():
                print(f"warned of as it is: {name}: {warning}")
            counts["none: as it is"] += bool(take.warnings())
            for fault, change in FAULTS.items():
                counts[fault] += bool(change(take).warnings())
    names = list(found)
    print(f"\n| fault | {' | '.join(f'{name}: warned of' for name in names)} |\n|---|{'---|' * len(names)}")
    for fault in ("none: as it is", *FAULTS):
        cells = [f"{found[name][fault]} of {found[name]['takes']}" for name in names]
        print(f"| {fault} | {' | '.join(cells)} |")
    for name in names:
        print(
            f"\n{name}: {1000 * spent[name] / found[name]['takes']:.2f} ms of processor time for the figures of a take"
        )
    print(f"\n| figure | {' | '.join(names)} | limits |\n|---|{'---|' * len(names)}---|")
    for figure in FIGURES:
        cells = [f"{min(v):.3g} to {max(v):.3g}" if (v := ranges[name].get(figure.name)) else "" for name in names]
        if any(cells):
            print(f"| {figure.name} | {' | '.join(cells)} | {figure.limits()} |")


if __name__ == "__main__":
    main()
