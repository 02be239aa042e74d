"""A root in another unit than the bones is found where feet would stand on the floor; other roots are left alone."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.root_units import FACTORS, root_factor

JOINTS = load_feature_set().joints


def walk(scale: float = 1.0, height: float = 95.0, speed: float = 4.0) -> np.ndarray:
    """Joints of a body in centimetres whose feet stand in turn, with the root's places times a scale."""
    frames = np.arange(120)
    positions = np.zeros((len(JOINTS), 3, len(frames)))
    root = np.stack([np.zeros(120), height + np.sin(frames / 5), speed * frames])
    stride = 8 * speed
    for side, shift in (("l", 0), ("r", 8)):
        steps = (frames + shift) // 16
        ankle = np.stack([np.full(120, 8.0 if side == "l" else -8.0), np.full(120, 8.0), 2 * stride * steps])
        ankle[:, ((frames + shift) % 16) > 11] += 10.0
        for joint, place in (("hip", root), ("knee", 0.5 * (root + ankle)), ("ankle", ankle)):
            positions[JOINTS.index(f"{side}{joint}")] = place - root
        positions[JOINTS.index(f"{side}toes")] = ankle + np.array([[0.0], [-6.0], [12.0]]) - root
    return positions + scale * root


def test_a_root_in_the_unit_of_the_bones_is_left_alone() -> None:
    assert root_factor(walk(), JOINTS) is None


@pytest.mark.parametrize("factor", FACTORS)
def test_a_root_in_another_unit_is_found(factor: float) -> None:
    assert root_factor(walk(1 / factor), JOINTS) == pytest.approx(factor)


@pytest.mark.parametrize("height", [0.9, 190.0, 0.0, 4000.0])
def test_a_body_far_from_a_floor_or_centred_at_its_root_is_left_alone(height: float) -> None:
    moving = walk(height=0.0) + np.array([[0.0], [height], [0.0]])
    assert root_factor(moving, JOINTS) is None
    still = walk(speed=0.0, height=95.0) - np.array([[0.0], [95.0 - height], [0.0]])
    assert root_factor(still, JOINTS) is None


def test_absurd_places_say_nothing() -> None:
    absurd = walk()
    absurd[:, :, 0] = np.inf
    assert root_factor(absurd, JOINTS) is None
