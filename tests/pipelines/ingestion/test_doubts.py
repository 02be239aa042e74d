"""Doubts about files: refusals, warnings and guesses by cause, and those of them that a person accepts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from kinedex.catalog.doubts import cause_sql
from kinedex.commands.cli import app
from kinedex.ops.errors import KinedexError
from kinedex.storage.store.accepted_doubts import chosen_doubts
from kinedex.storage.store.store import open_store
from tests.c3d_files import LABELS, standing_markers, write_c3d, z_up

POINTS = 1000 * z_up(standing_markers(60))


def kinedex(*words: str | Path) -> Result:
    return CliRunner().invoke(app, [*map(str, words)], prog_name="kinedex", catch_exceptions=False)


def ingest(source: Path) -> Path:
    store = source.parent / "store"
    done = kinedex("ingest", store, source, "--executor", "serial")
    assert done.exit_code in (0, 3), done.output
    return store


def doubts(store: Path, where: str = "true") -> list[dict[str, Any]]:
    return open_store(store).sql(f"SELECT * FROM doubts WHERE {where}").to_pylist()


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A folder of two trials that are refused for the same cause, and two with gaps of different lengths."""
    folder = tmp_path / "trials: of ann's"
    (folder / "day 2").mkdir(parents=True)
    for number, count in enumerate((12, 14)):
        labels = tuple(f"M{i}" for i in range(count))
        write_c3d(folder / "day 2" / f"unknown_{number}.c3d", POINTS[:count], labels)
    for number in (1, 2):
        points = POINTS.copy()
        points[LABELS.index("LKNE"), :, 20 : 20 + 2 * number] = float("nan")
        write_c3d(folder / f"gaps_{number}.c3d", points)
    return folder


def test_files_are_grouped_by_cause_and_the_message_has_the_details(source: Path) -> None:
    store = ingest(source)
    refused = doubts(store, "kind = 'refused'")
    assert [row["source"] for row in refused] == ["day 2/unknown_0.c3d", "day 2/unknown_1.c3d"]
    assert {row["cause"] for row in refused} == {"no human body is recognised among its points"}
    assert {row["source_root"] for row in refused} == {str(source)}
    assert [row["take"] for row in refused] == [None, None]
    assert [row["message"].split(";")[1] for row in refused] == [
        " 0 of 12 labels are known",
        " 0 of 14 labels are known",
    ]
    warned = doubts(store, "cause LIKE 'gaps%'")
    assert [row["take"] for row in warned] == ["gaps_1", "gaps_2"]
    assert {row["cause"] for row in warned} == {"gaps closed along straight lines"}
    assert len({row["message"] for row in warned}) == 2


@pytest.mark.parametrize(
    ("message", "cause"),
    [
        (
            "1384 of 2305 source frames are invalid and have no word; LKNE",
            "… of … source frames are invalid and have no word",
        ),
        ("its points have no human proportions (trunk 0.12 legs; hips)", "its points have no human proportions"),
        ("mapping 'a: b' has no lhip", "mapping … has no lhip"),
        ("POINT:Y_SCREEN is -Z; Z is up", "POINT:Y_SCREEN is -Z"),
        ("first line\nsecond line", "first line"),
    ],
)
def test_a_cause_is_the_message_without_details(source: Path, message: str, cause: str) -> None:
    store = open_store(ingest(source))
    assert store.sql(f"SELECT {cause_sql('$1')} AS cause", [message]).to_pylist() == [{"cause": cause}]


def test_a_body_of_low_confidence_is_a_guess(source: Path) -> None:
    legs = [i for i, label in enumerate(LABELS) if label[1:] in ("FWT", "BWT", "KNE", "ANK", "HEE", "TOE")]
    points = POINTS[legs].copy()
    knee = [LABELS[i] for i in legs].index("LKNE")
    points[knee, 2] -= 130.0  # the left shank is much shorter than the right one
    write_c3d(source / "uneven.c3d", points, tuple(LABELS[i] for i in legs))
    found = doubts(ingest(source), "kind = 'guessed'")
    assert [row["take"] for row in found] == ["uneven"]
    assert found[0]["message"].startswith(found[0]["cause"] + ": 0.")


def test_an_accepted_warning_stays_accepted_until_it_changes(source: Path) -> None:
    store = ingest(source)
    done = kinedex("takes", "accept", store, "gaps_1", "--where", "cause LIKE 'gaps%'", "--json")
    assert done.exit_code == 0, done.output
    answer = json.loads(done.stdout)
    assert (answer["accepted"], answer["changed"], len(answer["doubts"])) == (True, 1, 1)
    assert {row["take"]: row["accepted"] for row in doubts(store, "cause LIKE 'gaps%'")} == {
        "gaps_1": True,
        "gaps_2": False,
    }
    assert "gaps closed" in str(open_store(store).sql("SELECT warnings FROM takes WHERE name = 'gaps_1'").to_pylist())
    assert "1 were so before" in kinedex("takes", "accept", store, "--where", "cause LIKE 'gaps%'").output
    points = POINTS.copy()
    points[LABELS.index("LKNE"), :, 20:29] = float("nan")
    write_c3d(source / "gaps_1.c3d", points)
    ingest(source)
    assert {row["take"]: row["accepted"] for row in doubts(store, "cause LIKE 'gaps%'")} == {
        "gaps_1": False,
        "gaps_2": True,
    }
    assert kinedex("takes", "accept", store, "gaps_2", "--revoke").exit_code == 0
    assert not doubts(store, "accepted")


def test_what_is_refused_cannot_be_accepted(source: Path) -> None:
    store = open_store(ingest(source))
    with pytest.raises(KinedexError, match="refused files are none"):
        chosen_doubts(store, where="kind = 'refused'")
    with pytest.raises(KinedexError, match="gaps_3"):
        chosen_doubts(store, ["gaps_3"])
    with pytest.raises(KinedexError, match="--where"):
        chosen_doubts(store)
