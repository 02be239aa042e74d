"""The thesis's own method on silhouettes: frame by frame, with pose and logical priors, over several rounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.catalog.kinematics import load_surface
from kinedex.ops.body.capsules import body_capsules
from kinedex.ops.body.kinematic_chain import ChainBody, Poses
from kinedex.ops.body.pose_fit import fit_poses
from kinedex.ops.priors.motion import Motion
from kinedex.ops.priors.stabilise import Settings, Track, stabilise
from kinedex.ops.tracking.body_mask import render_mask
from kinedex.ops.tracking.contours import Silhouettes
from kinedex.ops.tracking.frame_tracker import track_frames
from kinedex.ops.tracking.prior_terms import PriorTerms
from kinedex.ops.tracking.views import View, camera_view
from kinedex.pipelines.evaluation.markdown import grid
from studies.camera_set import Filmed, filmed
from studies.prior_archive import track_words

F64 = npt.NDArray[np.float64]
U8 = npt.NDArray[np.uint8]
Bool = npt.NDArray[np.bool_]

TAKES = ("kickLFront1Reps", "squat1Reps", "sneak2StepsLStart", "jogLeftCircle4StepsRstart")
SEED, ROUNDS = 1, 3
TOO_THICK = 1.04
"""The capsules that track are so much thicker than those that were filmed."""
MASK_PART = 2
DARK_EVERY_S, DARK_S, DARK_CAMERAS = 1.5, (0.4, 1.0), 2

THESIS = {0: "79.1, 26.2, 166", 1: "51.8, 18.5, 134", 3: "47.9, 12.8, 106"}
"""The thesis's Table 6.1 (HumanEva-II S4, 1257 frames): mean, σ and greatest error after so many rounds."""
PROTOTYPE = {0: "104", 1: "65", 2: "35", 3: "45"}


@dataclass(frozen=True, eq=False)
class FrameResult:
    """A track of frames, with what the guard compares as its costs.

    Attributes
    ----------
    poses : Poses
        The poses.
    positions : float64 array (T, J, 3)
        The joints in metres.
    costs : float64 array (T,)
        The mean distance of the contour from the boundary of the silhouettes, in pixels.
    """

    poses: Poses
    positions: F64
    costs: F64


@dataclass(frozen=True, eq=False)
class SilhouetteTracker:
    """The tracker of frames with silhouettes, as `ops.priors.stabilise` needs it.

    Attributes
    ----------
    body : ChainBody
        The body.
    silhouettes : Silhouettes
        Its silhouettes.
    first : Poses
        The pose of the first frame.
    rate_hz : float
        Frames a second.
    """

    body: ChainBody
    silhouettes: Silhouettes
    first: Poses
    rate_hz: float

    def track(self, start: Poses | None, priors: PriorTerms | None) -> Track:
        """Track all frames; each starts from the one before, whatever `start` is."""
        found = track_frames(self.body, None, None, self.rate_hz, self.first, priors, self.silhouettes)
        return FrameResult(found.poses, found.positions, np.nan_to_num(found.shifts_px))

    def nodes_seen(self, track: Track) -> Bool:
        """Return that all nodes are seen: silhouettes name no joint."""
        return np.ones(track.poses.turns.shape[:2], np.bool_)

    def restart(self, poses: Poses, nodes_seen: Bool) -> Poses:
        """Return the poses."""
        return poses


def dark_cameras(frames: int, cameras: int, rate_hz: float, generator: np.random.Generator) -> Bool:
    """Return the frames in which each camera is dark (T, V): two cameras in every second and a half."""
    dark = np.zeros((frames, cameras), np.bool_)
    every = round(DARK_EVERY_S * rate_hz)
    for begin in range(0, frames, every):
        length = round(generator.uniform(*DARK_S) * rate_hz)
        first = begin + int(generator.integers(max(1, every - length + 1)))
        chosen = generator.permutation(cameras)[:DARK_CAMERAS]
        dark[first : first + length, chosen] = begin > 0  # the first pose is given, not the first second
    return dark


def tracker_of(one: Filmed) -> SilhouetteTracker:
    """Return the tracker of a take's silhouettes, which are rendered."""
    width, height = one.cameras[0].size
    views: list[View] = [
        camera_view(
            camera.matrix, camera.rotation, camera.translation, camera.distortion, camera.size,
            (width // MASK_PART, height // MASK_PART),
        )
        for camera in one.cameras
    ]  # fmt: skip
    surface = load_surface()
    filmed_capsules = body_capsules(one.body, surface)
    dark = dark_cameras(len(one.truth), len(views), one.rate_hz, np.random.default_rng(SEED))
    masks: list[tuple[U8 | None, ...]] = [
        tuple(
            None if dark[t, v] else np.where(render_mask(filmed_capsules, one.truth[t], view), 255, 0).astype(np.uint8)
            for v, view in enumerate(views)
        )
        for t in range(len(one.truth))
    ]
    silhouettes = Silhouettes(tuple(views), masks, body_capsules(one.body, surface, TOO_THICK))
    first = fit_poses(one.body, np.ascontiguousarray(one.truth[:1].transpose(1, 2, 0)))
    return SilhouetteTracker(one.body, silhouettes, first, one.rate_hz)


def rounds_of(one: Filmed, motions: Sequence[Motion], kinds: tuple[str, ...]) -> list[F64]:
    """Return the errors of the frames without priors, and after each round."""
    tracker = tracker_of(one)
    without = tracker.track(None, None)
    found = [one.errors_mm(without.positions)]
    words = lambda track: track_words(tracker.body, track.poses, tracker.rate_hz)  # noqa: E731
    for rounds in range(1, ROUNDS + 1):
        track = stabilise(tracker, without, words, motions, Settings(kinds=kinds, rounds=rounds)).track
        found.append(one.errors_mm(track.positions))
    return found


def silhouette_table(truth: Mapping[str, F64], motions: Sequence[Motion]) -> list[str]:
    """Return the errors after each round, beside those of the thesis."""
    films = [filmed(take, truth[take], 30.0, SEED) for take in TAKES]
    every = [rounds_of(one, motions, ("pose", "logical")) for one in films]
    lines = []
    for number in range(ROUNDS + 1):
        pooled = np.concatenate([one[number] for one in every])
        figures = [f"{value:.1f}" for value in (pooled.mean(), pooled.std())]
        own = [f"{one[number].mean():.0f}" for one in every]
        name = "no priors" if number == 0 else f"round {number}"
        reference = [PROTOTYPE.get(number, ""), THESIS.get(number, "")]
        lines.append([name, *figures, f"{pooled.max():.0f}", *own, *reference])
    takes = [f"{take}" for take in TAKES]
    return grid(["", "Ø", "σ", "max", *takes, "prototype", "thesis, Table 6.1"], lines)
