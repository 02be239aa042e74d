"""`python -m studies.mutations DATA [--hold FORMAT]`: change one thing in a motion file and see whether a joint moves.

DATA is a folder with `c3d`, `wild`, `cameras`, `cmu`, `bandai` and `hdm05`. Recordings that are read rightly are
written anew with one mutation each (studies/point_mutations.py, skeleton_mutations.py, acclaim_mutations.py,
scene_mutations.py), read again, and compared with what was read before. Skeletons of AMC files also change after a
store has taken them in (ingested_skeletons.py). One line for each format and mutation counts the outcomes:

right
    Every joint is within 2 cm of its place in the frames that have one.
estimated
    Joints that are farther away, 5 cm at most, are marked as estimated.
warned
    A joint is wrong, and the reading has a warning that the unchanged file does not cause.
refused
    The file is refused.
silent
    A joint is wrong without a word: the only failure. The exit code is 1 if there is any.
not knowable
    As silent, by a mutation that one file alone cannot show, such as all sides exchanged.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import TypeVar

import numpy as np
from rich.console import Console
from rich.table import Table

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.arrays import F64
from kinedex.ops.body import features
from kinedex.ops.errors import KinedexError
from kinedex.storage.formats.motion.reader import Body
from kinedex.storage.formats.motion.reader_table import read_body
from kinedex.storage.formats.motion.sources import scan
from studies.acclaim_mutations import AcclaimMutation, AcclaimText, acclaim_files, acclaim_mutations
from studies.acclaim_mutations import write as write_acclaim
from studies.ingested_skeletons import stored_trials, with_frames
from studies.point_mutations import FORMS, Mutation, Recording, point_mutations, recordings
from studies.scene_mutations import SceneMutation, fbx_files, gltf_files, scene_mutations
from studies.skeleton_mutations import BvhText, SkeletonMutation, bvh_files, bvh_mutations, write

FEATURES = load_feature_set()
JOINTS = FEATURES.joints
MAPPINGS = load_mappings("auto", JOINTS)
RIGHT_M, ESTIMATED_M = 0.02, 0.05
STORED_FRAMES = 60
SKELETONS = ("BVH", "AMC", "glTF", "FBX")
_ONE_LABEL = ("label hidden in all frames", "label removed", "label renamed to nonsense", "label duplicated")
OUTCOMES = ("right", "estimated", "warned", "refused", "silent", "not knowable")


@dataclass(frozen=True)
class Outcome:
    """The outcome of reading a mutated file: one of `OUTCOMES`, and a sentence on the worst joint or the refusal."""

    kind: str
    detail: str


def read(path: Path) -> Body:
    """Read a file with the shipped mappings."""
    return read_body(path, None, MAPPINGS, JOINTS)


def placed(moved: F64, still: F64) -> F64:
    """Return positions (J, 3, T) turned about the vertical axis and shifted, so that they fit others best."""
    both = np.isfinite(moved) & np.isfinite(still)
    use = both.all(axis=1)
    if not use.any():
        return moved
    a, b = moved.transpose(0, 2, 1)[use], still.transpose(0, 2, 1)[use]
    middle_a, middle_b = a.mean(axis=0), b.mean(axis=0)
    a, b = a - middle_a, b - middle_b
    angle = np.arctan2((a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]).sum(), (a[:, 0] * b[:, 0] + a[:, 2] * b[:, 2]).sum())
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    return np.asarray(np.einsum("ab,jbt->jat", turn, moved - middle_a[None, :, None]) + middle_b[None, :, None])


def read_beside(path: Path) -> Body:
    """Read an AMC file with the skeleton of its folder."""
    found = scan(path.parent)
    motion = next(one for one in found.motions if one.absolute == path)
    return read_body(path, found.skeleton_of(motion).absolute, MAPPINGS, JOINTS)


def judged(path: Path, control: Body, knowable: bool, reader: Callable[[Path], Body] = read) -> Outcome:
    """Read a mutated file and compare it with the control, which was read from the unchanged recording."""
    try:
        body = reader(path)
    except KinedexError as fault:
        return Outcome("refused", str(fault).removeprefix(f"{path}: "))
    faults = faults_of(body, control)
    if not faults:
        return Outcome("right", "")
    worst = max(faults.values())
    detail = ", ".join(f"{what} {size:.3g}" for what, size in sorted(faults.items(), key=lambda one: -one[1])[:4])
    if set(faults) <= set(body.estimated) and worst <= ESTIMATED_M:
        return Outcome("estimated", detail)
    new = [warning for warning in body.warnings if warning not in control.warnings]
    if new:
        return Outcome("warned", f"{detail}: {new[0]}")
    return Outcome("silent" if knowable else "not knowable", detail)


def faults_of(body: Body, control: Body) -> dict[str, float]:
    """Return the joints that are wrong, with the distance in metres, and `rate` or `words` with their shares."""
    found = {}
    if abs(body.rate_hz - control.rate_hz) > 0.01 * control.rate_hz:
        found["rate"] = body.rate_hz / control.rate_hz
    if body.frames != control.frames:
        return found | {"frames": body.frames / control.frames}
    valid = np.ones(body.frames, bool) if body.valid is None else body.valid
    positions = placed(np.where(valid, body.positions, np.nan), control.positions)
    for j, joint in enumerate(JOINTS):
        off = np.linalg.norm(positions[j] - control.positions[j], axis=0)
        off = off[np.isfinite(off)]
        if len(off) and (far := float(np.percentile(off, 95))) > RIGHT_M:
            found[joint] = far
    return found


def words_differing(body: Body, control: Body) -> float:
    """Return the share of frames whose words differ."""
    a, b = (features.words(one.positions, one.orientation, one.rate_hz, FEATURES.rules) for one in (body, control))
    return float(np.mean(a != b)) if len(a) == len(b) else 1.0


def control_of(path: Path, name: str, given: argparse.Namespace, reader: Callable[[Path], Body] = read) -> Body | None:
    """Read an unchanged file; None, with a line that says so, if it is refused and not one of those named here."""
    try:
        return reader(path)
    except KinedexError as fault:
        if not given.apart:
            raise
        print(f"not read at all: {name}: {str(fault).removeprefix(f'{path}: ')[:160]}")
        return None


Trial = tuple[str, str, str, Outcome]
"""Format, mutation, what it changed in which recording, and the outcome."""


def trials(found: list[Recording], form: str, given: argparse.Namespace) -> Iterator[Trial]:
    """Yield the trials of recordings of points in a format."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"take{FORMS[form].ending}"
        for recording in found:
            random = np.random.default_rng([given.seed, sum(recording.name.encode()), sum(form.encode())])
            FORMS[form].write(path, recording)
            control = control_of(path, recording.name, given)
            if control is None:
                continue
            for mutation in drawn(point_mutations(recording, form, random), given.trials, random):
                FORMS[form].write(path, mutation.recording)
                what = f"{recording.name}: {mutation.what}"
                yield form, mutation.name, what, judged(path, control, mutation.knowable)


def bvh_trials(found: list[BvhText], given: argparse.Namespace) -> Iterator[Trial]:
    """Yield the trials of BVH files."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "take.bvh"
        for file in found:
            random = np.random.default_rng([given.seed, sum(file.name.encode())])
            write(path, file)
            control = control_of(path, file.name, given)
            if control is None:
                continue
            for mutation in drawn(bvh_mutations(file), given.trials, random):
                write(path, mutation.file)
                yield "BVH", mutation.name, f"{file.name}: {mutation.what}", judged(path, control, mutation.knowable)


AnyMutation = TypeVar("AnyMutation", Mutation, SkeletonMutation, AcclaimMutation, SceneMutation)


def acclaim_trials(found: list[AcclaimText], given: argparse.Namespace) -> Iterator[Trial]:
    """Yield the trials of AMC files, each read with the skeleton that ingest chooses in its folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file in found:
            random = np.random.default_rng([given.seed, sum(file.name.encode())])
            control = control_of(write_acclaim(folder, file), file.name, given, read_beside)
            if control is None:
                continue
            for mutation in drawn(acclaim_mutations(file, found), given.trials, random):
                path = write_acclaim(folder, mutation.file)
                what = f"{file.name}: {mutation.what}"
                yield "AMC", mutation.name, what, judged(path, control, mutation.knowable, read_beside)


def stored_skeleton_trials(found: list[AcclaimText], given: argparse.Namespace) -> Iterator[Trial]:
    """Yield the trials of folders that are taken into a store again after their skeleton has changed."""
    for file in found[: given.trials]:
        for change, kind, detail in stored_trials(with_frames(file, STORED_FRAMES), found):
            yield "AMC", "skeleton changed after ingest", f"{file.name}: {change.what}", Outcome(kind, detail)


def scene_trials(data: Path, form: str, given: argparse.Namespace) -> Iterator[Trial]:
    """Yield the trials of glTF or FBX files."""
    bvh = bvh_files(data, given.apart)
    if given.apart:
        bvh = [file for file in bvh if is_read(file)]
    found = gltf_files(bvh, read) if form == "glTF" else fbx_files(data, bvh, read, given.apart)
    with tempfile.TemporaryDirectory() as folder:
        for file in found:
            path = Path(folder) / f"take{file.ending}"
            random = np.random.default_rng([given.seed, sum(file.name.encode())])
            file.write(path)
            control = control_of(path, file.name, given)
            if control is None:
                continue
            for mutation in drawn(scene_mutations(file, control, JOINTS, random), given.trials, random):
                mutation.file.write(path)
                right = replace(control, positions=mutation.size * control.positions)
                what = f"{file.name}: {mutation.what}"
                yield form, mutation.name, what, judged(path, right, mutation.knowable)


def is_read(file: BvhText) -> bool:
    """Return whether a BVH file is read at all."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder) / "take.bvh", file)
        try:
            read(Path(folder) / "take.bvh")
        except KinedexError:
            return False
    return True


def drawn(found: Iterable[AnyMutation], most: int | None, random: np.random.Generator) -> Iterator[AnyMutation]:
    """Yield all mutations, or at most so many of each name, drawn at random."""
    if most is None:
        yield from found
        return
    by_name: dict[str, list[AnyMutation]] = defaultdict(list)
    for mutation in found:
        by_name[mutation.name].append(mutation)
    for of_name in by_name.values():
        yield from (of_name[i] for i in sorted(random.permutation(len(of_name))[:most]))


def main() -> int:
    """Print the table; return 1 where a joint moved silently."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--hold", action="append", choices=[*FORMS, *SKELETONS], help="only files of this format")
    parser.add_argument("--trials", type=int, help="most trials of a mutation on a recording; all by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--apart", action="store_true", help="the other recordings of DATA, with none of which limits were set"
    )
    parser.add_argument("--show", nargs="*", default=["silent"], choices=OUTCOMES, help="outcomes to list one by one")
    given = parser.parse_args()
    counts: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    shown = []
    found = recordings(given.data, given.apart)
    forms = given.hold or [*FORMS, *SKELETONS]
    of_points = (trial for form in forms if form in FORMS for trial in trials(found, form, given))
    of_skeletons = bvh_trials(bvh_files(given.data, given.apart), given) if "BVH" in forms else ()
    acclaim = acclaim_files(given.data, given.apart) if "AMC" in forms else []
    of_acclaim = chain(acclaim_trials(acclaim, given), stored_skeleton_trials(acclaim, given))
    of_scenes = (trial for form in ("glTF", "FBX") if form in forms for trial in scene_trials(given.data, form, given))
    for form, mutation, what, outcome in chain(of_points, of_skeletons, of_acclaim, of_scenes):
        counts[form, mutation][outcome.kind] += 1
        if outcome.kind in given.show:
            shown.append(f"{outcome.kind}: {form}, {mutation}, {what}: {outcome.detail}")
    table = Table("format", "mutation", *OUTCOMES)
    for (form, mutation), found in sorted(counts.items()):
        table.add_row(form, mutation, *(str(found[kind] or "") for kind in OUTCOMES))
    total = sum(counts.values(), Counter[str]())
    lost = sum((counts[key] for key in counts if key[1] in _ONE_LABEL), Counter[str]())
    table.add_row("", "all", *(str(total[kind]) for kind in OUTCOMES))
    console = Console(width=200)
    for line in shown:
        console.print(line, highlight=False)
    console.print(table)
    if lost:
        held = lost["right"] + lost["estimated"]
        print(
            f"one label hidden, removed, renamed or duplicated: {held / lost.total():.1%} with every joint in its place"
        )
    return 1 if total["silent"] else 0


if __name__ == "__main__":
    sys.exit(main())
