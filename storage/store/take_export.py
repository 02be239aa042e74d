"""Export of takes: joint positions as CSV or Parquet, and a BVH of the named joints."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.storage.disk import whole_file
from kinedex.storage.formats.motion.bvh_writer import write_chain_bvh
from kinedex.storage.formats.motion.joint_motion import JointMotion
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.snapshot.snapshot import Snapshot


def export_take(store: Snapshot, take: str, form: str, path: Path) -> None:
    """Write a take's joint positions (metres, Y up, analysis rate) to a file, whole or not at all.

    Parameters
    ----------
    store : Snapshot
        The store that has the take.
    take : str
        The take's name.
    form : str
        "csv" (frame, then x, y, z of each joint), "parquet" (the rows of `frames`), or "bvh".
    path : Path
        The file to write; an existing one is replaced.

    Raises
    ------
    KinedexError
        There is no such take or form, a BVH is asked for of a take that lacks joints, or the file cannot be written.
    """
    writers: dict[str, Callable[[Snapshot, str, Path], None]] = {
        "csv": _write_csv, "parquet": _write_parquet, "bvh": _write_bvh,
    }  # fmt: skip
    if form not in writers:
        raise KinedexError(f"no export format '{form}'{did_you_mean(form, writers)}")
    store.take_id(take)
    try:
        with whole_file(path) as temporary:
            writers[form](store, take, temporary)
    except OSError as fault:
        raise KinedexError(f"{path}: cannot be written: {fault.strerror}") from None


def _write_parquet(store: Snapshot, take: str, path: Path) -> None:
    pq.write_table(store.frames(take), path)


def _write_csv(store: Snapshot, take: str, path: Path) -> None:
    rows = store.frames(take)
    columns = {"frame": rows.column("frame")}
    for joint, track in zip(store.feature_set.joints, _positions(store, rows), strict=True):
        columns |= {f"{joint}_{axis}": pa.array(values) for axis, values in zip("xyz", track, strict=True)}
    pa_csv.write_csv(pa.table(columns), path)


def _positions(store: Snapshot, rows: pa.Table) -> npt.NDArray[np.float32]:
    return joint_positions(rows, store.feature_set.joints)


def _write_bvh(store: Snapshot, take: str, path: Path) -> None:
    places = _positions(store, store.frames(take)).transpose(2, 0, 1)
    write_chain_bvh(path, JointMotion(take, tuple(store.feature_set.joints), places, store.rate_hz))
