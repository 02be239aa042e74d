"""The page about takes made from depth: moving figures, votes, costs, remarks and errors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.catalog.depth_recordings import load_depth_recordings
from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted
from kinedex.pipelines.reconstruction.reconstruction_errors import truth_places
from kinedex.pipelines.reconstruction.recording_tracks import REMARKS
from kinedex.pipelines.recordings.runs import earlier_rows
from kinedex.reports.motions import Motion, embed, pack, script_json
from kinedex.reports.page_environment import page_environment
from kinedex.reports.person_points import MOST_BYTES, packed_points
from kinedex.reports.reconstruction_jumps import Jumps, jumps_of
from kinedex.storage.formats.depth.recording import recording_truth
from kinedex.storage.store.store import Store

F64 = npt.NDArray[np.float64]

BINS = 240
"""Number of columns of a strip of costs."""

MOST_COST_M = 0.15
"""The cost, in metres, at the top of a strip."""

LENDERS = 8
"""Maximum number of archive takes in the table of takes that provide poses."""

VOTES = "archive lent the pose"
"""The lane of frames whose pose is that of the database."""


@dataclass(frozen=True)
class StripInterval:
    """Consecutive frames of a take that share a property, such as a remark.

    Attributes
    ----------
    start, stop : int
        Analysis frames of the take.
    left, width : float
        Place in the strip, in percent.
    text : str
        The text of its tooltip.
    """

    start: int
    stop: int
    left: float
    width: float
    text: str


@dataclass(frozen=True)
class ReconstructedOnPage:
    """A reconstructed take on the page.

    Attributes
    ----------
    take : str
        Its name.
    row : dict
        Its row of `reconstructions`.
    frames, seconds : int, float
        Its length in analysis frames and in time.
    lent : float
        Share of the frames with a pose of the database.
    bins : tuple of float
        Costs of the poses in strips, as a fraction of `MOST_COST_M`.
    lanes : dict of str to tuple of StripInterval
        Name of a lane → its intervals of frames.
    lenders : tuple of (str, int)
        Takes of the archive with the number of frames whose pose is from them.
    errors : dict or None
        The row of `reconstruction_errors` of the take.
    joints : tuple of dict
        Its rows of joints or markers, the worst first.
    jumps : Jumps
        The frames whose pose is from the pose database.
    near : int
        Index of the motion of its ground truth in `Motions.near`; −1 if none can be shown.
    """

    take: str
    row: Mapping[str, Any]
    frames: int
    seconds: float
    lent: float
    bins: tuple[float, ...]
    lanes: Mapping[str, tuple[StripInterval, ...]]
    lenders: tuple[tuple[str, int], ...]
    errors: Mapping[str, Any] | None
    joints: tuple[Mapping[str, Any], ...]
    jumps: Jumps
    near: int


def reconstruction_page(store: Store, stage: str, evaluation: str | None, title: str, most: int) -> str:
    """Return the HTML of the page.

    Parameters
    ----------
    store : Store
        The store.
    stage : str
        The stage that has reconstructed, "<pipeline>/<stage>".
    evaluation : str, optional
        The stage that has compared its takes with the truth.
    title : str
        The title.
    most : int
        Most takes that are shown: those farthest from the truth, or with the largest costs.
    """
    live = set(store.manifest.live_takes)
    rows = {str(row["take"]): row for row in earlier_rows(store, "reconstructions", stage) if row["take_id"] in live}
    errors = earlier_rows(store, "reconstruction_errors", evaluation) if evaluation else []
    frames = {take: _frames_of(store, stage, take) for take in rows}
    worst = {take: _mean_error(errors, take) or 0.0 for take in rows}
    order = sorted(rows, key=lambda take: (-worst[take], -float(np.nanmean(_costs(frames[take]))), take))[:most]
    motions = embed(store, order, "all")
    truths = _truths(store, [rows[take] for take in order], errors, motions.joints)
    motions, jumps = motions.beside(list(truths.values())), jumps_of(store, stage, [rows[take] for take in order])
    near = {take: number for number, take in enumerate(truths)}
    shown = [
        _shown(store, rows[take], frames[take], errors, jumps.get(take, Jumps()), near.get(take, -1)) for take in order
    ]
    clouds = _clouds(store, [rows[take] for take in order])
    whole = next((row for row in errors if row["scope"] == "all" and row["frames"]), None)
    return (
        page_environment({"counted": counted})
        .get_template("reconstruction.html.j2")
        .render(
            title=title, takes=shown, total=len(rows), motions=motions, scripts=True, whole=whole, votes=VOTES,
            motions_json=script_json({**asdict(motions), "clouds": clouds}), most_cm=100 * MOST_COST_M,
        )
    )  # fmt: skip


def _truths(
    store: Store, rows: Sequence[Mapping[str, Any]], errors: Sequence[Mapping[str, Any]], joints: tuple[str, ...]
) -> dict[str, Motion]:
    """Return the ground truth of each take as a motion, for takes whose truth still exists and has joints."""
    judged = {row["take"] for row in errors if row["scope"] == "take"}
    found: dict[str, Motion] = {}
    for row in (row for row in rows if row["take"] in judged and row["file"] and Path(row["file"]).is_file()):
        name = str(row["recording"])
        try:
            file = load_depth_recordings(row["file"])
            truth = recording_truth(file, name)
            if truth is None or file.entry(name).markers:
                continue
            known = truth_places(store, file, name, str(truth), store.rate_hz, joints)
        except KinedexError:
            continue  # it has changed since takes were compared with it
        positions = known.joints[:, :, : store.take_frames[row["take_id"]]]
        found[str(row["take"])] = pack(Path(known.name).name, positions, store.rate_hz)
    return found


def _clouds(store: Store, rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the packed points of the first takes that fit into the page."""
    found: list[dict[str, Any]] = []
    room = MOST_BYTES
    for row in rows:
        cloud = packed_points(row, store.take_frames[row["take_id"]], store.rate_hz)
        if cloud is not None:
            room -= len(cloud["data"])
            if room < 0:
                break
            found.append(cloud)
    return found


def _frames_of(store: Store, stage: str, take: str) -> list[dict[str, Any]]:
    """Return the rows of `reconstruction_frames` of a take, in order of time."""
    names = ["source_frame", "hypothesis", "cost_local", "cost_database", "archive_take", "archive_frame", "remarks"]
    found = store.rows_of("reconstruction_frames", stage, "take", [take]).select(names)
    return list(found.sort_by("source_frame").to_pylist())


def _costs(frames: Sequence[Mapping[str, Any]]) -> F64:
    """Return the cost of the pose of each frame; NaN without a person."""
    return np.array([np.nan if one["hypothesis"] is None else one[f"cost_{one['hypothesis']}"] for one in frames])


def _mean_error(errors: Sequence[Mapping[str, Any]], take: str) -> float | None:
    return next((row["mean_m"] for row in errors if row["take"] == take and row["scope"] == "take"), None)


def _shown(
    store: Store,
    row: Mapping[str, Any],
    frames: Sequence[Mapping[str, Any]],
    errors: Sequence[Mapping[str, Any]],
    jumps: Jumps,
    near: int,
) -> ReconstructedOnPage:
    take, total = str(row["take"]), store.take_frames[row["take_id"]]
    costs = np.nan_to_num(_costs(frames)) / MOST_COST_M
    bins = tuple(min(1.0, float(part.mean())) for part in np.array_split(costs, min(BINS, len(costs))))
    lent = [one["hypothesis"] == "database" for one in frames]
    lanes = {VOTES: _intervals(lent, [_lender(one) for one in frames], row, total, store.rate_hz)}
    for name in REMARKS:
        held = [name in one["remarks"] for one in frames]
        if any(held):
            lanes[name] = _intervals(held, [name] * len(frames), row, total, store.rate_hz)
    lenders = Counter(str(one["archive_take"]) for one, is_lent in zip(frames, lent, strict=True) if is_lent)
    own = [one for one in errors if one["take"] == take and one["frames"]]
    joints = sorted((one for one in own if one["scope"] == "joint"), key=lambda one: -float(one["mean_m"]))
    return ReconstructedOnPage(
        take, row, total, len(frames) / row["rate_hz"], float(np.mean(lent)), bins, lanes,
        tuple(sorted(lenders.items(), key=lambda one: (-one[1], one[0]))[:LENDERS]),
        next((one for one in own if one["scope"] == "take"), None), tuple(joints), jumps, near,
    )  # fmt: skip


def _lender(frame: Mapping[str, Any]) -> str:
    if frame["hypothesis"] != "database":
        return ""
    local = frame["cost_local"]
    instead = "" if local is None else f" instead of {100 * local:.1f}"
    return f"{frame['archive_take']}, frame {frame['archive_frame']}: {100 * frame['cost_database']:.1f}{instead} cm"


def _intervals(
    held: Sequence[bool], texts: Sequence[str], row: Mapping[str, Any], total: int, rate_hz: float
) -> tuple[StripInterval, ...]:
    """Return the runs of frames in which `held` is true, with the text of their first frame."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], np.asarray(held, np.bool_), [False]]).astype(np.int8)))
    found = []
    for first, last in edges.reshape(-1, 2).tolist():
        start = min(round(first * rate_hz / row["rate_hz"]), total - 1)
        stop = max(start + 1, min(round(last * rate_hz / row["rate_hz"]), total))
        frames = f"frame {first}" if last == first + 1 else f"frames {first} to {last - 1}"
        found.append(
            StripInterval(
                start, stop, 100 * first / len(held), 100 * (last - first) / len(held), f"{frames}: {texts[first]}"
            )
        )
    return tuple(found)
