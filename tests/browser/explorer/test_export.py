"""The Export page in a browser: a plan in the address, and the files that it writes."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.browser.explorer.conftest import Open


def test_a_plan_is_read_and_written(open_page: Open, tmp_path: Path) -> None:
    page = open_page("/export")
    expect(page.get_by_test_id("plan")).to_contain_text("8 clips of 8 takes")
    page.get_by_label("Only takes, as SQL").fill("class = 'jig'")
    expect(page.get_by_test_id("plan")).to_contain_text("2 clips of 2 takes")
    page.get_by_label("Split by").select_option("actor")
    page.get_by_label("Shares of train, val, test").fill("0.5,0.5")
    expect(page.get_by_role("region", name="Clips of each split and class")).to_contain_text("train")
    folder = tmp_path / "set"
    page.get_by_label("Folder on the machine of the server").fill(str(folder))
    expect(page.locator(".shell-same code")).to_contain_text(f"--output={folder}/")
    assert not folder.exists()
    page.get_by_role("button", name="Write", exact=True).click()
    expect(page.get_by_test_id("written")).to_contain_text("4 files", timeout=90_000)
    assert sorted(path.name for path in folder.iterdir()) == ["dataset.json", "metadata.csv", "test", "train"]


@pytest.mark.parametrize("condition", ["clas = 'jig'", "class = 'nothing'"])
def test_what_selects_nothing_is_explained(open_page: Open, condition: str) -> None:
    page = open_page("/export")
    page.get_by_label("Only takes, as SQL").fill(condition)
    expect(page.get_by_role("alert")).to_contain_text("clas" if "clas " in condition else "selects no take")
    expect(page.get_by_role("button", name="Write", exact=True)).to_be_disabled()
