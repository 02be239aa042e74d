"""SQL cannot write, whatever statement stands wherever in it, and reads no file outside the store.

`make attack` runs eleven times as many statements.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.attacks.sql_writes import attack


@pytest.mark.slow
def test_no_statement_writes_or_reads_a_file_whatever_its_nesting_and_its_blanks(tmp_path: Path) -> None:
    tried, refused, broken = attack(tmp_path, every=11)
    assert broken == []
    assert tried >= 1_100
    assert refused > 0.98 * tried  # the others have the word of a statement as an alias, as in FROM (VACUUM)
