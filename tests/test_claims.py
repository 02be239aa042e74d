"""Every command that the project prints has a way in which it is run, and names commands and options that there are."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from kinedex.ops.errors import StoreError
from studies import _report
from studies.__main__ import studies
from studies.bounded_process import run_bounded
from studies.small_form import FORMS, Bench, Form, forms
from tests.claims.__main__ import Report, Task, chosen, command, run_all
from tests.claims.outcomes import Outcome, table
from tests.claims.printed import ROOT, Printed, commands, make_targets, pages, printed_in_code, printed_in_page
from tests.claims.usage import wrong_usage
from tests.claims.ways import document, named_tests, page_ways, phony_targets, way_of_program, without_a_way

PIPELINES = " | "
"""In the README, all commands stand in one line, divided by it."""


@pytest.fixture(scope="module")
def printed() -> list[Printed]:
    """All that is printed, which takes a while to find."""
    return [one for name in pages() for one in printed_in_page(name)] + printed_in_code()


def test_every_page_says_how_its_commands_are_run(printed: list[Printed]) -> None:
    with_blocks = {one.place for one in printed if one.form == "block"}
    assert with_blocks == set(page_ways()), "tests/claims/ways.yaml"


@pytest.mark.parametrize("name", page_ways())
def test_what_the_list_says_of_a_page_is_about_commands_that_it_prints(name: str) -> None:
    way = page_ways()[name]
    lines = [one.line for one in printed_in_page(name) if one.form == "block"]
    assert not {*way.instead, *way.exit} - set(lines)
    assert all(any(line.startswith(beginning) for line in lines) for beginning in way.reasons)
    assert all(any(text in line for line in [*lines, *way.instead.values()]) for text in way.words)
    assert not [step.printed for step in way.steps() if not step.way], "has no way in tests/claims/ways.yaml"


def test_every_command_of_another_program_has_a_way(printed: list[Printed]) -> None:
    assert not [one for one in printed if without_a_way(one)], "tests/claims/ways.yaml"


def test_every_target_of_the_makefile_has_a_way() -> None:
    assert set(document()["make"]) == phony_targets()
    assert make_targets() <= phony_targets()
    ways = {"run", "within", "not", "nightly", "seconds"}
    assert all(set(way) <= ways and set(way) & {"run", "within", "not"} for way in document()["make"].values())


def test_commands_of_kinedex_and_their_options_exist(printed: list[Printed]) -> None:
    wrong = {
        (one.place, one.line): found
        for one in printed
        if one.line.startswith(("kinedex ", "python -m "))
        and PIPELINES not in one.line
        and (found := wrong_usage(one.line))
    }
    assert wrong == {}


def test_tests_that_the_list_names_exist() -> None:
    assert not [name for name in named_tests() if not (ROOT / name).is_file()]


def test_commands_are_found_in_all_their_forms() -> None:
    text = """
    kinedex sql s "SELECT 1
        FROM takes"  # a comment
    $ make demo      # another one
    kinedex search s q \\
        --top 3
    kinedex: this is what it prints
    for one in a b; do
      kinedex takes $one
    done
    kinedex.open_store("s")
    nothing else
    """
    assert list(commands(text)) == [
        'kinedex sql s "SELECT 1 FROM takes"', "make demo", "kinedex search s q --top 3",
        "for one in a b; do\nkinedex takes $one\ndone",
    ]  # fmt: skip


def test_a_new_command_without_a_way_is_found() -> None:
    assert way_of_program("python -m studies.bandai DIR")
    assert way_of_program("make test")
    for line in ("python -m studies.unheard_of", "make coffee", "python -m nothing"):
        assert not way_of_program(line)


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("kinedex takes STORE --where x", ""),
        ("kinedex takes … --columns name", ""),
        ("kinedex labels add --help", ""),
        ("kinedex inspect FILE [--sensors five.yaml]", ""),
        ("python -m studies.bandai DIR --seeds 6", ""),
        ("python -m studies.bandai DIR --fly", "no option --fly"),
        ("python -m studies.fly", "no program fly"),
        ("kinedex fly", "no command fly"),
        ("kinedex labels fly", "no command fly"),
        ("kinedex sql S --fly", "no option --fly"),
    ],
)
def test_wrong_usage_is_found(line: str, fault: str) -> None:
    assert wrong_usage(line) == fault


def test_a_table_of_outcomes_has_a_line_for_each_and_the_output_of_what_failed() -> None:
    text = table([Outcome("a", "as it is", 1.25, "ok"), Outcome("b | c", "", 0, "exit code 2\nno such file")])
    assert "| a | as it is | 1.2 | ok |" in text
    assert "exit code 2 |" in text
    assert text.endswith("b | c\nexit code 2\nno such file\n\n2 claims: 1 ok, 0 not run here, 1 failed")


def test_tasks_run_after_those_that_they_need_and_one_that_fails_costs_no_other() -> None:
    order: list[str] = []

    def task(name: str, *after: str) -> Task:
        def run() -> Iterator[Outcome]:
            order.append(name)
            if name == "b":
                raise ValueError("no b")
            yield Outcome(name, "", 0.0, "ok")

        return Task(name, run, after)

    report = Report()
    todo = [task("c", "a", "b"), task("b", "a"), task("a"), task("d", "c")]
    assert [one.name for one in chosen(todo, ["b"])] == ["b", "a"]
    run_all(chosen(todo, []), 2, report)
    assert order == ["a", "b", "c", "d"]
    assert {(one.claim, one.failed) for one in report.outcomes} == {
        ("a", False),
        ("b", True),
        ("c", False),
        ("d", False),
    }


def test_a_command_that_fails_shows_the_end_of_its_output_and_one_that_is_slow_is_ended(tmp_path: Path) -> None:
    bench = Bench(tmp_path, tmp_path)
    (failed,) = command("x", {"run": "python -c \"print('its words'); raise SystemExit(3)\""}, bench)
    assert failed.result == "exit code 3\nits words"
    (slow,) = command("x", {"run": "python -c 'import time; time.sleep(60)'", "seconds": 0.5}, bench)
    assert slow.result == "took longer than 0.5 s"


def test_targets_do_not_inherit_what_make_was_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    makefile = tmp_path / "Makefile"
    makefile.write_text("all:\n\t@test -z '$(NIGHTLY)'\n")
    monkeypatch.setenv("MAKEFLAGS", " -- NIGHTLY=1")
    monkeypatch.setenv("NIGHTLY", "1")
    (outcome,) = command("x", {"run": f"make -f {makefile}"}, Bench(tmp_path, tmp_path))
    assert outcome.result == "ok"


def test_every_study_has_a_small_form_or_a_reason_for_none() -> None:
    assert set(forms()) == set(studies()), FORMS.name
    assert all(bool(form.run) != bool(form.reason) for form in forms().values())


def test_a_small_study_runs_is_left_out_or_fails_with_its_output(tmp_path: Path) -> None:
    bench = Bench(tmp_path, tmp_path / "no data", {"queries": str(ROOT / "configs" / "queries" / "example.yaml")})
    assert bench.study("stiffness", forms()["stiffness"]).result == "ok"
    assert bench.study("priors", forms()["priors"]).result.startswith("left out: no hdm05, cameras in ")
    failed = bench.study("stiffness", Form("nothing.yaml"))
    assert failed.failed
    assert failed.result.startswith("exit code 1\n")
    assert "nothing.yaml" in failed.result


def test_the_list_of_studies_is_printed_and_an_unknown_one_is_refused() -> None:
    run = [sys.executable, "-m", "studies"]
    done = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.splitlines() == list(studies().values())
    done = subprocess.run([*run, "--small", "nothing"], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert "no study nothing; `python -m studies` lists them" in done.stderr


def test_studies_report_errors_of_kinedex_in_one_message(capsys: pytest.CaptureFixture[str]) -> None:
    _report(StoreError, StoreError("s: the index is missing"), None)
    assert capsys.readouterr().err == "python -m studies: s: the index is missing\n"


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="reads /proc")
def test_a_program_that_takes_too_long_ends_with_what_it_started(tmp_path: Path) -> None:
    script = "sleep 600 & echo $! > child; wait"
    assert run_bounded(["bash", "-c", script], tmp_path, os.environ, 1.0).code is None
    child = int((tmp_path / "child").read_text(encoding="utf-8"))
    deadline = time.monotonic() + 60
    while _runs(child) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not _runs(child)


def _runs(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"
