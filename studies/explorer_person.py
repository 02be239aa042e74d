"""A person who looks for a class in the explorer: a script that sends what the page sends, and knows the truth."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
import urllib.request
import uuid
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

from benchmarks.archive import archive as synthetic_files
from benchmarks.harness import silent
from kinedex.catalog.classes import load_classes
from kinedex.ops.evaluation.metrics import compare
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.labels.file_segments import placed_files
from kinedex.storage.formats.labels.formats import read_labels
from kinedex.storage.store.store import Store, open_store
from studies import BUILD

Range = tuple[int, int]
Ranges = Mapping[str, Sequence[Range]]
"""Intervals by the names of their takes."""

Row = dict[str, Any]

TOP, MAX_TOP, TAU = 60, 500, 0.1
"""The page shows so many hits at first, and so many at most, below this cost."""

STEP, MAX_TAU = 0.05, 0.3
"""The person raises τ by so much where the list ends, up to this."""

THINKING = 5.0
"""A person takes so many seconds at least from one learning to the next, in which the explorer gets ready for it."""

SIDED = ("left", "right")
"""Classes with one of these in their name have a side: the person asks for them without mirror images."""

STYLES = r"dataset-\d_[^_]+_(?P<actor>[^_]+)_(?P<clip>\d+)\."
CONTENT = re.compile(r"dataset-\d_([^_]+)_")
PEOPLE = r"[^/_]+_(?P<actor>[^/_]+)_[^/]+\.amc"


@dataclass(frozen=True)
class Archive:
    """A store without classes, and what is true of its takes.

    Attributes
    ----------
    name : str
        Its name.
    path : Path
        The store.
    classes : dict of str to mapping
        For each class the intervals that show it, by take.
    decided : frozenset of str
        The actors (or styles) whose takes the person decides on.
    by_take : bool
        True if F of takes decides, False for F of frames.
    """

    name: str
    path: Path
    classes: Mapping[str, Ranges]
    decided: frozenset[str]
    by_take: bool

    def where(self, *, decided: bool) -> str:
        """Return the condition on takes of one half."""
        names = ", ".join(f"'{one}'" for one in sorted(self.decided))
        return f"actor {'' if decided else 'NOT '}IN ({names})"


def half(names: set[str]) -> frozenset[str]:
    """Return every second one of some names, in the order of their hashes."""
    return frozenset(sorted(names, key=lambda one: sha256(one.encode()).hexdigest())[::2])


def bandai(source: Path) -> Archive:
    """Return Bandai's takes; each shows the content that its name has."""
    store = _ingested(source, BUILD / "explorer-bandai", STYLES)
    classes: dict[str, dict[str, list[Range]]] = defaultdict(dict)
    for name, frames in take_frames(store).items():
        found = CONTENT.search(name)
        if found is not None:
            classes[found[1]][name] = [(0, frames)]
    return Archive("Bandai", store.path, classes, half(set(store.takes()["actor"].drop_nulls())), True)


def synthetic() -> Archive:
    """Return the synthetic archive: clips of a folder each, and long takes with ground truth."""
    source = synthetic_files()
    store = _ingested(source, BUILD / "explorer-synthetic", PEOPLE)
    classes: dict[str, dict[str, list[Range]]] = defaultdict(lambda: defaultdict(list))
    frames = take_frames(store)
    folders = {name: Path(file).parent.name for name, file in store.takes().select("name", "source").iter_rows()}
    known = load_classes("synthetic", set(folders.values())).of_subclass()
    for name, folder in folders.items():
        if label := _kind(known.get(folder, "")):
            classes[label][name].append((0, frames[name]))
    for one in placed_files(store, [read_labels(source / "takes" / "ground_truth.csv")]).segments:
        classes[_kind(one.label)][one.take].append((int(one.start), int(one.stop)))
    return Archive("synthetic", store.path, classes, half(set(store.takes()["actor"].drop_nulls())), False)


def _kind(label: str) -> str:
    """Return a class of either side: kicks of the left and of the right foot are kicks."""
    return "kick" if label.startswith("kick") else label


def _ingested(source: Path, path: Path, pattern: str) -> Store:
    assignments = {"source": str(source), "patterns": json.dumps([pattern])}
    run_pipeline("ingest", path, assignments=assignments, terminal=silent())
    return open_store(path)


def take_frames(store: Store) -> dict[str, int]:
    return dict(store.takes().select("name", "frames").iter_rows())


class Explorer:
    """A running explorer, with the seconds for which a person has waited for its answers."""

    def __init__(self, address: str, token: str) -> None:
        self._address, self._token = address, token
        self.waited = 0.0
        self._learned = 0.0

    def ask(self, path: str, body: Row | None = None, *, waits: bool = True) -> Row:
        """Return the answer to a request, as the page sends it."""
        data = None if body is None else json.dumps(body).encode()
        headers = {"Authorization": f"Bearer {self._token}", "Content-Type": "application/json"}
        begin = time.perf_counter()
        with urllib.request.urlopen(urllib.request.Request(self._address + path, data, headers), timeout=120) as answer:
            found: Row = json.loads(answer.read())
        if waits:
            self.waited += time.perf_counter() - begin
        return found

    def learn(self) -> None:
        """Learn again and annotate, and wait for the end."""
        time.sleep(max(0.0, self._learned + THINKING - time.monotonic()))
        begin = time.perf_counter()
        self.ask("/api/learn", waits=False)
        id = self.ask("/api/learn", {}, waits=False)["id"]
        while True:
            (job,) = (one for one in self.ask("/api/jobs", waits=False)["jobs"] if one["id"] == id)
            if job["state"] not in ("waiting", "running"):
                break
            time.sleep(0.05)
        if job["state"] != "done":
            raise SystemExit(f"learning again failed: {job['problem']}")
        self.waited += time.perf_counter() - begin
        self._learned = time.monotonic()


@contextmanager
def explorer(store: Path) -> Iterator[Explorer]:
    """Start the explorer of a store, open its page and ask something, so that it is warm; it ends with the block."""
    words = [sys.executable, "-m", "kinedex", "explore", str(store), "--no-browser", "--port", "0"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            found = re.search(r"(http://[^/]+)/\S*token=(\S+)", process.stdout.readline())
            if found is None:
                raise SystemExit("the explorer did not start")
            opened = Explorer(found[1], found[2])
            take, frames = next(iter(take_frames(open_store(store)).items()))
            example = {"take": take, "start": 0, "stop": min(frames, 30)}
            opened.ask("/api/ask/examples", {"positives": [example], "top": 1}, waits=False)
            yield opened
        finally:
            process.terminate()
            process.wait(30)


@dataclass
class Person:
    """Somebody who looks for a class, with the intervals that were accepted and rejected so far."""

    archive: Archive
    label: str
    example: Row
    opened: Explorer
    each: int
    accepted: list[Row] = field(default_factory=list)
    rejected: list[Row] = field(default_factory=list)
    positives: list[Row] = field(default_factory=list)
    negatives: list[Row] = field(default_factory=list)
    decisions: int = 0
    corrections: int = 0
    learns: bool = False

    def __post_init__(self) -> None:
        self.positives = [self.example]

    def shows(self, row: Row) -> int:
        """Return how many frames of an interval show the class."""
        truth = self.archive.classes[self.label].get(row["take"], ())
        return compare([(row["start"], row["stop"])], truth).frames_both

    def answer(self, row: Row) -> bool:
        """Answer yes if half of an interval shows the class, and no otherwise."""
        self.decisions += 1
        right = 2 * self.shows(row) >= row["stop"] - row["start"]
        (self.accepted if right else self.rejected).append(interval(row))
        return right

    def undecided(self, rows: Sequence[Row]) -> list[Row]:
        """Return rows that are not those that were decided on."""
        return [row for row in rows if not any(alike(row, one) for one in (*self.accepted, *self.rejected))]

    def hits(self, top: int, tau: float = TAU, *, decided: bool = True, waits: bool = True) -> Row:
        """Ask by the examples."""
        body = {"positives": self.positives, "negatives": self.negatives, "tau": tau, "top": top}
        body |= {"mirror": not any(side in self.label for side in SIDED), "where": self.archive.where(decided=decided)}
        return self.opened.ask("/api/ask/examples", body, waits=waits)

    def more_like_these(self) -> None:
        """Ask for more like what was accepted and less like what was rejected, as the page does."""
        apart = [] if any(overlap(self.example, one) for one in self.accepted) else [self.example]
        self.positives, self.negatives = [*apart, *self.accepted], list(self.rejected)

    def next_hits(self) -> list[Row]:
        """Return the next hits of the list, the best first; where all are decided, more are asked for, or costlier."""
        top, tau = TOP, TAU
        while True:
            found = self.hits(top, tau)
            rows = self.undecided(found["hits"])
            if len(rows) >= self.each or (found["more"] and top >= MAX_TOP) or tau >= MAX_TAU:
                return rows[: self.each]
            top, tau = (min(MAX_TOP, 2 * top), tau) if found["more"] else (top, min(MAX_TAU, tau + STEP))

    def save(self) -> None:
        """Save what was accepted and rejected as labels."""
        body = {"class": self.label, "positives": self.accepted, "negatives": self.rejected}
        self.opened.ask("/api/ask/labels", body)

    def edit(self, take: str, change: Row) -> None:
        """Record a decision in the lanes or in the queue, which show the next thing meanwhile."""
        body = {"take": take, "changes": [{"id": uuid.uuid4().hex, **change}]}
        self.opened.ask("/api/labels/decide", body, waits=False)

    def draw(self, take: str, start: int, stop: int, *, shows: bool = True) -> None:
        """Draw a label."""
        verdict = "positive" if shows else "negative"
        row = {"take": take, "start": start, "stop": stop, "mirrored": False}
        (self.accepted if shows else self.rejected).append(row)
        self.edit(take, {"do": "draw", "class": self.label, "start": start, "stop": stop, "verdict": verdict})

    def is_drawn(self, take: str, start: int, stop: int) -> bool:
        """Return whether an interval is a label already, as the first example is."""
        return any((one["take"], one["start"], one["stop"]) == (take, start, stop) for one in self.accepted)

    def found(self, *, decided: bool) -> dict[str, list[Range]]:
        """Return what the class is found in, in one half of the takes."""
        store = open_store(self.archive.path, at="newest")
        takes = store.takes(self.archive.where(decided=decided))["name"].to_list()
        rows = (
            store.result("annotations").to_pylist()
            if self.learns
            else self.hits(MAX_TOP, decided=decided, waits=False)["hits"]
        )
        rows = [row for row in rows if row.get("class", self.label) == self.label and row["take"] in set(takes)]
        if decided:  # a person's word counts more than that of a template
            rows = [row for row in rows if not any(alike(row, one) for one in self.rejected)] + self.accepted
        found: dict[str, list[Range]] = {name: [] for name in takes}
        for row in rows:
            found[row["take"]].append((row["start"], row["stop"]))
        return found


def interval(row: Row) -> Row:
    """Return an interval of a take as requests have it."""
    return {key: row[key] for key in ("take", "start", "stop")} | {"mirrored": row.get("mirrored", False)}


def overlap(one: Row, other: Row) -> int:
    """Return the number of frames that two intervals share."""
    if one["take"] != other["take"]:
        return 0
    return max(0, min(one["stop"], other["stop"]) - max(one["start"], other["start"]))


def alike(one: Row, other: Row) -> bool:
    """Return whether two intervals share half of the frames of the shorter one."""
    return 2 * overlap(one, other) >= min(one["stop"] - one["start"], other["stop"] - other["start"])
