"""`python -m studies.inertial_simulated DATA`: print how well simulated sensors find errors that are put into takes.

DATA is a folder with cmu and hdm05. Five takes of CMU, pieces of HDM05's takes and takes of a synthetic archive wear
five sensors; all of them stand for 3 s at both ends, the tracker has 40 Hz and smooth noise of 1.5°, and all limbs but
the torso are broken. It takes a minute.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from kinedex.ops.evaluation.metrics import pooled
from kinedex.ops.inertial.rotations import distance_deg
from kinedex.reports.markdown import grid
from studies.inertial_comparisons import SHARES, TAUS, bases, known_by_joints, quantities, robustness
from studies.inertial_judged import Judged, judge, judge_together
from studies.inertial_trials import Source, read_trials, sources, synthetic


def calibration_errors(judged: Sequence[Judged]) -> list[str]:
    """Return a row's figures: offsets in ms, and q_G and q_L off by degrees."""
    offsets = [1000 * abs(one.clock.offset_s - one.trial.worn.clock.offset_s) for one in judged]
    worlds, mounts = list[float](), list[float]()
    for one in judged:
        for fit in one.fits:
            if fit.fit is not None and not fit.left_out:
                worlds.append(float(distance_deg(fit.fit.q_global, one.trial.worn.q_global)))
                mounts.append(float(distance_deg(fit.fit.q_mount, one.trial.worn.mounts[fit.limb])))
    return [
        f"{max(offsets):.2f}",
        f"{np.median(worlds):.2f}, {max(worlds):.2f}",
        f"{np.median(mounts):.2f}, {np.percentile(mounts, 95):.2f}, {max(mounts):.2f}",
    ]


def detection(judged: Sequence[Judged], limbs: str) -> list[str]:
    """Return precision, recall and F (frames) at each τ."""
    counts = [pooled(some) for some in zip(*(one.counts(limbs, TAUS) for one in judged), strict=True)]
    return [f"{one.p1:.2f} / {one.r1:.2f} / {one.f1:.3f}" for one in counts]


def lines(archives: Mapping[str, Sequence[Source]]) -> Iterator[str]:
    """Yield the tables as Markdown."""
    calibrated, found = list[list[str]](), list[list[str]]()
    good = list[Judged]()
    for archive, takes in archives.items():
        for grade in ("good", "cheap") if takes else ():
            trials = list(read_trials(takes, grade))
            judged = [judge(trial) for trial in trials]
            good = judged if (archive, grade) == ("CMU", "good") else good
            rows = {f"{archive}, {grade}": judged}
            if takes[0].is_divided:
                rows[f"{archive}, {grade}, pieces together"] = judge_together(trials)
            for name, some in rows.items():
                calibrated.append([name, str(len(some)), *calibration_errors(some)])
                found += [[f"{name}, {limbs}s", *detection(some, limbs)] for limbs in ("shank", "hand")]
    header = ["takes, sensors", "number", "offset, worst, ms", "q_G median, worst, °", "q_L median, 95 %, worst, °"]
    yield from grid(header, calibrated)
    at = [f"P / R / F (frames), τ = {tau:g}°" for tau in TAUS]
    yield from grid(["takes, sensors", *at], found)
    if good:
        yield from grid(["CMU, good, best threshold", "τ", "P", "R", "F (frames)"], quantities(good))
        joints = {one.motion.stem: known_by_joints(one.motion, one.skeleton) for one in archives["CMU"]}
        yield from grid(["CMU, good, shanks", *at], bases(good, joints))
        yield from grid(["q_L worst, °", *(f"{share:.0%} wrong" for share in SHARES)], robustness(good))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="folder with cmu and hdm05")
    archives = sources(parser.parse_args(arguments).data)
    with tempfile.TemporaryDirectory() as folder:
        for line in lines({**archives, "synthetic": synthetic(Path(folder) / "archive")}):
            sys.stdout.write(line + "\n")


if __name__ == "__main__":
    main()
