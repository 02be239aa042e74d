"""Tracks for tests: takes of a small archive, fitted by a kinematic chain, or filmed by simulated cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.console.terminal import Terminal
from kinedex.ops.body.pose_fit import fit_poses, measured_body
from kinedex.ops.simulation.recording import Setup
from kinedex.pipelines.engine.runner import Outcome, run_pipeline
from kinedex.pipelines.simulation.simulated_cameras import CameraRequest, simulate_cameras
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.pipelines.tracking.recorded_takes import Provenance
from kinedex.pipelines.tracking.tracked_takes import Track
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store, open_store
from tests.pipelines.archives import context, write_archive

PATTERNS = [r"x_(?P<actor>[a-z]+)_(?P<class>hop|sway)_(?P<clip>\d)"]
FILMED = "x_al_hop_1"


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


def filmed_archive(folder: Path) -> None:
    """Make an archive of four clips in a folder, and film one of them."""
    clips = {f"x_{actor}_{name}_1.amc": 160 for actor in ("al", "bo") for name in ("hop", "sway")}
    write_archive(folder / "source", clips)
    Ingest().run(context(folder / "store"), Ingest.parameters(source=str(folder / "source"), patterns=PATTERNS))
    with open_store(folder / "store", at="newest") as store:
        simulate_cameras(store, CameraRequest((FILMED,), None, 3, Setup()), folder / "sim", Terminal().progress)


def run(folder: Path, **settings: object) -> Outcome:
    given = {
        "source": str(folder / "source"),
        "recordings": str(folder / "sim" / "recordings.yaml"),
        "patterns": PATTERNS,
        "train": "class IS NOT NULL AND actor <> 'al'",
        "stabilise.rounds": 1,
        **settings,
    }
    return run_pipeline("stabilise", folder / "store", settings=given, executor="serial")
