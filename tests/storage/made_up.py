"""Takes made up for tests and benchmarks: seeded random words and positions, or given words; no motion."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa

from kinedex.catalog.features import FeatureSet, load_feature_set
from kinedex.ops.words import TakeWords
from kinedex.storage.snapshot.manifest import Part
from kinedex.storage.snapshot.parts import FramesWriter
from kinedex.storage.snapshot.schemas import takes_schema
from kinedex.storage.store.writer import StoreWriter

BODY = load_feature_set("body40")


def arrays(name: str, frames: int, edition: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, orientation and words of a made-up take; the name and edition are the seed."""
    rng = np.random.default_rng([edition, frames, *name.encode()])
    positions = rng.normal(size=(len(BODY.joints), 3, frames))
    orientation = rng.normal(size=(4, frames))
    changes = rng.integers(0, 2**40, size=frames // 4 + 1, dtype=np.uint64)
    words = np.repeat(changes & rng.integers(0, 2**40, size=len(changes), dtype=np.uint64), 4)[:frames]
    return positions, orientation, words


def take_row(take_id: int, name: str, frames: int, **columns: object) -> dict[str, object]:
    """One row of takes with everything filled in."""
    return {
        "take_id": take_id,
        "name": name,
        "source": f"{name[:2]}/{name}.amc",
        "source_root": "/archive",
        "checksum": "00" * 32,
        "source_bytes": 1000,
        "source_mtime_ns": 1,
        "format": "amc",
        "skeleton": "acclaim",
        "skeleton_source": "bd.asf",
        "unit": "0.45 inch",
        "source_rate_hz": 120.0,
        "source_frames": frames * 4,
        "rate_hz": 30.0,
        "frames": frames,
        "seconds": frames / 30.0,
        "invalid_frames": 0,
        "actor": name[:2],
        "class": None,
        "clip": None,
        "groups": json.dumps({"session": "1"}),
        "warnings": [],
    } | columns


def takes_table(rows: list[dict[str, object]]) -> pa.Table:
    return pa.Table.from_pylist(rows, schema=takes_schema())


def write_frames(store: Path, takes: dict[str, tuple[int, int]], edition: int = 0) -> Part:
    """Write a frames part as a worker does; takes are name → (take_id, frames)."""
    with FramesWriter(store, BODY) as writer:
        for name, (take_id, frames) in sorted(takes.items(), key=lambda item: item[1]):
            writer.add(take_id, *arrays(name, frames, edition))
        return writer.close()


def add(writer: StoreWriter, takes: dict[str, int], edition: int = 0, **columns: object) -> dict[str, int]:
    """Add made-up takes, name → number of frames, without a commit."""
    ids = writer.assign_take_ids(takes)
    part = write_frames(writer.path, {name: (ids[name], frames) for name, frames in takes.items()}, edition)
    writer.add_takes(takes_table([take_row(ids[name], name, takes[name], **columns) for name in takes]), part)
    return ids


def make_store(path: Path, takes: dict[str, int]) -> Path:
    with StoreWriter.open(path, BODY) as writer:
        add(writer, takes)
        writer.commit()
    return path


def make_word_store(
    path: Path, feature_set: FeatureSet, words: TakeWords, name: str = "take", in_part: int = 2000
) -> Path:
    """Add takes that have these words and no positions to a store, which is made where there is none.

    Parameters
    ----------
    path : Path
        The store.
    feature_set : FeatureSet
        The meaning of the words.
    words : TakeWords
        The words; their take ids are not kept.
    name : str
        The takes are named after it, and numbered.
    in_part : int
        The number of takes in a part of frames.
    """
    names = [f"{name}_{i:06d}" for i in range(len(words))]
    with StoreWriter.open(path, feature_set) as writer:
        ids = writer.assign_take_ids(names)
        for first in range(0, len(words), in_part):
            rows = []
            with FramesWriter(path, feature_set) as part:
                for i in range(first, min(first + in_part, len(words))):
                    own = words.take(i)
                    nowhere = np.full((len(feature_set.joints), 3, len(own)), np.nan, np.float32)
                    part.add(ids[names[i]], nowhere, np.full((4, len(own)), np.nan, np.float32), own)
                    rows.append(take_row(ids[names[i]], names[i], len(own)))
                written = part.close()
            writer.add_takes(takes_table(rows), written)
        writer.commit()
    return path
