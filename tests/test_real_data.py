"""The folder of real data is found beside the checkout, by KINEDEX_SHARED, or hidden by it."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

from tests.conftest import pytest_terminal_summary
from tests.real_data import shared_folder, takes_other_data

ROOT = Path(__file__).resolve().parents[1]


def test_the_folder_is_beside_the_checkout_unless_the_variable_names_or_hides_it(tmp_path: Path) -> None:
    checkout = tmp_path / "checkout"
    assert shared_folder(None, checkout) == tmp_path / "shared"
    assert shared_folder("", checkout) == tmp_path / "shared"
    assert shared_folder(str(tmp_path / "elsewhere"), checkout) == tmp_path / "elsewhere"
    (tmp_path / "shared").mkdir()
    assert not shared_folder("none", checkout).exists()


def test_one_module_alone_knows_where_real_data_is() -> None:
    named = [
        path.relative_to(ROOT).as_posix()
        for room in ("tests", "studies", "benchmarks")
        for path in sorted((ROOT / room).rglob("*.py"))
        if re.search(r"parents?(?:\[\d\])?(?:\.parent)* / \"shared\"", path.read_text(encoding="utf-8"))
    ]
    assert named == ["tests/real_data.py"]


def test_modules_that_take_other_data_are_found_by_what_they_import() -> None:
    assert takes_other_data(ROOT / "tests" / "fuzz" / "test_fuzz.py")  # by its seeds
    assert takes_other_data(ROOT / "tests" / "browser" / "explorer" / "test_story.py")
    assert not takes_other_data(ROOT / "tests" / "test_glossary.py")
    assert not takes_other_data(ROOT / "tests" / "pipelines" / "test_reference.py")  # by the fixture, so it is skipped


def test_reasons_of_skips_are_one_line_each() -> None:
    lines: list[str] = []
    skipped = [SimpleNamespace(longrepr=("a.py", line, f"Skipped: {why}")) for line, why in enumerate("xyx")]
    reporter = SimpleNamespace(stats={"skipped": skipped}, write_line=lines.append)
    pytest_terminal_summary(reporter)  # type: ignore[arg-type]
    assert lines == ["2 skipped: x", "1 skipped: y"]
