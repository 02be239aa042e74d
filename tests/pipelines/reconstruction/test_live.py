"""Frames of a live camera: followed while they are written, and saved as a take whatever ends the session."""

from __future__ import annotations

import json
import re
import shutil
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from kinedex.commands.cli import app
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.pipelines.reconstruction.followed_folder import FollowedFrame
from kinedex.storage.formats.motion.positions import parse_trc
from kinedex.storage.lock import Wait
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.pipelines.reconstruction.recordings import FILMED, FRAMES, filmed_by_depth

NAME = FILMED[0]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an archive of four clips, and recordings of two of them."""
    folder = tmp_path_factory.mktemp("live")
    filmed_by_depth(folder)
    return folder


@pytest.fixture
def frames(made: Path, tmp_path: Path) -> Path:
    """An empty folder that a camera writes into."""
    (tmp_path / "camera 1").mkdir()
    return tmp_path / "camera 1"


def follow(made: Path, frames: Path, *more: object, body: str = NAME, code: int = 0) -> tuple[list[Any], str]:
    """Follow a folder; return the JSON lines, and what was printed beside."""
    home = made / "rec" / NAME
    given = ("--camera", home / "camera.yaml", "--background", home / "background.png", "--body", body, "--json")
    words = ["reconstruct", made / "store", "--follow", frames, *given, *(more or ("--idle", 0.1))]
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == code, done.output
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith('{"')], done.stderr


def test_missing_and_damaged_frames_are_reported_and_the_take_has_the_others(made: Path, frames: Path) -> None:
    depth = made / "rec" / NAME / "depth"
    for path in depth.iterdir():
        if path.name != "000002.png":
            shutil.copy(path, frames)
    (frames / "000004.png").write_bytes(b"no image")
    (frames / "notes.txt").write_text("no frame")
    shutil.copy(made / "rec" / NAME / "background.png", frames / "empty room.png")
    (*lines, end), messages = follow(made, frames)
    assert [(one["frame"], one["skipped"], one["fault"] is not None) for one in lines] == [
        (0, 0, False), (1, 0, False), (3, 1, False), (4, 0, True), (5, 0, False), (6, 0, False), (7, 0, False),
    ]  # fmt: skip
    assert lines[3]["joints"] is None
    assert "empty room.png is passed over, as are all files without a number" in messages
    assert (end["take"], end["frames"]) == ("camera 1_live", FRAMES)
    assert any("2 frames without an image, missing or damaged: 2, 4" in text for text in end["remarks"])
    store = open_store(made / "store", at="newest")
    rows = store.sql("FROM reconstruction_frames WHERE take = 'camera 1_live' ORDER BY source_frame").to_pylist()
    assert [row["joints"] is None for row in rows] == [t in (2, 4) for t in range(FRAMES)]
    assert np.allclose(rows[7]["joints"], np.array(list(lines[6]["joints"].values())).ravel(), atol=1e-5)
    take = next(row for row in store.take_rows.to_pylist() if row["name"] == "camera 1_live")
    assert (take["format"], take["recording"], take["invalid_frames"]) == ("depth", "camera 1", 0)  # gaps are short
    assert store.sql("SELECT file FROM reconstructions WHERE take = 'camera 1_live'").to_pylist() == [{"file": None}]
    assert verify(store) == []
    assert follow(made, frames)[0][-1]["take"] == "camera 1_live_2"  # nothing is replaced
    assert verify(open_store(made / "store", at="newest")) == []


def test_half_written_files_are_waited_for_and_the_size_is_estimated(made: Path, frames: Path) -> None:
    camera = frames.parent / "camera.yaml"
    text = (made / "rec" / NAME / "camera.yaml").read_text()
    camera.write_text(re.sub(r"rate_hz: .*", "rate_hz: 5", text))

    def write() -> None:
        for path in sorted((made / "rec" / NAME / "depth").iterdir()):
            content = path.read_bytes()
            with (frames / path.name).open("wb", buffering=0) as file:
                for part in (content[:100], content[100:2000], content[2000:]):
                    file.write(part)
                    time.sleep(0.02)

    writer = threading.Thread(target=write)
    writer.start()
    (*lines, end), messages = follow(made, frames, "--camera", camera, "--idle", 3, body="estimate")
    writer.join(60)
    assert [(one["frame"], one["fault"]) for one in lines] == [(t, None) for t in range(FRAMES)]
    height = float(re.search(r"a person (\d\.\d\d) m tall, estimated", messages)[1])  # type: ignore[index]
    assert re.search(r"latency [\d.]+ ms in the median, 95 % within [\d.]+ ms, at worst", messages) or not any(
        one["latency_ms"] for one in lines[5:]
    )
    store = open_store(made / "store", at="newest")
    (row,) = store.sql(f"FROM reconstructions WHERE take = '{end['take']}'").to_pylist()
    assert row["body_from"] == "estimate"
    assert abs(row["height_m"] - height) < 0.006
    found = store.sql(f"SELECT joints FROM reconstruction_frames WHERE take = '{row['take']}' ORDER BY source_frame")
    places = np.array([one["joints"] for one in found.to_pylist()]).reshape(FRAMES, len(JOINTS), 3)
    shanks = np.linalg.norm(places[:, JOINTS.index("lknee")] - places[:, JOINTS.index("lankle")], axis=1)
    assert np.ptp(shanks) < 1e-6  # frames from before the estimation have the estimated bones, too


def test_what_was_seen_is_saved_whatever_ends_the_session(
    made: Path, frames: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(made / "rec" / NAME / "depth", frames, dirs_exist_ok=True)

    def stopped(one: FollowedFrame) -> dict[str, Any]:
        if one.number == 5:
            raise KeyboardInterrupt
        return {}

    with monkeypatch.context() as patch:
        patch.setattr(FollowedFrame, "document", stopped)
        assert follow(made, frames)[0][-1]["frames"] == 6
    for number in (100, 150, 200):
        shutil.copy(frames / "000007.png", frames / f"{number:06}.png")
    lines, _ = follow(made, frames, code=1)  # the numbers do not count frames
    assert lines[-1]["frames"] == 151


def test_a_store_that_another_process_writes_costs_no_frame(
    made: Path, frames: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(made / "rec" / NAME / "depth", frames, dirs_exist_ok=True)
    monkeypatch.chdir(frames.parent)
    store = open_store(made / "store", at="newest")
    with StoreWriter.open(made / "store", store.feature_set, store.rate_hz, Wait()):
        follow(made, frames, "--idle", 0.1, "--wait", "0.1s", code=1)
    points = parse_trc(frames.parent / "camera 1_live.trc")
    assert points.positions.shape[2] == FRAMES


def test_a_session_without_a_person_saves_nothing(made: Path, frames: Path) -> None:
    shutil.copy(made / "rec" / NAME / "background.png", frames / "000000.png")
    lines, messages = follow(made, frames, body="estimate")
    assert [one["hypothesis"] for one in lines] == [None]
    assert "nothing to save: nobody was seen" in messages
