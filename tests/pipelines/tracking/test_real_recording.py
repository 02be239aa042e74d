"""A real recording goes through whole: four cameras, 100 frames, compared with the triangulation of another program."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.commands.cli import app
from kinedex.ops.body.kinematic_chain import ChainBody, forward
from kinedex.ops.tracking.triangulation import triangulate
from kinedex.pipelines.tracking.observed_recordings import stored_recording
from kinedex.pipelines.tracking.tracked_takes import LIMBS, poses_of, stored_poses, track_errors, truth_reference
from kinedex.storage.store.store import open_store


def test_a_real_recording_is_tracked_and_near_its_own_triangulation(shared: Path, tmp_path: Path) -> None:
    trial = shared / "data" / "cameras" / "balancing"
    session = trial / "S00_P00_T01_BalancingTrial"
    truth = session / "pose-3d" / "S00_P00_T01_BalancingTrial_0-100.trc"
    entry = {
        "cameras": str(trial / "Calib_qualisys.toml"),
        "keypoints": str(session / "pose" / "{camera}_json" / "*.json"),
        "rate_hz": 60,
        "truth": str(truth),
    }
    (tmp_path / "recordings.yaml").write_text(json.dumps({"recordings": {"balance": entry}}))
    done = CliRunner().invoke(app, ["track", str(tmp_path / "store"), str(tmp_path / "recordings.yaml")])
    assert done.exit_code == 0, done.output
    store = open_store(tmp_path / "store")
    (row,) = store.result("tracks").to_pylist()
    assert (row["take"], row["source_frames"], row["rate_hz"]) == ("balance_tracked", 100, 60.0)
    cameras = {one["camera"]: one["median_px"] for one in store.result("track_cameras").to_pylist()}
    assert len(cameras) == 4
    assert max(cameras.values()) < 3 * float(np.median(list(cameras.values())))
    poses = poses_of(store, "track/track", row["take_id"])
    assert np.isfinite(stored_poses(poses, len(row["nodes"])).rotations).all()
    reference = truth_reference(store, str(truth), Path(), "balance")
    figures = {one["name"]: one["median_mm"] for one in track_errors(row, poses, reference)}
    assert figures["all"] < 25
    # where all four cameras agree on a joint of a limb
    recording = stored_recording(store, "balance").recording
    assert recording is not None
    chain = load_kinematic_chain()
    body = ChainBody(chain, np.array(row["body"]).reshape(-1, 3))
    joints, _ = forward(body, stored_poses(poses, len(chain.nodes)))
    _, agreeing = triangulate(recording.rays())
    points = recording.body_points(body)
    limbs = [p for p, joint in enumerate(points.joints) if joint >= 0 and chain.joints[joint] in LIMBS]
    own = points.joints[limbs]
    gaps = 1000.0 * np.linalg.norm(joints[own] - reference.joints[own], axis=1).T
    assert np.nanmedian(gaps[agreeing[:, limbs] == 4]) < 20
