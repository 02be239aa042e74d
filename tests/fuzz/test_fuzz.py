"""Some mutants of every reader's files, and whether the hunt would notice what it is for."""

from __future__ import annotations

import io
import os
import signal
import time
from pathlib import Path
from random import Random

import numpy as np
import pytest

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.labels.formats import FORMATS
from kinedex.storage.formats.motion.reader_table import reader_of, readers_by_ending
from tests.fuzz import hunt as hunting
from tests.fuzz.hunt import Mutator, attempt, hunt, mutant
from tests.fuzz.mutations import flip_bytes
from tests.fuzz.structure import change_structure
from tests.fuzz.targets import TARGETS, Broken, Target, check_ground_truth

CASES: dict[Mutator, int] = {"bytes": 25, "structure": 8}


@pytest.mark.parametrize("name", TARGETS)
def test_seeds_are_read_and_mutants_are_read_or_refused(tmp_path: Path, name: str) -> None:
    target = TARGETS[name]
    for key, data in target.seeds().items():
        assert attempt(target, tmp_path / f"{key}{target.ending}", data) == "read", key
    for mutator, cases in CASES.items():
        for case in range(cases):
            outcome = attempt(target, tmp_path / f"{mutator}{case}{target.ending}", mutant(target, 1, case, mutator))
            assert outcome in ("read", "refused"), f"{name}, {mutator}, seed 1, case {case}\n{outcome}"


def test_every_reader_of_motion_files_has_a_target(tmp_path: Path) -> None:
    """A seed of some target is a file that the reader reads; `make fuzz` would leave a reader without one alone."""
    readers, read = readers_by_ending(), set()
    for name, target in TARGETS.items():
        if target.ending in readers:
            path = tmp_path / f"{name}{target.ending}"
            path.write_bytes(next(iter(target.seeds().values())))
            read.add(type(reader_of(path)))
    built_in = {type(reader) for own in readers.values() for reader in own if not reader.distribution}
    assert len(built_in) >= 15
    assert built_in <= read


def test_every_format_of_label_files_has_a_target() -> None:
    checked = {target.ending for target in TARGETS.values() if target.check is check_ground_truth}
    assert {f".{ending}" for ending in FORMATS} <= checked


def test_the_same_seed_makes_the_same_mutants() -> None:
    for target in TARGETS.values():
        assert mutant(target, 3, 14) == mutant(target, 3, 14)
        if target.ending != ".c3d":  # of which every write has the time in it
            assert mutant(target, 3, 14, "structure") == mutant(target, 3, 14, "structure")
        assert len({mutant(target, 3, case) for case in range(8)}) > 1


def misread(path: Path) -> None:
    """A reader with every defect that the hunt looks for; which of them is the case's number."""
    match int(path.stem.removeprefix("case")) % 6 if path.stem.startswith("case") else 0:
        case 1:
            raise IndexError("list index out of range")
        case 2:
            time.sleep(60)
        case 3:
            os.kill(os.getpid(), signal.SIGSEGV)
        case 4:
            np.ones(1 << 31)
        case 5:
            raise SourceError(path, "wrong", line=10**9)


def hello() -> dict[str, bytes]:
    return {"hello": b"hello\n"}


MISREAD = Target("misread", ".txt", hello, (flip_bytes,), misread)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is looked up in /proc, which is not here")
def test_crashes_hangs_greed_and_wrong_results_are_found_and_can_be_looked_at_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hunting, "CASE_SECONDS", 0.2)
    report = hunt(MISREAD, seed=0, seconds=60, folder=tmp_path, cases=6)
    assert (report.cases, report.read) == (6, 1)
    found = {finding.case: finding for finding in report.findings}
    expected = {1: "IndexError", 2: "Hang", 3: "SIGSEGV", 4: "MemoryError", 5: "Broken"}
    for case, what in expected.items():
        assert what in found[case].what.splitlines()[-1]
        assert found[case].path.read_bytes() == mutant(MISREAD, 0, case)
        assert found[case].command in found[case].path.with_suffix(".txt.txt").read_text()
    assert sorted(found) == sorted(expected)


def test_a_reader_that_lets_infinity_through_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kinedex.storage.formats.motion.points.refuse_far", lambda *_: None)
    whole = np.load(io.BytesIO(TARGETS["npy"].seeds()["24"]))
    whole[-1, 15] = 1e300
    changed = io.BytesIO()
    np.save(changed, whole)
    outcome = attempt(TARGETS["npy"], tmp_path / "a.npy", changed.getvalue())
    assert Broken.__name__ in outcome
    assert "not finite, or out of bounds" in outcome


@pytest.mark.parametrize("ending", [".npy", ".npz"])
def test_arrays_of_every_type_are_changed_into_arrays(ending: str) -> None:
    """A mutator that numpy stops would end the hunt."""
    for number in range(600):
        random = Random(number)
        data = change_structure(_dates(ending), ending, random)
        for _ in range(3):
            data = change_structure(data, ending, random)
        assert data


def _dates(ending: str) -> bytes:
    file = io.BytesIO()
    dates = np.array([0, -1, 123456789123], "<M8[s]")
    if ending == ".npy":
        np.save(file, dates)
    else:
        np.savez(file, dates=dates, numbers=np.array([-1.0, np.nan]), letters=np.array("a" * 9))
    return file.getvalue()
