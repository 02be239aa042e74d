"""The map of an archive in a real browser: clusters that nobody has named, by lasso, by keys and as a table."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from playwright.sync_api import Page, expect

import kinedex
from tests.browser.explorer.conftest import WAIT_MS, Open
from tests.pipelines.labelled import POSES, write_store

pytestmark = pytest.mark.slow

MAP_MS = 8 * WAIT_MS
"""A process of low priority loads its libraries and computes the map, after all that runs beside it."""

EACH = 14


@pytest.fixture(scope="module")
def motions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a store of three motions, in many takes of different tempo each; of one motion no take has a class."""
    random = np.random.default_rng(3)
    takes: list[dict[str, object]] = [
        {
            "name": f"{name}_{number:02d}",
            "actor": "al",
            "class": None if name == "wave" else name,
            "words": np.repeat(POSES[name], random.integers(3, 9, len(POSES[name]))),
        }
        for name in ("kick", "walk", "wave")
        for number in range(EACH)
    ]
    return write_store(tmp_path_factory.mktemp("map") / "motions", takes)


@pytest.fixture(scope="module")
def explorer(serve: Callable[[Path], str], motions: Path) -> str:
    return serve(motions)


def place(page: Page, one: dict[str, float], reach: dict[str, float]) -> tuple[float, float]:
    """Return where a point of the map is on the screen while the whole map is in sight."""
    box = page.locator(".map-box").bounding_box()
    assert box is not None
    scale = 0.45 * min(box["width"] / reach["x"], box["height"] / reach["y"])
    return box["x"] + box["width"] / 2 + one["x"] * scale, box["y"] + box["height"] / 2 - one["y"] * scale


def test_a_cluster_that_nobody_has_named_is_seen_chosen_and_kept(open_page: Open, motions: Path) -> None:
    places = kinedex.open_store(motions).map()
    page = open_page("/?view=map")
    about = page.locator(".map-about")
    expect(about).to_contain_text(f"{3 * EACH} takes, 3 clusters", timeout=MAP_MS)
    expect(page.get_by_role("list", name="Signs of class").get_by_role("listitem")).to_have_text(
        [re.compile(f"^kick{EACH}"), re.compile(f"^walk{EACH}"), re.compile(f"^none{EACH}")]
    )
    waves = places.filter(pl.col("take").str.starts_with("wave"))
    assert waves["cluster"].n_unique() == 1
    reach = {axis: max(0.05, float(places[axis].abs().max())) for axis in ("x", "y")}  # type: ignore[arg-type]
    low, high = (
        {axis: getattr(waves[axis], end)() + by for axis in "xy"} for end, by in (("min", -0.03), ("max", 0.03))
    )
    page.keyboard.press("l")
    corners = [{"x": x, "y": y} for x, y in ((low["x"], low["y"]), (high["x"], low["y"]), (high["x"], high["y"]))]
    corners.append({"x": low["x"], "y": high["y"]})
    page.mouse.move(*place(page, corners[0], reach))
    page.mouse.down()
    for corner in corners[1:]:
        page.mouse.move(*place(page, corner, reach), steps=5)
    page.mouse.up()
    choice = page.get_by_role("group", name="What is chosen")
    expect(choice).to_contain_text(f"{EACH} takes chosen")
    page.reload()
    expect(choice).to_contain_text(f"{EACH} takes chosen")  # the address has it
    expect(choice.get_by_role("link", name="Search within")).to_have_attribute("href", re.compile("^/ask.filters="))
    page.keyboard.press("o")
    expect(page.get_by_role("button", name=f"Remove the filter chosen on the map: {EACH} takes")).to_be_visible()
    expect(about).to_contain_text(f"{EACH} points fit the filters")
    page.get_by_role("tab", name="Takes").click()
    expect(page.get_by_role("status").filter(has_text=f"{EACH} takes")).to_be_visible()
    expect(page.get_by_role("gridcell", name="wave_00")).to_be_visible()
    assert len(page.url) < 300


def test_keys_move_over_the_map_and_a_table_has_its_clusters(open_page: Open) -> None:
    page = open_page("/?view=map&colour=actor")
    expect(page.locator(".map-about")).to_contain_text("3 clusters", timeout=MAP_MS)
    page.get_by_role("application", name="Map of the archive").focus()
    page.keyboard.press("ArrowRight")
    expect(page.locator(".map-about")).to_contain_text(re.compile(r"At \w+_\d\d, al · "))
    first = page.locator(".map-hover strong").text_content()
    for key in ("ArrowRight", "ArrowUp", "ArrowLeft", "ArrowDown", "ArrowLeft"):
        page.keyboard.press(key)
    expect(page.locator(".map-hover strong")).not_to_have_text(str(first))
    page.keyboard.press(" ")
    expect(page.get_by_role("group", name="What is chosen")).to_contain_text("1 take chosen")
    name = page.locator(".map-hover strong").text_content()
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile(f"/take/{name}"))
    page.go_back()
    page.keyboard.press("t")
    rows = page.get_by_role("row")
    expect(rows).to_have_count(4)
    unnamed = rows.filter(has_text="no class")
    expect(unnamed.get_by_role("link")).to_have_count(3)
    expect(unnamed.get_by_role("link").first).to_have_text(re.compile("^wave_"))
    unnamed.get_by_role("button", name=re.compile("Only these")).click()
    expect(page.get_by_role("button", name=f"Remove the filter chosen on the map: {EACH} takes")).to_be_visible()


def test_windows_are_points_too_and_a_phone_shows_them(open_page: Open) -> None:
    page = open_page("/?view=map&unit=windows&class=walk", width=390, height=844, scheme="dark")
    expect(page.locator(".map-about")).to_contain_text(f"{3 * EACH} windows", timeout=MAP_MS)
    expect(page.get_by_role("application")).to_be_visible()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
