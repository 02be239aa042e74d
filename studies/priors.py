"""`python -m studies.priors DATA`: print the errors of tracks with and without priors, beside filters of points.

DATA is a folder with cameras/simulated (recordings with their truth) and hdm05/clips (the archive: bd, bk, dg). The
study takes one core. Silhouettes, beside the thesis's Table 6.1, are the subject of `studies.silhouettes`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.body.kinematic_chain import ChainBody
from kinedex.ops.body.pose_fit import measured_body
from kinedex.ops.priors.archive_poses import PriorMotion
from kinedex.ops.simulation.recording import LONG, Setup
from kinedex.ops.tracking.body_estimate import mean_body
from kinedex.reports.markdown import grid
from studies.camera_set import (
    CHAIN,
    LONG_TAKES,
    NEVER,
    OTHERS,
    Filmed,
    filmed,
    read_set,
    read_truth,
    without_failures,
)
from studies.prior_archive import Clip, motions_of, read_clips
from studies.tracked_rows import (
    FILTERS,
    POINT_FIT,
    TRIANGULATION,
    WITHOUT,
    Tracked,
    body_rows,
    estimated_body,
    point_rows,
    round_name,
    tracker_of,
)

F64 = npt.NDArray[np.float64]
Rows = dict[str, dict[str, Tracked]]
"""Method → recording → its track."""

LONG_SEED, UNSEEN_SEED = 1, 31
WITH = round_name(2)
FLOOR = "without priors, if the detector never failed"
PROTOTYPE = {
    TRIANGULATION: "52.1, 81.6, 30.0", "+ Butterworth 6 Hz": "49.3, 76.9, 28.7",
    "+ Savitzky–Golay, 11 frames": "48.6, 74.9, 29.0", "+ one-euro (1 Hz, 0.7)": "68.5, 93.6, 49.8",
    "+ Kalman and RTS": "48.6, 75.8, 28.3", "whole-take chain, no priors": "30.7, 42.5, 21.8",
    WITHOUT: "29.2, 39.2, 21.8", round_name(1): "26.0, 31.6, 21.7", WITH: "25.6, 31.0, 21.6",
}  # fmt: skip
"""The figures of the design's prototype on the same recordings: mean, in failures, elsewhere."""
HEAD = ["", "Ø", "σ", "max", "in failures", "elsewhere", "no class: Ø", "in failures", "ms a frame", "prototype"]


def rows_of(recordings: Sequence[Filmed], unfailing: Sequence[Filmed], motions: Sequence[PriorMotion]) -> Rows:
    """Return the tracks of all methods, and those of the same recordings without failures."""
    found: Rows = {}
    for one, calm in zip(recordings, unfailing, strict=True):
        tracks = point_rows(one) | body_rows(one, tracker_of(one), motions, (1, 2))
        for name, track in (tracks | {FLOOR: body_rows(calm, tracker_of(calm), motions, ())[WITHOUT]}).items():
            found.setdefault(name, {})[one.name] = track
    return found


def pooled(tracks: Mapping[str, Tracked], recordings: Sequence[Filmed], failing: bool | None = None) -> F64:
    """Return the errors of all frames, of those in failures, or of those elsewhere."""
    parts = [
        tracks[one.name].errors_mm[slice(None) if failing is None else one.failing == failing] for one in recordings
    ]
    return np.concatenate(parts) if parts else np.zeros(0)


def mean(tracks: Mapping[str, Tracked], recordings: Sequence[Filmed], failing: bool | None = None) -> float:
    """Return the mean error; NaN without frames."""
    errors = pooled(tracks, recordings, failing)
    return float(errors.mean()) if len(errors) else float("nan")


def table(rows: Rows, recordings: Sequence[Filmed], prototype: Mapping[str, str]) -> list[str]:
    """Return the table of methods; σ and max are those of the means of frames."""
    strange = [one for one in recordings if one.take in OTHERS]
    frames = sum(len(one.truth) for one in recordings)
    lines = []
    for name, tracks in rows.items():
        every = pooled(tracks, recordings)
        spent = 1000.0 * sum(track.seconds for track in tracks.values()) / frames
        figures = [every.mean(), every.std(), mean(tracks, recordings, True), mean(tracks, recordings, False)]
        figures += [mean(tracks, strange), mean(tracks, strange, True)]
        cells = [f"{value:.1f}" for value in figures]
        cells.insert(2, f"{every.max():.0f}")
        lines.append([name, *cells, f"{spent:.1f}", prototype.get(name, "")])
    return grid(HEAD, lines)


def aims(rows: Rows, recordings: Sequence[Filmed], with_name: str = WITH) -> list[str]:
    """Return how the track with priors stands against the aims."""
    ours, theirs = rows[with_name], rows[WITHOUT]
    strange = [one for one in recordings if one.take in OTHERS]
    filters = [name for name in (TRIANGULATION, *FILTERS) if name in rows]
    best = min((mean(rows[name], recordings, True) for name in filters), default=float("nan"))
    points = mean(rows[POINT_FIT], recordings, True) if POINT_FIT in rows else float("nan")
    changes = {one.name: mean(ours, [one]) - mean(theirs, [one]) for one in recordings}
    worst = max(changes, key=lambda name: changes[name])
    inside, before = mean(ours, recordings, True), mean(theirs, recordings, True)
    floor = mean(rows[FLOOR], recordings, True)
    lines = [
        ["of what failures add to the error, removed by priors", f"{(before - inside) / (before - floor):.0%}", ""],
        ["in failures, by no priors", f"{inside / before:.2f}", f"≤ 0.75 (without failures {floor / before:.2f})"],
        [
            "in failures, by no restart",
            f"{inside / mean(rows['whole-take chain, no priors'], recordings, True):.2f}",
            "",
        ],
        ["in failures, by the best filter", f"{inside / best:.2f}", "≤ 0.42"],
        ["in failures, by the fit of points", f"{inside / points:.2f}", ""],
        ["elsewhere, by no priors", _ratio(ours, theirs, recordings, False), "≤ 1.00 (1 %)"],
        ["takes of no class, by no priors", _ratio(ours, theirs, strange, None), "≤ 1.00 (1 %)"],
        ["most that a take got worse", f"{changes[worst]:+.1f} mm ({worst})", "≤ 2 mm"],
        ["worst frame", f"{pooled(ours, recordings).max():.0f} mm", f"≤ {pooled(theirs, recordings).max():.0f} mm"],
    ]
    return grid(["", "reached", "aim"], lines)


def _ratio(
    ours: Mapping[str, Tracked], theirs: Mapping[str, Tracked], recordings: Sequence[Filmed], failing: bool | None
) -> str:
    below = mean(theirs, recordings, failing) if recordings else float("nan")
    return f"{mean(ours, recordings, failing) / below:.3f}" if recordings else "–"


def per_take(rows: Rows, recordings: Sequence[Filmed]) -> list[str]:
    """Return the errors of every take without and with priors, over its recordings."""
    lines = []
    for take in dict.fromkeys(one.take for one in recordings):
        mine = [one for one in recordings if one.take == take]
        cells = [f"{mean(rows[name], mine):.1f}, {mean(rows[name], mine, True):.1f}" for name in (WITHOUT, WITH)]
        worst = [f"{pooled(rows[name], mine).max():.0f}" for name in (WITHOUT, WITH)]
        lines.append([take, str(len(mine[0].truth)), *cells, *worst])
    return grid(["take", "frames", "no priors: Ø, in failures", "with priors", "worst frame", "with priors"], lines)


def estimated(recordings: Sequence[Filmed], motions: Sequence[PriorMotion], archive_mean: ChainBody) -> Rows:
    """Return the tracks with bone lengths that are estimated from each recording."""
    found: Rows = {}
    for one in recordings:
        tracker = tracker_of(one, estimated_body(one, archive_mean))
        for name, track in body_rows(one, tracker, motions, (2,)).items():
            found.setdefault(f"{name}, lengths estimated", {})[one.name] = track
    return found


def archive_body(clips: Sequence[Clip]) -> ChainBody:
    """Return the mean body of the actors of an archive."""
    actors = sorted({clip.actor for clip in clips})
    joints = [np.concatenate([clip.joints for clip in clips if clip.actor == actor]) for actor in actors]
    return mean_body(CHAIN, [measured_body(CHAIN, np.ascontiguousarray(one.transpose(1, 2, 0))) for one in joints])


def section(title: str, lines: Sequence[str]) -> None:
    """Print a part of the study."""
    print(f"{title}\n\n" + "\n".join(lines), flush=True)


def compared(
    title: str, recordings: Sequence[Filmed], unfailing: Sequence[Filmed], motions: Sequence[PriorMotion],
    prototype: Mapping[str, str],
) -> Rows:  # fmt: skip
    """Print the tables of a set of recordings; return its tracks."""
    rows = rows_of(recordings, unfailing, motions)
    section(title, table(rows, recordings, prototype))
    section(f"{title}: aims", aims(rows, recordings))
    section(f"{title}: takes", per_take(rows, recordings))
    return rows


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(prog="python -m studies.priors", description=__doc__)
    parser.add_argument("data", type=Path, help="folder with cameras/simulated and hdm05/clips")
    parser.add_argument("--unseen", type=int, default=UNSEEN_SEED, help="seed of the recordings that nobody looked at")
    options = parser.parse_args()
    begin = time.perf_counter()
    clips = read_clips(options.data / "hdm05" / "clips")
    motions, given = motions_of(clips), read_set(options.data / "cameras" / "simulated")
    truth = read_truth(options.data / "cameras" / "simulated" / "truth.parquet")
    body_rows(given[0], tracker_of(given[0]), motions, (1,))  # compiles
    never = Setup(failures=NEVER)
    rows = compared("The set, seeds 1 and 2", given, [without_failures(one) for one in given], motions, PROTOTYPE)
    lengths = estimated(given, motions, archive_body(clips))
    section("Bone lengths estimated", table({WITHOUT: rows[WITHOUT], WITH: rows[WITH]} | lengths, given, {}))
    long = [filmed(take, truth[take], 30.0, LONG_SEED, Setup(failures=LONG)) for take in LONG_TAKES]
    calm = [filmed(take, truth[take], 30.0, LONG_SEED, never) for take in LONG_TAKES]
    compared(f"Long failures, seed {LONG_SEED}", long, calm, motions, {})
    unseen = [filmed(take, joints, 30.0, options.unseen) for take, joints in truth.items()]
    calm = [filmed(take, joints, 30.0, options.unseen, never) for take, joints in truth.items()]
    compared(f"Seed {options.unseen}, which no choice was made on", unseen, calm, motions, {})
    print(f"{(time.perf_counter() - begin) / 60:.1f} minutes")


if __name__ == "__main__":
    main()
