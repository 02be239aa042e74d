"""`python -m studies.duplicates DATA`: copies that `kinedex duplicates` finds and misses, and pairs that are none.

Of every take of the folders bandai, hdm05 and cmu in DATA one copy of each kind is planted (`studies.planted_copies`),
all copies of one kind in a store of their own beside the takes. Right are the planted pairs, and the pairs of `KNOWN`,
which are in the collections; all other pairs are wrong. What the collections hold is established without words: of all
takes the nearest seconds are listed, by the places of joints around their mean, turned by hips and shoulders.

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
from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

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
from kinedex.storage.store.store import Store, open_store
from studies.duplicate_archive import make_store
from studies.nearest_seconds import nearest_seconds
from studies.planted_copies import planted

F32 = npt.NDArray[np.float32]
FEATURES = load_feature_set()
COLLECTIONS = ("bandai", "hdm05", "cmu")
BASE_MINUTES = 30.0
WRONG_SHOWN = 10

KNOWN = {"cmu": [("01/01_01.amc", "same_take_amc_and_bvh/01_01.amc", "same_take_amc_and_bvh/01_01.bvh")]}
"""Files of the collections that hold one take; all others were looked at by their nearest seconds."""

Pair = frozenset[str]


class Found(NamedTuple):
    """The pairs that were found in a store with planted copies, and the seconds of the search."""

    planted: int
    right: int
    known: int
    wrong: list[str]
    seconds: float


def main() -> None:
    """Print how many copies are found, of each kind, how many pairs are wrong, and the time."""
    parser = argparse.ArgumentParser(prog="python -m studies.duplicates", description=__doc__)
    parser.add_argument("data", type=Path, nargs="?", help="folder with bandai, hdm05 and cmu, or some of them")
    parser.add_argument("--every", type=int, default=1, help="plant a copy of every n-th take")
    parser.add_argument("--hours", type=float, nargs="+", default=[], help="lengths of stores that are made")
    parser.add_argument("--store", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.store is not None:
        print(json.dumps(_measured(given.store)))
        return
    if given.data is None and not given.hours:
        parser.error("name a folder with bandai, hdm05 and cmu, or give --hours")
    for hours in given.hours:
        with tempfile.TemporaryDirectory() as name:
            _copies_in_hours(hours, Path(name))
    if given.data is None:
        return
    tables = {}
    for collection in COLLECTIONS:
        if (given.data / collection).is_dir():
            with tempfile.TemporaryDirectory() as name:
                tables[collection] = dict(_searched(given.data / collection, given.every, Path(name)))
    _print_table(tables)


def _searched(source: Path, every: int, folder: Path) -> Iterator[tuple[str, Found]]:
    """Yield what is found among the takes of a collection, and beside the copies of each kind."""
    _ingest(source, folder / "base")
    base = open_store(folder / "base")
    names = _names_of(base)
    known = {
        frozenset(pair)
        for group in KNOWN.get(source.name, ())
        for pair in combinations([names[file] for file in group if file in names], 2)
    }
    for line in nearest_seconds(base, known):
        print(f"{source.name}: {line}", flush=True)
    yield "none planted", _judged(base, {}, known)
    again = {
        file for group in KNOWN.get(source.name, ()) for file in group[1:]
    }  # copies of one take would be equal files
    originals = _originals(scan(source), {file: name for file, name in names.items() if file not in again}, every)
    kinds = [kind for kind, _ in planted(*next(iter(originals.values())), np.random.default_rng(0))]
    for number, kind in enumerate(kinds):
        shutil.copytree(folder / "base", folder / "store")
        (folder / "in").mkdir()
        copies = {}
        for k, (name, (positions, rate)) in enumerate(originals.items()):
            made = list(planted(positions, rate, np.random.default_rng([number, k])))[number][1]()
            made.write(folder / "in", f"planted{k:04}")
            copies[f"planted{k:04}"] = name
        _ingest(folder / "in", folder / "store")
        found = _judged(open_store(folder / "store"), copies, known)
        print(
            f"{source.name}, {kind}: {found.right} of {found.planted}, {len(found.wrong)} wrong, {found.seconds:.1f} s"
        )
        for line in found.wrong[:WRONG_SHOWN]:
            print(f"    {line}")
        sys.stdout.flush()
        yield kind, found
        shutil.rmtree(folder / "store")
        shutil.rmtree(folder / "in")


def _ingest(source: Path, store: Path) -> None:
    """Read the files of a folder into a store."""
    run_pipeline("ingest", store, assignments={"source": str(source)}, executor="processes", terminal=silent())


def _names_of(store: Store) -> dict[str, str]:
    """Return the name of the take of each source file."""
    rows = store.take_columns("name", "source").to_pylist()
    return {row["source"]: row["name"] for row in rows}


def _originals(found: Scan, names: Mapping[str, str], every: int) -> dict[str, tuple[F32, float]]:
    """Return the places (T, J, 3) and frames a second of takes, by their names in the store."""
    mappings, takes = load_mappings("auto", FEATURES.joints), {}
    for file in [file for file in found.motions if file.path in names][::every]:
        skeleton = found.skeleton_of(file).absolute if file.format == "amc" else None
        body = read_body(file.absolute, skeleton, mappings, FEATURES.joints)
        positions = np.ascontiguousarray(body.positions.transpose(2, 0, 1), np.float32)
        takes[names[file.path]] = positions, body.rate_hz
    return takes


def _judged(store: Store, copies: Mapping[str, str], known: set[Pair]) -> Found:
    """Return how many pairs of a store are found; `copies` names the take that each planted one is a copy of."""
    begin = time.perf_counter()
    rows = find_duplicates(store, silent()).to_pylist()
    seconds = time.perf_counter() - begin
    pairs = {frozenset((row["take"], row["of_take"])): row for row in rows}
    of = {name: copies.get(name, name) for name in store.take_ids}
    right = sum(frozenset(pair) in pairs for pair in copies.items())
    here = sum(pair in pairs for pair in known)
    wrong = []
    for pair, row in pairs.items():
        one = {of[name] for name in pair}
        if len(one) > 1 and one not in known:
            text = " and ".join(sorted(of[name] + "~" * (name in copies) for name in pair))
            wrong.append(
                f"{text}: {row['start_seconds']:.2f} to {row['stop_seconds']:.2f} s, {row['distance_mm']:.1f} mm"
            )
    return Found(len(copies), right, here, wrong, seconds)


def _print_table(tables: Mapping[str, Mapping[str, Found]]) -> None:
    """Print a table of the copies found of each kind, and recall and precision of all of them together."""
    print(f"| copy | {' | '.join(tables)} |\n|---|{'---|' * len(tables)}")
    for kind in next(iter(tables.values()), {}):
        cells = [f"{found.right} of {found.planted}" for found in (table[kind] for table in tables.values())]
        if kind != "none planted":
            print(f"| {kind} | {' | '.join(cells)} |")
    sums: dict[str, Counter[str]] = {}
    for name, table in tables.items():
        sums[name] = Counter()
        for found in table.values():
            sums[name] += Counter(planted=found.planted, right=found.right, known=found.known, wrong=len(found.wrong))
    rows = {
        "recall": [f"{one['right'] / max(1, one['planted']):.4f}" for one in sums.values()],
        "pairs that are no copies": [f"{one['wrong']:,}" for one in sums.values()],
        "precision": [
            f"{(one['right'] + one['known']) / max(1, one['right'] + one['known'] + one['wrong']):.4f}"
            for one in sums.values()
        ],
        "seconds of all searches": [f"{sum(found.seconds for found in one.values()):.1f}" for one in tables.values()],
    }
    for title, values in rows.items():
        print(f"| {title} | {' | '.join(values)} |")


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
    _ingest(folder / "archive" / "takes", folder / "base")
    copies = make_store(folder / "store", open_store(folder / "base"), hours, seed=0)
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
