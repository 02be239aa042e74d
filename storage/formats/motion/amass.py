"""Read the joint angles of SMPL bodies: AMASS, AIST++, and the output of body and shape estimators.

The joint positions at rest come from a body model, a file that the user must provide.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from kinedex.catalog.configs import config_path
from kinedex.catalog.skeletons.body_evidence import SAMPLED_FRAMES
from kinedex.catalog.skeletons.mappings import Fit, Format, Mappings
from kinedex.catalog.skeletons.skeleton_fit import axes_of_up
from kinedex.ops.body import axisangle
from kinedex.ops.body.up_axis import up_axis
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.body_models import (
    BODY,
    FACE,
    HANDS,
    JOINTS_BY_COUNT,
    LARGEST,
    BodyModel,
    load_body_model,
    model_digest,
)
from kinedex.storage.formats.motion.mapped_body import mapped_orientation, recognition_evidence, refuse_far
from kinedex.storage.formats.motion.numpy_arrays import array_names, array_shapes, load_arrays, load_pickle
from kinedex.storage.formats.motion.positions import ARRAYS
from kinedex.storage.formats.motion.reader import (
    FASTEST_HZ,
    SLOWEST_HZ,
    Body,
    Extent,
    MotionFile,
    Reader,
    ReadSettings,
    body_bytes,
)
from kinedex.storage.formats.source_files import file_size, first_bytes

F64 = npt.NDArray[np.float64]

RATES = ("mocap_framerate", "mocap_frame_rate", "fps", "frame_rate")
"""The keys of the rate: older files of AMASS have the first, newer ones the second."""

PARTS = ("root_orient", "pose_body", "pose_hand", "pose_jaw", "pose_eye")
"""The keys of newer files, which hold the angles in parts."""

_SYNONYMS = {
    "poses": ("smpl_poses", "fullpose", "pose", "pose_est_fullposes"),
    "trans": ("smpl_trans", "transl", "smpl_transl", "translation", "pose_est_trans"),
    "betas": ("shape_est_betas",),
    "root_orient": ("global_orient", "smpl_global_orient"),
    "pose_body": ("body_pose", "smpl_body_pose"),
    "pose_jaw": ("jaw_pose",),
    "scaling": ("smpl_scaling",),
}
"""A dict from the usual keys to those of other sources."""

_PAIRS = {"pose_hand": ("left_hand_pose", "right_hand_pose"), "pose_eye": ("leye_pose", "reye_pose")}
_NESTED = ("smpl_params_global", "smpl_params", "smplx_params", "smpl")
"""Dicts in pickles that hold the angles, in order of precedence."""

_READ = (
    *("poses", "trans", "betas", "gender", "scaling", *PARTS, *RATES),
    *(key for keys in (*_SYNONYMS.values(), *_PAIRS.values()) for key in keys),
)
_SURE = frozenset(
    (
        *("smpl_poses", "smpl_trans", "smpl_scaling", "global_orient", "body_pose", "root_orient", "pose_body"),
        *("fullpose", "pose_est_fullposes"),
    )
)
_MOSH = "stageii_debug_details"
"""The dict of MoSh++'s pickles that holds the rate."""

_HEAD = 4096  # bytes of a pickle that are searched for its first keys
_NO_TAKE = (b"chumpy", b"J_regressor", b"v_template", b"shapedirs")
SHIPPED = "smpl-amass"
"""The mapping with the axes of AMASS; a user's own mapping sets the axes for all files."""

AIST_HZ = 60.0
"""The rate of the AIST Dance Video Database, which the files of AIST++ do not state."""

_BLOCK_FRAMES = 4096  # frames at once; axisangle.forward uses the same number


@dataclass(frozen=True)
class Poses:
    """The joint angles of a body over time.

    Attributes
    ----------
    names : tuple of str
        The joints that have rotations.
    rotations : float64 array (T, J, 3)
        Rotation vectors, in radians.
    positions : float64 array (T, 3)
        The root's displacement from its rest position, in metres.
    shape : float64 array (B,)
        The shape parameters (betas) of the body.
    gender : str
        "male", "female" or "neutral".
    rate_hz : float, optional
        Frames per second, if the file states them.
    up : str, optional
        The vertical axis, if the source fixes it.
    known_hz : float, optional
        Frames per second of all files of the data set (AIST++), which do not state them.
    """

    names: tuple[str, ...]
    rotations: F64
    positions: F64
    shape: F64
    gender: str
    rate_hz: float | None
    up: str | None = "z"
    known_hz: float | None = None


class AmassReader(Reader):
    """Reads NPZ files and pickles that hold joint angles and no positions."""

    format: ClassVar[Format] = "amass"
    endings: ClassVar[tuple[str, ...]] = (".npz", ".pkl")

    def sniff(self, path: Path) -> bool:
        """Return whether a file holds joint angles and no positions; a pickle is judged by its first keys."""
        if path.suffix.lower() == ".pkl":
            # the first keys are those of angles, not of a body model
            head = first_bytes(path, _HEAD)
            return any(key.encode() in head for key in _SURE) and not any(word in head for word in _NO_TAKE)
        names = set(array_names(path))
        return bool(names & {"poses", *_SURE}) and not names & set(ARRAYS)

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the rates, and the body model with size and time of its files: the settings that affect the result."""
        return settings.rate_hz, settings.override_rate_hz, model_digest(settings.body_model)

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Read the headers of the arrays and estimate the memory of all angles and the joints."""
        if file.path.suffix.lower() == ".pkl":
            return Extent(0, 8 * file_size(file.path), settings.override_rate_hz)
        shapes = array_shapes(file.path)
        known = [shapes[key] for key in _READ if key in shapes]
        stored = sum(math.prod(shape) * kind.itemsize for shape, kind in known)
        # memory as read, as doubles if stored otherwise, and concatenated if stored in parts
        numbers = sum(math.prod(shape) * (0 if kind == np.float64 else 8) for shape, kind in known)
        parts = [shape for key, (shape, _) in shapes.items() if key in _READ and key != "poses"]
        together = 0 if "poses" in shapes else 16 * sum(map(math.prod, parts))
        frames = max((shape[0] for shape, _ in known if shape), default=0)
        block = min(frames, _BLOCK_FRAMES) * (len(BODY) + len(HANDS) + len(FACE)) * 400
        need = stored + numbers + together + block + body_bytes(frames, joints)
        return Extent(frames, need, settings.override_rate_hz)

    def read(self, file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings) -> Body:
        """Read a file of angles with the body model of the settings.

        Raises
        ------
        SourceError
            The file is damaged, no mapping fits, no rate is known, or there is no body model.
        """
        path = file.path
        poses, model, rest, fit, reasons = fitted_poses(file, mappings, joints, settings)
        warnings: list[str] = []
        if poses.shape.any() and not model.shapes.shape[2]:
            warnings.append("the figure has the shape of the body model; that of the file (betas) is not used")
        positions, turned = _posed(poses, model, rest, fit, joints)
        unit_m = fit.mapping.unit_m or 1.0
        positions *= unit_m
        refuse_far(path, positions, joints, fit.unknown)
        if poses.rate_hz is not None:
            rate_hz = settings.rate_of(poses.rate_hz, warnings)
        elif (set_hz := settings.override_rate_hz or settings.rate_hz or poses.known_hz) is not None:
            rate_hz = set_hz
        else:
            raise SourceError(path, f"has none of {', '.join(RATES)}: give `rate_hz`, or --rate")
        return Body(
            positions=positions,
            orientation=mapped_orientation(fit, turned),
            rate_hz=rate_hz,
            unit=f"{unit_m:.6g} m",
            skeleton=fit.mapping.name,
            up=fit.up,
            unknown=fit.unknown,
            warnings=tuple(warnings),
            evidence=(*reasons, *recognition_evidence(fit)),
        )


class FittedPoses(NamedTuple):
    """The angles of a file with its body model, rest joints (J, 3), mapping, and the reason for its up axis."""

    poses: Poses
    model: BodyModel
    rest: F64
    fit: Fit
    reasons: tuple[str, ...]


def fitted_poses(file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings) -> FittedPoses:
    """Read the angles of a file with the body model of the settings, and find the mapping of its joints.

    Raises
    ------
    SourceError
        The file is damaged, no mapping fits, or there is no body model.
    """
    path = file.path
    poses = parse_amass(path)
    if settings.body_model is None:
        raise SourceError(
            path,
            "holds the joint angles of a body (AMASS, SMPL); the places of its joints at rest are in a body model, "
            "which may not come with kinedex: give `body_model`, your model.npz of SMPL-H or a table of its joints "
            "at rest; docs/formats.md explains it",
        )
    model = load_body_model(settings.body_model, poses.gender)
    rest = model.rest(poses.shape)
    fit = mappings.detect(path, "amass", {name: i for i, name in enumerate(model.names)})
    return FittedPoses(poses, model, rest, *_upright(poses, model, rest, fit, joints))


def _upright(
    poses: Poses, model: BodyModel, rest: F64, fit: Fit, joints: tuple[str, ...]
) -> tuple[Fit, tuple[str, ...]]:
    """Return the fit with the axis along which the body stands, for files whose source does not fix the up axis."""
    if poses.up is not None or fit.mapping.path != config_path("skeletons", SHIPPED):
        return fit, ()
    sample = np.unique(np.linspace(0, len(poses.rotations) - 1, min(len(poses.rotations), SAMPLED_FRAMES)).astype(int))
    plain = replace(fit, mapping=replace(fit.mapping, axes=np.eye(3)))
    few = replace(poses, rotations=poses.rotations[sample], positions=poses.positions[sample])
    positions = _posed(few, model, rest, plain, joints)[0]
    found = up_axis({joint: positions[i] for i, joint in enumerate(joints) if joint not in fit.unknown})
    up = found.axis or "y"
    reason = f"up is {up} by posture (confidence {found.confidence:.2f})"
    return replace(fit, mapping=replace(fit.mapping, axes=axes_of_up(up))), (reason, *found.reasons)


def _posed(poses: Poses, model: BodyModel, rest: F64, fit: Fit, joints: tuple[str, ...]) -> tuple[F64, F64]:
    """Return the named joints (J, 3, T) and the root's rotation (9, T), computed in blocks of frames."""
    frames = len(poses.rotations)
    positions, turned = np.empty((len(joints), 3, frames)), np.empty((9, frames))
    for start in range(0, frames, _BLOCK_FRAMES):
        part = slice(start, start + _BLOCK_FRAMES)
        rotations = model_rotations(poses, model, part)
        places, turned[:, part] = axisangle.forward(rest, model.parents, rotations, poses.positions[part])
        positions[:, :, part] = fit.apply(places, joints)
    return positions, turned


def model_rotations(poses: Poses, model: BodyModel, part: slice) -> F64:
    """Return the rotation vectors (K, J, 3) of all joints of a model in some frames; 0 for joints not given."""
    given = poses.rotations[part]
    rotations = np.zeros((len(given), len(model.names), 3))
    for i, name in enumerate(model.names):
        if name in poses.names:
            rotations[:, i] = given[:, poses.names.index(name)]
    return rotations


def parse_amass(path: Path) -> Poses:
    """Read the angles of an AMASS file, in one array (`poses`) or in parts (`root_orient`, `pose_body`, …).

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    SourceError
        An array is missing, has another shape, or holds anything but numbers.
    """
    if path.suffix.lower() == ".pkl":
        found = load_pickle(path)
        inner = next((found[key] for key in _NESTED if isinstance(found.get(key), dict)), found)
        arrays = {key: value for key, value in inner.items() if not isinstance(value, dict) and key in _READ}
        names = list(arrays)
        from_mosh = "pose_est_fullposes" in arrays or isinstance(inner.get(_MOSH), dict)
        if from_mosh:
            arrays |= _mosh_details(inner)
    else:
        arrays, names = load_arrays(path, _READ)
        from_mosh = False
    from_aist = "smpl_poses" in arrays
    arrays = _usual(path, arrays)
    posed, rotations = _rotation_vectors(path, arrays)
    frames = len(rotations)
    if "trans" not in arrays:
        raise SourceError(path, f"has no `trans`, where the body is in every frame; it has {', '.join(names)}")
    positions = _numbers(path, arrays, "trans")
    if positions.shape != (frames, 3):
        raise SourceError(
            path, f"`trans` must have {frames} frames of 3 numbers, as many as angles, got {positions.shape}"
        )
    shape = _numbers(path, arrays, "betas") if "betas" in arrays else np.zeros(0)
    shape = shape.mean(axis=0) if shape.ndim == 2 and len(shape) == frames else shape.ravel()
    if "scaling" in arrays:
        positions = positions / _scale(path, arrays)
    rate = next((_numbers(path, arrays, key) for key in RATES if key in arrays), None)
    if rate is not None and (rate.size != 1 or not SLOWEST_HZ <= float(rate.ravel()[0]) <= FASTEST_HZ):
        raise SourceError(path, f"the rate must be one number, {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz, got {rate}")
    rate_hz = None if rate is None else float(rate.ravel()[0])
    from_amass = not from_mosh and (
        any(key in arrays for key in RATES[:2]) or (path.suffix.lower() == ".npz" and "gender" in arrays)
    )
    known_hz = AIST_HZ if from_aist else None
    return Poses(
        posed, rotations, positions, shape, _gender(path, arrays), rate_hz, "z" if from_amass else None, known_hz
    )


def _mosh_details(found: dict[str, Any]) -> dict[str, Any]:
    """Return the rate and the gender of a pickle of MoSh++, which are in dicts within it."""
    details = found.get(_MOSH)
    details = details if isinstance(details, dict) else {}
    model = details.get("cfg")
    for key in ("surface_model", "gender"):
        model = model.get(key) if isinstance(model, dict) else None
    more = {"mocap_frame_rate": details.get("mocap_frame_rate"), "gender": model}
    return {key: value for key, value in more.items() if isinstance(value, np.ndarray) and key not in found}


def _usual(path: Path, arrays: dict[str, Any]) -> dict[str, Any]:
    """Return the arrays under their usual keys, with rotation matrices converted to rotation vectors."""
    usual = {key: value for key, value in arrays.items() if key in ("betas", "gender", "scaling", *PARTS, *RATES)}
    for key, others in _SYNONYMS.items():
        there = next((other for other in (key, *others) if other in arrays), None)
        if there is not None:
            usual.setdefault(key, arrays[there])
    for key, pair in _PAIRS.items():
        if key not in usual and all(other in arrays for other in pair):
            halves = [_vectors(path, arrays, other) for other in pair]
            if halves[0].shape == halves[1].shape and halves[0].shape[1:] in ((3,), (45,)):
                usual[key] = np.concatenate(halves, axis=1)
    for key in ("poses", *PARTS):
        if key in usual:
            usual[key] = _vectors(path, usual, key)
    return usual


def _vectors(path: Path, arrays: dict[str, Any], key: str) -> Any:
    """Return angles (T, 3 J), also from arrays (T, J, 3) and from rotation matrices (T, J, 3, 3)."""
    array = arrays[key]
    if array.ndim == 4 and array.shape[2:] == (3, 3) and array.size:
        matrices = _numbers(path, arrays, key)
        array = axisangle.vectors(matrices.reshape(-1, 3, 3)).reshape(len(matrices), -1)
    elif array.ndim == 3 and array.shape[2] == 3:
        array = array.reshape(len(array), -1)
    return array


def _scale(path: Path, arrays: dict[str, Any]) -> float:
    """Return the `scaling` of AIST++, by which the root's positions are divided to be in metres of the body model."""
    scale = _numbers(path, arrays, "scaling")
    if scale.size != 1 or not 1e-3 <= float(scale.ravel()[0]) <= 1e6:
        raise SourceError(path, f"`scaling` must be one positive number, got {scale.ravel()[:3]}")
    return float(scale.ravel()[0])


def _rotation_vectors(path: Path, arrays: dict[str, Any]) -> tuple[tuple[str, ...], F64]:
    """Return the joints that have rotations, and their rotation vectors (T, J, 3)."""
    if "poses" in arrays:
        poses = _angles(path, arrays, "poses")
        if poses.shape[1] not in JOINTS_BY_COUNT:
            counts = ", ".join(str(3 * count) for count in JOINTS_BY_COUNT)
            raise SourceError(path, f"`poses` must have {counts} angles a frame, got {3 * poses.shape[1]}")
        return JOINTS_BY_COUNT[poses.shape[1]], poses
    names: list[str] = []
    parts: list[F64] = []
    for key, joints in zip(PARTS, (BODY[:1], BODY[1:], HANDS, FACE[:1], FACE[1:]), strict=True):
        if key not in arrays:
            if key in PARTS[:2]:
                raise SourceError(path, f"has no `{key}`, nor `poses`")
            continue
        part = _angles(path, arrays, key)
        if key == "pose_body" and part.shape[1] == len(JOINTS_BY_COUNT[24]) - 1:
            joints = JOINTS_BY_COUNT[24][1:]
        if part.shape[1] != len(joints) or (parts and len(part) != len(parts[0])):
            raise SourceError(
                path,
                f"`{key}` must have {3 * len(joints)} angles in every frame, got {len(part)} × {3 * part.shape[1]}",
            )
        names += joints
        parts.append(part)
    return tuple(names), np.concatenate(parts, axis=1)


def _angles(path: Path, arrays: dict[str, Any], key: str) -> F64:
    angles = _numbers(path, arrays, key)
    if angles.ndim != 2 or not angles.size or angles.shape[1] % 3:
        raise SourceError(path, f"`{key}` must be angles of frames × three a joint, got {angles.shape}")
    return angles.reshape(len(angles), -1, 3)


def _numbers(path: Path, arrays: dict[str, Any], key: str) -> F64:
    array = arrays[key]
    if array.dtype.kind not in "fiu":
        raise SourceError(path, f"`{key}` must be numbers, got {array.dtype}")
    numbers: F64 = array.astype(np.float64, copy=False)
    if not (numbers.min(initial=0.0) >= -LARGEST and numbers.max(initial=0.0) <= LARGEST):
        raise SourceError(path, f"`{key}` has numbers that are NaN, infinite or beyond {LARGEST:g}")
    return numbers


def _gender(path: Path, arrays: dict[str, Any]) -> str:
    if "gender" not in arrays:
        return "neutral"
    value = arrays["gender"].ravel()[:1]
    text = value.astype("U") if value.dtype.kind in "SU" else np.array(["?"])
    gender = str(text[0]) if len(text) else "?"
    if gender not in ("male", "female", "neutral"):
        raise SourceError(path, f"`gender` must be male, female or neutral, got {gender!r}")
    return gender
