"""Flips of one bit in every kind of file of a store: an answer is the same as before, or an error that names the file.

The store is that of the demo. Of each kind of file (frames, takes, every kind of result, the newest manifest, older
ones, the file of the index, its record, its bit slices, and each kind of report) as many flips are tried, at random
places of random files, every other one with the time of the file kept. The flip is made in the file itself and undone
afterwards; each is met by a store that is opened for it.

The questions are every view, the example of every macro, takes, words, frames, search, rank, similar, annotations,
templates, export, the data of the report page, the comparison of evaluations, a version before the newest, and
`kinedex verify`. A store is asked a few of the questions that depend on the file, and one that does not: a question
depends on a file if its answer changes with one byte of a part or of slices, or once another file is cut in half.
Pages and summaries beside the results are read by people, so that `verify` alone finds their flips.

Not tried: all questions after every flip, commands in processes of their own (they ask the same functions), a store
that is open while the bit flips, and stages that write.
"""

from __future__ import annotations

import hashlib
import os
import random
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow as pa

from kinedex.catalog.sql.views import MACROS, VIEWS
from kinedex.library.store import Store as Archive
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.evaluation.written_evaluations import read_evaluations
from kinedex.pipelines.export.data_set import export_take
from kinedex.pipelines.export.request import ClipOptions
from kinedex.reports.annotation_data import read_report_data
from kinedex.storage.index.builder import build_index
from kinedex.storage.snapshot.manifest_files import read_version, versions
from kinedex.storage.snapshot.schemas import FORMAT_VERSION
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.attacks.outcome import Options, Outcome
from tests.storage.flipped import flip_bit
from tests.storage.stores import unpacked

EACH = {"sample": 1, "ordinary": 60, "nightly": 1_000}
"""Flips for every kind of file, of each size."""

ASKED = 4
"""Most of the questions that depend on a file that are asked after one flip."""

Question = Callable[[Store], object]


@dataclass(frozen=True)
class Flip:
    """One flip: the file, the byte, the bit, and whether the time of the file is kept."""

    kind: str
    file: Path
    at: int
    bit: int
    keep_time: bool


def run(folder: Path, options: Options) -> Outcome:
    """Flip bits in the store of a demo; of a sample, in a smaller one."""
    if options.size == "sample":
        return attack(unpacked(FORMAT_VERSION, folder), EACH["sample"], options)
    path = folder / "store"
    words = [sys.executable, "-m", "kinedex", "demo", str(path), "--minutes", "2", "--executor", "serial"]
    subprocess.run(words, check=True, capture_output=True, timeout=1800, cwd=folder)
    store = open_store(path)
    with StoreWriter.open(path, store.feature_set) as writer:
        # versions before this one have other takes and another index, which must not answer for it
        writer.drop_takes([max(store.manifest.live_takes)])
        writer.commit()
        build_index(writer.store)
    return attack(path, EACH[options.size], options)


def attack(path: Path, each: int, options: Options) -> Outcome:
    """Flip bits in every kind of file of a store.

    Parameters
    ----------
    path : Path
        The store, which is as before afterwards.
    each : int
        The number of flips for every kind of file.
    options : Options
        The seed, and the case to repeat: the number of a flip.
    """
    outcome = Outcome()
    asked = questions(open_store(path))
    before = answers(path, asked)
    if failed := {name: answer for name, answer in before.items() if isinstance(answer, KinedexError)}:
        raise AssertionError(f"the sound store does not answer: {failed}")
    known: dict[Path, list[str]] = {}
    flips = chosen(path, each, random.Random(options.seed))
    for number, flip in enumerate(flips):
        if options.case not in (None, str(number)):
            continue
        if flip.file not in known:
            known[flip.file] = dependent(flip.file, path, asked, before)
        # chosen by the number, so that one case can be repeated without those before it
        dice = random.Random(f"{options.seed} {number}")
        names = dice.sample(known[flip.file], min(ASKED, len(known[flip.file])))
        names += dice.sample(sorted(set(asked).difference(names)), 1)
        after = flipped(flip, path, {name: asked[name] for name in names})
        found = any(isinstance(answer, KinedexError) for answer in after.values())
        outcome.count(f"{flip.kind}, {'found' if found else 'nothing changed'}")
        for name in names:
            if problem := wrong(flip.file, before[name], after[name]):
                outcome.fail(str(number), f"{flip}: {name}: {problem}")
    outcome.cases = sum(outcome.counts.values())
    outcome.count("flips", outcome.cases)
    outcome.count("questions", len(asked))
    return outcome


def chosen(path: Path, each: int, dice: random.Random) -> list[Flip]:
    """Return the flips of every kind of file, in random places."""
    flips = []
    for kind, files in kinds_of_files(path).items():
        for number in range(each):
            file = dice.choice(files)
            flips.append(Flip(kind, file, dice.randrange(file.stat().st_size), dice.randrange(8), number % 2 == 1))
    return flips


def kinds_of_files(path: Path) -> dict[str, list[Path]]:
    """Return the files of a store that may change an answer, by kind."""
    store = open_store(path)
    kinds: dict[str, list[Path]] = {}
    for part in store.manifest.parts:
        kinds.setdefault(part.path.split("/part-")[0], []).append(path / part.path)
    manifests = sorted((path / "manifest").glob("*.json"))
    kinds |= {"manifest, newest": manifests[-1:], "manifest, older": manifests[-2:-1]}
    generation = store.index_path().parent
    kinds |= {
        "index.duckdb": [generation / "index.duckdb"],
        "generation.json": [generation / "generation.json"],
        "slices": sorted(generation.glob("*.slices")),
    }
    for file in sorted((path / "results" / "reports").glob("*/*")):
        kinds.setdefault(f"report {file.suffix}", []).append(file)
    return kinds


def questions(store: Store) -> dict[str, Question]:
    """Return the questions by name."""
    asked: dict[str, Question] = {}
    for view in VIEWS:
        asked[f"view {view.name}"] = _sql(f"FROM {view.name} ORDER BY ALL")
    for macro in MACROS:
        asked[f"macro {macro.name}"] = _sql(f"FROM ({macro.example}) ORDER BY ALL")
    take = min(store.take_ids)
    asked |= {
        "takes": lambda store: store.takes_table("frames > 0"),
        "words": lambda store: [store.words().words.tobytes(), store.words().offsets.tolist()],
        "frames": lambda store: [store.frames(name) for name in sorted(store.take_ids)[:3]],
        "search": lambda store: Archive(store).search("example"),
        "similar": lambda store: Archive(store).similar(take, 0, 20, top=5, workers=1),
        "annotations": lambda store: Archive(store).results("annotations"),
        "export": lambda store: _exported(store, take),
        "older version": lambda store: _older(store, take),
        "verify": _verified,
    }
    if store.manifest.results.get("templates"):
        template = store.result("templates").column("subclass")[0].as_py()
        asked["templates"] = lambda store: Archive(store).templates()
        asked["rank"] = lambda store: Archive(store).rank(template, top=5, workers=1)
    if records := [key for key in store.manifest.stages if key.endswith("/report")]:
        pipeline = records[0].split("/")[0]
        inputs = store.manifest.stages[records[0]].summary["inputs"]
        moment = datetime(2026, 1, 1, tzinfo=UTC)
        asked["report"] = lambda store: read_report_data(store, pipeline, created=moment, inputs=inputs)
        asked["compare"] = lambda store: read_evaluations(str(store.path))
    return asked


def _sql(query: str) -> Question:
    return lambda store: store.sql(query)


def _exported(store: Store, take: str) -> bytes:
    file = store.path.parent / "exported.csv"
    export_take(store, take, ClipOptions("csv"), file)
    return file.read_bytes()


def _older(store: Store, take: str) -> object:
    """Return answers of the version before the newest."""
    older = Store(store.path, read_version(store.path, versions(store.path)[-2]))
    return [older.take_rows, older.words([older.take_id(take)]).words.tobytes()]


def _verified(store: Store) -> object:
    """Return nothing for a sound store; the error has what verify finds."""
    if found := verify(store):
        raise KinedexError("\n".join(str(finding) for finding in found))
    return None


def digest(answer: object) -> str:
    """Return a hash of an answer: of its values, whatever their layout in memory."""
    return hashlib.sha256(repr(_plain(answer)).encode()).hexdigest()


def _plain(answer: object) -> object:
    if hasattr(answer, "to_arrow"):
        answer = answer.to_arrow()
    if isinstance(answer, pa.Table):
        return str(answer.schema), answer.to_pydict()
    if isinstance(answer, np.ndarray):
        return answer.dtype.str, answer.shape, answer.tobytes()
    if is_dataclass(answer):
        return [_plain(getattr(answer, one.name)) for one in fields(answer)]
    if isinstance(answer, dict):
        return [(key, _plain(value)) for key, value in answer.items()]
    return [_plain(one) for one in answer] if isinstance(answer, list | tuple) else answer


def answers(path: Path, asked: dict[str, Question]) -> dict[str, str | Exception]:
    """Ask a store that is opened for it; the answers are digests, or errors."""
    found: dict[str, str | Exception] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            store = open_store(path)
        except KinedexError as fault:
            return dict.fromkeys(asked, fault)
        with store:
            for name, question in asked.items():
                try:
                    found[name] = digest(question(store))
                except Exception as fault:
                    found[name] = fault
    return found


def dependent(file: Path, path: Path, asked: dict[str, Question], before: dict[str, str | Exception]) -> list[str]:
    """Return the questions that depend on a file; `verify`, which takes long, only where nothing else does."""
    content, status = file.read_bytes(), file.stat()
    if file.suffix in (".parquet", ".slices"):
        at = len(content) // 10  # amid the values: the end of a part describes its columns, which all of SQL needs
        damaged = content[:at] + bytes([content[at] ^ 255]) + content[at + 1 :]
    else:
        damaged = content[: len(content) // 2]
    try:
        file.write_bytes(damaged)
        after = answers(path, asked)
    finally:
        file.write_bytes(content)
        os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))
    found = [name for name in asked if after[name] != before[name]]
    return [name for name in found if name != "verify"] or found


def flipped(flip: Flip, path: Path, asked: dict[str, Question]) -> dict[str, str | Exception]:
    """Return the answers of a store with one flipped bit, which is flipped back afterwards."""
    status = flip.file.stat()
    flip_bit(flip.file, flip.at, flip.bit, keep_time=flip.keep_time)
    try:
        return answers(path, asked)
    finally:
        flip_bit(flip.file, flip.at, flip.bit)
        os.utime(flip.file, ns=(status.st_atime_ns, status.st_mtime_ns))


def wrong(file: Path, before: str | Exception, after: str | Exception) -> str | None:
    """Return what is wrong with an answer; None for the same one, and for an error that names the file."""
    if after == before:
        return None
    if not isinstance(after, KinedexError):
        return f"a {type(after).__name__}: {after}" if isinstance(after, Exception) else "another answer, no error"
    return None if file.name in str(after) else f"the error does not name the file: {after}"
