"""Tracks for tests: takes of a small archive whose joints a kinematic chain is fitted to."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.body.pose_fit import fit_poses, measured_body
from kinedex.pipelines.tracking.tracked_takes import Provenance, Track
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store


def joints_of(store: Store, take: str) -> np.ndarray:
    """The joints (J, 3, T) of a take, in the order of the kinematic chain."""
    chain = load_kinematic_chain()
    places = joint_positions(store.frames(take), store.feature_set.joints).astype(np.float64)
    order = [store.feature_set.joints.index(joint) for joint in chain.joints]
    return np.ascontiguousarray(places[order])


def fitted_track(store: Store, take: str, name: str, root: Path, **changes: object) -> Track:
    """A track that moves as a take does."""
    joints = joints_of(store, take)
    body = measured_body(load_kinematic_chain(), joints)
    origin = Provenance(str(root), "recordings.yaml", "ab" * 32, 1234, 5, name.removesuffix("_tracked"), ("c1", "c2"))
    poses = fit_poses(body, joints)
    valid = np.ones(joints.shape[2], bool)
    given = {"name": name, "provenance": origin, "body": body, "poses": poses, "rate_hz": store.rate_hz}
    return Track(**{**given, "valid": valid, "recipe": "first", **changes})  # type: ignore[arg-type]
