"""Bodies are recognised in skeleton trees of many dialects, whatever their names and axes; others are refused."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.recognition.recognised_tree import recognise_tree
from tests.skeleton_dialects import DIALECTS, evidence_of

JOINTS = load_feature_set().joints
NEAR_M = 0.05


@pytest.mark.parametrize("name", DIALECTS)
def test_a_body_of_a_dialect_comes_in_with_its_joints_in_place(name: str) -> None:
    evidence, truth = evidence_of(DIALECTS[name])
    fit = recognise_tree("x", evidence, JOINTS)
    assert fit.unknown == ()
    placed = dict(zip(JOINTS, fit.apply(evidence.places, JOINTS), strict=True))
    far = {joint: np.linalg.norm(placed[joint] - place, axis=0).max() for joint, place in truth.items()}
    assert {joint: round(float(d), 3) for joint, d in far.items() if d > NEAR_M} == {}
    assert fit.confidence > 0.6 or name == "nameless"
