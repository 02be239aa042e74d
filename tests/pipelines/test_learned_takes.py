"""When takes are added, changed or removed, only results that were learned from them are learned again."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
import yaml
from rich.console import Console
from typer.testing import CliRunner

from kinedex.commands.cli import app
from kinedex.console.terminal import Terminal
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine import plan
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.engine.plan import make_plan
from kinedex.pipelines.engine.runner import Outcome, run_pipeline
from kinedex.pipelines.stages.learn_keyframes import LearnKeyframes
from kinedex.storage.store.store import open_store
from tests.pipelines.archives import human_amc, write_archive
from tests.pipelines.labelled import POSES, clip, long_take, write_store

CLIPS = {
    f"clips/{label}/x_{actor}_{label}_{number}_120.amc": 40 + 4 * number
    for label in ("walk", "kick")
    for actor in ("al", "bo")
    for number in (1, 2)
}
TAKES = {"takes/x_cy_take1.amc": 80, "takes/x_cy_take2.amc": 60}


class Archive:
    """Motion files, and a pipeline over them that learns templates from the clips of `al` and annotates takes."""

    def __init__(self, folder: Path) -> None:
        self.source = write_archive(folder / "source", {**CLIPS, **TAKES})
        self.store = folder / "store"
        self.file = folder / "line.yaml"
        self.params: dict[str, dict[str, object]] = {
            "learn_templates": {"where": "class IS NOT NULL AND actor = 'al'", "methods": ["soft"]},
            "annotate": {},
        }

    def write(self) -> Path:
        patterns = [r"clips/(?P<class>[^/]+)/x_(?P<actor>[^_]+)_", r"takes/x_(?P<actor>[^_]+)_"]
        ingest = {"source": str(self.source), "patterns": patterns, "prune": True}
        stages = {"ingest": ingest, **self.params}
        content = {"name": "line", "stages": {name: {"params": params} for name, params in stages.items()}}
        self.file.write_text(yaml.safe_dump(content, sort_keys=False))
        return self.file

    def run(self, **options: object) -> tuple[Outcome, str]:
        message = io.StringIO()
        terminal = Terminal(Console(file=message, width=200))
        return run_pipeline(self.write(), self.store, terminal=terminal, **options), message.getvalue()  # type: ignore[arg-type]

    def templates(self) -> str:
        return open_store(self.store).manifest.stages["line/learn_templates"].run

    def kept_takes(self) -> int:
        return int(open_store(self.store).manifest.stages["line/annotate"].summary["kept_takes"])

    def put(self, path: str, seed: int, frames: int = 50) -> None:
        (self.source / path).write_text(human_amc(frames, seed))


@pytest.fixture
def archive(tmp_path: Path) -> Archive:
    made = Archive(tmp_path)
    assert made.run()[0].ran == ("ingest", "learn_templates", "annotate")
    return made


def test_templates_stay_when_takes_come_that_are_not_learned_from(archive: Archive) -> None:
    learned = archive.templates()
    archive.put("takes/x_cy_take3.amc", 77)
    archive.put("clips/kick/x_bo_kick_3_120.amc", 78)
    outcome, message = archive.run()
    assert outcome.ran == ("ingest", "annotate")
    assert archive.kept_takes() == 2
    assert archive.templates() == learned
    (line,) = [line for line in message.splitlines() if "learn_templates" in line and line.startswith("[")]
    assert "nothing to do, unchanged: 4 clips" in line
    assert archive.run()[0].ran == ()


def test_templates_stay_when_other_takes_change_or_go(archive: Archive) -> None:
    archive.put("takes/x_cy_take1.amc", 79)
    (archive.source / "clips/kick/x_bo_kick_2_120.amc").unlink()
    outcome, _ = archive.run()
    assert outcome.ran == ("ingest", "annotate")
    assert archive.kept_takes() == 1


def test_templates_are_learned_again_when_a_clip_comes_changes_goes_or_gets_another_class(archive: Archive) -> None:
    first = "clips/walk/x_al_walk_1_120.amc"
    changes = [
        lambda: archive.put("clips/kick/x_al_kick_3_120.amc", 80),
        lambda: archive.put("clips/kick/x_al_kick_3_120.amc", 81),
        lambda: (archive.source / "clips/kick/x_al_kick_3_120.amc").unlink(),
        lambda: (archive.source / first).rename(archive.source / "clips/kick/x_al_walk_1_120.amc"),
    ]
    for change in changes:
        change()
        learned = archive.templates()
        outcome, message = archive.run()
        assert outcome.ran == ("ingest", "learn_templates", "annotate")
        assert "learn_templates: the takes that it reads changed\n" in message
        assert archive.templates() != learned


def test_clips_that_come_back_as_they_were_leave_templates_as_they_are(archive: Archive) -> None:
    learned = archive.templates()
    archive.run(force=frozenset({"ingest"}))
    assert archive.templates() == learned
    archive.run(force=frozenset({"learn_templates"}))
    assert archive.templates() != learned


def test_another_filter_or_other_code_learns_again(archive: Archive, monkeypatch: pytest.MonkeyPatch) -> None:
    archive.params["learn_templates"]["where"] = "class IS NOT NULL"
    assert archive.run()[0].ran == ("learn_templates", "annotate")
    monkeypatch.setattr(plan, "code_digest", lambda kind: f"new {kind.name}")
    assert archive.run()[0].ran == ("ingest", "learn_templates", "annotate")


def test_a_plan_says_what_is_certain_and_what_is_not(archive: Archive) -> None:
    steps = make_plan(load_pipeline(archive.write()), archive.store)
    assert [(step.reason, step.what) for step in steps][:2] == [(None, ""), (None, "4 clips")]
    archive.put("takes/x_cy_take3.amc", 77)
    reasons = [step.reason for step in make_plan(load_pipeline(archive.write()), archive.store)]
    assert reasons[1] == "ingest runs, which may change the takes that it reads"
    shown = CliRunner().invoke(app, ["plan", str(archive.file), "--store", str(archive.store)], env={"COLUMNS": "200"})
    assert shown.exit_code == 0, shown.output
    archive.run()
    shown = CliRunner().invoke(app, ["plan", str(archive.file), "--store", str(archive.store)], env={"COLUMNS": "200"})
    assert "– (unchanged: 4 clips)" in shown.output


def test_a_filter_that_does_not_work_is_told_by_the_stage(archive: Archive) -> None:
    archive.params["learn_templates"]["where"] = "clas IS NOT NULL"
    with pytest.raises(KinedexError, match=r"stage learn_templates: the filter over takes does not work"):
        archive.run()


QUICK = {"generations": "5", "population": "10", "runs": "2", "alternatives": "1"}
LABELLED = [
    clip(subclass, actor, number)
    for subclass in ("walk", "kick")
    for actor, number in (("al", 1), ("al", 2), ("bo", 3))
]


def learn(store: Path, **params: str) -> tuple[tuple[str, ...], str]:
    message = io.StringIO()
    given = {f"learn_keyframes.{key}": value for key, value in {**QUICK, **params}.items()}
    terminal = Terminal(Console(file=message, width=200))
    return run_pipeline("keyframes", store, assignments=given, terminal=terminal).ran, message.getvalue()


def test_queries_stay_when_takes_come_that_are_not_learned_from(tmp_path: Path) -> None:
    store = write_store(tmp_path / "store", [*LABELLED, long_take("cy_1", "cy", "walk", "kick")])
    assert learn(store)[0] == ("learn_keyframes",)
    write_store(store, [long_take("cy_2", "cy", "wave", "kick")])
    ran, message = learn(store)
    assert ran == ()
    assert "nothing to do, unchanged: 6 clips" in message
    write_store(store, [clip("kick", "cy", 4)])
    assert learn(store)[0] == ("learn_keyframes",)


def test_a_reading_is_of_names_classes_and_words_alone(tmp_path: Path) -> None:
    params = LearnKeyframes.parameters()

    def digest(folder: str, *takes: dict[str, object]) -> str:
        return LearnKeyframes().reading(params, open_store(write_store(tmp_path / folder, list(takes)))).digest

    one, other = clip("walk", "al", 1), clip("kick", "al", 2)
    plain = digest("plain", one, other)
    assert plain == digest("same", one, other)
    assert plain == digest("elsewhere", {**one, "source": "elsewhere.amc", "source_mtime_ns": 9}, other)
    others = [
        digest("renamed", {**one, "name": "again"}, other),
        digest("relabelled", {**one, "class": "kick"}, other),
        digest("unlabelled", {**one, "class": None}, other),
        digest("words", {**one, "words": POSES["wave"]}, other),
        digest("fewer", one),
        digest("more", one, other, clip("kick", "al", 3)),
        digest("cut", {**one, "words": one["words"][:-1]}, other),  # type: ignore[index]
    ]
    assert len({plain, *others}) == 1 + len(others)
