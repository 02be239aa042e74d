"""Write joint positions as tables: CSV and Parquet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from kinedex.ops.words import NO_WORD
from kinedex.storage.formats.motion.joint_motion import JointMotion


def write_csv(path: Path, motion: JointMotion) -> None:
    """Write a CSV file: `frame`, `time` in seconds, then `<joint>_x`, `<joint>_y`, `<joint>_z` of every joint.

    Parameters
    ----------
    path : Path
        The file to write.
    motion : JointMotion
        The motion; unknown positions are written as nan.
    """
    frames = len(motion.places)
    columns = {
        "frame": pa.array(np.arange(frames, dtype=np.int32)),
        "time": pa.array(np.arange(frames) / motion.rate_hz),
    }
    for j, joint in enumerate(motion.joints):
        columns |= {f"{joint}_{axis}": pa.array(motion.places[:, j, k]) for k, axis in enumerate("xyz")}
    pa_csv.write_csv(pa.table(columns), path)


def write_parquet(path: Path, motion: JointMotion) -> None:
    """Write a Parquet file with the columns of the view `frames`: a STRUCT(x, y, z) for every joint, and the word.

    The rate is in the file's metadata as `kinedex.rate_hz`. The word of an invalid frame is null.

    Parameters
    ----------
    path : Path
        The file to write.
    motion : JointMotion
        The motion.
    """
    columns: dict[str, pa.Array] = {"frame": pa.array(np.arange(len(motion.places), dtype=np.int32))}
    for j, joint in enumerate(motion.joints):
        columns[joint] = pa.StructArray.from_arrays([pa.array(motion.places[:, j, k]) for k in range(3)], list("xyz"))
    if motion.orientation is not None:
        turns = [pa.array(motion.orientation[:, k]) for k in range(4)]
        columns["root_orientation"] = pa.StructArray.from_arrays(turns, list("wxyz"))
    if motion.words is not None:
        columns["word"] = pa.array(motion.words, mask=motion.words == NO_WORD)
    metadata = {"kinedex.rate_hz": repr(float(motion.rate_hz)), "kinedex.unit": "m", "kinedex.up": "y"}
    pq.write_table(pa.table(columns).replace_schema_metadata(metadata), path)
