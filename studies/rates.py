"""`python -m studies.rates STORE`: measure how far words depend on the rate of the source.

The takes of a store are written as TRC at the analysis rate (30 Hz) and read again. The positions of joints are the
same; velocities and hysteresis were computed from all source frames before, and from every fourth of them (at 120 Hz)
now.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from kinedex.ops.words import NO_WORD
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.storage.formats.motion.joint_motion import JointMotion
from kinedex.storage.formats.motion.table_writer import write_trc
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store, open_store


def compare(store: Store, where: str, folder: Path) -> str:
    """Compare the words of takes at their own rate and at the analysis rate, in one line."""
    names = store.takes(where).sort("name")["name"].to_list()
    (folder / "trc").mkdir()
    joints = tuple(store.feature_set.joints)
    for name in names:
        positions = joint_positions(store.frames(name), joints).transpose(2, 0, 1)
        write_trc(folder / "trc" / f"{name}.trc", JointMotion(name, joints, positions, store.rate_hz))
    run_pipeline("ingest", folder / "store", assignments={"source": str(folder / "trc")})
    again = open_store(folder / "store")
    frames = same = bits = 0
    by_feature = np.zeros(len(store.feature_set.features), np.int64)
    for name in names:
        fine, coarse = (one.words([one.take_id(name)]).take(0) for one in (store, again))
        length = min(len(fine), len(coarse))
        valid = (fine[:length] != NO_WORD) & (coarse[:length] != NO_WORD)
        differ = (fine[:length] ^ coarse[:length])[valid]
        frames += len(differ)
        same += int(np.count_nonzero(differ == 0))
        bits += int(np.bitwise_count(differ).sum())
        by_feature += [int(np.count_nonzero(differ >> np.uint64(i) & np.uint64(1))) for i in range(len(by_feature))]
    worst = np.argsort(by_feature)[::-1][:5]
    worst_features = ", ".join(f"{store.feature_set.features[i].name} {by_feature[i] / frames:.1%}" for i in worst)
    return (
        f"{len(names)} takes, {frames:,} frames: {same / frames:.1%} of the words are the same, "
        f"{bits / frames / len(by_feature):.2%} of the bits differ; most often {worst_features}"
    )


def main() -> None:
    """Print the fraction of words that change with the rate."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("store", type=Path, help="a store of takes faster than 30 Hz")
    parser.add_argument("--where", default="class IS NULL", help="takes to compare: a SQL filter")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print(compare(open_store(given.store), given.where, Path(folder)))


if __name__ == "__main__":
    main()
