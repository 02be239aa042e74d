"""Read the ground truth that takes made from recordings are compared with: a take of the store, or a motion file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.arrays import F64
from kinedex.ops.body.resample import resample
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.digests import Reading, hash_of
from kinedex.storage.formats.motion.reader import ReadSettings
from kinedex.storage.formats.motion.reader_table import motion_endings, read_body
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store


class TruthParameters(BaseModel):
    """The parameters of the stages that compare takes of recordings with the truth."""

    model_config = ConfigDict(extra="forbid")

    truth: str | None = Field(
        None,
        description="a take, or a motion file, that all takes are compared with; that of the recording unless given",
    )


def every_take(store: Store) -> Reading:
    """Return a digest of all takes of a store, any of which can be the truth."""
    rows = store.take_rows.to_pylist()
    return Reading(hash_of(sorted((row["name"], row["checksum"], row["recipe"]) for row in rows)), "")


@dataclass(frozen=True, eq=False)
class Truth:
    """The true positions of joints over time.

    Attributes
    ----------
    name : str
        The name of the take or file.
    joints : float64 array (J, 3, T)
        Positions of joints in metres; NaN if unknown.
    rate_hz : float
        Frames per second.
    failures : tuple of (int, int)
        Half-open ranges of its frames in which the observations are known to fail.
    """

    name: str
    joints: F64
    rate_hz: float
    failures: tuple[tuple[int, int], ...] = ()


def take_places(store: Store, take: str, joints: tuple[str, ...]) -> F64:
    """Return joint positions (J, 3, T) of a take of the store in metres; NaN if unknown."""
    places = joint_positions(store.frames(take), store.feature_set.joints).astype(np.float64)
    at = {name: places[j] for j, name in enumerate(store.feature_set.joints)}
    nowhere = np.full(places.shape[1:], np.nan)
    return np.stack([at.get(name, nowhere) for name in joints])


def read_truth(store: Store, truth: str, folder: Path, joints: tuple[str, ...], rate_hz: float | None = None) -> Truth:
    """Return the truth of a recording.

    Parameters
    ----------
    store : Store
        The store.
    truth : str
        A take of the store, or a motion file of any format, with joints as positions or angles.
    folder : Path
        The folder that relative paths start from.
    joints : tuple of str
        The joints, in the order of the result; estimated ones count as unknown.
    rate_hz : float, optional
        Frames per second of a file that does not state them.

    Raises
    ------
    KinedexError
        `truth` is neither a take nor a motion file.
    """
    if truth in store.take_ids:
        return Truth(truth, take_places(store, truth, joints), store.rate_hz)
    file = folder / Path(truth).expanduser()
    if not file.is_file() or file.suffix.lower() not in motion_endings():
        raise KinedexError(
            f"truth '{truth}' is neither a take of the store nor a motion file ({file}); give one of them, or null"
        )
    body = read_body(file, None, load_mappings("auto", joints), joints, ReadSettings(rate_hz=rate_hz))
    known = np.array([joint not in body.estimated for joint in joints])
    return Truth(str(truth), np.where(known[:, None, None], body.positions, np.nan), body.rate_hz)


def at_rate(places: F64, source_rate_hz: float, rate_hz: float) -> F64:
    """Return positions (J, 3, T) resampled to another rate."""
    if source_rate_hz == rate_hz:
        return places
    turns = np.tile(np.array([[1.0], [0.0], [0.0], [0.0]]), places.shape[2])
    return resample(places, turns, source_rate_hz, rate_hz).positions
