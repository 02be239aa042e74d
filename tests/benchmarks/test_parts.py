"""Parts of the benchmarks: none is forgotten, one that fails keeps no other from running, finished ones are kept."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks import __main__ as program
from benchmarks.harness import LEFT_OUT, ROOT, Figure
from benchmarks.kept_parts import KeptParts, state_of_checkout

MODULES = {path.stem for path in (ROOT / "benchmarks").glob("*.py")} - {"__init__", "__main__"}
ONE = [Figure("one", 2.0, "takes", 1.0, "another", 3.0)]


def texts() -> Iterator[tuple[Path, str]]:
    """Yield every source and page that may name a module of the benchmarks."""
    for pattern in ("benchmarks/**/*.py", "studies/*.py", "tests/**/*.py", "ops/**/*.py", "docs/**/*.md", "*.md"):
        for path in ROOT.glob(pattern):
            yield path, path.read_text(encoding="utf-8")


def test_every_module_is_a_part_or_is_used_by_another_or_is_a_program_that_a_page_names() -> None:
    named = set(program.PARTS)
    for path, text in texts():
        found = re.findall(r"(?:from benchmarks import|from benchmarks\.|benchmarks\.)(\w+)", text)
        named |= {name for name in found if path != ROOT / "benchmarks" / f"{name}.py"}
        for names in re.findall(r"^from benchmarks import ([\w, ]+)$", text, re.MULTILINE):
            named |= {name.strip() for name in names.split(",")}
    assert MODULES - named == set()


def test_every_part_has_figures_of_a_store() -> None:
    for part in program.PARTS:
        tree = ast.parse((ROOT / "benchmarks" / f"{part}.py").read_text(encoding="utf-8"))
        (figures,) = (one for one in tree.body if isinstance(one, ast.FunctionDef) and one.name == "figures")
        assert [one.arg for one in figures.args.args][:1], part


@pytest.fixture
def parts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, list[Figure] | Exception]:
    """Let the program run parts of these figures, and count how often it does under `ran`."""
    made: dict[str, list[Figure] | Exception] = {"good": ONE, "bad": ValueError("no table"), "empty": [], "last": ONE}

    def module(name: str) -> SimpleNamespace:
        def figures(store: object) -> Iterator[Figure]:
            ran.append(name.removeprefix("benchmarks."))
            found = made[ran[-1]]
            if isinstance(found, Exception):
                yield ONE[0]
                raise found
            yield from found

        return SimpleNamespace(figures=figures)

    ran = list[str]()
    made["ran"] = ran  # type: ignore[assignment]
    monkeypatch.setattr(program, "import_module", module)
    monkeypatch.setattr(program, "store", lambda: None)
    monkeypatch.setattr(program, "calibrate", lambda: Figure("calibration", 1.0, "M numbers", 1.0))
    monkeypatch.setattr(program, "BUILD", tmp_path)
    monkeypatch.setattr(program, "state_of_checkout", lambda: "abc")
    return made


def test_a_part_that_raises_or_has_no_figure_fails_and_the_others_run(
    parts: dict[str, list[Figure]], capsys: pytest.CaptureFixture[str]
) -> None:
    assert program.main([], ("good", "bad", "empty", "last")) == 1
    assert parts["ran"] == ["good", "bad", "empty", "last"]
    out = capsys.readouterr().out
    assert "failed: bad: ValueError: no table\nfailed: empty: it has no figure\n" in out


def test_a_run_goes_on_with_the_parts_that_are_not_finished(
    parts: dict[str, list[Figure]], capsys: pytest.CaptureFixture[str]
) -> None:
    assert program.main([], ("good", "bad")) == 1
    parts["bad"] = ONE
    assert program.main([], ("good", "bad")) == 0
    assert parts["ran"] == ["good", "bad", "bad"]
    assert "[1/2] good: kept from an earlier run of this commit" in capsys.readouterr().out
    assert program.main(["good", "--anew"], ("good", "bad")) == 0
    assert parts["ran"] == ["good", "bad", "bad", "good"]


def test_a_part_is_kept_for_its_state_of_the_checkout_alone(tmp_path: Path) -> None:
    KeptParts(tmp_path, "abc").write("reading", ONE, 60.0)
    assert KeptParts(tmp_path, "abc").read("reading") == ONE
    assert KeptParts(tmp_path, "abd").read("reading") is None
    assert KeptParts(tmp_path, None).read("reading") is None
    assert KeptParts(tmp_path, "abd").left(["reading"]) == ", some 1.0 min left"
    assert KeptParts(tmp_path, "abd").left(["reading", "ranking"]) == ""


def test_any_change_is_another_state(tmp_path: Path) -> None:
    def git(*words: str) -> None:
        who = ["-c", "user.name=somebody", "-c", "user.email=somebody@example.org"]
        subprocess.run(["git", "-C", str(tmp_path), *who, *words], check=True, capture_output=True, timeout=240)

    git("init", "-q")
    (tmp_path / "one.py").write_text("1\n")
    git("add", ".")
    git("commit", "-q", "-m", "One")
    states = [state_of_checkout(tmp_path)]
    for text in ("2\n", "3\n"):
        (tmp_path / "one.py").write_text(text)
        states.append(state_of_checkout(tmp_path))
    assert len(set(states)) == 3
    (tmp_path / "one.py").write_text("1\n")
    assert state_of_checkout(tmp_path) == states[0]


def test_what_is_left_out_is_listed_with_its_reason(
    parts: dict[str, list[Figure]], capsys: pytest.CaptureFixture[str]
) -> None:
    parts["good"] = [Figure("files", 0.0, "MB", None, f"{LEFT_OUT}no files")]
    assert program.main(["good"], ("good",)) == 0
    assert "files: left out: no files" in capsys.readouterr().out


def test_an_unknown_part_is_wrong_usage() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "raeding"], cwd=ROOT, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 2
    assert "did you mean 'reading'" in done.stderr
