"""Render the page about stabilised takes: figures before and after, trust, hits, priors, joints and cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa

from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.arrays import F64
from kinedex.ops.body.kinematic_chain import ChainBody, forward
from kinedex.ops.intervals import in_seconds
from kinedex.ops.tracking.observations import MIN_CONFIDENCE
from kinedex.ops.wording import counted
from kinedex.pipelines.tracking.observed_recordings import StoredRecording, stored_recording
from kinedex.pipelines.tracking.recording_runs import earlier_rows
from kinedex.pipelines.tracking.tracked_takes import LIMBS, poses_of, stored_poses
from kinedex.pipelines.tracking.tracking_tasks import ESTIMATE
from kinedex.reports.embedded_motions import embed, pack, script_json
from kinedex.reports.page_environment import page_environment
from kinedex.storage.store.store import Store

BINS = 240
"""Number of columns of a strip that shows the fraction of trusted keypoints."""

BAD_CAMERA = 3.0
"""Ratio of a camera's median residual to that of the other cameras from which on the camera is marked."""

MOVED = 8
"""Number of joints in the table of the most moved ones."""


@dataclass(frozen=True)
class ShownPrior:
    """An interval to which a prior was applied.

    Attributes
    ----------
    label : str
        The class.
    kind : str
        The kind of prior, with its side.
    start, stop : int
        Frames of the take.
    left, width : float
        Place in the strip, in percent.
    cost : float
        The cost of the hit.
    kept : bool
        False if the prior was withdrawn.
    reason : str
        The reason why it was withdrawn.
    round : int
        The iteration of stabilisation in which it was applied.
    """

    label: str
    kind: str
    start: int
    stop: int
    left: float
    width: float
    cost: float
    kept: bool
    reason: str
    round: int


@dataclass(frozen=True)
class ShownTake:
    """A stabilised take on the page.

    `bins` has the fractions of trusted keypoints over time, `metrics` the mean distances by part of the body before and
    after stabilisation, and `moved_mm` is the mean displacement of all joints.
    """

    take: str
    before: str
    recording: str
    frames: int
    seconds: float
    near: int
    moved_mm: float
    row: Mapping[str, Any]
    bins: tuple[float, ...]
    priors: tuple[ShownPrior, ...]
    moved: tuple[tuple[str, float, float], ...]
    cameras: tuple[Mapping[str, Any], ...]
    metrics: tuple[tuple[str, float | None, float | None], ...]
    remarks: tuple[str, ...] = field(default=())

    @property
    def lanes(self) -> dict[str, list[ShownPrior]]:
        """The priors of the last iteration, and those that were withdrawn, by class."""
        last = [one for one in self.priors if one.round == self.row["rounds"] or not one.kept]
        return {label: [one for one in last if one.label == label] for label in sorted({one.label for one in last})}

    @property
    def withdrawn_seconds(self) -> float:
        """The total duration of intervals whose priors were withdrawn, in seconds."""
        return (
            len({frame for one in self.withdrawn for frame in range(one.start, one.stop)}) * self.seconds / self.frames
        )

    @property
    def distances(self) -> tuple[float | None, float | None]:
        """Mean distances from the ground truth over all frames, before and after stabilisation; None if unknown."""
        return next(((before, after) for name, before, after in self.metrics if name == "all"), (None, None))

    @property
    def lengths(self) -> str:
        """The origin of the bone lengths."""
        origin = str(self.row["body_from"])
        return "bone lengths measured in the recording" if origin == ESTIMATE else f"bone lengths of {origin}"

    @property
    def withdrawn(self) -> list[ShownPrior]:
        """The priors that were withdrawn."""
        return [one for one in self.priors if not one.kept]


def stabilised_page(store: Store, stage: str, title: str, most: int) -> str:
    """Return the HTML of the page.

    Parameters
    ----------
    store : Store
        The store.
    stage : str
        The stage that stabilised the takes, "<pipeline>/<stage>".
    title : str
        The title.
    most : int
        Largest number of takes that are shown: those whose joints were moved most.
    """
    rows = {str(row["take"]): row for row in earlier_rows(store, "tracks", stage) if row["take_id"] in _live(store)}
    moved = {take: _moved(store, stage, take) for take in rows}
    order = sorted(rows, key=lambda take: (-float(moved[take].mean()), take))[:most]
    motions = embed(store, order, "all")
    lengths = {take: store.take_frames[store.take_ids[take]] for take in order}
    pairs = [take for take in order if str(rows[take]["track_of"]) in store.take_ids]
    motions = motions.with_near(
        store, [(str(rows[take]["track_of"]), 0, lengths[take], np.arange(lengths[take])) for take in pairs]
    )
    shown = [
        _shown(store, rows[take], moved[take], stage, lengths[take], pairs.index(take) if take in pairs else -1)
        for take in order
    ]
    rays = [found for take in order if (found := _rays(store, rows[take], stage, lengths[take])) is not None]
    return (
        page_environment({"counted": counted})
        .get_template("stabilised.html.j2")
        .render(
            title=title, takes=shown, total=len(rows), motions=motions, scripts=True,
            motions_json=script_json({**asdict(motions), "rays": rays}), bad=BAD_CAMERA,
            rate_hz=store.rate_hz,
        )
    )  # fmt: skip


def _live(store: Store) -> set[int]:
    return set(store.manifest.live_takes)


def _of_take(store: Store, kind: str, stage: str, take: str) -> pa.Table:
    return store.rows_of(kind, stage, "take", [take])


def _moved(store: Store, stage: str, take: str) -> F64:
    """Return the distance by which each joint was moved in each frame, (T, J) in millimetres."""
    rows = _of_take(store, "track_frames", stage, take).column("moved_mm").to_pylist()
    return np.array([one if one is not None else [0.0] for one in rows], np.float64)


def _shown(store: Store, row: Mapping[str, Any], moved: F64, stage: str, frames: int, near: int) -> ShownTake:
    take, before = str(row["take"]), str(row["track_of"])
    trusted = _of_take(store, "track_frames", stage, take).column("trusted").to_numpy()
    joints = row["joints"]
    whole = moved.shape[1] == len(joints)
    order = np.argsort(-moved.mean(axis=0), kind="stable")[: MOVED if whole else 0]
    metrics = {name: _metrics(store, name) for name in (before, take)}
    return ShownTake(
        take, before, row["recording"] or "", frames, in_seconds(frames, store.rate_hz), near, float(moved.mean()), row,
        tuple(float(part.mean()) for part in np.array_split(trusted, min(BINS, len(trusted)))),
        tuple(_prior(one, frames, store.rate_hz) for one in _of_take(store, "priors", stage, take).to_pylist()),
        tuple((joints[j], float(moved[:, j].mean()), float(moved[:, j].max())) for j in order),
        tuple(_cameras(_of_take(store, "track_cameras", stage, take).to_pylist())),
        tuple(
            (name, metrics[before].get(name), metrics[take].get(name))
            for name in ("all", "in failures", "elsewhere")
            if name in metrics[take] or name in metrics[before]
        ),
        tuple(row["remarks"]),
    )  # fmt: skip


def _prior(row: Mapping[str, Any], frames: int, rate_hz: float) -> ShownPrior:
    start = min(round(row["start_seconds"] * rate_hz), frames - 1)
    stop = max(start + 1, min(round(row["stop_seconds"] * rate_hz), frames))
    kind = f"{row['kind']}, {row['side']}" if row["side"] else row["kind"]
    return ShownPrior(
        row["class"], kind.replace("_", " "), start, stop, 100 * start / frames, 100 * (stop - start) / frames,
        row["cost"], row["kept"], row["reason"] or "", row["round"],
    )  # fmt: skip


def _cameras(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return rows of cameras, each marked if its residual is far above that of the other cameras."""
    found = []
    for row in rows:
        others = [one["median_px"] for one in rows if one is not row and one["median_px"] is not None]
        own = row["median_px"]
        found.append({**row, "bad": own is not None and bool(others) and own > BAD_CAMERA * float(np.median(others))})
    return found


def _metrics(store: Store, take: str) -> dict[str, float]:
    rows = store.result("track_metrics").to_pylist()
    return {row["name"]: row["mean_mm"] for row in rows if row["take"] == take and row["scope"] in ("take", "part")}


def _rays(store: Store, row: Mapping[str, Any], stage: str, frames: int) -> dict[str, Any] | None:
    """Return, for the player, the rays of the limbs' keypoints, each with its point nearest to the joint.

    None is returned if the take has no recording with keypoints.
    """
    name = row["recording"]
    if name is None:
        return None
    stored: StoredRecording = stored_recording(store, name)
    recording = stored.recording
    if recording is None or not recording.keypoints:
        return None
    chain = load_kinematic_chain()
    body = ChainBody(chain, np.array(row["body"], np.float64).reshape(-1, 3))
    positions, _ = forward(body, stored_poses(poses_of(store, stage, row["take_id"]), len(chain.nodes)))
    points, rays = recording.body_points(body), recording.rays()
    limbs = [p for p, joint in enumerate(points.joints) if joint >= 0 and chain.joints[joint] in LIMBS]
    moments = np.round(np.arange(frames) * row["rate_hz"] / store.rate_hz).astype(np.int64)
    at = np.minimum(moments, positions.shape[2] - 1)
    places = positions[points.joints[limbs]].transpose(2, 0, 1)[at]
    directions, confidence = rays.directions[at][:, :, limbs], rays.confidence[at][:, :, limbs]
    gaps = places[:, None] - rays.centres[None, :, None]
    ends = rays.centres[None, :, None] + np.einsum("tvpi,tvpi->tvp", gaps, directions)[..., None] * directions
    ends = np.where((confidence >= MIN_CONFIDENCE)[..., None], ends, np.nan)
    packed = pack(str(row["take"]), ends.reshape(len(ends), -1, 3).transpose(1, 2, 0), store.rate_hz)
    joints = [chain.joints[int(points.joints[p])] for p in limbs]
    return {
        **asdict(packed),
        "cameras": [{"name": one.name, "centre": np.round(one.centre, 3).tolist()} for one in recording.cameras],
        "points": joints,
    }
