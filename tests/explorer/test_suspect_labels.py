"""The explorer lists labels that are probably wrong, and judges anew when a label changes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinedex.storage.index.builder import build_index
from kinedex.storage.store.store import open_store
from tests.explorer.conftest import Connect
from tests.explorer.test_labels import new
from tests.ops.numeric.motions import motion
from tests.pipelines.labelled import write_store

NAMES = ("raise left", "bow", "raise right")


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    """Return a store of eighteen takes with a class, one of which bows but is called a walk by a label."""
    takes = []
    for k in range(18):
        body = motion(NAMES[k % 3], 36 + k, k)
        row = {"name": f"take_{k:02d}", "actor": "al", "class": NAMES[k % 3], "words": np.zeros(len(body), np.uint64)}
        takes.append(row | {"positions": body.transpose(1, 2, 0)})
    path = write_store(tmp_path / "archive", takes)
    build_index(open_store(path, at="newest"))
    return path


def test_suspects_are_listed_with_the_command_and_change_with_the_labels(connect: Connect, archive: Path) -> None:
    client = connect(archive)

    def suspects(**asked: Any) -> dict[str, Any]:
        answer = client.post("/api/labels/suspects", json=asked)
        assert answer.status_code == 200, answer.text
        found: dict[str, Any] = answer.json()
        return found

    before = suspects()
    assert before["judged"] == 18
    assert not [one for one in before["rows"] if one["source"] == "label"]
    id = new()
    change = {"do": "draw", "id": id, "class": "raise left", "start": 0, "stop": 37}
    client.post("/api/labels/decide", json={"take": "take_01", "annotator": "ann", "changes": [change]})
    found = suspects()
    assert found["judged"] == 19
    first = found["rows"][0]
    assert (first["take"], first["class"], first["kind"], first["new_class"]) == (
        "take_01",
        "raise left",
        "class",
        "bow",
    )
    assert first["source"] == "label"
    assert suspects(classes=["raise left"], where="kind = 'class'")["total"] == 1
    assert "--class 'raise left'" in suspects(classes=["raise left"])["command"]
    assert suspects(takes=["take_02"])["rows"] == [one for one in found["rows"] if one["take"] == "take_02"]
    assert client.post("/api/labels/suspects", json={"where": "nothing"}).status_code == 400


def test_labels_without_a_body_are_counted(connect: Connect) -> None:
    found = connect().post("/api/labels/suspects", json={}).json()
    assert (found["judged"], found["total"]) == (0, 0)
    (remark,) = found["remarks"]
    assert remark.startswith("8 labels not judged: positions must be with hips or shoulders that are apart from above")
