"""The loop: annotate, export, correct, import, learn again, annotate; and nothing else runs."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from typer.testing import CliRunner

from kinedex.commands.cli import app
from kinedex.storage.store.store import open_store
from tests.pipelines.archives import write_archive

PATTERNS = [
    r"clips/(?P<class>[^/]+)/[^/_]+_(?P<actor>[^/_]+)_.*_(?P<clip>\d+)_\d+\.",
    r"takes/[^/_]+_(?P<actor>[^/_]+)_(?P<clip>take\d+)\.",
]
CLIPS = [f"clips/{name}/x_{actor}_{name}_001_120.amc" for name in ("walk", "kick") for actor in ("ann", "bob")]


def kinedex(*words: object) -> str:
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture(scope="module")
def annotated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """A store with annotations, its pipeline file and the folder of both."""
    folder = tmp_path_factory.mktemp("loop")
    for number, subclass in enumerate(("walk", "kick")):
        write_archive(folder / "source", {name: 80 for name in CLIPS if subclass in name}, first_seed=number)
        write_archive(folder / "source", {f"takes/x_{subclass}_take01.amc": 240}, first_seed=number)
    stages: dict[str, dict[str, object]] = {
        "ingest": {"source": str(folder / "source"), "patterns": PATTERNS},
        "index": {},
        "learn_templates": {"examples": ["clips", "labels"]},
        "annotate": {"where": "class IS NULL", "tau": 0.4},
    }
    content = {"name": "loop", "stages": {name: {"params": params} for name, params in stages.items()}}
    (folder / "loop.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    kinedex("run", folder / "loop.yaml", "--store", folder / "store", "--executor", "serial")
    return folder / "store", folder / "loop.yaml", folder


def corrected(file: Path) -> None:
    """Remove the first annotation of an ELAN file and let the next one begin 0.2 s later."""
    tree = ElementTree.parse(file)
    places = [(tier, one) for tier in tree.iter("TIER") for one in tier.findall("ANNOTATION")]
    assert len(places) > 1
    tier, first = places[0]
    tier.remove(first)
    aligned = places[1][1].find("ALIGNABLE_ANNOTATION")
    assert aligned is not None
    slots = {slot.get("TIME_SLOT_ID"): slot for slot in tree.iter("TIME_SLOT")}
    begin = slots[aligned.get("TIME_SLOT_REF1")]
    begin.set("TIME_VALUE", str(int(str(begin.get("TIME_VALUE"))) + 200))
    tree.write(file, encoding="utf-8", xml_declaration=True)


def running(pipeline: Path, store: Path) -> dict[str, str]:
    stages = json.loads(kinedex("plan", pipeline, "--store", store, "--json"))["stages"]
    return {one["stage"]: one["runs_because"] for one in stages if one["runs_because"] is not None}


@pytest.mark.parametrize("form", ["eaf", "csv"])
def test_corrections_come_back_and_only_what_depends_on_them_runs(
    annotated: tuple[Path, Path, Path], form: str, tmp_path: Path
) -> None:
    store, pipeline, _ = annotated
    kinedex("run", pipeline, "--store", store, "--executor", "serial")
    assert running(pipeline, store) == {}
    before = open_store(store).result("annotations").to_pylist()
    kinedex("labels", "export", store, "--format", form, "-o", tmp_path / "old")
    kinedex("labels", "export", store, "--format", form, "-o", tmp_path / "new")
    changed = max((tmp_path / "new").iterdir(), key=lambda path: path.stat().st_size)
    if form == "eaf":
        corrected(changed)
    else:
        head, first, *rest = changed.read_text().splitlines()
        changed.write_text("\n".join([head, *rest, re.sub(",(walk|kick),", ",stroll,", first, count=1)]) + "\n")
    table = json.loads(kinedex("labels", "diff", tmp_path / "old", tmp_path / "new", "--format", "json"))
    changes = sorted(row["change"] for row in table)
    assert changes == (["moved", "removed"] if form == "eaf" else ["renamed"])
    corrections = ("--corrects", "annotations", "--annotator", "ann", "--json")
    imported = ("labels", "import", store, tmp_path / "new", *corrections)
    result = json.loads(kinedex(*imported))
    assert result["counts"]["rejected"] == 1
    assert result["counts"]["corrected"] == 1
    assert sum(result["counts"].values()) + result["known"] >= len(before)
    assert running(pipeline, store).keys() == {"learn_templates", "annotate"}
    assert "the takes that it reads changed" in running(pipeline, store)["learn_templates"]
    again = json.loads(kinedex(*imported))
    assert again["counts"] == {}
    kinedex("run", pipeline, "--store", store, "--executor", "serial")
    assert running(pipeline, store) == {}
    with open_store(store) as opened:
        learned = {clip for row in opened.result("templates").to_pylist() for clip in row["clips"]}
        labels = [row for row in opened.labels().to_pylist() if row["verdict"] == "positive"]
        assert {f"{row['take']}[{row['start']}:{row['stop']}]" for row in labels} <= learned
        assert {row["annotator"] for row in labels} == {"ann"}


def test_a_take_that_is_read_again_keeps_its_labels(annotated: tuple[Path, Path, Path]) -> None:
    store, pipeline, folder = annotated
    kinedex("labels", "add", store, "x_walk_take01", "walk", 0, 20)
    before = {row["id"] for row in open_store(store).labels().to_pylist()}
    write_archive(folder / "source", {"takes/x_walk_take01.amc": 200}, first_seed=0)
    kinedex("run", pipeline, "--store", store, "--executor", "serial")
    assert {row["id"] for row in open_store(store).labels().to_pylist()} == before
    with open_store(store) as opened:
        changed = opened.sql("SELECT DISTINCT take, file_changed FROM labels ORDER BY take").to_pylist()
        assert {row["take"]: row["file_changed"] for row in changed}["x_walk_take01"]
