"""Proposals of patterns: tokens of names are found again, and look like what people call them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from kinedex.commands.cli import app
from kinedex.pipelines.ingestion.pattern_proposal import matched_count, propose_patterns
from kinedex.pipelines.ingestion.pipeline_draft import division, draft_pipeline
from kinedex.storage.formats.motion.sources import path_groups
from kinedex.storage.store.store import open_store
from tests.pipelines.archives import write_archive

PEOPLE = ("al", "bo", "cy")
KICKS = [f"clips/{c}/X_{a}_{c}_{n:03}_120.amc" for c in ("kickLeft", "squat") for a in ("al", "bo") for n in (1, 2, 3)]
TAKES = ["takes/X_cy_take01.amc", "takes/X_cy_take02.amc"]
UNDERSCORES = [
    f"{c}_{s}_{n:02}.bvh" for c in ("walk", "walk_turn_left", "run") for s in ("angry", "sad") for n in (1, 2)
]
NUMBERS = [f"{s:02}/{s:02}_{n:02}.amc" for s in (1, 2, 7) for n in (1, 2, 3)]
PLAIN = [f"{c}{n}.bvh" for c in ("Walk", "Run") for n in (1, 2, 3)]
CAMEL = [f"{c}{s}{n}.fbx" for c in ("Walk", "Jump") for s in ("Angry", "Sad") for n in (1, 2)]


def groups(paths: list[str], path: str) -> dict[str, str]:
    patterns = [re.compile(one.pattern) for one in propose_patterns(paths)]
    assert matched_count(propose_patterns(paths), paths) == len(paths)
    return dict(path_groups(path, patterns) or {})


@pytest.mark.parametrize(
    ("paths", "path", "expected"),
    [
        (KICKS + TAKES, KICKS[0], {"actor": "al", "class": "kickLeft", "clip": "001"}),
        (KICKS + TAKES, TAKES[1], {"actor": "cy", "clip": "take02"}),
        (UNDERSCORES, "walk_turn_left_angry_02.bvh", {"class": "walk_turn_left", "style": "angry", "clip": "02"}),
        (NUMBERS, "07/07_03.amc", {"actor": "07", "clip": "03"}),
        (PLAIN, "Run2.bvh", {"class": "Run", "clip": "2"}),
        (CAMEL, "JumpSad1.fbx", {"class": "Jump", "style": "Sad", "clip": "1"}),
        (
            [f"S{s}/S{s}-throw-{n}.c3d" for s in (1, 2) for n in (1, 2)],
            "S2/S2-throw-1.c3d",
            {"actor": "S2", "clip": "1"},
        ),
    ],
)
def test_tokens_look_like_what_people_call_them(paths: list[str], path: str, expected: dict[str, str]) -> None:
    found = groups(paths, path)
    assert found | {"class": found.get("class")} == expected | {"class": expected.get("class")}


def test_names_without_anything_in_common_get_no_pattern() -> None:
    assert propose_patterns(["BTS.c3d", "rolling.c3d", "Vicon.c3d"]) == []
    assert propose_patterns([]) == propose_patterns(["a.bvh"]) == []


FIELD = st.text("abXY'#: .()é\n", min_size=1, max_size=6)
COLUMNS = st.lists(st.lists(FIELD, min_size=1, max_size=4, unique=True), min_size=1, max_size=3)


@given(columns=COLUMNS, folders=st.integers(0, 2), separator=st.sampled_from("_- "))
@settings(max_examples=60, deadline=None)
def test_a_pattern_gives_back_the_values_of_its_tokens(columns: list[list[str]], folders: int, separator: str) -> None:
    names = [""]
    for values in columns:
        names = [f"{name}{separator if name else ''}{value}" for name in names for value in values][:40]
    paths = [f"{'x/' * (n % (folders + 1))}{name}{separator}{n}.bvh" for n, name in enumerate(names)]
    proposals = propose_patterns(paths)
    for proposal in proposals:
        assert proposal.fits
        for number, path in enumerate(proposal.layout.paths):
            found = path_groups(path, [re.compile(proposal.pattern)])
            assert found == {one.role: one.column.values[number] for one in proposal.tokens if one.role}
    text = yaml.safe_load(draft_pipeline(proposals, Path("/a b"), len(paths), 0, "x.yaml"))
    assert text["stages"]["ingest"]["params"]["patterns"] == [one.pattern for one in proposals]


def test_a_drafted_pipeline_runs_as_it_is(tmp_path: Path) -> None:
    write_archive(
        tmp_path / "archive", dict.fromkeys((f"x_{a}_{c}_1.amc" for a in PEOPLE for c in ("run", "walk")), 30)
    )
    runner, file = CliRunner(), str(tmp_path / "my.yaml")
    shown = runner.invoke(app, ["init", str(tmp_path / "archive"), "-o", file])
    assert (shown.exit_code, "6 of 6 paths match" in shown.output) == (0, True)
    again = runner.invoke(app, ["init", str(tmp_path / "archive"), "-o", file])
    assert (again.exit_code, "exists already" in again.stderr) == (1, True)
    store = str(tmp_path / "store")
    assert runner.invoke(app, ["plan", file, "--store", store]).exit_code == 0
    done = runner.invoke(app, ["run", file, "--store", store, "--executor", "serial"])
    assert done.exit_code == 0, done.output
    assert open_store(store).takes()["actor"].to_list() == ["al", "al", "bo", "bo", "cy", "cy"]
    assert "annotate: \"actor = 'cy'\"" in (tmp_path / "my.yaml").read_text()
    assert "2 takes against ground truth" in done.output


@pytest.mark.parametrize(
    ("paths", "annotate"),
    [
        ([f"{n}_{c}_{a}.bvh" for c in ("walk", "run") for a in ("al", "bo", "cy") for n in (1, 2)], "actor = 'cy'"),
        ([f"x_{c}_{n:02}.bvh" for c in ("walk", "run") for n in range(9)], "clip = '08'"),
        ([f"{c}/{c[0]}{n:02}.bvh" for c in ("walk", "run") for n in range(9)], "clip = '08'"),
        ([f"{c}/{c[0]}{name}.bvh" for c in ("walk", "run") for name in ("fox", "elm", "", "y")], "take_id % 4 = 0"),
        (["walk/fox.bvh", "walk/elm.bvh", "walk/b.bvh", "run/pea.bvh"], None),
    ],
)  # fmt: skip
def test_takes_that_all_have_a_class_are_divided_and_every_class_is_learned(
    paths: list[str], annotate: str | None
) -> None:
    found = division(propose_patterns(paths))
    assert (found and found.annotate) == annotate


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "path", "expected"),
    [
        (
            "hdm05",
            "clips/c/HDM_bd_cartwheelLHandStart1Reps_001_120.amc",
            ("bd", "cartwheelLHandStart1Reps", None, "001"),
        ),
        ("bandai", "dataset-1/dataset-1_walk_angry_001.bvh", (None, "walk", "angry", "001")),
        ("cmu", "01/01_05.amc", ("01", None, None, "05")),
    ],
)
def test_real_archives(shared: Path, name: str, path: str, expected: tuple[str | None, ...]) -> None:
    folder = shared / "data" / name
    endings = {".amc", ".bvh"}
    paths = [str(file.relative_to(folder)) for file in sorted(folder.rglob("*")) if file.suffix in endings]
    found = path_groups(path, [re.compile(one.pattern) for one in propose_patterns(paths)]) or {}
    assert tuple(found.get(role) for role in ("actor", "class", "style", "clip")) == expected
