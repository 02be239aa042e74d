"""A store of many hours of motion in which some takes are known copies of others, made without motion files.

The motion is that of half an hour of synthetic takes. Every take of the store goes through one of them from a drawn
moment, at a pace that changes, with a body of another size, and with joints that wander by some centimetres: the words
are like those of the other takes, and the motion is not the same. Every eighth take has a copy, of each kind in turn.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.pipelines.ingestion.analysis import analyse
from kinedex.storage.formats.motion.points import root_orientation
from kinedex.storage.formats.motion.reader import Body
from kinedex.storage.snapshot.parts import FramesWriter, joint_positions
from kinedex.storage.store.store import Store
from kinedex.storage.store.writer import StoreWriter
from studies.planted_copies import planted

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]

SECONDS = (60.0, 240.0)
"""The shortest and the longest take."""
COPIED = 8
"""One take of so many has a copy."""
TAKES_A_PART = 100
PACES, SIZES, WANDERING_M = (0.75, 1.3), (0.88, 1.12), 0.04
PACE_S, WANDER_S = 4.0, 1.5  # seconds between two drawn paces, and between two drawn places of a joint


def make_store(path: Path, base: Store, hours: float, seed: int) -> dict[str, tuple[str, str]]:
    """Make a store, and return for each take that is a copy the name of the other take and the kind of copy.

    Parameters
    ----------
    path : Path
        The new store.
    base : Store
        A store of the motion that takes go through.
    hours : float
        The length of all takes together, copies included.
    seed : int
        Seed of all random numbers; the same arguments make the same motion.
    """
    joints = list(base.feature_set.joints)
    motions = [
        np.ascontiguousarray(joint_positions(table, joints).transpose(2, 0, 1))
        for _, table in base.frames_of(base.take_ids)
    ]
    random, copies, frames = np.random.default_rng(seed), dict[str, tuple[str, str]](), 0
    waiting: list[tuple[str, F32, float]] = []
    with StoreWriter.open(path, base.feature_set, base.rate_hz) as writer:
        number = 0
        while frames < hours * 3600 * base.rate_hz:
            name, positions = f"take{number:06}", _another(motions, base.rate_hz, random)
            waiting.append((name, positions, base.rate_hz))
            frames += len(positions)
            if number % COPIED == 0:
                every = list(planted(positions, base.rate_hz, random))
                kind, make = every[number // COPIED % len(every)]
                copy = make()
                copies[f"copy{number:06}"] = name, kind
                waiting.append((f"copy{number:06}", copy.positions, copy.rate_hz))
                frames += round(len(copy.positions) * base.rate_hz / copy.rate_hz)
            number += 1
            if len(waiting) >= TAKES_A_PART:
                _put(writer, waiting, base.feature_set, base.rate_hz)
                waiting = []
        _put(writer, waiting, base.feature_set, base.rate_hz)
        writer.commit()
    return copies


def _another(motions: list[F32], rate_hz: float, random: np.random.Generator) -> F32:
    """Return a take that goes through a drawn part of a motion in a way of its own."""
    motion = motions[random.integers(len(motions))]
    count = round(rate_hz * random.uniform(*SECONDS))
    paces = np.interp(np.arange(count), *_drawn(count, PACE_S * rate_hz, random, *PACES))
    moments = np.cumsum(paces) + random.uniform(0, len(motion))
    moments = np.abs((moments + len(motion)) % (2 * len(motion)) - len(motion)).clip(
        0, len(motion) - 1.001
    )  # to and fro
    before, share = moments.astype(np.int64), (moments % 1).astype(np.float32)[:, None, None]
    positions = motion[before] * (1 - share) + motion[before + 1] * share
    positions *= np.float32(random.uniform(*SIZES))
    knots, _ = _drawn(count, WANDER_S * rate_hz, random, 0, 1)
    wander = random.normal(0, WANDERING_M, (len(knots), *positions.shape[1:])).astype(np.float32)
    after = np.searchsorted(knots, np.arange(count), side="right").clip(1, len(knots) - 1)
    left, right = knots[after - 1], knots[after]
    part = ((np.arange(count) - left) / (right - left)).astype(np.float32)[:, None, None]
    part = part * part * (3 - 2 * part)
    moved: F32 = positions + wander[after - 1] * (1 - part) + wander[after] * part
    return moved


def _drawn(count: int, every: float, random: np.random.Generator, low: float, high: float) -> tuple[F64, F64]:
    """Return knots over some frames, and a drawn value at each."""
    knots = np.linspace(0, count, max(2, round(count / every) + 1))
    return knots, random.uniform(low, high, len(knots))


def _put(writer: StoreWriter, takes: list[tuple[str, F32, float]], feature_set: FeatureSet, rate_hz: float) -> None:
    """Add takes to a store, in a part of their own."""
    if not takes:
        return
    ids, joints, rows = writer.assign_take_ids([name for name, *_ in takes]), feature_set.joints, []
    with FramesWriter(writer.path, feature_set, rate_hz) as frames:
        for name, places, rate in sorted(takes, key=lambda one: ids[one[0]]):
            positions = np.ascontiguousarray(places.transpose(1, 2, 0), np.float64)
            valid = np.ones(len(places), np.bool_)
            orientation = root_orientation(positions, joints, valid, [])
            body = Body(positions, orientation, rate, "m", "smpl24", (), ())
            found = analyse(body, feature_set, rate_hz)
            frames.add(ids[name], *found)
            count = len(found[2])
            rows.append({
                "take_id": ids[name], "name": name, "source": name, "source_root": "", "checksum": name,
                "source_bytes": 0, "source_mtime_ns": 0, "format": "synthetic", "skeleton": body.skeleton, "unit": "m",
                "source_rate_hz": rate, "source_frames": len(places), "rate_hz": rate_hz, "frames": count,
                "seconds": count / rate_hz, "invalid_frames": 0, "warnings": [],
            })  # fmt: skip
        part = frames.close()
    writer.add_takes(pa.Table.from_pylist(rows, schema=writer.takes_schema), part)
