"""Labels of a store that are probably wrong are listed with what fits better."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

import kinedex
from kinedex.commands.cli import app
from kinedex.ops.errors import KinedexError

WRONG, RIGHT = "squat1Reps", "kickLeft1Reps"


def planted(store: kinedex.Store) -> tuple[str, str]:
    """Label the clip of a class as another class; return the take and the id of the label."""
    take = store.takes(f"class = '{RIGHT}'").sort("name").row(0, named=True)
    row = {"take": take["name"], "class": WRONG, "start": 0, "stop": take["frames"]}
    return take["name"], store.labels.add([row])["id"][0]


def test_a_wrong_label_is_suspect_and_the_right_class_is_proposed(store: kinedex.Store) -> None:
    take, id = planted(store)
    try:
        found = store.labels.suspects()
        first = found.filter(found["id"] == id).row(0, named=True)
        assert (first["take"], first["kind"], first["new_class"], first["source"]) == (take, "class", RIGHT, "label")
        assert first["probability"] < 0.05
        assert found["suspicion"].is_sorted(descending=True)
        assert store.labels.suspects(f"id = '{id}'").height == 1
        ran = CliRunner().invoke(app, ["labels", "suspects", str(store.path), "--take", take, "--json"])
        shown = json.loads(ran.stdout)
        assert [one["id"] for one in shown["suspects"] if one["class"] == WRONG] == [id]
        assert shown["judged"] == store.takes("class IS NOT NULL").height + 1
        ran = CliRunner().invoke(app, ["labels", "suspects", str(store.path), "--class", WRONG, "--top", "1"])
        assert take in ran.stdout
        assert f"{RIGHT}\n" in ran.stdout or f"{RIGHT} " in ran.stdout
    finally:
        store.labels.remove([id])


def test_labels_that_cannot_be_judged_are_counted_with_the_reason(store: kinedex.Store) -> None:
    take = store.takes("class IS NOT NULL")["name"][0]
    made = store.labels.add([{"take": take, "class": "nod", "start": 3, "stop": 12}])
    try:
        with pytest.warns(UserWarning, match="1 label not judged: no other label of its class can be judged"):
            store.labels.suspects()
    finally:
        store.labels.remove(made["id"])


def test_a_filter_that_does_not_work_names_the_columns(store: kinedex.Store) -> None:
    with pytest.raises(KinedexError, match="columns of suspects: take, take_id, class"):
        store.labels.suspects("confidence > 1")
