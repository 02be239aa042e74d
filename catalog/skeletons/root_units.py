"""Find a root that moves in another unit than the bones are measured in, by the floor and by feet that stand still."""

from __future__ import annotations

import numpy as np

from kinedex.ops.arrays import F64

FACTORS = (100.0, 0.01, 1000.0, 0.001, 1 / 0.0254, 0.0254, 2.54, 1 / 2.54)
"""The factors that are tried: between metres, centimetres, millimetres and inches."""

OTHER_ROOT_UNIT = "its root seems to move in another unit than that of the bones"
"""The words with which warnings on such roots begin."""

_FEET = ("lankle", "rankle", "ltoes", "rtoes")
_ON_FLOOR = 0.12  # share of the legs by which the lowest foot may be off a floor at 0
_OFF_FLOOR = 0.3  # share of the legs from which on the lowest foot is doubted
_STILL = 0.75  # share to which the way of the foot that moves least must fall; it is 0.6 or less of walks at hand
_FRAMES = 32


@np.errstate(over="ignore", invalid="ignore")  # Absurd numbers are refused elsewhere.
def root_factor(positions: F64, joints: tuple[str, ...]) -> float | None:
    """Return the factor from the unit of the root to that of the bones; None if none is needed or found.

    A factor of `FACTORS` is found if the lowest foot, which is far from a height of 0 in the file, comes to lie near 0
    with it, and if the foot that stands best moves clearly less between frames than without the factor.

    Parameters
    ----------
    positions : float64 array (J, 3, T)
        The joints, Y up, in any unit.
    joints : tuple of str
        The names of the J joints.
    """
    if not {"root", "lhip", "lknee", *_FEET} <= set(joints):
        return None
    at = {joint: joints.index(joint) for joint in ("root", "lhip", "lknee", *_FEET)}
    hip, knee, ankle = (positions[at[joint], :, 0] for joint in ("lhip", "lknee", "lankle"))
    leg = float(np.sqrt(((hip - knee) ** 2).sum()) + np.sqrt(((knee - ankle) ** 2).sum()))
    step = -(-positions.shape[2] // _FRAMES)
    feet = positions[[at[joint] for joint in _FEET]]
    low = float(feet[:, 1, ::step].min())
    if not leg > 0 or not abs(low) > _OFF_FLOOR * leg:
        return None
    return _factor(positions[at["root"]], feet, leg, step)


def _factor(root: F64, feet: F64, leg: float, step: int) -> float | None:
    """Return the first factor with which the feet (4, 3, T) reach the floor and stand better; None if there is none."""
    own = feet - root
    moved = np.diff(root, axis=1)
    turned = np.diff(own, axis=2)

    def way(factor: float) -> float:
        return float(np.median(np.sqrt(((factor * moved + turned) ** 2).sum(axis=1)).min(axis=0)))

    for factor in FACTORS:
        low = float((factor * root[1] + own[:, 1])[:, ::step].min())
        if abs(low) < _ON_FLOOR * leg and root.shape[1] > 1 and way(factor) < _STILL * way(1.0):
            return factor
    return None
