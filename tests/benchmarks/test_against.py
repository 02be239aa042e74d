"""Two commits are measured by turns: the order, the ratio with its spread, what fell, and the exit status."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.against import __main__ as program
from benchmarks.against import commits, rivals
from benchmarks.against.commits import DRIVERS, Side
from benchmarks.against.comparison import Compared, compare, write
from benchmarks.against.guarded_figures import guarded_figures
from benchmarks.against.inputs import lengthened_amc, lengthened_bvh
from benchmarks.against.turns import (
    DriverError,
    Measurement,
    Missing,
    by_turns,
    measure_once,
    order_of_turns,
    read_answer,
    reason_of,
)
from kinedex.ops.errors import KinedexError

WORK = ast.parse((DRIVERS / "work.py").read_text(encoding="utf-8"))


def side(name: str) -> Side:
    """Return a side of which only the name counts."""
    return Side(name, Path(sys.executable), Path(), Path(), Path())


SIDES = (side("old"), side("this"))


class Fake:
    """Measurements of figures by the names of the sides, and the order in which they were asked for."""

    def __init__(self, **seconds: float | list[float] | str) -> None:
        self.seconds = seconds
        self.asked = list[str]()

    def __call__(self, measured: Side, figure: str, inputs: Path) -> Measurement:
        self.asked.append(measured.name)
        found = self.seconds[measured.name]
        if isinstance(found, str):
            if found.startswith("no "):
                return Missing(found)
            raise DriverError(found)
        value = found if isinstance(found, float) else found[self.asked.count(measured.name) - 1]
        return {"seconds": value, "amount": 10.0}


def rounds(*values: float) -> list[dict[str, float]]:
    return [{"seconds": value, "amount": 10.0} for value in values]


def test_the_sides_take_turns_in_being_first() -> None:
    assert list(order_of_turns(4)) == [(0, 1), (1, 0), (0, 1), (1, 0)]
    fake = Fake(old=2.0, this=1.0)
    found = by_turns(SIDES, "figure", Path(), 3, fake)
    assert fake.asked == ["old", "this", "old", "this", "this", "old", "old", "this"]
    assert [len(one) for one in found] == [3, 3]


def test_the_first_measurement_of_each_side_only_fills_the_caches() -> None:
    found = by_turns(SIDES, "figure", Path(), 2, Fake(old=[9.0, 1.0, 2.0], this=[8.0, 3.0, 4.0]))
    assert found == (rounds(1.0, 2.0), rounds(3.0, 4.0))


def test_a_side_that_lacks_a_figure_is_asked_once() -> None:
    fake = Fake(old="no such command", this=1.0)
    assert by_turns(SIDES, "figure", Path(), 5, fake) == (Missing("no such command"), rounds(1.0)[0])
    assert fake.asked == ["old", "this"]


@pytest.mark.parametrize(("unit", "other", "this"), [("MB/s", 5.0, 10.0), ("s", 2.0, 1.0), ("ms", 2000.0, 1000.0)])
def test_half_the_time_is_twice_as_good_in_every_unit(unit: str, other: float, this: float) -> None:
    row = compare("figure", unit, rounds(2.0, 2.0, 2.0), rounds(1.0, 1.0, 1.0))
    assert row == Compared("figure", unit, other, this, 2.0, 2.0, 2.0, False)


def test_twice_the_memory_is_half_as_good() -> None:
    row = compare("figure", "MB", [{"bytes": 1e6}], [{"bytes": 2e6}])
    assert (row.other, row.this, row.ratio, row.fell) == (1.0, 2.0, 0.5, True)


def test_the_spread_is_that_of_the_rounds_and_one_disturbed_round_does_not_widen_it() -> None:
    row = compare("figure", "s", rounds(1.0, 1.0, 1.0, 1.0, 9.0), rounds(1.0, 1.25, 2.0, 1.0, 1.0))
    assert (row.low, row.ratio, row.high) == (0.8, 1.0, 1.0)
    assert not row.fell


@pytest.mark.parametrize(
    ("seconds", "fell"),
    [
        ((1.05, 1.05, 1.05, 1.05, 1.05), False),  # less than 10 %
        ((1.2, 1.2, 1.2, 1.2, 1.2), True),
        ((1.2, 1.2, 1.2, 1.0, 1.0), False),  # within the spread
        ((1.2, 1.2, 1.2, 1.2, 0.5), True),  # but for one round
        ((0.5, 0.5, 0.5, 0.5, 0.5), False),
    ],
)
def test_a_figure_fell_if_it_is_worse_by_more_than_a_tenth_beyond_the_spread(
    seconds: tuple[float, ...], fell: bool
) -> None:
    assert compare("figure", "s", rounds(1.0, 1.0, 1.0, 1.0, 1.0), rounds(*seconds)).fell is fell


def test_json_has_a_list_of_figures(tmp_path: Path) -> None:
    write([Compared("a", "s", 2.0, 1.0, 2.0, 1.9, 2.1, False, "aside")], tmp_path / "build" / "against.json")
    (found,) = json.loads((tmp_path / "build" / "against.json").read_text())
    assert list(found) == ["figure", "unit", "other", "this", "ratio", "low", "high", "fell", "remark"]


@pytest.mark.parametrize("text", ["", "no json", "{}", '{"seconds": 0, "amount": 1}', '{"seconds": 1}', '{"bytes": 0}'])
def test_a_driver_that_measured_nothing_is_an_error(text: str) -> None:
    with pytest.raises(DriverError, match="printed no measurement"):
        read_answer(text, "read_amc", "old")


# ---- the program -----------------------------------------------------------------------------------------


@pytest.fixture
def compared(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Let the program compare two sides that are not there, and return the file of its result."""
    monkeypatch.setattr(program, "RESULT", tmp_path / "against.json")
    monkeypatch.setattr(program, "ROOT", tmp_path)
    monkeypatch.setattr(program, "inputs", lambda: tmp_path)
    monkeypatch.setattr(program, "other_side", lambda commit, report, with_page: side("old"))
    monkeypatch.setattr(program, "this_side", lambda: Side("this", Path(), Path(), Path(), tmp_path / "this"))
    monkeypatch.setattr(program, "rival_rows", lambda figures, rows, inputs: [])
    return tmp_path / "against.json"


@pytest.mark.parametrize(
    ("old", "this", "status"),
    [
        (1.0, 1.0, 0),
        (1.0, 2.0, 1),
        ("no such command", 2.0, 0),  # an older commit lacks it
        (1.0, "no such command", 1),  # this one may lack nothing
        ("a traceback", 1.0, 1),
        (1.0, "a traceback", 1),
    ],
)
def test_the_exit_status_says_whether_a_figure_fell_or_failed(
    compared: Path, old: float | str, this: float | str, status: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert program.main(["old", "features"], Fake(old=old, this=this)) == status
    (row,) = json.loads(compared.read_text())
    assert row["fell"] is (this == 2.0 and old == 1.0)
    out = capsys.readouterr().out
    for text in (old, this):
        if isinstance(text, str):
            assert text in " ".join(out.split())


def test_a_figure_that_fails_keeps_no_other_from_being_measured(compared: Path) -> None:
    class Half(Fake):
        def __call__(self, measured: Side, figure: str, inputs: Path) -> Measurement:
            if figure == "start_help":
                raise DriverError("a traceback")
            return super().__call__(measured, figure, inputs)

    assert program.main(["old", "startup", "--rounds", "1"], Half(old=1.0, this=1.0)) == 1
    ratios = [row["ratio"] for row in json.loads(compared.read_text())]
    assert ratios == [None] + [1.0] * (len(guarded_figures(["startup"])) - 1)


def test_an_interrupted_run_leaves_what_it_measured(compared: Path, capsys: pytest.CaptureFixture[str]) -> None:
    class Interrupted(Fake):
        def __call__(self, measured: Side, figure: str, inputs: Path) -> Measurement:
            if figure == "start_sql":
                raise KeyboardInterrupt
            return super().__call__(measured, figure, inputs)

    with pytest.raises(KeyboardInterrupt):
        program.main(["old", "startup"], Interrupted(old=2.0, this=1.0))
    assert [row["ratio"] for row in json.loads(compared.read_text())] == [2.0, 2.0]
    assert capsys.readouterr().out.count("2.00 (2.00 to 2.00)") == 2


def test_an_unknown_part_is_wrong_usage(compared: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert program.main(["old", "raeding"], Fake()) == 2
    assert "did you mean 'reading'?" in capsys.readouterr().err


def test_an_unknown_commit_is_an_error_and_no_history_is_none_for_the_newest_tag(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(commits, "ROOT", tmp_path)  # no repository
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert program.main(["v0.0.0"], Fake()) == 2
    assert "commit 'v0.0.0' is not in the git history" in capsys.readouterr().err
    assert program.main(["newest-tag"], Fake()) == 0
    assert "nothing is compared" in capsys.readouterr().out
    assert program.main(["newest-tag", "raeding"], Fake()) == 2


# ---- other packages --------------------------------------------------------------------------------------


def test_packages_that_do_the_same_stand_below_the_figures_and_nothing_falls(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fake(figure: str, package: str, inputs: Path) -> dict[str, float]:
        if package == "second":
            raise DriverError("it took longer than 600 s")
        return {"seconds": 1.0, "amount": 4.0}

    monkeypatch.setattr(rivals, "_measured", fake)
    monkeypatch.setattr(rivals.metadata, "version", lambda name: "1.2")
    monkeypatch.setattr(
        rivals,
        "rival_readers",
        lambda figure, inputs: (inputs, {"first": str, "second": str} if figure == "read_bvh" else {}),
    )
    figures = [one for one in guarded_figures(["reading"]) if one.key in ("read_bvh", "read_trc")]
    rows = [compare(one.figure, one.unit, rounds(1.0), rounds(1.0)) for one in figures]
    found = rivals.rival_rows(figures, rows, tmp_path)
    assert [(row.figure, row.other, row.this, row.ratio, row.fell) for row in found] == [
        ("read a BVH file, beside first 1.2", 4.0, 10.0, 2.5, False),
        ("read a BVH file, beside second 1.2", None, 10.0, None, False),
    ]
    assert found[1].remark == "not compared: it took longer than 600 s"


# ---- commits ---------------------------------------------------------------------------------------------


@pytest.fixture
def repository(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A repository with two commits, of which the first has a tag."""
    root = tmp_path / "repository"
    root.mkdir()
    monkeypatch.setattr(commits, "ROOT", root)
    monkeypatch.setattr(commits, "BUILD", root / "build" / "against")
    who = ["-c", "user.name=somebody", "-c", "user.email=somebody@example.org"]

    def git(*words: str) -> None:
        subprocess.run(["git", "-C", str(root), *who, *words], check=True, capture_output=True, timeout=240)

    git("init", "-q")
    for number in (1, 2):
        (root / "requirements.lock").write_text(f"# {number}\n")
        git("add", ".")
        git("commit", "-q", "-m", f"Number {number}")
        if number == 1:
            git("tag", "v0.1.0")
    return root


def test_the_newest_tag_is_that_before_this_commit(repository: Path) -> None:
    assert commits.newest_tag() == "v0.1.0"


def test_a_commit_gets_a_checkout_and_an_environment_once(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run, said = list[list[str]](), list[str]()

    def install(command: list[str]) -> None:
        run.append(command)
        if "venv" in command:
            Path(command[-1]).mkdir()

    monkeypatch.setattr(commits, "_run", install)
    made = commits.other_side("v0.1.0", said.append)
    assert (made.tree / "requirements.lock").read_text() == "# 1\n"
    assert [command[2] for command in run] == ["venv", "pip"]
    assert str(made.tree / "requirements.lock") in run[1]
    assert len(said) == 2
    assert commits.other_side("v0.1.0", said.append) == made
    assert (len(run), len(said)) == (2, 2)


def test_the_page_of_a_commit_is_built_once_if_it_has_one_and_it_is_needed(
    repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, said = list[list[str]](), list[str]()

    def install(command: list[str]) -> None:
        run.append(command)
        if "venv" in command:
            Path(command[-1]).mkdir()

    monkeypatch.setattr(commits, "_run", install)
    tree = commits.other_side("v0.1.0", said.append, with_page=True).tree
    assert [command for command in run if command[0] == "make"] == []
    (tree / "Makefile").write_text("page: built\n")
    commits.other_side("v0.1.0", said.append)
    assert [command for command in run if command[0] == "make"] == []
    for _ in range(2):
        commits.other_side("v0.1.0", said.append, with_page=True)
    environment = tree.parent / "environment"
    assert [command for command in run if command[0] == "make"] == [
        ["make", "-C", str(tree), "page", f"VENV={environment}"]
    ]
    assert (environment / "run.stamp").is_file()
    assert said[-1] == "building the explorer's page of v0.1.0"


def test_what_a_command_of_a_failed_process_printed_is_in_the_error() -> None:
    trace = "Traceback (most recent call last):\n  File\nCalledProcessError: exit status 1."
    assert reason_of(f"a notice\nkinedex: no such limb\n{trace}\n") == (
        "kinedex: no such limb; CalledProcessError: exit status 1."
    )
    assert reason_of(trace) == "CalledProcessError: exit status 1."
    assert reason_of("killed\n") == "killed"
    assert reason_of("") == "nothing was printed"


def test_the_first_commit_has_a_driver_of_its_own() -> None:
    assert (DRIVERS / f"commit_{commits.FIRST}.py").is_file()


# ---- drivers ---------------------------------------------------------------------------------------------


def functions(name: str) -> set[str]:
    """Return the public functions of a module of the drivers."""
    tree = ast.parse((DRIVERS / f"{name}.py").read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef) and not node.name.startswith("_")}


def test_every_guarded_figure_has_its_work_and_says_what_it_means() -> None:
    figures = guarded_figures()
    assert {one.key for one in figures} == functions("work")
    assert len({one.figure for one in figures}) == len(figures)
    for one in figures:
        assert one.unit in ("s", "ms", "MB") or one.unit.endswith("/s")
        assert one.means.endswith(".")
        assert one.rounds >= 3


def test_a_public_driver_does_every_part_of_the_work_and_older_ones_nothing_else() -> None:
    parts = {
        node.attr
        for node in ast.walk(WORK)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "driver"
    }
    assert functions("public_api") == parts
    for path in DRIVERS.glob("commit_*.py"):
        assert functions(path.stem) < parts


def test_the_public_driver_imports_nothing_of_the_inside() -> None:
    tree = ast.parse((DRIVERS / "public_api.py").read_text(encoding="utf-8"))
    modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    modules |= {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    assert {name for name in modules if name and name.startswith("kinedex")} == {"kinedex"}


def launched(driver: Path, figure: str, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, DRIVERS / "launcher.py", driver, figure, folder, folder / "work"]
    return subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=60)


def test_the_launcher_measures_a_figure_with_a_driver(tmp_path: Path) -> None:
    (tmp_path / "long").mkdir()
    (tmp_path / "long" / "long.amc").write_bytes(b"x" * 2_000_000)
    driver = tmp_path / "driver.py"
    driver.write_text("def read(path):\n    print('heard by nobody')\n    return path.read_bytes()\n")
    found = read_answer(launched(driver, "read_amc", tmp_path).stdout, "read_amc", "this")
    assert isinstance(found, dict)
    assert found["amount"] == 2.0
    assert 0 < found["seconds"] < 60


def test_a_figure_of_this_checkout_is_measured_in_a_process_of_its_own(tmp_path: Path) -> None:
    here = replace(commits.this_side(), work=tmp_path / "work")
    found = measure_once(here, "start_help", tmp_path)
    assert isinstance(found, dict)
    assert found["amount"] == 1.0
    assert found["seconds"] > 0
    assert (tmp_path / "work" / tmp_path.name).is_dir()


def test_a_figure_that_fails_says_with_what(tmp_path: Path) -> None:
    here = replace(commits.this_side(), work=tmp_path / "work")
    with pytest.raises(DriverError, match=r"read_amc at this ended with status 1: .*long\.amc"):
        measure_once(here, "read_amc", tmp_path)


def test_a_driver_that_lacks_a_part_of_the_work_says_so_and_one_that_raises_fails(tmp_path: Path) -> None:
    driver = tmp_path / "driver.py"
    driver.write_text("def read(path):\n    raise ValueError('no numbers')\n")
    found = launched(driver, "ingest_index", tmp_path)
    assert read_answer(found.stdout, "ingest_index", "old") == Missing("no run pipeline")
    (tmp_path / "long").mkdir()
    (tmp_path / "long" / "long.amc").write_bytes(b"x")
    failed = launched(driver, "read_amc", tmp_path)
    assert failed.returncode != 0
    assert failed.stderr.strip().endswith("ValueError: no numbers")


def test_long_files_repeat_the_frames_of_short_ones() -> None:
    amc = lengthened_amc(b"#!OML\n:DEGREES\n1\nroot 1\nleg 2\n2\nroot 3\nleg 4\n", 3).decode()
    assert amc == "#!OML\n:DEGREES\n1\nroot 1\nleg 2\n2\nroot 3\nleg 4\n3\nroot 1\nleg 2\n"
    bvh = lengthened_bvh(b"HIERARCHY\n}\nMOTION\nFrames: 2\nFrame Time: 0.1\n1 2\n3 4\n", 3).decode()
    assert bvh == "HIERARCHY\n}\nMOTION\nFrames: 3\nFrame Time: 0.1\n1 2\n3 4\n1 2\n"


def test_a_wrong_part_names_the_known_ones() -> None:
    with pytest.raises(KinedexError, match="which has reading, ingest"):
        guarded_figures(["raeding"])
