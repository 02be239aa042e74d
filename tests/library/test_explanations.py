"""Intervals of a store are explained by quantities, as examples of the store have them."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

import kinedex
from kinedex.commands.cli import app
from kinedex.ops.errors import KinedexError


def first_of(store: kinedex.Store, label: str) -> str:
    return str(store.takes(f"class = '{label}'").sort("name")["name"][0])


def test_a_clip_is_explained_as_its_class(store: kinedex.Store) -> None:
    found = store.explain(first_of(store, "kickLeft1Reps"))
    assert found.row(0, named=True)["class"] == "kickLeft1Reps"
    assert (found["speaks"] == "for").sum() > (found["speaks"] == "against").sum()
    assert found["share"].abs().is_sorted(descending=True)
    assert found["probability"][0] > 0.9


def test_the_other_leg_speaks_against_a_kick(store: kinedex.Store) -> None:
    found = store.explain(first_of(store, "kickLeft1Reps"), label="kickRight1Reps")
    assert set(found["other"]) == {"kickLeft1Reps"}
    against = found.filter(found["speaks"] == "against")["quantity"].to_list()
    assert any("right foot" in one or "right knee" in one for one in against)


def test_the_command_shows_the_same(store: kinedex.Store) -> None:
    take = first_of(store, "squat1Reps")
    ran = CliRunner().invoke(app, ["explain", str(store.path), take, "0", "0.9s", "--json"])
    shown = json.loads(ran.stdout)
    rows = store.explain(take, 0, 27)
    assert [one["text"] for one in shown["reasons"]] == rows["text"].to_list()[:12]
    assert shown["probability"] == pytest.approx(rows["probability"][0])
    ran = CliRunner().invoke(app, ["explain", str(store.path), take, "--top", "3", "--format", "csv"])
    assert len(ran.stdout.splitlines()) == 4


def test_a_class_that_nothing_teaches_is_refused(store: kinedex.Store) -> None:
    with pytest.raises(KinedexError, match="teaches the class 'squat1Rep'; did you mean 'squat1Reps'"):
        store.explain(first_of(store, "squat1Reps"), label="squat1Rep")
    with pytest.raises(KinedexError, match="expected 0 <= START < STOP"):
        store.explain(first_of(store, "squat1Reps"), 5, 5)
