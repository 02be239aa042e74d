"""The explorer lists labels that are probably wrong, and judges anew when a label changes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.explorer.conftest import Connect
from tests.explorer.test_labels import new


def test_suspects_are_listed_with_the_command_and_change_with_the_labels(connect: Connect, moving: Path) -> None:
    client = connect(moving)

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
    assert remark.startswith("8 labels not judged: positions must be with legs that have a length")
