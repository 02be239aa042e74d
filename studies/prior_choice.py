"""`python -m studies.prior_choice DATA`: choose the parameters of priors on takes of the archive's own actors.

Takes of bd, bk and dg are joined from their clips, two of each class and a medley, and filmed; the archive leaves the
filmed actor out. No take of the study of priors is looked at.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.priors.archive_poses import PriorMotion
from kinedex.ops.priors.stabilisation import Settings
from kinedex.ops.simulation.recording import Setup
from kinedex.reports.markdown import grid
from studies.camera_set import CHAIN, NEVER, Filmed, filmed
from studies.prior_archive import DELTA, Clip, motions_of, read_clips
from studies.ray_tracker import RayTracker
from studies.tracked_rows import stabilised, tracker_of

F64 = npt.NDArray[np.float64]

ACTORS, CLIPS_A_TAKE, MEDLEY, FADE_FRAMES, SEED = ("bd", "bk", "dg"), 2, 5, 10, 100
HEAD = ["", "Ø", "max", "in failures", "elsewhere", "takes worse by 1 mm", "most that a take got worse"]


@dataclass(frozen=True)
class Choice:
    """A set of parameters that is tried.

    Attributes
    ----------
    name : str
        What differs from the defaults.
    settings : Settings
        The settings of the rounds.
    delta : float
        δ of the templates.
    """

    name: str
    settings: Settings = field(default_factory=Settings)
    delta: float = DELTA


CHOICES = (
    Choice("defaults"),
    Choice("1 round", Settings(rounds=1)),
    Choice("3 rounds", Settings(rounds=3)),
    *(Choice(f"τ = {tau:.2f}", Settings(threshold=tau)) for tau in (0.09, 0.10, 0.11, 0.12, 0.16)),
    Choice("δ = 0.10", delta=0.10),
    Choice("no guard", Settings(guard=float("inf"))),
    Choice("guard 1.07", Settings(guard=1.07)),
    Choice("weight of archive poses halved", Settings(factors={"archive": 0.5})),
    Choice("weight of archive poses doubled", Settings(factors={"archive": 2.0})),
    Choice("no other hits tried", Settings(attempts=1)),
)


def joined(clips: Sequence[Clip]) -> F64:
    """Join clips to one take (T, J, 3): each is turned and moved onto the one before it, and cross-faded."""
    take = clips[0].joints
    for clip in clips[1:]:
        turn = _heading(take[-FADE_FRAMES]) - _heading(clip.joints[0])
        cosine, sine = np.cos(turn), np.sin(turn)
        turned = clip.joints @ np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]]).T
        move = take[-FADE_FRAMES, CHAIN.joint("root")] - turned[0, CHAIN.joint("root")]
        turned = turned + move * np.array([1.0, 0.0, 1.0])
        share = np.linspace(0.0, 1.0, FADE_FRAMES)[:, None, None]
        faded = (1.0 - share) * take[-FADE_FRAMES:] + share * turned[:FADE_FRAMES]
        take = np.concatenate([take[:-FADE_FRAMES], faded, turned[FADE_FRAMES:]])
    return take


def _heading(joints: F64) -> float:
    """Return the angle about Y of the line from right to left."""
    left, right = ([CHAIN.joint(side + part) for part in ("hip", "shoulder")] for side in "lr")
    across = (joints[left] - joints[right]).sum(axis=0)
    return float(np.arctan2(across[2], across[0]))


def recordings_of(clips: Sequence[Clip], seed: int = SEED, setup: Setup | None = None) -> list[Filmed]:
    """Film the takes of all actors; their names begin with the actor."""
    found = []
    for actor in ACTORS:
        own = [clip for clip in clips if clip.actor == actor and len(clip.joints) > FADE_FRAMES]
        labels = sorted({clip.label for clip in own})
        takes = {label: [clip for clip in own if clip.label == label][:CLIPS_A_TAKE] for label in labels}
        drawn = np.random.default_rng(1).permutation(labels)[:MEDLEY]
        takes["medley"] = [takes[label][0] for label in drawn]
        found += [filmed(f"{actor}_{name}", joined(parts), 30.0, seed, setup) for name, parts in takes.items()]
    return found


def actor_of(one: Filmed) -> str:
    """Return the actor of a recording."""
    return one.take.partition("_")[0]


def line(name: str, errors: Mapping[str, F64], without: Mapping[str, F64], recordings: Sequence[Filmed]) -> list[str]:
    """Return the row of a choice, from the errors of each recording's frames with and without priors."""
    every = np.concatenate([errors[one.name] for one in recordings])
    failing = np.concatenate([one.failing for one in recordings])
    changes = {one.name: float(errors[one.name].mean() - without[one.name].mean()) for one in recordings}
    worst = max(changes, key=lambda key: changes[key])
    figures = (every.mean(), every[failing].mean(), every[~failing].mean())
    cells = [f"{value:.2f}" for value in figures]
    cells.insert(1, f"{every.max():.0f}")
    worse = str(sum(change > 1.0 for change in changes.values()))
    return [name, *cells, worse, f"{changes[worst]:+.1f} ({worst.rpartition('_seed')[0]})"]


def tried(
    choice: Choice, recordings: Sequence[Filmed], trackers: Mapping[str, RayTracker],
    archives: Mapping[tuple[str, float], Sequence[PriorMotion]],
) -> dict[str, F64]:  # fmt: skip
    """Return the errors of all frames of each recording with a choice of parameters."""
    return {
        one.name: one.errors_mm(
            stabilised(trackers[one.name], archives[actor_of(one), choice.delta], choice.settings).track.positions
        )
        for one in recordings
    }


def main() -> None:
    """Print a row for every choice."""
    parser = argparse.ArgumentParser(prog="python -m studies.prior_choice", description=__doc__)
    parser.add_argument("data", type=Path, help="folder with hdm05/clips")
    parser.add_argument("--seed", type=int, default=SEED, help="seed of the cameras")
    options = parser.parse_args()
    begin = time.perf_counter()
    clips = read_clips(options.data / "hdm05" / "clips")
    recordings = recordings_of(clips, options.seed)
    trackers = {one.name: tracker_of(one) for one in recordings}
    without = {one.name: one.errors_mm(trackers[one.name].without.track.positions) for one in recordings}
    calm = recordings_of(clips, options.seed, Setup(failures=NEVER))
    floor = {one.name: one.errors_mm(tracker_of(one).without.track.positions) for one in calm}
    archives: dict[tuple[str, float], Sequence[PriorMotion]] = {}
    print(f"{len(recordings)} takes, {sum(len(one.truth) for one in recordings)} frames\n")
    print("\n".join(grid(HEAD, [line("no priors", without, without, recordings)])[:-1]), flush=True)
    print(grid(HEAD, [line("no priors, if the detector never failed", floor, without, recordings)])[2], flush=True)
    for choice in CHOICES:
        for actor in ACTORS:
            if (actor, choice.delta) not in archives:
                archives[actor, choice.delta] = motions_of(clips, choice.delta, (actor,))
        found = tried(choice, recordings, trackers, archives)
        print(grid(HEAD, [line(choice.name, found, without, recordings)])[2], flush=True)
    print(f"\n{(time.perf_counter() - begin) / 60:.1f} minutes")


if __name__ == "__main__":
    main()
