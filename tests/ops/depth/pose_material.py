"""Poses for the tests of database, lookup and tracker: the standing person with limbs turned at random."""

from __future__ import annotations

import numpy as np

from kinedex.ops.depth.thinned_poses import bone_directions
from tests.ops.depth.cone_bodies import POSE, bone_lengths, random_pose

BONES = bone_lengths(POSE)


def random_directions(count: int, degrees: float = 25.0, first_seed: int = 0) -> np.ndarray:
    """The directions of poses whose pivots are turned by an angle about random axes."""
    return bone_directions(np.stack([random_pose(first_seed + seed, degrees) for seed in range(count)]))
