"""Render the page about takes made from depth: figures beside points, votes, costs, jumps, remarks and errors."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.compute as pc

from kinedex.catalog.depth_cameras import placement_of
from kinedex.catalog.depth_recordings import load_depth_recordings
from kinedex.ops.arrays import F64
from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted
from kinedex.pipelines.reconstruction.reconstructed_takes import explained_votes
from kinedex.pipelines.reconstruction.reconstruction_errors import true_positions
from kinedex.pipelines.reconstruction.recording_tracks import REMARKS, make_scene
from kinedex.pipelines.tracking.recording_runs import earlier_rows
from kinedex.reports.embedded_motions import PACKED_STEP, EmbeddedMotion, embed, pack, script_json
from kinedex.reports.page_environment import page_environment
from kinedex.storage.formats.depth.recording import read_recording, recording_truth
from kinedex.storage.store.store import Store

BINS = 240
"""Number of columns of a strip of costs."""

MAX_COST_M = 0.15
"""The cost, in metres, at the top of a strip."""

LENDERS = 8
"""Maximum number of archive takes in the table of takes that provide poses."""

VOTES = "pose from the archive"
"""The name of the lane with the frames whose pose is from the pose database."""


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
        The row of the take in `reconstructions`.
    frames, seconds : int, float
        The length of the take in analysis frames and in seconds.
    lent : float
        Share of the frames whose pose is from the pose database.
    bins : tuple of float
        Costs of the poses in the columns of the strip, as fractions of `MAX_COST_M`.
    lanes : dict of str to tuple of StripInterval
        Name of a lane → its intervals of frames.
    lenders : tuple of (str, int)
        Take of the archive, and the number of frames whose pose is from this take.
    errors : dict or None
        The row of `reconstruction_errors` of the take.
    joints : tuple of dict
        The rows of `reconstruction_errors` for joints or markers, the largest errors first.
    jumps : Jumps
        The frames whose pose is from the pose database.
    near : int
        Index of the motion of the ground truth in `EmbeddedMotions.near`; −1 if none can be shown.
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
        The stage that reconstructed the takes, "<pipeline>/<stage>".
    evaluation : str, optional
        The stage that compared these takes with the ground truth.
    title : str
        The title.
    most : int
        Largest number of takes that are shown: those farthest from the ground truth, or with the largest costs.
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
            motions_json=script_json({**asdict(motions), "clouds": clouds}), most_cm=100 * MAX_COST_M,
        )
    )  # fmt: skip


def _truths(
    store: Store, rows: Sequence[Mapping[str, Any]], errors: Sequence[Mapping[str, Any]], joints: tuple[str, ...]
) -> dict[str, EmbeddedMotion]:
    """Return the ground truth of each take as a motion, for takes whose ground truth still exists and has joints."""
    judged = {row["take"] for row in errors if row["scope"] == "take"}
    found: dict[str, EmbeddedMotion] = {}
    for row in (row for row in rows if row["take"] in judged and row["file"] and Path(row["file"]).is_file()):
        name = str(row["recording"])
        try:
            file = load_depth_recordings(row["file"])
            truth = recording_truth(file, name)
            if truth is None or file.entry(name).markers:
                continue
            known = true_positions(store, file, name, str(truth), store.rate_hz, joints)
        except KinedexError:
            continue  # the ground truth has changed since the comparison
        positions = known.joints[:, :, : store.take_frames[row["take_id"]]]
        found[str(row["take"])] = pack(Path(known.name).name, positions, store.rate_hz)
    return found


def _clouds(store: Store, rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the packed points of the person for the first takes whose points fit into the page."""
    found: list[dict[str, Any]] = []
    room = MAX_BYTES
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
    costs = np.nan_to_num(_costs(frames)) / MAX_COST_M
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


MAX_JUMPS = 30
"""Maximum number of jumps of a take in its table; if there are more, those that reduced the cost most are shown."""

MARGIN_S = 0.5
"""Seconds that are played before and after a jump."""


@dataclass(frozen=True)
class Jump:
    """A frame whose pose is from the pose database.

    Attributes
    ----------
    source_frame : int
        Frame of the recording, from 0.
    seconds : float
        Its time.
    direction : str
        Direction of time in which the pose was found.
    archive_take, archive_frame : str, int
        The take and the frame of the archive from which the pose is taken.
    candidate : int
        The number of the pose among the candidates of the frame, from 1.
    lookup_cost, trial_cost, cost : float or None
        The cost of the pose in the lookup, after a short fit, and in the vote.
    followed_cost : float or None
        The cost, in the vote, of the pose that was tracked from the previous frame; None if there is none.
    start, stop : int
        The analysis frames that are played around the jump.
    """

    source_frame: int
    seconds: float
    direction: str
    archive_take: str
    archive_frame: int
    candidate: int
    lookup_cost: float | None
    trial_cost: float | None
    cost: float
    followed_cost: float | None
    start: int
    stop: int


@dataclass(frozen=True)
class Jumps:
    """The jumps of a take.

    Attributes
    ----------
    shown : tuple of Jump
        The jumps in the table, in order of time.
    total : int
        The number of all jumps.
    """

    shown: tuple[Jump, ...] = ()
    total: int = 0


def jumps_of(store: Store, stage: str, rows: Sequence[Mapping[str, Any]]) -> dict[str, Jumps]:
    """Return a dict from name of a take to the jumps of the take.

    Parameters
    ----------
    store : Store
        The store.
    stage : str
        The stage that reconstructed the takes, "<pipeline>/<stage>".
    rows : sequence of dict
        The rows of `reconstructions` of the takes.
    """
    votes = explained_votes(store, stage, [str(row["take"]) for row in rows])
    lent = votes.filter(pc.and_(votes.column("winner"), pc.equal(votes.column("hypothesis"), "database")))
    local = votes.filter(pc.equal(votes.column("hypothesis"), "local")).select(
        ["take", "source_frame", "direction", "cost"]
    )
    followed = {
        (take, frame, way): cost
        for take, frame, way, cost in zip(*(column.to_pylist() for column in local.columns), strict=True)
    }
    found: dict[str, list[Jump]] = defaultdict(list)
    of_take = {str(row["take"]): row for row in rows}
    for one in lent.to_pylist():
        row = of_take[one["take"]]
        before = followed.get((one["take"], one["source_frame"], one["direction"]))
        found[one["take"]].append(_jump(one, before, row["rate_hz"], store.take_frames[row["take_id"]], store.rate_hz))
    return {take: _most_telling(jumps) for take, jumps in found.items()}


def _jump(vote: Mapping[str, Any], followed: float | None, source_hz: float, total: int, rate_hz: float) -> Jump:
    seconds = vote["source_frame"] / source_hz
    return Jump(
        vote["source_frame"], seconds, vote["direction"], vote["archive_take"], vote["archive_frame"],
        vote["candidate"], vote["lookup_cost"], vote["trial_cost"], vote["cost"], followed,
        max(0, min(round((seconds - MARGIN_S) * rate_hz), total - 1)),
        max(1, min(round((seconds + MARGIN_S) * rate_hz), total)),
    )  # fmt: skip


def _most_telling(jumps: Sequence[Jump]) -> Jumps:
    """Choose the jumps that a table shows: starts of tracking, then the jumps that reduced the cost most."""

    def gain(one: Jump) -> float:
        return float("inf") if one.followed_cost is None else one.followed_cost - one.cost

    chosen = sorted(jumps, key=lambda one: (-gain(one), one.source_frame))[:MAX_JUMPS]
    return Jumps(tuple(sorted(chosen, key=lambda one: one.source_frame)), len(jumps))


POINTS = 160
"""Number of points of a frame that are drawn."""

MAX_BYTES = 6_000_000
"""The largest size of all points of a page."""


def packed_points(row: Mapping[str, Any], frames: int, rate_hz: float) -> dict[str, Any] | None:
    """Return points of the person in every frame of a take, in the form that the player draws.

    Parameters
    ----------
    row : dict
        The take's row of `reconstructions`.
    frames : int
        The length of the take in analysis frames.
    rate_hz : float
        Analysis frames per second.

    Returns
    -------
    dict or None
        The object that the player reads; None if the recording no longer exists or cannot be read.
    """
    if row["file"] is None or not Path(row["file"]).is_file():
        return None
    try:
        recording = read_recording(load_depth_recordings(row["file"]), row["recording"])
    except KinedexError:
        return None
    camera, background = recording.camera, recording.background
    placement = placement_of(camera, background)
    scene = make_scene(camera, background, placement, row["stride"])
    points: F64 = np.full((POINTS, 3, frames), np.nan)
    for frame in range(0, frames, PACKED_STEP):
        image = recording.frames[min(round(frame * row["rate_hz"] / rate_hz), len(recording.frames) - 1)]
        if image is None:
            continue
        cloud = scene.preparation.prepare(image).points
        chosen = np.unique(np.linspace(0, len(cloud) - 1, min(POINTS, len(cloud))).astype(np.int64))
        points[: len(chosen), :, frame] = placement.in_world(cloud[chosen])
    return {**asdict(pack(str(row["take"]), points, rate_hz)), "count": POINTS}
