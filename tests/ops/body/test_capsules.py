"""The capsules of a body are as thick as the body is high."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.catalog.kinematics import load_kinematic_chain, load_surface
from kinedex.ops.body.capsules import Capsule, Surface, body_capsules, body_height
from kinedex.ops.body.kinematic_chain import ChainBody
from kinedex.ops.errors import ParameterError
from tests.ops.body.test_kinematic_chain import BODY

SURFACE = load_surface()


def test_radii_grow_with_the_height_from_the_ankles_to_the_top_of_the_head() -> None:
    # 0.42 + 0.42 of the leg, 0.08 of the hips' drop, 0.12 + 0.12 + 0.14 of the trunk, 0.1 + 0.16 of the head
    assert body_height(BODY, SURFACE.low, SURFACE.high) == pytest.approx(1.56)
    small, thick = body_capsules(BODY, SURFACE), body_capsules(BODY, SURFACE, 1.04)
    radii = np.array([capsule.radius for capsule in SURFACE.capsules])
    np.testing.assert_allclose(small.radii, radii * 1.56 / 1.58)
    np.testing.assert_allclose(thick.radii, small.radii * 1.04)
    twice = body_capsules(ChainBody(BODY.chain, 2 * BODY.offsets), SURFACE)
    np.testing.assert_allclose(twice.radii, 2 * small.radii)
    joints = load_kinematic_chain().joints
    assert (joints[small.starts[0]], joints[small.ends[0]]) == ("root", "belly")


def test_surfaces_without_size_are_refused() -> None:
    with pytest.raises(ParameterError, match="thickness must be positive and finite, got 0"):
        body_capsules(BODY, SURFACE, 0)
    with pytest.raises(ParameterError, match="radius must be positive and finite, got nan"):
        Surface((Capsule(0, 1, np.nan),), (0,), 1, 1.58)
    with pytest.raises(ParameterError, match="offsets must be those of a body whose head is above its ankles"):
        body_capsules(ChainBody(BODY.chain, -BODY.offsets), SURFACE)
