"""After a power loss a store shows its last version or the one that was being committed, whole."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.attacks.power_loss import attack


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("strace") is None, reason="no strace on this machine")
def test_unflushed_writes_tear_no_version(tmp_path: Path) -> None:
    outcome = attack(tmp_path, every=151)
    assert outcome.failures == []
    assert outcome.counts["crash points"] >= 12
    assert min(outcome.counts["before"], outcome.counts["after"]) > 0
