"""`python -m studies.duplicates DIR`: copies of takes that `kinedex duplicates` finds, by what was done to them.

`--hours H` looks for copies in a store of that length instead (`studies.duplicate_archive`), made under a temporary
folder and removed afterwards; 100 hours take some 3 GB.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.harness import silent
from benchmarks.scaling import peak_mib
from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.inspection.duplicates import find_duplicates
from kinedex.pipelines.simulation.synthetic_archive import write_archive
from kinedex.storage.formats.motion.reader_table import read_body
from kinedex.storage.formats.motion.sources import Scan, scan
from kinedex.storage.store.store import open_store
from studies.duplicate_archive import make_store

F32 = npt.NDArray[np.float32]
FEATURES = load_feature_set()
SEPARATOR = "~"
BASE_MINUTES = 30.0


def main() -> None:
    """Print how many copies are found, of each kind, how many pairs are wrong, and the time."""
    parser = argparse.ArgumentParser(prog="python -m studies.duplicates", description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", help="folder of motion files")
    parser.add_argument("--every", type=int, default=1, help="take every n-th file")
    parser.add_argument("--names", type=int, default=5, help="names of each file where copies of files are counted")
    parser.add_argument("--hours", type=float, nargs="+", default=[], help="lengths of stores that are made")
    parser.add_argument("--store", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.store is not None:
        print(json.dumps(_measured(given.store)))
        return
    if given.folder is None and not given.hours:
        parser.error("name a folder of motion files, or give --hours")
    for hours in given.hours:
        with tempfile.TemporaryDirectory() as name:
            _copies_in_hours(hours, Path(name))
    if given.folder is None:
        return
    found = scan(given.folder)
    with tempfile.TemporaryDirectory() as name:
        _copies_of_files(found, given.every, Path(name), given.names)
    with tempfile.TemporaryDirectory() as name:
        _copies_of_motion(found, given.every, Path(name))


def variants(positions: F32, rate: float) -> Iterator[tuple[str, F32, float]]:
    """Yield the copies of a take: name, places (T, J, 3) and frames per second."""
    count, joints = len(positions), list(FEATURES.joints)
    yield "as it is", positions, rate
    yield "cut", positions[count // 5 + 1 : count - count // 7], rate
    yield "half the rate", positions[1::2], rate / 2
    turned = positions @ np.array([[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]], np.float32) + np.float32([2, 0, 5])
    yield "moved and turned", turned, rate
    yield "in place", positions - positions[:, :1] * np.float32([1, 0, 1]), rate
    yield "to whole millimetres", np.round(positions, 3), rate
    other = {"l": "r", "r": "l"}
    sides = [joints.index(other.get(joint[0], "") + joint[1:]) if joint[0] in other and joint != "root" else
             joints.index(joint) for joint in joints]  # fmt: skip
    yield "mirrored", positions[:, sides] * np.float32([-1, 1, 1]), rate
    yield "cut, half the rate, mirrored", (positions[:, sides] * np.float32([-1, 1, 1]))[count // 5 + 1 :: 2], rate / 2


def _copies_of_files(found: Scan, every: int, folder: Path, names: int) -> None:
    """Print how many copies are found of files that stand under several names."""
    source, store = folder / "in", folder / "store"
    files = found.motions[::every]
    for number in range(names):
        for file in (*files, *found.skeletons):
            target = source / str(number) / file.path
            target.parent.mkdir(parents=True, exist_ok=True)
            suffix = f"-{number}" if file in files else ""
            shutil.copyfile(file.absolute, target.with_stem(target.stem + suffix))
    run_pipeline("ingest", store, assignments={"source": str(source)}, executor="processes", terminal=silent())
    opened = open_store(store)
    begin = time.perf_counter()
    rows = find_duplicates(opened, silent())
    seconds = time.perf_counter() - begin
    copies = rows.column("same").to_pylist().count("file")
    print(
        f"{len(files)} files under {names} names each: {copies} copies found of {len(files) * (names - 1)}, "
        f"{rows.num_rows - copies} further pairs, {seconds:.2f} s"
    )


def _copies_of_motion(found: Scan, every: int, folder: Path) -> None:
    """Print how many changed copies of motion are found, and the pairs of takes that are no copies."""
    mappings = load_mappings("auto", FEATURES.joints)
    kinds: list[str] = []
    for file in found.motions[::every]:
        skeleton = found.skeleton_of(file).absolute if file.format == "amc" else None
        body = read_body(file.absolute, skeleton, mappings, FEATURES.joints)
        positions = np.ascontiguousarray(body.positions.transpose(2, 0, 1), np.float32)
        (folder / "in").mkdir(exist_ok=True)
        kinds = []
        for number, (kind, copy, rate) in enumerate(variants(positions, body.rate_hz)):
            kinds.append(kind)
            path = folder / "in" / f"{file.stem}{SEPARATOR}{number}.npz"
            np.savez(path, positions=copy, names=np.array(FEATURES.joints), rate_hz=rate)
    settings = {"source": str(folder / "in")}
    run_pipeline("ingest", folder / "store", assignments=settings, executor="processes", terminal=silent())
    opened = open_store(folder / "store")
    begin = time.perf_counter()
    table = find_duplicates(opened, silent())
    seconds = time.perf_counter() - begin
    rows = table.select(["take", "of_take"]).to_pylist()
    pairs = {tuple(sorted((row["take"], row["of_take"]))) for row in rows}
    wrong = [pair for pair in pairs if len({name.rpartition(SEPARATOR)[0] for name in pair}) > 1]
    stems = {name.rpartition(SEPARATOR)[0] for name in opened.take_ids}
    print(f"{len(opened.take_ids)} takes; {len(pairs)} pairs in {seconds:.2f} s; {len(wrong)} of different takes")
    for pair in sorted(wrong)[:10]:
        print("    " + " and ".join(pair))
    print("| copy | found |\n|---|---|")
    for number, kind in enumerate(kinds[1:], 1):
        here = [stem for stem in stems if f"{stem}{SEPARATOR}{number}" in opened.take_ids]
        hits = sum((f"{stem}{SEPARATOR}0", f"{stem}{SEPARATOR}{number}") in pairs for stem in here)
        print(f"| {kind} | {hits} of {len(here)} |")


def _measured(store: Path) -> dict[str, object]:
    """Return the pairs of takes that are found in a store, the seconds, those of a core, and the peak memory."""
    begin, cpu = time.perf_counter(), time.process_time()
    rows = find_duplicates(open_store(store), silent()).select(["take", "of_take"]).to_pylist()
    return {
        "pairs": [[row["take"], row["of_take"]] for row in rows], "seconds": time.perf_counter() - begin,
        "cpu": time.process_time() - cpu, "mib": peak_mib(),
    }  # fmt: skip


def _copies_in_hours(hours: float, folder: Path) -> None:
    """Print how many copies are found in a store of some hours, the pairs that are no copies, time and memory."""
    write_archive(folder / "archive", minutes=BASE_MINUTES + 1, clip_minutes=1)
    settings = {"source": str(folder / "archive" / "takes")}
    run_pipeline("ingest", folder / "base", assignments=settings, executor="processes", terminal=silent())
    copies = make_store(folder / "store", open_store(folder / "base"), hours, variants, seed=0)
    # in a process of its own, whose peak memory the making of the store has not raised
    words = [sys.executable, "-m", "studies.duplicates", "--store", str(folder / "store")]
    done = json.loads(subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True, timeout=6 * 3600).stdout)
    opened = open_store(folder / "store")
    pairs = {frozenset(pair) for pair in done["pairs"]}
    known = {frozenset((name, other)): kind for name, (other, kind) in copies.items()}
    length = sum(opened.take_frames.values()) / opened.rate_hz / 3600
    size = sum(file.stat().st_size for file in (folder / "store").rglob("*") if file.is_file())
    print(
        f"{length:.1f} hours, {len(opened.take_ids)} takes, {size / 1e9:.1f} GB: "
        f"{len(pairs & known.keys())} copies found of {len(known)}, {len(pairs - known.keys())} further pairs; "
        f"{done['seconds']:.1f} s, {done['cpu']:.1f} s of a core, peak memory {done['mib']:.0f} MiB"
    )
    print("| copy | found |\n|---|---|")
    for kind in dict.fromkeys(known.values()):
        here = [pair for pair, one in known.items() if one == kind]
        print(f"| {kind} | {len(pairs.intersection(here))} of {len(here)} |")


if __name__ == "__main__":
    main()
