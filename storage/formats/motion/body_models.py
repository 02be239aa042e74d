"""Load body models, the rest joints of a figure, from files of the user, since none may be distributed."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.catalog.configs import load_yaml
from kinedex.ops.errors import SourceError, did_you_mean
from kinedex.storage.formats.motion.numpy_arrays import load_arrays
from kinedex.storage.formats.source_files import stamp_of

F64 = npt.NDArray[np.float64]

BODY = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
)  # fmt: skip
"""The joints with which all SMPL bodies begin, in their order."""

FACE = ("jaw", "left_eye", "right_eye")
"""The joints that follow these in SMPL-X."""

HANDS = tuple(
    f"{side}_{finger}{i}"
    for side in ("left", "right")
    for finger in ("index", "middle", "pinky", "ring", "thumb")
    for i in (1, 2, 3)
)
"""The joints of the fingers of SMPL-H and SMPL-X, in their order."""

GENDERS = ("male", "female", "neutral")

_PARENTS = dict(
    zip(
        BODY[1:], [BODY[i] for i in (0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)], strict=True
    )
)
JOINTS_BY_COUNT = {22: BODY, 24: (*BODY, "left_hand", "right_hand"), 52: (*BODY, *HANDS), 55: (*BODY, *FACE, *HANDS)}
"""A dict from number of joints to the joints of the bodies of SMPL, SMPL-H and SMPL-X with as many, in their order."""
_MODEL = ("v_template", "J_regressor", "shapedirs")
_TABLE = ("joints", "names", "shapes")
LARGEST = 1e9
"""The largest plausible angle, position or number of a body model; larger ones would overflow in computations."""

_MAX_SHAPES = 16  # AMASS uses this many; models have up to 400


@dataclass(frozen=True)
class BodyModel:
    """The joints of a figure at rest, in metres, standing along Y and facing +Z.

    Attributes
    ----------
    names : tuple of str
        Names of the J joints, every joint after its parent.
    parents : tuple of int
        Index of each joint's parent; −1 for the first.
    joints : float64 array (J, 3)
        Joints of the mean shape.
    shapes : float64 array (J, 3, B)
        Change of the joints by each of B shape parameters; B is 0 if the model has one shape only.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    joints: F64
    shapes: F64

    def rest(self, shape: F64) -> F64:
        """Return the rest joints (J, 3) of a body with shape parameters (betas)."""
        count = min(len(shape), self.shapes.shape[2])
        moved: F64 = self.joints + self.shapes[:, :, :count] @ shape[:count]
        return moved


def model_path(given: str, gender: str) -> Path:
    """Return the file of a body model; `{gender}` in the setting stands for male, female or neutral."""
    return Path(given.replace("{gender}", gender)).expanduser()


def model_digest(given: str | None) -> str:
    """Return paths, sizes and times of a body model's files, for the checksum of takes that are read with it."""
    if given is None:
        return ""
    stamps = {str(path): stamp_of(path) for path in (model_path(given, gender) for gender in GENDERS)}
    return " ".join(f"{path}:{size}:{time}" for path, (size, time) in stamps.items())


def load_body_model(given: str, gender: str) -> BodyModel:
    """Read a body model.

    An .npz holds the model itself (`v_template`, `J_regressor`, perhaps `shapedirs`), or its `joints` (J, 3), perhaps
    with `names` and `shapes` (J, 3, B). A .csv has the columns joint, x, y, z. A .yaml has `joints: {pelvis: [x, y, z],
    …}`. Without names the joints are the 22, 24 (SMPL), 52 (SMPL-H) or 55 (SMPL-X) in the usual order.

    Parameters
    ----------
    given : str
        Path of the file, perhaps with `{gender}`.
    gender : str
        "male", "female" or "neutral".

    Raises
    ------
    SourceError
        There is no such file, or it is damaged.
    """
    path = model_path(given, gender)
    return _load(str(path), stamp_of(path))


@lru_cache(maxsize=4)
def _load(text: str, _stamp: tuple[int, int]) -> BodyModel:
    path = Path(text)
    if not path.is_file():
        raise SourceError(
            path, "no such body model; `body_model` gives its path, {gender} in it stands for the figure's"
        )
    ending = path.suffix.lower()
    if ending == ".npz":
        names, joints, shapes = _from_arrays(path)
    elif ending == ".csv":
        names, joints, shapes = _from_csv(path)
    elif ending in (".yaml", ".yml"):
        names, joints, shapes = _from_yaml(path)
    else:
        raise SourceError(path, "a body model is an .npz, .csv or .yaml file")
    return _model(path, names, joints, shapes)


def _from_arrays(path: Path) -> tuple[tuple[str, ...], F64, F64]:
    arrays, others = load_arrays(path, (*_MODEL, *_TABLE))
    if "joints" in arrays:
        joints = _numbers(path, arrays, "joints", 2)
        shapes = _numbers(path, arrays, "shapes", 3) if "shapes" in arrays else np.zeros((len(joints), 3, 0))
    elif {"v_template", "J_regressor"} <= set(arrays):
        regressor, skin = _numbers(path, arrays, "J_regressor", 2), _numbers(path, arrays, "v_template", 2)
        if regressor.shape[1] != len(skin) or skin.shape[1:] != (3,):
            raise SourceError(path, f"J_regressor {regressor.shape} and v_template {skin.shape} do not go together")
        joints = regressor @ skin
        shapes = np.zeros((len(joints), 3, 0))
        if "shapedirs" in arrays:
            moved = _numbers(path, arrays, "shapedirs", 3)[:, :, :_MAX_SHAPES]
            if moved.shape[:2] != skin.shape:
                raise SourceError(path, f"shapedirs {moved.shape} and v_template {skin.shape} do not go together")
            shapes = np.einsum("jv,vab->jab", regressor, moved)
    else:
        raise SourceError(
            path, f"must have `joints`, or `v_template` and `J_regressor`{did_you_mean('J_regressor', others)}"
        )
    names = tuple(str(name) for name in arrays["names"].ravel()) if "names" in arrays else ()
    return names, joints, shapes


def _from_csv(path: Path) -> tuple[tuple[str, ...], F64, F64]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as fault:
        raise SourceError(path, f"cannot be read: {fault}") from None
    names, positions = [], []
    for line, row in enumerate(rows, 2):
        try:
            names.append(str(row["joint"]).strip())
            positions.append([float(row[axis]) for axis in "xyz"])
        except (KeyError, TypeError, ValueError):
            raise SourceError(path, "expected columns joint, x, y, z, with numbers of metres", line=line) from None
    return tuple(names), np.array(positions, dtype=np.float64).reshape(-1, 3), np.zeros((len(names), 3, 0))


def _from_yaml(path: Path) -> tuple[tuple[str, ...], F64, F64]:
    located = load_yaml(path)
    joints = located.mapping().get("joints")
    if not isinstance(joints, dict):
        raise located.error("expected `joints: {pelvis: [x, y, z], ...}`", "joints")
    for name, place in joints.items():
        if not isinstance(place, list) or len(place) != 3 or not all(isinstance(x, (int, float)) for x in place):
            raise located.error(f"expected three numbers of metres, got {place!r}", "joints", name)
    positions = np.array(list(joints.values()), dtype=np.float64).reshape(-1, 3)
    return tuple(map(str, joints)), positions, np.zeros((len(joints), 3, 0))


def _numbers(path: Path, arrays: dict[str, Any], key: str, axes: int) -> F64:
    array = arrays[key]
    if array.dtype.kind not in "fiu" or array.ndim != axes:
        raise SourceError(path, f"`{key}` must be numbers in {axes} dimensions, got {array.shape} of {array.dtype}")
    numbers = np.asarray(array, dtype=np.float64)
    if not (np.abs(numbers) <= LARGEST).all():
        raise SourceError(path, f"`{key}` has numbers that are NaN, infinite or beyond {LARGEST:g}")
    return numbers


def _model(path: Path, names: tuple[str, ...], joints: F64, shapes: F64) -> BodyModel:
    """Return the model with SMPL's joints by name, in SMPL's order; other joints are ignored."""
    if not names:
        if len(joints) not in JOINTS_BY_COUNT:
            counts = ", ".join(map(str, JOINTS_BY_COUNT))
            raise SourceError(path, f"has {len(joints)} joints without `names`; of {counts} they would be known")
        names = JOINTS_BY_COUNT[len(joints)]
    if len(names) != len(joints) or joints.shape[1:] != (3,) or shapes.shape[:2] != joints.shape:
        raise SourceError(
            path, f"{len(names)} names, joints of shape {joints.shape} and shapes of {shapes.shape} do not go together"
        )
    wrong = np.flatnonzero(~(np.abs(joints) <= LARGEST).all(axis=1))
    if len(wrong):
        raise SourceError(path, f"joint '{names[wrong[0]]}' has coordinates that are not finite, or beyond {LARGEST:g}")
    for name in BODY:
        if name not in names:
            raise SourceError(path, f"lacks the joint '{name}'{did_you_mean(name, names)}")
    order = [name for name in (*BODY, "left_hand", "right_hand", *FACE, *HANDS) if name in names]
    index = [names.index(name) for name in order]
    parents = tuple(_parent(name, order) for name in order)
    return BodyModel(tuple(order), parents, joints[index], shapes[index])


def _parent(name: str, order: list[str]) -> int:
    if name in _PARENTS:
        return order.index(_PARENTS[name])
    if name in FACE:
        return order.index("head")
    if name in HANDS:
        before = f"{name[:-1]}{int(name[-1]) - 1}"
        return order.index(before if before in order else f"{name.split('_')[0]}_wrist")
    return order.index(f"{name.split('_')[0]}_wrist") if name.endswith("_hand") else -1
