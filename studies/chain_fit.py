"""`python -m studies.chain_fit FILE …`: measure how well the kinematic chain fits the joints of takes, and how fast."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import kinedex
from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.body.kinematic_chain import forward
from kinedex.ops.body.pose_fit import fit_poses, measured_body, start_poses
from kinedex.reports.markdown import grid

HEAD = ["take", "frames", "mean (mm)", "largest (mm)", "joint", "start, mean (mm)", "ms a frame"]


def fitted(source: Path) -> list[str]:
    """Return the row of a take: distances of the fitted joints, of those of the start, and the time."""
    chain, take = load_kinematic_chain(), kinedex.read(source)
    order = [take.joints.index(joint) for joint in chain.joints]
    positions = np.ascontiguousarray(take.positions[:, order].transpose(1, 2, 0), np.float64)
    body = measured_body(chain, positions)
    fit_poses(body, positions[:, :, :2])  # compiles
    begin = time.perf_counter()
    poses = fit_poses(body, positions)
    took = (time.perf_counter() - begin) / len(take) * 1000
    apart, before = (
        np.sqrt(((forward(body, one)[0] - positions) ** 2).sum(axis=1)) * 1000
        for one in (poses, start_poses(body, positions))
    )
    worst = chain.joints[int(np.argmax(apart.max(axis=1)))]
    figures = (f"{apart.mean():.2f}", f"{apart.max():.1f}", worst, f"{before.mean():.1f}", f"{took:.2f}")
    return [take.name, str(len(take)), *figures]


def main() -> None:
    """Print a row for every take."""
    parser = argparse.ArgumentParser(prog="python -m studies.chain_fit", description=__doc__)
    parser.add_argument("files", type=Path, nargs="+", help="motion files of whole bodies")
    print("\n".join(grid(HEAD, [fitted(file) for file in parser.parse_args().files])))


if __name__ == "__main__":
    main()
