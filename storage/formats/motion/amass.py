"""The reader of AMASS files: the joint angles of SMPL bodies.

The places of the joints at rest come from a body model, a file of the user's own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.mappings import Fit, Format, Mappings
from kinedex.ops.body import axisangle
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.body_models import (
    BODY,
    FACE,
    HANDS,
    LARGEST,
    BodyModel,
    load_body_model,
    model_digest,
)
from kinedex.storage.formats.motion.mapped_body import mapped_orientation, refuse_far, virtual_joint_warnings
from kinedex.storage.formats.motion.numpy_arrays import array_names, array_shapes, load_arrays
from kinedex.storage.formats.motion.position_files import ARRAYS
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

F64 = npt.NDArray[np.float64]

RATES = ("mocap_framerate", "mocap_frame_rate")
"""The keys of the rate: older files have the one, newer ones the other."""

PARTS = ("root_orient", "pose_body", "pose_hand", "pose_jaw", "pose_eye")
"""The keys of newer files, which hold the angles in parts."""

_AT_ONCE = 4096  # frames; axisangle.forward computes so many at a time, too
_POSED = {22: BODY, 24: (*BODY, "left_hand", "right_hand"), 52: (*BODY, *HANDS), 55: (*BODY, *FACE, *HANDS)}


@dataclass(frozen=True)
class Poses:
    """The joint angles of a body over time.

    Attributes
    ----------
    names : tuple of str
        The joints that turn.
    turns : float64 array (T, J, 3)
        Rotation vectors, in radians.
    places : float64 array (T, 3)
        The root's displacement from its place at rest, in metres.
    shape : float64 array (B,)
        The figure's shape (betas).
    gender : str
        "male", "female" or "neutral".
    rate_hz : float, optional
        Frames per second, if the file states them.
    """

    names: tuple[str, ...]
    turns: F64
    places: F64
    shape: F64
    gender: str
    rate_hz: float | None


class AmassReader(Reader):
    """Reads NPZ files that hold joint angles and no positions."""

    format: ClassVar[Format] = "amass"
    endings: ClassVar[tuple[str, ...]] = (".npz",)

    def sniff(self, path: Path) -> bool:
        """Return whether an NPZ file holds joint angles and no positions."""
        names = set(array_names(path))
        return bool(names & {"poses", "pose_body"}) and not names & set(ARRAYS)

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the rates, and the body model with size and time of its files."""
        return settings.rate_hz, settings.override_rate_hz, model_digest(settings.body_model)

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Read the headers of the arrays; the memory is that of all angles, and of the joints."""
        shapes = array_shapes(file.path)
        known = [shapes[key] for key in ("poses", "trans", "betas", "gender", *PARTS, *RATES) if key in shapes]
        stored = sum(math.prod(shape) * kind.itemsize for shape, kind in known)
        # read, as doubles where it is stored otherwise, and put together where it comes in parts
        numbers = sum(math.prod(shape) * (0 if kind == np.float64 else 8) for shape, kind in known)
        together = 0 if "poses" in shapes else 8 * sum(math.prod(shapes[key][0]) for key in PARTS if key in shapes)
        frames = max((shape[0] for shape, _ in known if shape), default=0)
        block = min(frames, _AT_ONCE) * (len(BODY) + len(HANDS) + len(FACE)) * 400
        need = stored + numbers + together + block + body_bytes(frames, joints)
        return Extent(frames, need, settings.override_rate_hz)

    def read(self, file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings) -> Body:
        """Read an AMASS file with the body model of the settings.

        Raises
        ------
        SourceError
            The file is damaged, no mapping fits, no rate is known, or there is no body model.
        """
        path = file.path
        poses = parse_amass(path)
        if settings.body_model is None:
            raise SourceError(
                path,
                "holds the joint angles of a body (AMASS); the places of its joints at rest are in a body model, which "
                "may not come with kinedex: give `body_model`, your model.npz of SMPL-H or a table of its joints at "
                "rest; docs/formats.md explains it",
            )
        model = load_body_model(settings.body_model, poses.gender)
        warnings: list[str] = []
        rest = model.rest(poses.shape)
        if poses.shape.any() and not model.shapes.shape[2]:
            warnings.append("the figure has the shape of the body model; that of the file (betas) is not used")
        fit = mappings.detect(path, "amass", {name: i for i, name in enumerate(model.names)})
        positions, turned = _posed(poses, model, rest, fit, joints)
        unit_m = fit.mapping.unit_m or 1.0
        positions *= unit_m
        refuse_far(path, positions, joints, fit.unknown)
        if poses.rate_hz is not None:
            rate_hz = settings.rate_of(poses.rate_hz, warnings)
        elif (set_hz := settings.override_rate_hz or settings.rate_hz) is not None:
            rate_hz = set_hz
        else:
            raise SourceError(path, f"has none of {', '.join(RATES)}: give `rate_hz`, or --rate")
        return Body(
            positions=positions,
            orientation=mapped_orientation(fit, turned),
            rate_hz=rate_hz,
            unit=f"{unit_m:.6g} m",
            skeleton=fit.mapping.name,
            unknown=fit.unknown,
            warnings=(*warnings, *virtual_joint_warnings(fit)),
        )


def _posed(poses: Poses, model: BodyModel, rest: F64, fit: Fit, joints: tuple[str, ...]) -> tuple[F64, F64]:
    """Return the named joints (J, 3, T) and the root's rotation (9, T), computed in blocks of frames."""
    frames = len(poses.turns)
    positions, turned = np.empty((len(joints), 3, frames)), np.empty((9, frames))
    for start in range(0, frames, _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        given = poses.turns[part]
        turns = np.zeros((len(given), len(model.names), 3))
        for i, name in enumerate(model.names):
            if name in poses.names:
                turns[:, i] = given[:, poses.names.index(name)]
        places, turned[:, part] = axisangle.forward(rest, model.parents, turns, poses.places[part])
        positions[:, :, part] = fit.apply(places, joints)
    return positions, turned


def parse_amass(path: Path) -> Poses:
    """Read the angles of an AMASS file, in one array (`poses`) or in parts (`root_orient`, `pose_body`, …).

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    SourceError
        An array is missing, has another shape, or holds something else than numbers.
    """
    arrays, names = load_arrays(path, ("poses", "trans", "betas", "gender", *PARTS, *RATES))
    posed, turns = _turns(path, arrays)
    frames = len(turns)
    if "trans" not in arrays:
        raise SourceError(path, f"has no `trans`, where the body is in every frame; it has {', '.join(names)}")
    places = _numbers(path, arrays, "trans")
    if places.shape != (frames, 3):
        raise SourceError(
            path, f"`trans` must have {frames} frames of 3 numbers, as many as angles, got {places.shape}"
        )
    shape = _numbers(path, arrays, "betas").ravel() if "betas" in arrays else np.zeros(0)
    rate = next((_numbers(path, arrays, key) for key in RATES if key in arrays), None)
    if rate is not None and (rate.size != 1 or not SLOWEST_HZ <= float(rate.ravel()[0]) <= FASTEST_HZ):
        raise SourceError(path, f"the rate must be one number, {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz, got {rate}")
    rate_hz = None if rate is None else float(rate.ravel()[0])
    return Poses(posed, turns, places, shape, _gender(path, arrays), rate_hz)


def _turns(path: Path, arrays: dict[str, Any]) -> tuple[tuple[str, ...], F64]:
    """Return the joints that turn, and their rotation vectors (T, J, 3)."""
    if "poses" in arrays:
        poses = _angles(path, arrays, "poses")
        if poses.shape[1] not in _POSED:
            counts = ", ".join(str(3 * count) for count in _POSED)
            raise SourceError(path, f"`poses` must have {counts} angles a frame, got {3 * poses.shape[1]}")
        return _POSED[poses.shape[1]], poses
    names: list[str] = []
    parts: list[F64] = []
    for key, joints in zip(PARTS, (BODY[:1], BODY[1:], HANDS, FACE[:1], FACE[1:]), strict=True):
        if key not in arrays:
            if key in PARTS[:2]:
                raise SourceError(path, f"has no `{key}`, nor `poses`")
            continue
        part = _angles(path, arrays, key)
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
        raise SourceError(path, f"`{key}` has numbers that are none, infinite, or beyond {LARGEST:g}")
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
