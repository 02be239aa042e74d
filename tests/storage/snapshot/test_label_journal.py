"""The journal of labels: decisions that need no writer's lock, outlive every kill, and come into the next version."""

from __future__ import annotations

import signal
import subprocess
import sys
from multiprocessing import get_context
from pathlib import Path

import pyarrow as pa
import pytest

from kinedex.console.terminal import Terminal
from kinedex.ops.errors import ParameterError, StoreError
from kinedex.pipelines.ingestion.store_repair import repair_store
from kinedex.storage.snapshot.label_journal import read_journals
from kinedex.storage.snapshot.manifest_files import read_newest
from kinedex.storage.store.garbage_collection import collect_garbage
from kinedex.storage.store.result_changes import record_labels
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, add, make_store


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return make_store(tmp_path / "store", {"bd_walk": 50, "mm_run": 40})


def decide(path: Path, label: str = "walk", start: int = 3, **more: object) -> dict[str, object]:
    row = {"take": "bd_walk", "class": label, "start": start, "stop": start + 9, "origin": "drawn", **more}
    (new,) = record_labels(path, pa.Table.from_pylist([row])).to_pylist()
    return dict(new)


def classes(path: Path, at: int | None = None) -> list[str]:
    with open_store(path, at="newest" if at is None else at) as store:
        names: list[str] = store.labels().column("class").to_pylist()
        return names


def commit(path: Path) -> int:
    with StoreWriter.open(path, BODY) as writer:
        return writer.commit().version


def journal(path: Path) -> Path:
    (file,) = (path / "labels" / "journal").iterdir()
    return file


def test_a_decision_is_shown_at_once_and_published_by_the_next_commit(path: Path) -> None:
    before = read_newest(path).version
    first = decide(path)
    assert read_newest(path).version == before
    assert classes(path) == ["walk"]
    assert classes(path, before) == []
    assert commit(path) == before + 1
    assert [one.rows for one in read_journals(path)] == [[]]
    assert classes(path, before + 1) == classes(path) == ["walk"]
    decide(path, "run", replaces=first["id"], origin="corrected")
    assert classes(path) == ["run"]
    assert commit(path) == before + 2
    assert commit(path) == before + 2
    assert classes(path) == ["run"]
    assert read_newest(path).changes["labels"] == 1
    assert verify(open_store(path, at="newest")) == []


def test_a_writer_at_work_does_not_stop_decisions_and_loses_none(path: Path) -> None:
    with StoreWriter.open(path, BODY) as writer:
        add(writer, {"new": 30})
        first = decide(path)
        writer.put_labels(pa.Table.from_pylist([{**first, "id": None, "replaces": first["id"], "class": "run"}]))
        decide(path, "kick")
        writer.commit()
        assert classes(path) == ["run", "kick"]
        decide(path, "turn")
    assert classes(path) == ["run", "kick", "turn"]
    collect_garbage(path, keep=1)
    assert classes(path) == ["run", "kick", "turn"]


def test_an_opened_store_shows_the_same_labels_until_it_forgets_them(path: Path) -> None:
    with open_store(path, at="newest") as store:
        assert store.labels().num_rows == 0
        decide(path)
        assert store.labels().num_rows == 0
        store.forget_labels()
        assert store.labels().num_rows == 1


def test_a_line_that_a_killed_process_began_is_removed_and_nothing_else(path: Path) -> None:
    decide(path)
    file = journal(path)
    whole = file.read_bytes()
    decide(path, "run")
    added = file.read_bytes()[len(whole) :]
    for cut in sorted({*range(0, len(added), 9), 1, len(added) - 2, len(added) - 1}):
        file.write_bytes(whole + added[:cut])
        expected = ["walk", "run"] if cut == len(added) - 1 else ["walk"]  # only the end of the line is missing
        assert classes(path) == expected
        assert verify(open_store(path, at="newest")) == []
    for cut in (1, len(added) // 2, len(added) - 1):
        file.write_bytes(whole + added[:cut])
        before = classes(path)
        decide(path, "kick")
        assert classes(path) == [*before, "kick"]
    commit(path)
    assert classes(path) == ["walk", "run", "kick"]


def test_a_full_disk_leaves_the_journal_as_it_was(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    decide(path)
    whole = journal(path).read_bytes()

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", full)
        with pytest.raises(StoreError, match="No space left on device"):
            decide(path, "run")
    assert journal(path).read_bytes() == whole
    decide(path, "kick")
    assert classes(path) == ["walk", "kick"]


def test_a_damaged_line_is_an_error_is_kept_and_costs_no_other_line(path: Path) -> None:
    for label in ("walk", "run", "kick"):
        decide(path, label)
    file = journal(path)
    content = file.read_bytes()
    file.write_bytes(content.replace(b'"run"', b'"ran"'))
    with pytest.raises(StoreError, match=r"jsonl: line 3 of the journal of labels is damaged; `kinedex repair"):
        classes(path)
    commit(path)  # work on takes goes on
    (finding,) = verify(open_store(path, at="newest"))
    assert (finding.kind, finding.fault) == ("labels", True)
    assert file.read_bytes() == content.replace(b'"run"', b'"ran"')
    with pytest.raises(StoreError, match="damaged"):
        decide(path, "turn")
    repaired = repair_store(path, Terminal())
    assert classes(path) == ["walk", "kick"]
    assert repaired.remaining == []
    (kept,) = (path / "quarantine").rglob("*.jsonl")
    assert kept.read_bytes() == content.replace(b'"run"', b'"ran"')
    decide(path, "turn")
    assert classes(path) == ["walk", "kick", "turn"]


def test_a_wrong_decision_is_refused_and_not_stored(path: Path) -> None:
    for bad in ({"confidence": 1.5}, {"replaces": "nothing"}, {"origin": "guessed"}):
        with pytest.raises(ParameterError):
            decide(path, **bad)
    assert not (path / "labels" / "journal").exists()


def _many(path: Path, worker: int) -> None:
    for number in range(10):
        decide(path, f"{worker}/{number}")


def test_several_processes_decide_while_a_writer_commits(path: Path) -> None:
    context = get_context("spawn")
    people = [context.Process(target=_many, args=(path, worker)) for worker in range(2)]
    for one in people:
        one.start()
    commits = 0
    while any(one.is_alive() for one in people) and commits < 1_000:
        commit(path)
        seen = classes(path)
        assert len(seen) == len(set(seen))
        commits += 1
    for one in people:
        one.join(timeout=60)
        assert one.exitcode == 0
    assert sorted(classes(path)) == sorted(f"{worker}/{number}" for worker in range(2) for number in range(10))
    assert len(read_journals(path)) <= 2


KILLED = """
import sys
from tests.storage.snapshot.test_label_journal import Path, decide

for number in range(10_000):
    decide(Path(sys.argv[1]), str(number))
    print(number, flush=True)
"""


def test_a_killed_process_loses_nothing_that_was_acknowledged(path: Path) -> None:
    killed = subprocess.Popen([sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE, text=True)
    assert killed.stdout is not None
    for _ in range(3):
        killed.stdout.readline()
    killed.send_signal(signal.SIGKILL)
    last = int((["2", *killed.stdout.read().split()])[-1])
    killed.wait(timeout=60)
    found = [int(name) for name in classes(path)]
    assert found in (list(range(last + 1)), list(range(last + 2)))
    decide(path, "next")
    commit(path)
    assert classes(path)[-1] == "next"
    assert verify(open_store(path, at="newest")) == []
