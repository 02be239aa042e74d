"""This module mirrors motions across the plane x = 0, with left and right exchanged."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinedex.ops.arrays import F64


def mirrored_names(names: Sequence[str]) -> list[str]:
    """Return for each named joint the name of its mirror image: lhip for rhip, root for root.

    A name that begins with l or r has a mirror image where the other one is among the names, too.
    """
    known = set(names)
    others = {name: {"l": "r", "r": "l"}.get(name[:1], "") + name[1:] for name in names}
    return [others[name] if others[name] in known and name[:1] in "lr" else name for name in names]


def mirrored_places(places: F64, names: Sequence[str]) -> F64:
    """Return the joint positions of a body's mirror image.

    Parameters
    ----------
    places : float array (T, J, 3)
        Places of joints; NaN where a joint is not known.
    names : sequence of str
        The J joints; those that begin with l and r are pairs (`mirrored_names`).

    Returns
    -------
    float array (T, J, 3)
        Joint by joint in the order of the names. Mirroring twice restores the positions exactly.
    """
    index = {name: j for j, name in enumerate(names)}
    order = np.array([index[name] for name in mirrored_names(names)], np.int64)
    return places[:, order] * np.array([-1, 1, 1], places.dtype)


def mirrored_quaternions(turns: F64) -> F64:
    """Return the orientations of mirror images, float array (…, 4) w, x, y, z.

    They belong to a body whose own axes are mirrored, too: its left is +X as before.
    """
    return turns * np.array([1, 1, -1, -1], turns.dtype)
