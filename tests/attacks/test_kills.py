"""A store survives SIGKILL in every phase of a work: see `tests.attacks.kills` for all works."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.attacks.kills import attack
from tests.attacks.system_calls import Call, available, watched

pytestmark = pytest.mark.skipif(not available(), reason="system calls can be watched on Linux on x86-64 alone")


@pytest.mark.slow
def test_works_killed_in_every_phase_leave_a_whole_version_and_end_with_the_same_content(tmp_path: Path) -> None:
    outcome = attack(tmp_path, seed=0, kills=8, works=["first ingest", "compaction"], jobs=1)
    assert outcome.failures == []
    assert outcome.counts["kills"] >= 12
    assert {f"compaction: {phase}" for phase in ("frames parts", "takes parts", "commit")} <= set(outcome.counts)


def test_a_call_that_is_not_allowed_never_happens(tmp_path: Path) -> None:
    seen: list[Call] = []

    def allow(call: Call) -> bool:
        seen.append(call)
        return call.name != "rename"

    def work() -> None:
        (tmp_path / "a").write_text("whole")
        (tmp_path / "a").rename(tmp_path / "b")
        (tmp_path / "c").mkdir()

    assert watched(work, str(tmp_path), allow) == -9
    assert [call.name for call in seen] == ["openat", "write", "rename"]
    assert (tmp_path / "a").read_text() == "whole"
    assert {path.name for path in tmp_path.iterdir()} == {"a"}
