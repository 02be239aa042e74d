"""Races: readers of every kind while others write, build the index and collect garbage; several starts of one store.

A writer commits takes with one row of results each, and builds the index now and then; a collector removes every
version that it may. Meanwhile readers open versions and read all that there is: each must see a whole version, with
its index, whose takes, frames, words, runs, bit slices and results agree. Then several processes begin the same new
store: one wins, and the others wait, or report whom they would have to wait for.
"""

from __future__ import annotations

import logging
import random
import re
import time
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

import kinedex
from kinedex.ops.errors import KinedexError, StoreError
from kinedex.pipelines.keyframes.slice_search import sliced_store
from kinedex.storage.index.builder import build_index
from kinedex.storage.index.generations import current_generation
from kinedex.storage.lock import Wait
from kinedex.storage.snapshot.manifest_files import versions
from kinedex.storage.store.compaction import compact
from kinedex.storage.store.garbage_collection import collect_garbage
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter
from tests.attacks.outcome import Options, Outcome
from tests.killed_runs import channel, start
from tests.pipelines.archives import write_archive
from tests.storage.made_up import BODY, add

ANSWER_SECONDS, COMMIT_SECONDS = 300.0, 15.0
"""A process that takes longer than this, and than so long for each commit, is ended and counts as a failure."""

WAIT = Wait(60.0)
HELD_SECONDS = 1.5
MIX = "feature_set = 'mix'"
BUSY = re.compile(r"is being written by process \d+ on ")


ROUNDS = {"sample": (4, 1), "ordinary": (60, 6), "nightly": (600, 40)}
"""Commits while readers read, and races for a new store, of each size."""


def run(folder: Path, options: Options) -> Outcome:
    """Run the races of ordinary size, or the long ones of a night; a case is "reads", or "new store 3"."""
    commits, rounds = ROUNDS[options.size]
    return attack(folder, options.seed, commits=commits, rounds=rounds, case=options.case)


def attack(folder: Path, seed: int = 0, *, commits: int, rounds: int, case: str | None = None) -> Outcome:
    """Race readers against so many commits, and 2 to 4 processes for a new store so many times.

    Parameters
    ----------
    folder : Path
        An empty folder to work in.
    seed : int
        Seed of the takes and of the versions that readers choose.
    commits : int
        Number of commits while readers read.
    rounds : int
        Number of races for a new store.
    case : str, optional
        The one race to run.

    Returns
    -------
    Outcome
        The counts of reads, commits and collections, and a failure for every read that was wrong or failed.
    """
    outcome = Outcome()
    if case in (None, "reads"):
        _race_readers(folder / "reads", seed, commits, outcome)
    for number in range(rounds):
        if case in (None, f"new store {number}"):
            _race_for_a_new_store(folder / f"new{number}", number, outcome)
    outcome.cases = sum(count for kind, count in outcome.counts.items() if kind.startswith(("reads", "races")))
    return outcome


def _race_readers(store: Path, seed: int, commits: int, outcome: Outcome) -> None:
    _commit(store, 0)
    build_index(open_store(store, at="newest"))
    stop = store.with_name("stop")
    works: list[tuple[Callable[..., dict[str, int]], tuple[Any, ...]]] = [
        (_write, (store, stop, commits)), (_collect, (store, stop)),
        *((_read_newest, (store, stop)) for _ in range(2)), (_read_for_long, (store, stop)),
        (_read_old, (store, stop, seed)),
    ]  # fmt: skip
    for kind, count in _together(works, "reads", outcome, ANSWER_SECONDS + COMMIT_SECONDS * commits):
        outcome.count(kind, count)


def _together(
    works: list[tuple[Callable[..., dict[str, int]], tuple[Any, ...]]],
    case: str,
    outcome: Outcome,
    seconds: float = ANSWER_SECONDS,
) -> list[tuple[str, int]]:
    """Call functions in processes of their own at the same time; return their counts, and add their failures."""
    running = []
    for function, given in works:
        ours, theirs = channel()
        running.append((function.__name__, start(_answer, theirs, function, given), ours))
        theirs.close()
    counts: list[tuple[str, int]] = []
    deadline = time.monotonic() + seconds
    for name, process, pipe in running:
        found: Any = f"{name} gave no answer in {seconds:.0f} s"
        if pipe.poll(max(0.0, deadline - time.monotonic())):
            try:
                found = pipe.recv()
            except EOFError:
                found = f"{name} has died"
        process.kill()
        process.join()
        if isinstance(found, str):
            outcome.fail(case, found)
        else:
            counts += found.items()
    return counts


def _answer(pipe: Connection, function: Callable[..., dict[str, int]], given: tuple[Any, ...]) -> None:
    try:
        pipe.send(function(*given))
    except BaseException:
        pipe.send(f"{function.__name__}: {traceback.format_exc()}")


def _commit(store: Path, number: int) -> None:
    """Add three takes, drop one, and store a row of results for each take."""
    with StoreWriter.open(store, BODY, wait=WAIT) as writer:
        add(writer, {f"t{number:04d}{letter}": 20 + number % 7 for letter in "abc"})
        live = writer.store.manifest.live_takes
        gone = live[:1] if number % 5 == 4 else ()
        writer.drop_takes(gone)
        writer.put_results("hits", _hits(len(live) - len(gone) + 3), stage="p/search", run=f"r{number}")
        writer.commit()
        if number % 9 == 8:
            compact(writer)


def _hits(count: int) -> pa.Table:
    columns = {
        "saved_as": pa.nulls(count, pa.string()), "query": ["q"] * count, "take_id": np.arange(1, count + 1),
        "take": ["t"] * count, "start": np.zeros(count, np.int32), "stop": np.ones(count, np.int32),
        "start_seconds": np.zeros(count), "stop_seconds": np.ones(count),
    }  # fmt: skip
    return pa.table(columns)


def _write(store: Path, stop: Path, commits: int) -> dict[str, int]:
    built = 0
    try:
        for number in range(1, commits + 1):
            _commit(store, number)
            if number % 3 == 0:
                build_index(open_store(store, at="newest"), threads=1, wait=WAIT)
                built += 1
    finally:
        stop.touch()
    return {"commits": commits, "index builds": built}


def _collect(store: Path, stop: Path) -> dict[str, int]:
    counts = dict.fromkeys(("collections", "versions removed", "versions kept for readers"), 0)
    while not stop.exists():
        found = collect_garbage(store, keep=1, wait=WAIT)
        counts["collections"] += 1
        counts["versions removed"] += sum(one.kind == "old version" for one in found.removed)
        counts["versions kept for readers"] += len(found.open_versions)
        time.sleep(0.05)
    return counts


def _read_newest(store: Path, stop: Path) -> dict[str, int]:
    """Open the store as users do, again and again, and once at least; the index must be there every time."""
    reads = opened = 0
    last = 0
    while not reads or not stop.exists():
        with open_store(store) as one:
            if one.manifest.version < last:
                raise AssertionError(f"version {last} was shown before, now {one.manifest.version}")
            last = one.manifest.version
            reads += read_all(one)
            opened += 1
    return {"reads of the newest": reads, "stores opened": opened}


def _read_for_long(store: Path, stop: Path) -> dict[str, int]:
    """Keep versions open while others are published and collected, and read all of them again and again."""
    reads = opened = 0
    while not stop.exists():
        with open_store(store) as one:
            opened += 1
            until = time.monotonic() + HELD_SECONDS
            while time.monotonic() < until and not stop.exists():
                again = Store(one.path, one.manifest)  # so that nothing is answered from memory
                reads += read_all(again)
                again.close()
    return {"reads of versions kept open": reads, "stores opened": opened}


def _read_old(store: Path, stop: Path, seed: int) -> dict[str, int]:
    """Open any version that is there; that it has been removed before it is open is the one error allowed."""
    chance = random.Random(seed)
    counts = dict.fromkeys(("reads of a version by number", "versions gone before they were open"), 0)
    while not stop.exists():
        number = chance.choice(versions(store))
        try:
            one = open_store(store, at=number)
        except StoreError as fault:
            if f"it has no version {number}" not in str(fault):
                raise
            counts["versions gone before they were open"] += 1
            continue
        indexed = current_generation(store, one.manifest) is not None
        time.sleep(0.2 * chance.random())
        counts["reads of a version by number"] += read_all(one, indexed=indexed)
        one.close()
    return counts


def read_all(store: Store, *, indexed: bool = True) -> int:
    """Read all that an open store has, and return the number of reads.

    Raises
    ------
    AssertionError
        The tables of the version do not agree with each other.
    """
    takes = len(store.manifest.live_takes)
    rows = store.takes()
    if not takes:
        return 1  # the version with which a store begins
    frames = int(rows["frames"].sum())
    words = store.words()
    found = {
        "rows of takes": (rows.height, takes),
        "takes with words": (len(words), takes),
        "words": (len(words.words), frames),
        "frames of a take": (store.frames(rows["name"][0]).num_rows, rows["frames"][0]),
        "rows of hits": (store.result("hits").num_rows, takes),
        "takes with frames": (_number(store, "SELECT count(DISTINCT take_id) FROM frames"), takes),
        "rows of frames": (_number(store, "SELECT count(*) FROM frames"), frames),
        "rows of hits in SQL": (_number(store, "SELECT count(*) FROM hits"), takes),
    }
    if indexed:
        found |= {
            "takes with runs": (_number(store, "SELECT count(DISTINCT take_id) FROM word_runs"), takes),
            "frames of runs": (_number(store, f"SELECT sum(stop - start) FROM word_runs WHERE {MIX}"), frames),
            "frames of the vocabulary": (_number(store, f"SELECT sum(frames) FROM vocabulary WHERE {MIX}"), frames),
            "takes with bit slices": (len(sliced_store(store).take_ids), takes),
        }
    wrong = {name: pair for name, pair in found.items() if pair[0] != pair[1]}
    if wrong:
        raise AssertionError(f"version {store.manifest.version}: {wrong}")
    return len(found)


def _number(store: Store, query: str) -> int:
    return int(store.sql(f"SELECT ({query})::BIGINT AS n").column(0)[0].as_py() or 0)


def _race_for_a_new_store(folder: Path, number: int, outcome: Outcome) -> None:
    """Begin one new store from 2 to 4 processes; every other time they wait for each other."""
    write_archive(folder / "source", {"x_1.amc": 30, "x_2.amc": 40})
    processes, waits = 2 + number % 3, number % 2 == 1
    works = [(_ingest, (folder / "source", folder / "store", 60.0 if waits else 0.0))] * processes
    counts = dict.fromkeys(("done", "busy"), 0)
    for kind, count in _together(works, f"new store {number}", outcome):
        counts[kind] += count
    outcome.count("races for a new store")
    outcome.count("runs that won, or waited", counts["done"])
    outcome.count("runs that reported the winner", counts["busy"])
    if not counts["done"] or (waits and counts["busy"]):
        outcome.fail(f"new store {number}", f"of {processes} runs {counts['done']} were done, waits: {waits}")
    with open_store(folder / "store") as store:
        if store.takes()["name"].to_list() != ["x_1", "x_2"] or store.index_path() is None:
            outcome.fail(f"new store {number}", f"the store holds {store.takes()['name'].to_list()}")


def _ingest(source: Path, store: Path, wait_seconds: float) -> dict[str, int]:
    logging.disable(logging.CRITICAL)
    try:
        kinedex.run_pipeline("ingest", store, settings={"source": str(source)}, wait_seconds=wait_seconds)
    except KinedexError as fault:
        if not BUSY.search(str(fault)):
            raise
        return {"busy": 1}
    return {"done": 1}
