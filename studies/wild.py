"""`python -m studies.wild DIR`: read motion files of others, and synthetic motion in the dialects of their skeletons.

The first table lists the files below DIR: in, with joints estimated, or refused, and why; the counts below it name
those whose figures are implausible. The second needs `--skeletons FILE` (`wild_skeletons.json`): each skeleton is moved
like a synthetic actor, written as BVH twice, with Y up and with Z up (as Blender exports it), read again, and compared
with the truth: the distance of joints, left and right, the vertical axis, and the words.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.body_evidence import Evidence
from kinedex.catalog.skeletons.mappings import Fit, Format, Mappings, load_mappings
from kinedex.ops.body import features
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.ingestion.analysis import known_features, measured_quality
from kinedex.pipelines.simulation.synthetic_archive import write_archive
from kinedex.storage.formats.motion.reader import DEFAULT_SETTINGS, Body, MotionFile
from kinedex.storage.formats.motion.reader_table import reader_of
from kinedex.storage.formats.motion.sources import scan
from kinedex.storage.formats.motion.unpacked_files import unpacked
from studies.wild_variants import Actor, Skeleton, Variant, load_skeletons, roles_of, sliding, variant

F64 = npt.NDArray[np.float64]
FEATURES = load_feature_set()
NEAR_M = 0.05
STEP = 4  # every fourth frame of the synthetic take, at 30 Hz
ENDS = ("toes", "fingers", "headtop", "head", "clavicle")  # joints that dialects define differently
TURNS = {"y": np.eye(3), "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])}


class TimedMappings(Mappings):
    """Mappings that measure how long recognition takes, in milliseconds a file."""

    took: ClassVar[list[float]] = []

    def recognised(self, source: str | Path, form: Format, evidence: Evidence) -> Fit:
        """Recognise a body and keep the time."""
        begin = time.perf_counter()
        try:
            return super().recognised(source, form, evidence)
        finally:
            self.took.append(1000 * (time.perf_counter() - begin))


@dataclass(frozen=True)
class Outcome:
    """The outcome of reading a file: a body or the reason of the refusal."""

    body: Body | None
    reason: str


def read(path: Path, mappings: Mappings, skeleton: Path | None = None, person: str = "") -> Outcome:
    """Read one person of a file."""
    try:
        with unpacked(path, skeleton) as copy:
            file = MotionFile(copy.path, copy.skeleton, None, person)
            return Outcome(reader_of(copy.path).read(file, mappings, FEATURES.joints, DEFAULT_SETTINGS), "")
    except KinedexError as fault:
        return Outcome(None, str(fault).removeprefix(f"{path}: "))


def census(folder: Path, mappings: Mappings, console: Console) -> None:
    """Read all motion files below a folder and print a line for each, and the sums by ending."""
    found = scan(folder)
    sums: Counter[tuple[str, str]] = Counter()
    implausible: Counter[tuple[str, str]] = Counter()
    table = Table("file", "dialect", "frames", "confidence", "unknown", "estimated", "warnings, or the reason")
    for motion in found.motions:
        skeleton = found.skeleton_of(motion).absolute if motion.format == "amc" else None
        try:
            with unpacked(motion.absolute) as copy:
                persons = reader_of(copy.path).persons(MotionFile(copy.path), mappings) or ("",)
        except KinedexError:
            persons = ("",)
        for person in persons:
            outcome = read(motion.absolute, mappings, skeleton, person)
            doubts = measured_quality(outcome.body, FEATURES.joints, ())[1] if outcome.body else []
            table.add_row(*_row(motion.path + (f" [{person}]" if person else ""), outcome, doubts))
            dialect = outcome.body.skeleton if outcome.body else "refused"
            sums[motion.format, dialect] += 1
            implausible[motion.format, dialect] += bool(doubts)
    console.print(table)
    for (ending, dialect), count in sorted(sums.items()):
        doubted = f", {implausible[ending, dialect]} implausible" if dialect != "refused" else ""
        console.print(f".{ending}: {count} {dialect}{doubted}")
    for line in found.unread_lines():
        console.print(line)


def _row(path: str, outcome: Outcome, doubts: list[str]) -> tuple[str, ...]:
    body = outcome.body
    if body is None:
        return path, "refused", "", "", "", "", outcome.reason
    return (
        path, body.skeleton, str(body.frames), f"{body.confidence:.2f}", " ".join(body.unknown),
        " ".join(body.estimated), " | ".join([*body.warnings, *doubts]),
    )  # fmt: skip


def synthetic_actor(folder: Path, mappings: Mappings) -> Actor:
    """Return the motion of a synthetic take."""
    write_archive(folder, minutes=2.0, actors=1, clip_minutes=0.5)
    found = scan(folder)
    take = max(found.motions, key=lambda motion: motion.size)
    body = read(take.absolute, mappings, found.skeleton_of(take).absolute).body
    assert body is not None
    joints = {joint: body.positions[i, :, ::STEP] for i, joint in enumerate(FEATURES.joints)}
    return Actor(joints, body.orientation[:, ::STEP], body.rate_hz / STEP)


@dataclass(frozen=True)
class Comparison:
    """A body beside the truth.

    Attributes
    ----------
    far : float
        Largest distance in metres over joints that the skeleton has, ends excluded; each the 95th percentile of frames.
    farthest : str
        That joint.
    ends : float
        The same over toes, fingers, head, top of the head and clavicles.
    swapped : bool
        True if a joint is nearer to that of the other side.
    upright : bool
        True if the head's height agrees.
    bits : float
        Share of equal bits, of known features.
    worst : float
        The smallest F over features that are on in 2 to 98 % of frames.
    worst_feature : str
        That feature.
    """

    far: float
    farthest: str
    ends: float
    swapped: bool
    upright: bool
    bits: float
    worst: float
    worst_feature: str


def compare(body: Body, made: Variant, actor: Actor) -> Comparison:
    """Compare a body with the truth, turned about the vertical axis to fit best."""
    joints = [joint for joint in FEATURES.joints if joint in made.truth]
    index = {joint: i for i, joint in enumerate(FEATURES.joints)}
    usable = [joint for joint in joints if joint not in body.unknown and joint in made.own]
    ours = np.stack([body.positions[index[joint]] for joint in usable])
    true = np.stack([made.truth[joint] for joint in usable])
    turned = _about_vertical(ours, true)
    apart = np.percentile(np.linalg.norm(turned - true, axis=1), 95, axis=1)
    inner = [i for i, joint in enumerate(usable) if not joint.endswith(ENDS)]
    ends = [i for i, joint in enumerate(usable) if joint.endswith(ENDS)]
    worst = max(inner, key=lambda i: apart[i])
    swapped = any(
        np.linalg.norm(turned[i] - made.truth["r" + joint[1:]], axis=0).mean() < apart[i] * 0.5
        for i, joint in enumerate(usable)
        if joint[0] == "l" and "r" + joint[1:] in made.truth
    )
    heights = np.abs(turned[:, 1] - true[:, 1]).mean()
    bits, least, name = _words(body, made, actor)
    return Comparison(
        float(apart[worst]), usable[worst], float(max((apart[i] for i in ends), default=0.0)), swapped,
        bool(heights < 2 * NEAR_M), bits, least, name,
    )  # fmt: skip


def _about_vertical(ours: F64, true: F64) -> F64:
    """Return the joints turned about Y, which no file states, to fit best."""
    a, b = ours[:, [2, 0]].reshape(len(ours), 2, -1), true[:, [2, 0]]
    angle = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    c, s = np.cos(angle), np.sin(angle)
    turned = ours.copy()
    turned[:, 2], turned[:, 0] = c * ours[:, 2] - s * ours[:, 0], s * ours[:, 2] + c * ours[:, 0]
    return turned


def _words(body: Body, made: Variant, actor: Actor) -> tuple[float, float, str]:
    """Return the fraction of equal bits, and the smallest F of a feature that is neither always on nor always off."""
    true = np.stack([made.truth[joint] for joint in FEATURES.joints])
    known = known_features(FEATURES, body) & FEATURES.known(made.unknown)
    numbers = [i for i in range(len(FEATURES.features)) if known >> i & 1]
    want = features.words(np.ascontiguousarray(true), actor.orientation, actor.rate_hz, FEATURES.rules)
    have = features.words(body.positions, body.orientation, actor.rate_hz, FEATURES.rules, body.valid)
    scores, equal = {}, []
    for i in numbers:
        a, b = (want >> np.uint64(i)) & np.uint64(1), (have >> np.uint64(i)) & np.uint64(1)
        equal.append(float((a == b).mean()))
        if 0.02 <= a.mean() <= 0.98:
            scores[f"F{i + 1}"] = 2 * float((a & b).sum()) / float(a.sum() + b.sum())
    worst = min(scores, key=lambda name: scores[name])
    return float(np.mean(equal)), scores[worst], worst


def variants(skeletons: Iterable[Skeleton], mappings: Mappings, console: Console) -> None:
    """Write, read and compare the variants of all skeletons, and print a line for each and the sums."""
    table = Table("skeleton", "family", "up", "farthest joint, cm", "ends, cm", "bits", "worst F", "faults")
    sums: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="kinedex-") as name:
        actor = synthetic_actor(Path(name) / "synth", mappings)
        for skeleton in skeletons:
            roles = roles_of(skeleton)
            if roles is None:
                path = Path(name) / "variant.bvh"
                path.write_text(sliding(skeleton), encoding="utf-8")
                outcome = read(path, mappings)
                sums["of no human, refused" if outcome.body is None else "of no human, in"] += 1
                cells = ("", "", "", "", f"refused: {outcome.reason[:200]}" if outcome.body is None else "in")
                table.add_row(skeleton.label, "no human", "", *cells)
                continue
            family, nodes = roles
            for up, turn in TURNS.items():
                made = variant(skeleton, nodes, actor, turn)
                path = Path(name) / "variant.bvh"
                path.write_text(made.text, encoding="utf-8")
                outcome = read(path, mappings)
                table.add_row(skeleton.label, family, up, *_judged(outcome, made, actor, sums))
    console.print(table)
    for fault, count in sums.most_common():
        console.print(f"{count:4d}  {fault}")


def _judged(outcome: Outcome, made: Variant, actor: Actor, sums: Counter[str]) -> tuple[str, ...]:
    """Return the cells of a variant, and count its faults."""
    sums["variants"] += 1
    if outcome.body is None:
        sums["refused"] += 1
        return "", "", "", "", f"refused: {outcome.reason[:200]}"
    found = compare(outcome.body, made, actor)
    faults = {
        f"a joint farther than {NEAR_M * 100:g} cm": found.far > NEAR_M,
        "left and right swapped": found.swapped,
        "not upright": not found.upright,
        "fewer than 95 % of bits equal": found.bits < 0.95,
        "a feature with F below 0.9": found.worst < 0.9,
        "a joint unknown that the skeleton has": bool(set(outcome.body.unknown) & made.own),
    }
    for fault, there in faults.items():
        sums[fault] += there
    sums["without a fault"] += not any(faults.values())
    return (
        f"{found.far * 100:.1f} ({found.farthest})", f"{found.ends * 100:.1f}", f"{found.bits:.1%}",
        f"{found.worst:.2f} ({found.worst_feature})", "; ".join(fault for fault, there in faults.items() if there),
    )  # fmt: skip


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(prog="python -m studies.wild", description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--skeletons", type=Path)
    given = parser.parse_args()
    console = Console(width=200)
    mappings = TimedMappings(**vars(load_mappings("auto", FEATURES.joints)))
    if given.folder is not None:
        census(given.folder, mappings, console)
    if given.skeletons is not None:
        variants(load_skeletons(given.skeletons), mappings, console)
    took = np.array(mappings.took)
    console.print(
        f"recognition of {len(took)} bodies: {took.mean():.1f} ms in the mean, {np.median(took):.1f} in the median, "
        f"{np.percentile(took, 95):.1f} at most in 95 %, {took.max():.1f} at most"
    )


if __name__ == "__main__":
    main()
