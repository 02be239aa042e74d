"""Labels by way of the server: what a page shows as saved is in the store, once, and conflicts are reported."""

from __future__ import annotations

import re
import shlex
import shutil
import uuid
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from typer.testing import CliRunner

import kinedex
from kinedex.commands.cli import app
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.storage.index.builder import build_index
from kinedex.storage.store.store import open_store
from tests.explorer.conftest import Connect
from tests.pipelines.labelled import labelled_line

TAKE = "cat_take01"
Json = dict[str, Any]


class Page:
    """The requests of a page."""

    def __init__(self, connect: Connect, path: Path, *, read_only: bool = False) -> None:
        self.store = path
        self.client = connect(path, read_only=read_only)
        self.take_id = open_store(path).take_ids[TAKE]

    def post(self, path: str, body: Json, status: int = 200) -> Json:
        answer = self.client.post(path, json=body)
        assert answer.status_code == status, answer.text
        found: Json = answer.json()
        return found

    def get(self, path: str) -> Json:
        answer = self.client.get(path)
        assert answer.status_code == 200, answer.text
        found: Json = answer.json()
        return found

    def decide(self, *changes: Json, status: int = 200, take: str = TAKE) -> Json:
        return self.post("/api/labels/decide", {"take": take, "annotator": "ann", "changes": changes}, status)

    def labels(self) -> list[Json]:
        rows = self.get(f"/api/takes/{self.take_id}/labels")["rows"]
        return [row for row in rows if row["current"]]

    def shown(self) -> list[tuple[Any, ...]]:
        keys = ("class", "start", "stop", "verdict", "origin")
        return sorted(tuple(row[key] for key in keys) for row in self.labels())


@pytest.fixture(scope="module")
def annotated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    line = labelled_line(tmp_path_factory.mktemp("labels"))
    line.run(LearnTemplates, methods=["soft"])
    line.run(Annotate, tau=0.2)
    build_index(open_store(line.store, at="newest"))
    return line.store


@pytest.fixture
def page(connect: Connect, annotated: Path) -> Page:
    """A page whose take has no label; the history grows from test to test."""
    page = Page(connect, annotated)
    for row in page.labels():
        page.decide({"do": "withdraw", "id": new(), "label": row["id"]})
    return page


def new() -> str:
    return uuid.uuid4().hex


def draw(label: str, start: int, stop: int) -> Json:
    return {"do": "draw", "id": new(), "class": label, "start": start, "stop": stop}


def test_edits_of_lanes_become_labels_and_their_history_stays(page: Page) -> None:
    made = page.decide(draw("walk", 2, 20))["made"][0]
    moved = page.decide({"do": "change", "id": new(), "label": made, "start": 4, "class": "run"})["made"][0]
    parts = page.decide({"do": "split", "ids": [new(), new()], "label": moved, "at": 10})["made"]
    assert page.shown() == [("run", 4, 10, "positive", "corrected"), ("run", 10, 20, "positive", "corrected")]
    page.decide({"do": "join", "ids": [new(), new()], "labels": parts})
    assert page.shown() == [("run", 4, 20, "positive", "corrected")]
    (whole,) = page.labels()
    assert whole["annotator"] == "ann"
    page.decide({"do": "withdraw", "id": new(), "label": whole["id"]})
    assert page.shown() == []
    stored = kinedex.open_store(page.store).labels.table(history=True)
    assert {made, moved, *parts, whole["id"]} <= set(stored["id"])


def test_every_edit_can_be_undone_and_done_again(page: Page) -> None:
    first, second, third = new(), new(), new()
    parts = new(), new()
    edits: list[tuple[Json, list[str]]] = [
        ({**draw("walk", 0, 8), "id": first}, []),
        ({**draw("walk", 9, 20), "id": second}, []),
        ({"do": "change", "id": third, "label": first, "stop": 7}, [first]),
        ({"do": "split", "ids": parts, "label": second, "at": 15}, [second]),
        ({"do": "join", "ids": [new(), new()], "labels": parts}, [*parts]),
        ({"do": "withdraw", "id": new(), "label": third}, [third]),
    ]
    seen = [page.shown()]
    undo, redo = [], []
    for edit, back in edits:
        undo.append((page.decide(edit)["made"], back))
        seen.append(page.shown())
    for _ in range(2):
        for steps, others, states in ((undo, redo, seen[-2::-1]), (redo, undo, seen[1:])):
            for state in states:
                made, back = steps.pop()
                ids = [new() for _ in range(len(made) + len(back))]
                answer = page.decide({"do": "restore", "ids": ids, "made": made, "back": back})
                assert page.shown() == state
                names = answer["restored"]
                for step in (*undo, *redo):
                    step[0][:] = [names.get(one, one) for one in step[0]]
                others.append((answer["made"], made))
    assert len({tuple(state) for state in seen}) == len(seen)


def test_the_commands_of_decisions_make_the_same_labels(page: Page, connect: Connect, tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(page.store, other)
    python = tmp_path / "by python"
    shutil.copytree(page.store, python)
    columns = ["take", "class", "start", "stop", "limb", "verdict", "annotator", "note", "source"]

    def content(store: Path) -> pl.DataFrame:
        return kinedex.open_store(store).labels.table().sort(columns)

    def decide(*changes: Json) -> list[str]:
        before = {row["id"]: row for row in content(page.store).to_dicts()}
        answer = page.decide(*changes)
        for line in answer["command"].splitlines():
            words = [word.replace(str(page.store), str(other)) for word in shlex.split(line)[1:]]
            done = CliRunner().invoke(app, [twin(word, before, other) for word in words])
            assert done.exit_code == 0, (line, done.output)
        lines = answer["python"].replace(str(page.store), str(python))
        exec(re.sub(r"'([0-9a-f]{12})'", lambda found: repr(twin(found[1], before, python)), lines))
        for store in (other, python):
            assert content(store).select(columns).rows() == content(page.store).select(columns).rows(), answer[
                "command"
            ]
        made: list[str] = answer["made"]
        return made

    def twin(word: str, before: dict[str, Json], store: Path) -> str:
        """Return the id in another store of the label with the same content."""
        row = next((row for id, row in before.items() if id.startswith(word)), None) if len(word) == 12 else None
        if row is None:
            return word
        rows = content(store).to_dicts()
        return str(next(one["id"] for one in rows if all(one[key] == row[key] for key in columns)))

    (walk,) = decide(draw("walk, slowly", 2, 20))
    decide({**draw("it's a kick", 30, 40), "verdict": "negative", "note": "a -- hop"})
    (limb,) = decide({**draw("error", 1, 9), "limb": "lshank"})
    (moved,) = decide({"do": "change", "id": new(), "label": walk, "start": 4, "class": "run"})
    parts = decide({"do": "split", "ids": [new(), new()], "label": moved, "at": 10})
    decide({"do": "restore", "ids": [new() for _ in range(3)], "made": parts, "back": [moved]})
    (whole,) = (row["id"] for row in page.labels() if row["class"] == "run")
    parts = decide({"do": "split", "ids": [new(), new()], "label": whole, "at": 12})
    *_, joined = decide({"do": "join", "ids": [new(), new()], "labels": parts})
    decide({"do": "change", "id": new(), "label": joined, "verdict": "negative"})
    gone = decide({"do": "withdraw", "id": new(), "label": limb})
    decide({"do": "restore", "ids": [new(), new()], "made": gone, "back": [limb]})
    queue = page.post("/api/labels/queue", {"takes": [TAKE]})
    row, other_row = ({key: one[key] for key in ("class", "subclass", "start", "stop")} for one in queue["rows"][:2])
    (accepted,) = decide({"do": "accept", "id": new(), "stage": queue["stage"], **row})
    decide({"do": "reject", "id": new(), "stage": queue["stage"], **row, "seen": accepted})
    decide({"do": "reject", "id": new(), "stage": queue["stage"], **other_row}, draw("two at once", 3, 4))


def test_a_request_that_is_sent_twice_is_recorded_once(page: Page) -> None:
    change = draw("walk", 3, 9)
    assert len(page.decide(change)["rows"]) == 1
    assert page.decide(change)["rows"] == []
    move = {"do": "change", "id": new(), "label": change["id"], "stop": 12}
    assert len(page.decide(move)["rows"]) == 1
    assert page.decide(move) == page.decide(move)
    assert page.shown() == [("walk", 3, 12, "positive", "corrected")]


def test_two_tabs_that_change_one_label_are_told(page: Page) -> None:
    made = page.decide(draw("walk", 3, 9))["made"][0]
    page.decide({"do": "change", "id": new(), "label": made, "stop": 12})
    mine = {"do": "change", "id": new(), "label": made, "start": 1}
    error = page.decide(draw("kick", 30, 35), mine, status=409)["error"]
    assert error["type"] == "ConflictError"
    assert "was changed to walk in cat_take01[3:12] meanwhile by ann" in error["message"]
    assert page.shown() == [("walk", 3, 12, "positive", "corrected")]  # all of a request, or nothing
    assert "there is such a label already" in page.decide(draw("walk", 3, 12), status=409)["error"]["message"]
    error = page.decide({"do": "restore", "ids": [new()], "made": [made], "back": []}, status=409)["error"]
    assert "changed again" in error["message"]


def test_what_is_no_label_is_refused_with_what_was_expected(page: Page) -> None:
    assert "within the" in page.decide(draw("walk", 3, 10_000), status=422)["error"]["message"]
    assert "did you mean" in page.decide(draw("walk", 3, 9), status=400, take="cat_take1")["error"]["message"]
    assert "id" in page.decide({**draw("walk", 3, 9), "id": "../x"}, status=422)["error"]["message"]
    made = page.decide(draw("walk", 3, 9))["made"][0]
    page.decide({"do": "split", "ids": [new(), new()], "label": made, "at": 9}, status=422)
    page.decide({"do": "change", "id": new(), "label": made}, status=422)


def test_annotations_are_accepted_and_rejected_from_the_queue(page: Page) -> None:
    answer = page.get(f"/api/takes/{page.take_id}/labels")
    queue = page.post("/api/labels/queue", {"takes": [TAKE]})
    assert queue["stage"] == answer["stage"] == "test/annotate"
    assert queue["open"] == len(answer["annotations"]) >= 2
    confidences = [row["confidence"] for row in queue["rows"]]
    assert confidences == sorted(confidences, key=lambda one: (one is None, one))
    first, second = queue["rows"][:2]
    assert first["nearest"]["take"].split("_")[1] == first["class"]

    def decision(do: str, row: Json, seen: str | None = None) -> Json:
        keys = ("class", "subclass", "start", "stop")
        return {"do": do, "id": new(), "stage": queue["stage"], "seen": seen, **{key: row[key] for key in keys}}

    made = page.decide(decision("accept", first), decision("reject", second))["made"]
    after = page.post("/api/labels/queue", {"takes": [TAKE]})
    assert (after["open"], after["accepted"], after["rejected"]) == (queue["open"] - 2, 1, 1)
    accepted = next(row for row in page.labels() if row["id"] == made[0])
    assert (accepted["origin"], accepted["confidence"]) == ("accepted", first["confidence"])
    assert "labelled meanwhile" in page.decide(decision("reject", first), status=409)["error"]["message"]
    page.decide(decision("reject", first, made[0]))
    again = page.post("/api/labels/queue", {"takes": [TAKE], "decided": True, "classes": [first["class"]]})
    assert {row["verdict"] for row in again["rows"] if row["label"]} >= {"negative"}
    asked = {"takes": [TAKE], "classes": [first["class"]], "where": "start >= 0 -- all", "decided": True}
    shown = page.post("/api/labels/queue", asked)
    query = shlex.split(shown["command"])[-1]
    keys = ("take", "class", "start", "stop")
    rows = kinedex.open_store(page.store).sql(query).to_pylist()
    assert [[row[key] for key in keys] for row in rows] == [[row[key] for key in keys] for row in shown["rows"]]


def test_the_facts_count_labels_and_decisions_since_the_templates(page: Page) -> None:
    before = page.get("/api/labels")
    page.decide(draw("spin", 3, 9))
    facts = page.get("/api/labels")
    assert facts["learned"]["since"] == before["learned"]["since"] + 1
    spin = next(one for one in facts["classes"] if one["name"] == "spin")
    assert spin == {"name": "spin", "positive": 1, "negative": 0}
    listed = page.post("/api/labels/list", {"where": "class = 'spin'"})
    assert listed["rows"][0]["start"] == 3
    assert page.post("/api/labels/list", {"history": True})["total"] > listed["total"]


def test_limbs_without_errors_are_counted_apart_and_are_part_of_the_checksum(page: Page, tmp_path: Path) -> None:
    file = tmp_path / "limbs.csv"
    asked: Json = {"paths": [str(file)]}
    file.write_text(f"take,class,start,stop,limb,annotator\n{TAKE},,,,torso,A1\n")
    shown = page.post("/api/labels/read", asked)
    assert shown["counts"] == {"without errors": 1}
    file.write_text(f"take,class,start,stop,limb,annotator\n{TAKE},,,,lshank,A1\n")
    page.post("/api/labels/import", {**asked, "checksum": shown["checksum"]}, status=409)


def test_files_are_shown_before_they_are_taken_in(page: Page, tmp_path: Path) -> None:
    page.decide(draw("walk", 4, 24))
    folder = tmp_path / "labels"
    written = page.post("/api/labels/export", {"what": "labels", "folder": str(folder), "format": "eaf"})
    assert written["written"] == 1
    (file,) = folder.iterdir()
    asked: Json = {"paths": [str(folder)], "corrects": "labels"}
    assert page.post("/api/labels/read", asked)["total"] == 0
    nothing = {"what": "labels", "folder": str(tmp_path / "none"), "where": f"name <> '{TAKE}'"}
    assert "no take has a label" in page.post("/api/labels/export", nothing, status=400)["error"]["message"]
    file.write_text(file.read_text().replace(">walk<", ">run<"))
    shown = page.post("/api/labels/read", asked)
    assert [(row["class"], row["before"]["class"]) for row in shown["rows"]] == [("run", "walk")]
    assert page.shown() == [("walk", 4, 24, "positive", "drawn")]
    file.write_text(file.read_text().replace(">run<", ">hop<"))
    page.post("/api/labels/import", {**asked, "checksum": shown["checksum"]}, status=409)
    shown = page.post("/api/labels/read", asked)
    page.post("/api/labels/import", {**asked, "checksum": shown["checksum"], "annotator": "eve"})
    assert page.shown() == [("hop", 4, 24, "positive", "corrected")]
    assert "there already" in page.post(
        "/api/labels/export", {"what": "labels", "folder": str(folder)}, status=400
    )["error"]["message"]  # fmt: skip
    page.post("/api/labels/read", {"paths": [str(tmp_path / "none.eaf")]}, status=400)
    for route, elsewhere in (
        ("/api/labels/read", {"paths": ["s3://bucket/labels.eaf"]}),
        ("/api/labels/export", {"what": "labels", "folder": "s3://bucket/labels"}),
    ):
        assert "files of this machine alone" in page.post(route, elsewhere, status=400)["error"]["message"]


def test_a_server_that_only_reads_records_nothing(connect: Connect, annotated: Path, tmp_path: Path) -> None:
    page = Page(connect, annotated, read_only=True)
    before = page.shown()
    assert page.decide(draw("walk", 1, 5), status=403)["error"]["type"] == "ReadOnlyError"
    page.post("/api/labels/export", {"what": "annotations", "folder": str(tmp_path / "out")}, status=403)
    page.post("/api/labels/import", {"paths": ["x.eaf"], "checksum": ""}, status=403)
    assert page.shown() == before
    assert not (tmp_path / "out").exists()
