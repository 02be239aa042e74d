"""Check a recording as a whole, and raise an error that suggests the cause if tracking cannot succeed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from kinedex.catalog.camera_recordings import RecordingsFile
from kinedex.catalog.cameras import Camera, observed_rays
from kinedex.ops.body.up_axis import up_axis
from kinedex.ops.tracking.triangulation import triangulate
from kinedex.storage.formats.cameras.calibrations import UNITS_M
from kinedex.storage.formats.cameras.keypoint_files import KeypointArrays

F64 = npt.NDArray[np.float64]

MIN_CONFIDENCE = 0.1
"""Minimum confidence of a keypoint that counts as seen."""

TRUNK_M = (0.2, 0.9)
"""The smallest and largest plausible distance between the middles of hips and shoulders, in metres."""

LIMBS = {
    "thigh": ("hip", "knee"), "shank": ("knee", "ankle"), "foot": ("ankle", "toes"),
    "upper arm": ("shoulder", "elbow"), "forearm": ("elbow", "wrist"),
}  # fmt: skip
"""A dict from limb to the two joints at its ends."""

LONGEST_LIMB_M, MAX_UNLIKE = 0.75, 1.5
"""The longest plausible limb in metres, and the ratio of left to right length that suggests a misnamed keypoint."""

BAD_CAMERA = 3.0
"""The ratio of a camera's residual to that of the other cameras from which on the camera is reported."""

_APART_M = 0.01
_FAR = 0.1  # how far beyond the border of an image is far outside, as a share of its width and height
_MAX_FAR = 0.1  # largest share of a camera's keypoints that may be far outside
_SAMPLE = 200  # frames that are checked
_MIN_POINTS = 20


def check_cameras(file: RecordingsFile, name: str, cameras: Sequence[Camera], notes: Sequence[str]) -> None:
    """Raise an error for cameras that cannot triangulate; `notes` report how files were matched to cameras.

    Raises
    ------
    ConfigError
        There is only one camera, or all are at the same position.
    """
    if len(cameras) < 2:
        listed = cameras[0].name if cameras else "none"
        more = f"; {'; '.join(notes)}: name cameras in the files as in the calibration" if notes else ""
        raise file.error(name, "cameras", f"one camera with observations ({listed}): tracking needs two or more{more}")
    centres = np.stack([camera.centre for camera in cameras])
    apart = float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())
    if apart < _APART_M:
        raise file.error(
            name, "cameras", f"all {len(cameras)} cameras stand in one place, within {2000 * apart:.2g} mm; are "
            "rotations and translations those of x = R X + t, and is `unit:` right?",
        )  # fmt: skip


def check_keypoints(
    file: RecordingsFile, name: str, cameras: Sequence[Camera], keypoints: KeypointArrays, unit: str
) -> tuple[int, list[str]]:
    """Check keypoints against the cameras, and return the number of keypoints outside the images, and notes.

    Parameters
    ----------
    file : RecordingsFile
        The file that errors name.
    name : str
        The recording.
    cameras : sequence of Camera
        V cameras.
    keypoints : KeypointArrays
        The keypoints that the cameras saw.
    unit : str
        The unit in which the calibration was read.

    Raises
    ------
    ConfigError
        Keypoints are far outside the images, no frame is seen by two cameras, the rays meet behind a camera, or the
        body has an impossible size.
    """
    seen = keypoints.confidence >= MIN_CONFIDENCE
    outside = 0
    for v, camera in enumerate(cameras):
        outside += _refuse_far(file, name, camera, keypoints.pixels[:, v][seen[:, v]])
    together = seen.any(axis=2).sum(axis=1)
    if together.max(initial=0) < 2:
        raise file.error(
            name, "keypoints", "no frame is seen by two cameras: the numbers of their frames do not meet; check the "
            "names of the files, or write `offsets:`",
        )  # fmt: skip
    frames = np.flatnonzero(together >= 2)
    frames = frames[:: max(1, len(frames) // _SAMPLE)]
    pixels, confidence = keypoints.pixels[frames], keypoints.confidence[frames]
    _refuse_behind(file, name, cameras, pixels, np.where(seen[frames], confidence, 0.0))
    points, count = triangulate(observed_rays(cameras, pixels, confidence))
    positions = keypoints.keypoint_set.positions
    joints = {positions[key].joint: points[:, p].T for p, key in enumerate(keypoints.names) if positions[key].joint}
    _refuse_size(file, name, joints, unit)
    notes = _residual_notes(cameras, pixels, np.where(seen[frames], confidence, 0.0), points)
    notes += _limb_notes(keypoints, joints)
    up = up_axis(joints)
    if up.axis not in ("", "y") and count.any():
        notes.append(
            f"the body stands along {up.axis} of a world that should be Y up; is `up:` right? ({up.reasons[0]})"
        )
    return outside, notes


def _refuse_far(file: RecordingsFile, name: str, camera: Camera, pixels: F64) -> int:
    """Count the keypoints outside the image of a camera; raise an error if many of them are far outside."""
    if not len(pixels):
        return 0
    size = np.array(camera.size)
    far = ((pixels < -_FAR * size) | (pixels > (1 + _FAR) * size)).any(axis=1)
    highest = np.quantile(pixels, 0.95, axis=0)
    guess = "are they keypoints of this camera, and of images of this size?"
    if far.mean() > _MAX_FAR:
        raise file.error(
            name, "keypoints", f"{100 * far.mean():.0f} % of the keypoints of camera '{camera.name}' lie far outside "
            f"its {size[0]} × {size[1]} pixels, up to ({highest[0]:.0f}, {highest[1]:.0f}); {guess}",
        )  # fmt: skip
    if np.abs(pixels).max() <= 2.0:
        raise file.error(
            name, "keypoints", f"all keypoints of camera '{camera.name}' lie within 2 pixels of 0: they are shares of "
            "the image's size; multiply them by its width and height",
        )  # fmt: skip
    return int((~camera.contains(pixels)).sum())


def _refuse_behind(file: RecordingsFile, name: str, cameras: Sequence[Camera], pixels: F64, weights: F64) -> None:
    """Raise an error if the rays of most keypoints meet behind the cameras, as with inverted rotations."""
    rays = observed_rays(cameras, pixels, weights)
    across = np.eye(3) - rays.directions[..., :, None] * rays.directions[..., None, :]
    matrices = np.einsum("tvp,tvpij->tpij", rays.confidence, across)
    vectors = np.einsum("tvp,tvpij,vj->tpi", rays.confidence, across, rays.centres)
    usable = ((rays.confidence > 0).sum(axis=1) >= 2) & (np.linalg.cond(matrices) < 1e8)
    points = np.linalg.solve(matrices[usable], vectors[usable][..., None])[..., 0]
    if not len(points):
        raise file.error(name, "cameras", "all rays of keypoints are parallel: check rotations and translations")
    behind = []
    for v, camera in enumerate(cameras):
        own = np.moveaxis(rays.confidence, 1, 2)[usable][:, v] > 0
        if own.sum() and (camera.project(points[own])[1] <= 0).mean() > 0.5:
            behind.append(camera.name)
    if behind:
        raise file.error(
            name, "cameras", f"the rays of most keypoints meet behind camera {', '.join(behind)}: rotation and "
            "translation must take the world to the camera, x = R X + t; is it the inverse, the camera in the world?",
        )  # fmt: skip


def _refuse_size(file: RecordingsFile, name: str, joints: dict[str, F64], used: str) -> None:
    """Raise an error for a body of implausible size, with a guess at the unit."""
    if not {"lhip", "rhip", "lshoulder", "rshoulder"} <= joints.keys():
        return
    hips, shoulders = joints["lhip"] + joints["rhip"], joints["lshoulder"] + joints["rshoulder"]
    lengths = np.linalg.norm(hips - shoulders, axis=0) / 2
    lengths = lengths[np.isfinite(lengths)]
    if len(lengths) < min(_MIN_POINTS, hips.shape[1]) or TRUNK_M[0] <= np.median(lengths) <= TRUNK_M[1]:
        return
    length = float(np.median(lengths))
    lengths_m = {unit: length * unit_m / UNITS_M[used] for unit, unit_m in UNITS_M.items()}
    fits = [
        f"`unit: {unit}` makes it {is_m:.2f} m" for unit, is_m in lengths_m.items() if TRUNK_M[0] <= is_m <= TRUNK_M[1]
    ]
    low, high = TRUNK_M
    guess = f"; {' and '.join(fits)}" if fits else "; check `unit:` and the translations"
    raise file.error(
        name, "unit", f"hips and shoulders are {length:.3g} m apart, and those of a body {low} to {high} m; "
        f"the calibration was read in {used}{guess}",
    )  # fmt: skip


def _limb_notes(keypoints: KeypointArrays, joints: dict[str, F64]) -> list[str]:
    """Return notes on limbs of implausible length, which suggest that the keypoints are in a wrong order."""
    wrong = []
    for limb, (start, end) in LIMBS.items():
        ends = [(f"{side}{start}", f"{side}{end}") for side in "lr"]
        if any(joint not in joints for pair in ends for joint in pair):
            continue
        lengths = [np.linalg.norm(joints[a] - joints[b], axis=0) for a, b in ends]
        seen = [one[np.isfinite(one)] for one in lengths]
        if min(len(one) for one in seen) == 0:
            continue
        left, right = (float(np.median(one)) for one in seen)
        if max(left, right) > MAX_UNLIKE * min(left, right) or max(left, right) > LONGEST_LIMB_M:
            wrong.append(f"{limb} {left:.2f} m on the left, {right:.2f} m on the right")
    name = keypoints.keypoint_set.name
    return [f"limbs have lengths of no body ({'; '.join(wrong)}); are the keypoints those of {name}?"] if wrong else []


def _residual_notes(cameras: Sequence[Camera], pixels: F64, weights: F64, points: F64) -> list[str]:
    """Return a note on each camera whose residual is far larger than that of the others, as after a bad calibration."""
    medians = []
    for v, camera in enumerate(cameras):
        errors = np.linalg.norm(camera.project(points)[0] - pixels[:, v], axis=-1)[weights[:, v] > 0]
        errors = errors[np.isfinite(errors)]
        medians.append(float(np.median(errors)) if len(errors) >= _MIN_POINTS else np.nan)
    notes = []
    for v, camera in enumerate(cameras):
        others = [median for w, median in enumerate(medians) if w != v and np.isfinite(median)]
        if len(others) > 1 and medians[v] > BAD_CAMERA * max(float(np.median(others)), 1.0):
            notes.append(
                f"camera '{camera.name}' disagrees with the others: its median residual is {medians[v]:.1f} px, "
                f"theirs {np.median(others):.1f} px; is it calibrated, and does it begin at the same moment?"
            )
    return notes
