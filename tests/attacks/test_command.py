"""`python -m tests.attacks` goes on after an attack that raises, ends with a table, and fails where one succeeded."""

from __future__ import annotations

import json
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from tests.attacks import __main__ as command
from tests.attacks import runs
from tests.attacks.outcome import Options, Outcome


def harmless(_: Path, options: Options) -> Outcome:
    return Outcome({options.size: options.seed}, cases=1_234)


def harmful(_: Path, __: Options) -> Outcome:
    outcome = Outcome(cases=2)
    outcome.fail("the case", "a store is torn")
    return outcome


def raising(_: Path, __: Options) -> Outcome:
    raise AssertionError("nothing is as it was")


@pytest.fixture(autouse=True)
def attacks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    known = {"raising": raising, "harmful": harmful, "harmless": harmless}
    for module in (command, runs):
        monkeypatch.setattr(module, "ATTACKS", known)
        monkeypatch.setattr(module, "FOLDER", tmp_path / "attack")
    (tmp_path / "attack").mkdir()
    monkeypatch.setattr(runs, "ProcessPoolExecutor", lambda *_: ThreadPoolExecutor(1))
    monkeypatch.setattr(runs, "JOBS", 1)


def called(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["attacks", *arguments])
    return command.main()


def test_an_attack_that_raises_has_failed_and_the_others_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert called(monkeypatch, "--sample", "--seed", "7") == 1
    shown = capsys.readouterr().out
    assert "Traceback" in shown
    assert "tests.attacks raising --seed 7 --sample\n" in shown
    assert "tests.attacks harmful --seed 7 --sample --case 'the case'\n" in shown
    assert shown.index("Traceback") < shown.index("a store is torn") < shown.index("sample size, seed 7")
    lines = [line.split() for line in shown.splitlines()[-6:]]
    assert lines[0] == ["sample", "size,", "seed", "7"]
    assert lines[1] == ["attack", "cases", "failures", "seconds"]
    assert [line[:3] for line in lines[2:]] == [
        ["raising", "0", "1"], ["harmful", "2", "1"], ["harmless", "1,234", "0"], ["all", "1,236", "2"],
    ]  # fmt: skip
    written = json.loads((tmp_path / "attack" / "raising.json").read_text())
    assert "nothing is as it was" in written["failures"][0]["problem"]
    assert json.loads((tmp_path / "attack" / "harmless.json").read_text())["counts"] == {"sample": 7}


def test_a_process_that_dies_has_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Dead(ThreadPoolExecutor):
        def submit(self, *_: object, **__: object) -> Future[object]:
            future = Future[object]()
            future.set_exception(BrokenProcessPool("terminated abruptly"))
            return future

    monkeypatch.setattr(runs, "ProcessPoolExecutor", lambda *_: Dead(1))
    assert called(monkeypatch, "harmless") == 1


def test_it_ends_with_0_where_no_attack_succeeded(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert called(monkeypatch, "harmless") == 0
    assert "ordinary size, seed 0" in capsys.readouterr().out
