"""The whole story in a browser, by clicks and keys: from a folder of files to a labelled data set.

A person filters the archive, finds a motion by one example, accepts hits, saves them as labels, learns, corrects two of
the annotations, and writes a data set that is split by actor. Then the commands that the page has shown at its bottom
do the same to a copy of the store, and what comes out is compared. `pytest -s` prints the seconds of each step.

The files are the 658 of Bandai beside the checkout; where they are missing, a synthetic archive.
"""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from playwright.sync_api import Browser, FloatRect, Locator, Page, expect
from typer.testing import CliRunner

import kinedex
from kinedex.commands.cli import app
from kinedex.explorer.jobs import FOLDER
from tests.browser.explorer.conftest import WAIT_MS
from tests.real_data import SHARED

BANDAI = SHARED / "data" / "bandai"
PATTERN = r"dataset-\d_(?P<class>[^_]+)_(?P<actor>[^_]+)_(?P<clip>\d+)\."
NEW = "waving, by one example"
"""The class of the labels; a comma in its name is one everywhere."""

COUNT = """
for (const name of ['pointerdown', 'keydown']) {
  const count = () => localStorage.setItem(`test-${name}`, 1 + Number(localStorage.getItem(`test-${name}`)));
  addEventListener(name, count, true);
}
"""
"""Counts what a person does."""

FIELDS = 6
"""Fields that a person fills or chooses in: the class twice, and the settings of the export."""

DIFFERENT = ["id", "created", "replaces", "current", "take_id"]
"""Columns of labels that differ between two stores, or follow from such; `replaces` is compared by rows."""

RUNS = ["run", "pipeline_run"]
"""Columns of annotations that name the run: its time and random digits."""

FRAME_PX = 4
"""Pixels of a frame at which a drag is sure to move by whole frames."""

LONG_MS = 240_000
"""Learning and writing take longer than an answer of the page, on a machine with other work."""


@dataclass(frozen=True)
class Archive:
    """Files, the store that they are ingested into, and what is searched for in them."""

    store: Path
    group: str
    take: str
    frames: tuple[int, int]
    hits: int
    shares: str


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Archive:
    folder = tmp_path_factory.mktemp("story")
    store = folder / "a store"
    if BANDAI.is_dir():
        command("ingest", store, BANDAI, "--set", f"patterns=['{PATTERN}']", "--executor", "processes")
        return Archive(store, "wave-both-hands", "dataset-2_wave-both-hands_active_004", (45, 120), 20, "0.8,0.1,0.1")
    command("synth", folder / "files", "--minutes", "2", "--actors", "3", "--workers", "1")
    command("ingest", store, folder / "files", "--executor", "serial")
    take = "SYN_cy_punchRight1Reps_001_120"
    return Archive(store, "punchRight1Reps", take, (0, 25), 3, "0.5,0.5")


def command(*words: object) -> str:
    """Run a command of kinedex in this process, and return what it prints."""
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == 0, (words, done.output, done.exception)
    return done.stdout


@dataclass
class Story:
    """A page, the commands that it has shown, and the seconds of each step."""

    page: Page
    archive: Archive
    commands: dict[str, str] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        begin = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - begin

    def shown(self, name: str, *beginning: str) -> None:
        """Note the command at the bottom of the page, once it begins with some words."""
        bar = self.page.locator(".shell-same code")
        words = shlex.join(["kinedex", *beginning])
        expect(bar).to_have_attribute("title", _beginning(words))
        self.commands[name] = bar.get_attribute("title") or ""

    def find(self) -> None:
        page, (first, last) = self.page, self.archive.frames
        with self.step("find an example in the archive"):
            page.get_by_label("Totals").get_by_text(self.archive.group, exact=True).click()
            expect(page.get_by_role("grid")).to_contain_text(self.archive.take)
            page.get_by_text(self.archive.take, exact=True).dblclick()
            expect(page.get_by_role("heading", name=self.archive.take)).to_be_visible()
            expect(page.locator(".player-note")).to_be_hidden()
            expect(page.locator(".pose-features li:visible").first).to_be_visible()
        with self.step("select where it shows the motion, and search"):
            lanes = page.locator(".lanes-area")
            (frames,) = kinedex.open_store(self.archive.store).takes(f"name = '{self.archive.take}'")["frames"]
            drag(lanes, (first + 0.2) / frames, (last - 0.2) / frames)
            expect(page).to_have_url(_containing(f"from={first}&to={last}"))
            page.get_by_text("Search by this").click()
            expect(self.hits().nth(self.archive.hits - 1)).to_be_visible()
        self.shown("rank", "rank", str(self.archive.store))

    def hits(self) -> Locator:
        return self.page.get_by_role("listbox", name="Hits, the best first").get_by_role("option")

    def accept(self) -> None:
        page, count = self.page, self.archive.hits
        with self.step(f"accept {count} hits by y, and save them as labels"):
            self.hits().first.focus()
            for _ in range(count):
                page.keyboard.press("y")
            expect(page.get_by_role("toolbar", name="What to do with the hits")).to_contain_text(f"{count} accepted")
            page.get_by_role("combobox", name="Class of the accepted hits").fill(NEW)
            page.get_by_role("button", name="Save as labels").click()
            expect(page.get_by_text(f"{count} labels of {NEW} saved in the store")).to_be_visible()
        self.shown("accept", "labels", "add")

    def learn(self) -> None:
        page = self.page
        with self.step("learn and annotate"):
            page.get_by_role("link", name="Learn from the labels").click()
            page.get_by_role("button", name="Learn and annotate").click()
            expect(page.get_by_test_id("job")).to_contain_text("Learn again: done", timeout=LONG_MS)
            expect(page.get_by_test_id("changes")).to_contain_text("new")
        self.shown("learn", "run")

    def correct(self) -> None:
        """Correct an annotation that overlaps no label by mouse, and another one by keys."""
        page = self.page
        store = kinedex.open_store(self.archive.store)
        labels = store.labels.table().select("take", pl.col("start").alias("from"), pl.col("stop").alias("to"))
        found = store.results("annotations").filter(pl.col("stop") - pl.col("start") > 12)
        near = found.join(labels, on="take").filter(
            (pl.col("start") < pl.col("to")) & (pl.col("from") < pl.col("stop"))
        )
        found = found.join(near, on=["take", "start", "stop"], how="anti").sort("take", "start")
        first, second, *_ = found.to_dicts()
        with self.step("correct the end of an annotation by mouse"):
            self.open(first)
            page.keyboard.press("e")
            self.saved("accept by e", "accept")
            lane = page.locator(f'[data-lane="labels/{NEW}"]')
            chosen = lane.locator('[aria-pressed="true"]')
            drag_end(chosen, first["stop"] - first["start"], -5)
            self.saved("correct by mouse", "change")
            expect(chosen).to_have_attribute("title", _containing(f"to {first['stop'] - 5},"))
        with self.step("correct the start of another one by keys"):
            self.open(second)
            page.keyboard.press("e")
            self.saved("accept again", "accept")
            for _ in range(4):
                page.keyboard.press("ArrowRight")
            page.keyboard.press("{")
            self.saved("correct by keys", "change")
            chosen = page.get_by_role("region", name="Chosen")
            expect(chosen.get_by_role("textbox", name="Start")).to_have_value(str(second["start"] + 4))

    def open(self, row: dict[str, Any]) -> None:
        """Open the lanes of an annotation from the list of what learning has changed; it is chosen there."""
        page = self.page
        page.get_by_role("link", name="Label", exact=True).click()
        page.get_by_role("tab", name="Learn").click()
        table = page.get_by_role("region", name="Annotations that differ")
        interval = f"[{row['start']}:{row['stop']}]"
        line = table.get_by_role("row").filter(has_text=row["take"]).filter(has_text=interval)
        line.get_by_role("link").click()
        expect(page.locator('[aria-pressed="true"]')).to_have_attribute(
            "title", _containing(f"frames {row['start']} to {row['stop']}, annotation")
        )

    def saved(self, name: str, word: str) -> None:
        self.shown(name, "labels", word)
        expect(self.page.get_by_test_id("saved")).to_contain_text("✓ Saved")

    def export(self, folder: Path) -> None:
        page = self.page
        with self.step("plan and write the data set"):
            page.get_by_role("link", name="Export", exact=True).click()
            page.get_by_label("Clips", exact=True).select_option("labels")
            page.get_by_role("combobox", name="Only classes").or_(page.get_by_label("Only classes")).first.fill(NEW)
            page.keyboard.press("Enter")
            page.get_by_label("Split by").select_option("actor")
            page.get_by_label("Shares of train, val, test").fill(self.archive.shares)
            page.get_by_label("Folder on the machine of the server").fill(str(folder))
            expect(page.get_by_test_id("plan")).to_contain_text(f"{self.archive.hits + 2} clips")
            self.shown("export", "export", str(self.archive.store), f"--output={folder}/")
            page.get_by_role("button", name="Write", exact=True).click()
            expect(page.get_by_test_id("written")).to_contain_text("files", timeout=LONG_MS)


def drag(area: Locator, start: float, stop: float) -> None:
    """Drag by mouse over shares of the width of an area."""
    box = box_of(area)
    left, y = box["x"], box["y"] + min(box["height"] / 2, 60)
    move(area.page, (left + start * box["width"], y), (left + stop * box["width"], y))


def drag_end(segment: Locator, frames: int, by: int) -> None:
    """Drag the end of a segment of so many frames, after zooming in until a frame is some pixels wide.

    A mouse rests on whole pixels: in a long take that is shown whole, a pixel is more than half a frame.
    """
    for _ in range(20):
        box = box_of(segment)
        right, y = box["x"] + box["width"], box["y"] + box["height"] / 2
        if box["width"] / frames >= FRAME_PX:
            move(segment.page, (right - 2, y), (right - 2 + by * box["width"] / frames, y))
            return
        segment.page.mouse.move(right - 2, y)
        segment.page.mouse.wheel(0, -200)
        expect(segment).not_to_have_css("width", f"{box['width']:g}px")
    raise AssertionError("the lanes do not zoom in")


def box_of(area: Locator) -> FloatRect:
    box = area.bounding_box()
    assert box is not None
    return box


def move(page: Page, begin: tuple[float, float], end: tuple[float, float]) -> None:
    """Drag by mouse from a point to another one."""
    page.mouse.move(*begin)
    page.mouse.down()
    page.mouse.move((begin[0] + end[0]) / 2, (begin[1] + end[1]) / 2)
    page.mouse.move(*end)
    page.mouse.up()


def _beginning(words: str) -> Any:
    return re.compile("^" + re.escape(words))


def _containing(words: str) -> Any:
    return re.compile(re.escape(words))


@pytest.mark.slow
def test_the_story_by_clicks_and_keys_is_the_story_by_commands(
    browser: Browser, serve: Callable[[Path], str], archive: Archive, tmp_path: Path
) -> None:
    other = tmp_path / "another store"
    shutil.copytree(archive.store, other)
    context = browser.new_context(viewport={"width": 1400, "height": 900})
    page = context.new_page()
    page.set_default_timeout(WAIT_MS)
    faults: list[object] = []
    context.add_init_script(COUNT)
    page.on("pageerror", lambda fault: faults.append(fault))
    story = Story(page, archive)
    with story.step("open the archive"):
        page.goto(serve(archive.store))
        expect(page.get_by_role("grid")).to_be_visible()
    story.find()
    shown = [str(one.get_attribute("aria-label")) for one in story.hits().all()]
    story.accept()
    story.learn()
    story.correct()
    story.export(tmp_path / "by clicks")
    clicks, keys = (
        page.evaluate(f"Number(localStorage.getItem('test-{name}'))") for name in ("pointerdown", "keydown")
    )
    context.close()
    assert faults == []

    begin = time.perf_counter()
    again = Again(archive.store, other)
    again.ranked(story.commands["rank"], shown)
    again.run(story.commands["accept"])
    assert len(story.commands["accept"].splitlines()) == archive.hits
    shutil.copytree(archive.store / FOLDER, other / FOLDER)  # the file of the pipeline that the page has written
    again.run(story.commands["learn"])
    for name in ("accept by e", "correct by mouse", "accept again", "correct by keys"):
        again.run(story.commands[name])
    again.export(story.commands["export"], tmp_path / "by clicks", tmp_path / "by commands")
    assert again.labels(archive.store) == again.labels(other)
    assert again.annotations(archive.store) == again.annotations(other)
    again.same_files(tmp_path / "by clicks", tmp_path / "by commands")
    story.seconds["the same by commands"] = time.perf_counter() - begin
    print(f"\n{clicks} clicks and drags, {keys} keys, and {FIELDS} fields to fill")
    for name, seconds in story.seconds.items():
        print(f"{seconds:7.1f} s  {name}")


class Again:
    """The commands of the page once more, on a copy of the store as it was before."""

    def __init__(self, store: Path, other: Path) -> None:
        self.store = store
        self.other = other

    def words(self, line: str) -> list[str]:
        """Return the words of a command for the copy, whose labels have ids of their own."""
        program, *words = shlex.split(line)
        assert program == "kinedex"
        words = [word.replace(str(self.store), str(self.other)) for word in words]
        if words[:2] in (["labels", "change"], ["labels", "remove"]):
            place = [row["id"].startswith(words[3]) for row in self.history(self.store)].index(True)
            words[3] = self.history(self.other)[place]["id"]
        return words

    def run(self, lines: str) -> None:
        for line in lines.splitlines():
            command(*self.words(line))

    def ranked(self, line: str, shown: list[str]) -> None:
        """Compare the hits of `kinedex rank` with those that the page has shown."""
        found = json.loads(command(*self.words(line), "--json"))
        hits = found["hits"]
        rate = kinedex.open_store(self.other).rate_hz
        listed = [
            f"{place}: {hit['similarity']:.2f} {'mirror ' * hit['mirrored']}{hit['take']}, at {hit['start'] / rate:.1f}"
            + " s"
            + ("" if hit["probable"] else ", probably another motion")
            for place, hit in enumerate(hits, 1)
        ]
        assert listed == [one.replace(" example, at ", ", at ") for one in shown]

    def export(self, line: str, before: Path, folder: Path) -> None:
        """Run the command in a process of its own, whose command line dataset.json records."""
        words = [word.replace(str(before), str(folder)) for word in self.words(line)]
        done = subprocess.run([sys.executable, "-m", "kinedex", *words], capture_output=True, text=True, timeout=240)
        assert done.returncode == 0, done.stderr

    def history(self, store: Path) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = kinedex.open_store(store).labels.table(history=True).to_dicts()
        return found

    def labels(self, store: Path) -> list[dict[str, Any]]:
        """Return all rows of labels without what differs; a row that replaces another names its place."""
        rows = self.history(store)
        places = {row["id"]: place for place, row in enumerate(rows)}
        return [
            {key: value for key, value in row.items() if key not in DIFFERENT}
            | {"replaces": places.get(row["replaces"]), "current": row["current"]}
            for row in rows
        ]

    def annotations(self, store: Path) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = kinedex.open_store(store).results("annotations").drop(RUNS).to_dicts()
        return found

    def same_files(self, one: Path, other: Path) -> None:
        """Compare two data sets: all bytes but the command in dataset.json, which names store and folder."""
        files = {path.relative_to(one) for path in one.rglob("*") if path.is_file()}
        assert files == {path.relative_to(other) for path in other.rglob("*") if path.is_file()}
        assert {path.parts[0] for path in files} >= {"train", "test", "metadata.csv", "dataset.json"}
        for path in files - {Path("dataset.json")}:
            assert (one / path).read_bytes() == (other / path).read_bytes(), path
        records = [json.loads((folder / "dataset.json").read_text()) for folder in (one, other)]
        commands = [record.pop("command") for record in records]
        assert records[0] == records[1]
        assert commands[1] == commands[0].replace(str(self.store), str(self.other)).replace(str(one), str(other))
