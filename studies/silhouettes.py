"""`python -m studies.silhouettes DATA`: track silhouettes alone, frame by frame, with the thesis's own priors.

DATA is a folder with `hdm05/clips`, the archive, and `cameras/simulated`, the takes of another actor with the cameras
that film them. Masks are rendered from the true joints, with capsules that are 4 % too thick; two of four cameras are
dark for 0.4 to 1 s every 1.5 s. The first pose and the bone lengths are given. Errors are means over hips, knees,
ankles, shoulders, elbows and wrists in mm. With `--actor bd` the takes are joined from the clips of one actor of the
archive, who then is no part of it: parameters are chosen on those.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import polars as pl

import kinedex
from kinedex.catalog.features import load_feature_set
from kinedex.catalog.kinematics import load_kinematic_chain, load_surface
from kinedex.ops.arrays import U64
from kinedex.ops.body.capsules import Capsules, body_capsules
from kinedex.ops.body.kinematic_chain import ChainBody, Poses
from kinedex.ops.body.pose_fit import fit_poses, measured_body
from kinedex.ops.priors.allocation import POSE
from kinedex.ops.priors.archive_poses import PriorMotion
from kinedex.ops.priors.constraints import template_marks
from kinedex.ops.priors.stabilisation import LOGICAL, Settings, stabilise
from kinedex.ops.simulation.recording import CameraRing, ring_of_cameras
from kinedex.ops.templates.templates import quantise
from kinedex.ops.tracking.contours import Observed, Silhouettes
from kinedex.ops.tracking.frame_tracker import FrameTrack, track_frames
from kinedex.ops.tracking.observations import PriorTerms
from kinedex.ops.tracking.views import View, camera_view, render_mask
from kinedex.reports.markdown import grid

F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

CLASSES = ("kickLFront1Reps", "squat1Reps", "sneak2StepsLStart", "jogLeftCircle4StepsRstart")
ACTORS = ("bd", "bk", "dg")
LOCOMOTION = ("sneak2StepsLStart", "jogLeftCircle4StepsRstart")
RATE_HZ, THICKNESS, DELTA, ROUNDS = 30.0, 1.04, 0.05, 3
MASK_SIZE = (640, 480)
THESIS = (("Thesis, Table 6.1 (HumanEva-II S4, images)", "79.1", "51.8", "", "47.9"),)
HEAD = ["", "no priors", "round 1", "round 2", "round 3"]

CHAIN, SURFACE = load_kinematic_chain(), load_surface()
LIMBS = [CHAIN.joint(side + name) for side in "lr" for name in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")]


@dataclass(frozen=True, eq=False)
class RenderedMasks:
    """Masks of true joints (J, 3, T), rendered when they are read; None where a camera (T, V) is dark."""

    joints: F64
    views: tuple[View, ...]
    capsules: Capsules
    dark: Bool

    def __len__(self) -> int:
        return len(self.dark)

    def __getitem__(self, frame: int) -> tuple[npt.NDArray[np.uint8] | None, ...]:
        pose = np.ascontiguousarray(self.joints[:, :, frame])
        return tuple(
            None if dark else render_mask(self.capsules, pose, view).view(np.uint8) * np.uint8(255)
            for view, dark in zip(self.views, self.dark[frame], strict=True)
        )


def dark_cameras(frames: int, cameras: int, generator: np.random.Generator) -> Bool:
    """Return the cameras that show nothing, bool (T, V): two of them for 0.4 to 1 s in every 1.5 s."""
    dark = np.zeros((frames, cameras), np.bool_)
    for begin in np.arange(0.0, frames / RATE_HZ, 1.5):
        seconds = generator.uniform(0.4, 1.0)
        start = begin + generator.uniform(0.0, 1.5 - seconds)
        chosen = generator.choice(cameras, 2, replace=False)
        dark[int(start * RATE_HZ) : int((start + seconds) * RATE_HZ), chosen] = True
    return dark


@dataclass(frozen=True, eq=False)
class FrameTracker:
    """A tracker of single frames on silhouettes alone, for rounds of priors; see `ops.priors.stabilisation.Tracker`."""

    body: ChainBody
    first: Poses
    silhouettes: Silhouettes
    rate_hz: float = RATE_HZ
    carries_over: bool = True

    def track(self, start: Poses | None = None, priors: PriorTerms | None = None) -> FrameTrack:
        """Track the recording with priors; `start` is ignored, as each frame starts from the previous one."""
        observed = Observed(self.body, self.rate_hz, None, silhouettes=self.silhouettes)
        return track_frames(observed, self.first, priors)

    def nodes_seen(self, track: FrameTrack) -> Bool:
        """Return a mask (T, K) that is True for all nodes of the frames that are not lost."""
        return np.repeat(~track.lost[:, None], len(self.body.chain.nodes), axis=1)

    def restart(self, poses: Poses, nodes_seen: Bool) -> Poses:
        """Return the poses unchanged, as this tracker only starts from the first frame."""
        return poses


def tracker_of(joints: F64, views: tuple[View, ...], generator: np.random.Generator) -> FrameTracker:
    """Return the tracker of a take with true joints (J, 3, T)."""
    body = measured_body(CHAIN, joints)
    dark = dark_cameras(joints.shape[2], len(views), generator)
    masks = RenderedMasks(joints, views, body_capsules(body, SURFACE, THICKNESS), dark)
    silhouettes = Silhouettes(views, masks, body_capsules(body, SURFACE))
    return FrameTracker(body, fit_poses(body, joints[:, :, :1]), silhouettes)


def filmed(data: Path, seed: int) -> Iterator[tuple[str, F64, FrameTracker]]:
    """Yield name, true joints and tracker of the takes of the actor who is not in the archive."""
    folder = data / "cameras" / "simulated"
    recordings = json.loads((folder / "cameras.json").read_text(encoding="utf-8"))["recordings"]
    truth = pl.read_parquet(folder / "truth.parquet")
    for number, name in enumerate(CLASSES):
        rows = truth.filter(pl.col("take") == name).sort("frame")
        joints = np.stack([rows[joint].struct.unnest().to_numpy().T for joint in CHAIN.joints]).astype(np.float64)
        views = []
        for camera in recordings[f"{name}_seed{1 + seed % 2}"]:
            rotation = np.array(camera["rotation"])
            move = -rotation @ np.array(camera["centre"])
            views.append(camera_view(camera["matrix"], rotation, move, [], tuple(camera["size"]), MASK_SIZE))
        yield name, joints, tracker_of(joints, tuple(views), np.random.default_rng([seed, number]))


def clips_of(data: Path, name: str, actors: Sequence[str]) -> list[kinedex.Take]:
    """Return the clips of a class by some actors."""
    files = sorted((data / "hdm05" / "clips" / name).glob("*.amc"))
    return [kinedex.read(file) for file in files if file.name.split("_")[1] in actors]


def joined(data: Path, seed: int, actor: str) -> Iterator[tuple[str, F64, FrameTracker]]:
    """Yield name, true joints and tracker of takes joined from three clips of an actor of the archive."""
    ring = CameraRing()
    for number, name in enumerate(CLASSES):
        generator = np.random.default_rng([seed, number, ACTORS.index(actor)])
        takes = clips_of(data, name, [actor])[:3]
        parts = [take.positions[:, [take.joints.index(joint) for joint in CHAIN.joints]] for take in takes]
        joints = np.ascontiguousarray(join(parts).transpose(1, 2, 0), np.float64)
        rotations, moves = ring_of_cameras(ring, joints[0].T, 0.0, generator)
        views = tuple(
            camera_view(ring.matrix, turn, move, [], ring.size, MASK_SIZE)
            for turn, move in zip(rotations, moves, strict=True)
        )
        yield f"{actor} {name}", joints, tracker_of(joints, views, generator)


def join(clips: Sequence[F64], fade: int = 10) -> F64:
    """Return clips (T, J, 3) in a row, each turned and moved onto the one before, with frames cross-faded."""
    hips = [CHAIN.joint("rhip"), CHAIN.joint("lhip")]
    whole = np.asarray(clips[0], np.float64)
    for clip in clips[1:]:
        one, other = (pose[hips[1]] - pose[hips[0]] for pose in (clip[0], whole[-fade]))
        angle = np.arctan2(one[2], one[0]) - np.arctan2(other[2], other[0])
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        turned = clip @ turn.T
        turned += (whole[-fade, 0] - turned[0, 0]) * (1.0, 0.0, 1.0)
        share = np.linspace(0, 1, fade)[:, None, None]
        mixed = (1 - share) * whole[-fade:] + share * turned[:fade]
        whole = np.concatenate([whole[:-fade], mixed, turned[fade:]])
    return whole


def motions_of(data: Path, actors: Sequence[str]) -> list[PriorMotion]:
    """Return what the archive knows of all classes, without poses: templates and marked regions."""
    bits = {feature.name: bit for bit, feature in enumerate(load_feature_set("body40").features)}
    motions = []
    for folder in sorted(path.name for path in (data / "hdm05" / "clips").iterdir() if path.is_dir()):
        template = kinedex.Template.learn(clips_of(data, folder, actors), name=folder)
        quantised = quantise(template.learned.learned.template, DELTA)
        motions.append(PriorMotion(folder, quantised, None, template_marks(quantised, bits, folder in LOCOMOTION)))
    return motions


def words_of(track: FrameTrack) -> U64:
    """Return the words of a track."""
    return kinedex.Take.from_positions(track.positions, RATE_HZ, joints=CHAIN.joints).words()


def errors_mm(track: FrameTrack, joints: F64) -> F64:
    """Return the mean error of the limbs' joints in each frame."""
    apart = np.moveaxis(track.positions, 0, 2)[LIMBS] - joints[LIMBS]
    return 1000 * np.sqrt((apart**2).sum(axis=1)).mean(axis=0)


def rounds(
    tracker: FrameTracker, motions: Sequence[PriorMotion], kinds: tuple[str, ...], guard: float
) -> list[FrameTrack]:
    """Return the track without priors and those after each round."""
    tracks: list[FrameTrack] = []

    def words(track: FrameTrack) -> U64:
        tracks.append(track)  # every round begins with the words of the track before it
        return words_of(track)

    settings = Settings(kinds=kinds, rounds=ROUNDS, guard=guard)
    last = stabilise(tracker, tracker.track(), words, motions, settings).track
    return [*tracks, *[last] * (ROUNDS + 1 - len(tracks))]


def main() -> None:
    """Print a row for each take, and one for all frames."""
    parser = argparse.ArgumentParser(prog="python -m studies.silhouettes", description=__doc__)
    parser.add_argument("data", type=Path, help="folder with hdm05/clips and cameras/simulated")
    parser.add_argument("--actor", choices=ACTORS, help="film this actor of the archive, who then is no part of it")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3], help="of the cameras that are dark")
    parser.add_argument("--guard", type=float, default=1.1, help="of the mean contour shift; inf for none")
    options = parser.parse_args()
    motions = motions_of(options.data, [actor for actor in ACTORS if actor != options.actor])
    rows, errors = [], []
    for seed in options.seeds:
        takes = joined(options.data, seed, options.actor) if options.actor else filmed(options.data, seed)
        for name, joints, tracker in takes:
            tracks = rounds(tracker, motions, (POSE, LOGICAL), options.guard)
            errors.append(np.stack([errors_mm(track, joints) for track in tracks]))
            rows.append([f"{name}, seed {seed}", *(f"{error:.1f}" for error in errors[-1].mean(axis=1))])
    every = np.concatenate(errors, axis=1)
    rows.append(["all frames", *(f"{error:.1f}" for error in every.mean(axis=1))])
    rows.append(["σ", *(f"{error:.1f}" for error in every.std(axis=1))])
    rows.append(["largest", *(f"{error:.0f}" for error in every.max(axis=1))])
    print("\n".join(grid(HEAD, [*rows, *map(list, THESIS)])))


if __name__ == "__main__":
    main()
