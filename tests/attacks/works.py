"""The works that are killed on their way: each changes a small store in one way, and is run again afterwards."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pyarrow as pa
import yaml

import kinedex
from kinedex.console.terminal import Terminal
from kinedex.pipelines.ingestion import read_passes
from kinedex.pipelines.ingestion.store_repair import repair_store
from kinedex.pipelines.keyframes import learning_runs
from kinedex.storage.index.builder import build_index
from kinedex.storage.store.garbage_collection import collect_garbage
from kinedex.storage.store.result_changes import record_labels
from kinedex.storage.store.store import open_store
from kinedex.storage.store.upgrade import upgrade
from kinedex.storage.store.writer import StoreWriter
from tests.bvh_files import write_duet
from tests.pipelines.archives import write_archive
from tests.storage.stores import unpacked

BATCH_BYTES = 1 << 12
"""A batch of files is this small, so that an ingest of a few takes commits several times."""

PATTERNS = [
    r"clips/(?P<class>[^/]+)/[^/_]+_(?P<actor>[^/_]+)_.*_(?P<clip>\d+)_\d+\.",
    r"takes/[^/_]+_(?P<actor>[^/_]+)_(?P<clip>take\d+)\.",
]

STAGES: dict[str, dict[str, object]] = {
    "learn_templates": {"where": "class IS NOT NULL"},
    "annotate": {"where": "class IS NULL", "tau": 0.2},
    "evaluate": {},
    "learn_keyframes": {"where": "class IS NOT NULL", "generations": 4, "population": 8, "runs": 2},
    "compare_methods": {"title": "others", "splits": [{"name": "others", "leave_out": "actor"}], "embed": "none"},
    "report": {},
}
"""The stages of a pipeline that follow ingest and index, with their parameters."""


@dataclass(frozen=True)
class Work:
    """A work that changes a store.

    Attributes
    ----------
    name : str
        Its name in tables.
    prepare : callable
        Makes the store as it is before, and the sources, in an empty folder.
    run : callable
        Changes a copy of that store; given the folder and the copy.
    damaged : bool
        True if the store is damaged before, so that only the end can be sound.
    """

    name: str
    prepare: Callable[[Path], object]
    run: Callable[[Path, Path], object]
    damaged: bool = False


def bring_in(folder: Path, store: Path) -> None:
    """Ingest the folder's sources in small batches."""
    read_passes.MEGABYTE = BATCH_BYTES
    stages: dict[str, dict[str, object]] = {"ingest": {"source": str(folder / "source"), "prune": True}}
    kinedex.run_pipeline(str(_written(folder, "ingest", "ingest", stages)), store)


def _written(folder: Path, file: str, name: str, stages: dict[str, dict[str, object]]) -> Path:
    path = folder / f"{file}.yaml"
    if not path.exists():
        content = {"name": name, "stages": {stage: {"params": params} for stage, params in stages.items()}}
        path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


def _new(folder: Path) -> None:
    write_archive(folder / "source", {f"x_{number}.amc": 20 + number for number in range(4)})
    write_duet(folder / "source" / "duet.bvh", 30)


def _changed(folder: Path) -> None:
    """A store of four takes, of whose files one has changed since, one is gone and one is new."""
    _new(folder)
    bring_in(folder, folder / "store")
    build_index(open_store(folder / "store", at="newest"))
    (folder / "source" / "x_0.amc").unlink()
    write_archive(folder / "source", {"x_1.amc": 31, "x_7.amc": 25}, first_seed=50)


def _many_parts(folder: Path) -> None:
    """A store whose parts are merged at the next ingest."""
    write_archive(folder / "source", {f"x_{number}.amc": 20 for number in range(7)})
    bring_in(folder, folder / "store")
    write_archive(folder / "source", {"x_8.amc": 20}, first_seed=50)


def _no_index(folder: Path) -> None:
    _new(folder)
    bring_in(folder, folder / "store")


def _old_index(folder: Path) -> None:
    _changed(folder)
    bring_in(folder, folder / "store")


def _garbage(folder: Path) -> None:
    """A store with old versions, parts of replaced takes, an index of before, and unfinished files."""
    _old_index(folder)
    build_index(open_store(folder / "store", at="newest"))
    for name in ("frames/.tmp-1.parquet", "manifest/.tmp-2.json"):
        (folder / "store" / name).write_bytes(b"unfinished")


def _staged(count: int, folder: Path) -> None:
    """A store of labelled clips and takes on which so many stages have run."""
    for number, subclass in enumerate(("walk", "kick")):
        names = [
            f"clips/{subclass}/x_{actor}_{subclass}_{clip:03d}_120.amc" for actor in ("ann", "bob") for clip in (1, 2)
        ]
        for clip, name in enumerate(names):
            write_archive(folder / "source", {name: 60 + 10 * clip}, first_seed=number)
        write_archive(folder / "source", {f"takes/x_{subclass}_take01.amc": 200}, first_seed=number)
    (folder / "source" / "takes" / "ground_truth.csv").write_text(
        "take,class,start,stop\nx_walk_take01,walk,10,90\nx_kick_take01,kick,20,100\n"
    )
    _stages(count, folder, folder / "store")


def _stages(count: int, folder: Path, store: Path) -> None:
    # saves by the clock would make more versions on a slow machine than the undisturbed run made
    learning_runs.SAVE_SECONDS = math.inf
    source = str(folder / "source")
    stages: dict[str, dict[str, object]] = {"ingest": {"source": source, "patterns": PATTERNS}, "index": {}}
    stages |= dict(list(STAGES.items())[:count])
    if "evaluate" in stages:
        stages["evaluate"] = {"source": source}
    kinedex.run_pipeline(str(_written(folder, f"stages{count}", "killed", stages)), store)


def _old_format(folder: Path) -> None:
    """A store of format 3, with an index of the kinedex that wrote it."""
    unpacked(3, folder)


def _damaged(kinds: tuple[str, ...], folder: Path) -> None:
    """A store of which a part of each of these kinds has a flipped byte."""
    _staged(2, folder)
    for kind in kinds:
        path = sorted((folder / "store").glob(f"{kind}/*"))[-1]
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)


def _upgrade(folder: Path, store: Path) -> None:
    upgrade(store)


def _repair(folder: Path, store: Path) -> None:
    read_passes.MEGABYTE = BATCH_BYTES
    repair_store(store, Terminal())


def _decided(folder: Path) -> None:
    """A store with decisions about labels in its journal, one of them in a line that was never finished."""
    _no_index(folder)
    for number in range(2):
        decide(folder / "store", number)
    (journal,) = (folder / "store" / "labels" / "journal").iterdir()
    with journal.open("ab") as file:
        file.write(b'{"xxh3":"0123')


def decide(store: Path, number: int) -> None:
    """Record a label whose id is this number."""
    row = {"id": str(number), "take": "x_1", "class": "walk", "start": number, "stop": number + 5, "origin": "drawn"}
    record_labels(store, pa.Table.from_pylist([row]))


def _decide(folder: Path, store: Path) -> None:
    decide(store, 2)
    with StoreWriter.open(store, open_store(store, at="newest").feature_set) as writer:
        decide(store, 3)
        writer.commit()
        decide(store, 4)
        writer.commit()


def _build(folder: Path, store: Path) -> None:
    build_index(open_store(store, at="newest"))


def _collect(folder: Path, store: Path) -> None:
    collect_garbage(store, keep=1)


WORKS = {
    work.name: work
    for work in (
        Work("first ingest", _new, bring_in),
        Work("later ingest", _changed, bring_in),
        Work("compaction", _many_parts, bring_in),
        Work("first index", _no_index, _build),
        Work("later index", _old_index, _build),
        *(Work(stage, partial(_staged, number), partial(_stages, number + 1)) for number, stage in enumerate(STAGES)),
        Work("labels", _decided, _decide),
        Work("gc", _garbage, _collect),
        Work("upgrade", _old_format, _upgrade),
        Work("repair frames", partial(_damaged, ("frames", "index/gen-*")), _repair, damaged=True),
        Work("repair results", partial(_damaged, ("results/annotations", "results/templates")), _repair, damaged=True),
    )
}
"""All works by name."""
