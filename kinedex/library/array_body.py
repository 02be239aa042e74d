"""Make a body from an array of joint positions, as readers of files make it, after checks of the array."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import ParameterError

if TYPE_CHECKING:
    from kinedex.storage.formats.motion.reader import Body

Bool = npt.NDArray[np.bool_]

_BLOCK = 256  # frames that are transposed at a time, so that they stay in the cache


def body_of_array(
    positions: npt.ArrayLike,
    rate: float,
    feature_set: FeatureSet,
    joints: Sequence[str] | None,
    orientation: npt.ArrayLike | None,
) -> Body:
    """Return a body with the joint positions of an array."""
    from kinedex.storage.formats.motion.points import root_orientation
    from kinedex.storage.formats.motion.reader import Body

    check_rate(rate)
    names = feature_set.joints if joints is None else tuple(joints)
    given = np.asarray(positions, np.float64)
    if given.ndim != 3 or given.shape[1:] != (len(names), 3) or not len(given):
        raise ParameterError("positions", f"of shape (frames, {len(names)}, 3) with at least 1 frame", given.shape)
    odd = sorted(set(names) - set(feature_set.joints))
    if odd or len(set(names)) < len(names):
        raise ParameterError("joints", f"different names among {', '.join(feature_set.joints)}", odd or list(names))
    placed = np.empty((len(feature_set.joints), 3, len(given)))
    placed[[name not in names for name in feature_set.joints]] = np.nan
    places = [feature_set.joints.index(name) for name in names]
    for start in range(0, len(given), _BLOCK):
        placed[places, :, start : start + _BLOCK] = given[start : start + _BLOCK].transpose(1, 2, 0)
    lost: Bool = np.any(np.isnan(placed), axis=1)
    unknown: Bool = np.all(lost, axis=1)
    valid: Bool = ~np.any(lost[~unknown], axis=0)
    if unknown.all() or not valid.any():
        raise ParameterError("positions", "finite for every joint in at least one frame", "NaN in every frame")
    warnings: list[str] = []
    if orientation is None:
        turned = root_orientation(placed, feature_set.joints, valid, warnings)
    else:
        turned = np.asarray(orientation, np.float64).T
        if turned.shape != (4, len(given)):
            raise ParameterError("orientation", f"of shape ({len(given)}, 4)", turned.T.shape)
    return Body(
        positions=placed,
        orientation=np.ascontiguousarray(turned),
        rate_hz=float(rate),
        unit="1 m",
        skeleton="array",
        unknown=tuple(name for name, gone in zip(feature_set.joints, unknown, strict=True) if gone),
        warnings=tuple(warnings),
        valid=None if valid.all() else valid,
    )


def check_rate(rate: float) -> None:
    """Raise a ParameterError if a rate is outside of the range that is allowed for motion files."""
    from kinedex.storage.formats.motion.reader import FASTEST_HZ, SLOWEST_HZ

    if not (math.isfinite(rate) and SLOWEST_HZ <= rate <= FASTEST_HZ):
        raise ParameterError("rate", f"from {SLOWEST_HZ:g} to {FASTEST_HZ:g} frames per second", rate)
