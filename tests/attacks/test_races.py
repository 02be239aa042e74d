"""Readers, writers, builds and collections at the same time, in short: `tests.attacks.races` has the long form."""

from __future__ import annotations

from pathlib import Path

from tests.attacks.races import attack


def test_no_read_fails_while_others_write_build_and_collect(tmp_path: Path) -> None:
    outcome = attack(tmp_path, commits=4, rounds=0)
    assert outcome.failures == []
    assert outcome.counts["commits"] == 4
    assert outcome.counts["reads of the newest"] > 0


def test_processes_that_begin_the_same_new_store_wait_or_name_the_winner(tmp_path: Path) -> None:
    outcome = attack(tmp_path, commits=0, rounds=2, case="new store 1")
    assert outcome.failures == []
    assert outcome.counts["runs that won, or waited"] == 3
