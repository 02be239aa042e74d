"""The explorer says why an interval is of a class."""

from __future__ import annotations

from pathlib import Path

from kinedex.storage.store.store import open_store
from tests.explorer.conftest import Connect


def test_an_interval_is_explained_with_the_command(connect: Connect, moving: Path) -> None:
    client, take_id = connect(moving), open_store(moving).take_ids["take_00"]
    asked = f"/api/takes/{take_id}/explain?start=0&stop=36"
    found = client.get(asked).json()
    assert (found["label"], found["probability"] > 0.9) == ("raise left", True)
    assert "left hand" in found["reasons"][0]["quantity"] or "right hand" in found["reasons"][0]["quantity"]
    other = client.get(f"{asked}&class=raise%20right").json()
    assert (other["label"], other["other"]) == ("raise right", "raise left")
    assert other["reasons"][0]["speaks"] == "against"
    assert other["command"].endswith("take_00 0 36 --class 'raise right'")


def test_intervals_and_classes_that_are_not_there_are_refused(connect: Connect, moving: Path) -> None:
    client, take_id = connect(moving), open_store(moving).take_ids["take_00"]
    assert client.get(f"/api/takes/{take_id}/explain?start=5&stop=500").status_code == 422
    assert "did you mean 'bow'" in client.get(f"/api/takes/{take_id}/explain?start=0&stop=9&class=bowe").text
