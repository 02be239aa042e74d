"""No name on a terminal is obeyed: a few commands over hostile takes; `python -m tests.attacks names` tries all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.attacks.names import HOSTILE, on_terminal, problems
from tests.storage.made_up import make_store


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has no pseudo-terminals")
def test_no_command_writes_a_name_that_a_terminal_obeys(tmp_path: Path) -> None:
    store = str(make_store(tmp_path / "store", dict.fromkeys(HOSTILE, 9)))
    for arguments in (
        ["takes", store],
        ["sql", store, "SELECT [name], name FROM takes"],
        ["export", store, "\x1b[2Jx"],
    ):
        code, shown = on_terminal([*arguments], tmp_path)
        assert [*problems(code, shown)] == []
        assert code == int(arguments[0] == "export")
        assert "\\x1b[" in shown
