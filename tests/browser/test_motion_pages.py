"""Pages and pictures of hits, takes and templates, which commands write with `--html` and `-o FILE.png`."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from playwright.sync_api import Browser, expect
from typer.testing import CliRunner

from kinedex.commands.cli import app
from kinedex.reports.motion_pages.motion_page import shares
from tests.browser.pages import BEYOND, SCROLLED, SMALL, WAIT_MS, is_drawn, opened, picture


def call(*words: object) -> Any:
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture(scope="module")
def pages(store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a page of each kind, and two pictures."""
    folder = tmp_path_factory.mktemp("pages")
    query = folder / "jig.yaml"
    assert call("query", "from-clip", store, "x_al_jig_1", "-o", query).exit_code == 0
    calls = [
        ("rank", store, "--all", "--tau", 0.3, "--html", folder / "rank.html", "-o", folder / "rank.png"),
        ("rank", store, "--take", "x_al_jig_1", "--tau", 0.4, "--html", folder / "example.html", "--figures", 1),
        ("search", store, query, "--html", folder / "search.html", "-o", folder / "search.png"),
        ("template", "show", store, "jig", "--html", folder / "template.html"),
        ("takes", store, "--html", folder / "takes.html", "--figures", 5),
    ]
    for words in calls:
        done = call(*words)
        assert done.exit_code == 0, done.output
    ranked = folder / "ranked"
    source = f"source={store.parent / 'archive'}"
    patterns = "patterns=['clips/(?P<class>[^/]+)/x_(?P<actor>[^_]+)_']"
    done = call("run", "retrieval", "--store", ranked, "--set", source, "--set", patterns, "--set", "rank.tau=0.3")
    assert done.exit_code == 0, done.output
    shutil.copy(ranked / "results" / "reports" / "retrieval" / "retrieval.html", folder)
    return folder


KINDS = ("rank", "example", "search", "template", "takes", "retrieval")


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_beyond_the_window_or_too_small_for_a_finger(browser: Browser, pages: Path, kind: str) -> None:
    for size, scheme in (("desk", "light"), ("phone", "dark")):
        with opened(browser, pages / f"{kind}.html", size, scheme) as page:
            assert page.evaluate(BEYOND) == []
            assert page.evaluate(SMALL) == []
            if size == "desk":
                assert page.evaluate(SCROLLED) == []
            expect(page.locator("canvas[data-start]").first).to_be_visible()


@pytest.mark.parametrize("kind", ["rank", "retrieval"])
def test_figures_move_and_a_click_plays_one_beside_its_nearest_example(
    browser: Browser, pages: Path, kind: str
) -> None:
    with opened(browser, pages / f"{kind}.html") as page:
        figure = page.locator("canvas[data-near]").first
        figure.scroll_into_view_if_needed()
        page.wait_for_function(
            "one => one.getContext('2d').getImageData(0, 0, one.width, one.height).data.some(value => value)",
            arg=figure.element_handle(), timeout=WAIT_MS,
        )  # fmt: skip
        before = picture(page, "canvas[data-near]")
        page.wait_for_function("before => document.querySelector('canvas[data-near]').toDataURL() !== before",
                               arg=before, timeout=WAIT_MS)  # fmt: skip
        figure.click()
        expect(page.locator("#player")).to_be_visible()
        expect(page.locator("#player .title")).to_contain_text("beside it x_")
        assert is_drawn(page, "#player canvas")


def test_a_page_states_how_many_it_shows_and_the_option_for_more(browser: Browser, pages: Path) -> None:
    with opened(browser, pages / "takes.html") as page:
        expect(page.locator(".amount")).to_contain_text("5 of 8 takes; --figures 8 shows all.")
        assert page.locator(".wall canvas").count() == 5
        assert page.locator("h2").all_inner_texts() == ["jig 2", "reel 1 of 2", "waltz 1 of 2", "without class 1 of 2"]
    with opened(browser, pages / "example.html") as page:
        assert page.locator(".wall canvas").count() == 1


def test_a_template_has_a_figure_above_each_column_and_its_clips(browser: Browser, pages: Path) -> None:
    with opened(browser, pages / "template.html") as page:
        columns = page.locator(".columns rect[height='13']").count() / 40
        assert page.locator(".columns path.left").count() == columns == page.locator(".columns path.right").count()
        assert sorted(page.locator("figcaption b").all_inner_texts()) == ["x_al_jig_1", "x_bo_jig_1"]


@pytest.mark.parametrize("kind", ["rank", "search"])
def test_a_strip_has_a_row_for_each_hit(pages: Path, kind: str) -> None:
    with Image.open(pages / f"{kind}.png") as image:
        assert image.width == 1640
        assert (image.height - 172) % 396 == 0
        assert len(image.getcolors(1 << 20) or ()) > 10


def test_the_same_command_makes_the_same_bytes(pages: Path, store: Path, tmp_path: Path) -> None:
    call("takes", store, "--html", tmp_path / "takes.html", "--figures", 5)
    assert (tmp_path / "takes.html").read_bytes() == (pages / "takes.html").read_bytes()


def test_a_wrong_name_of_a_page_is_an_error_before_any_work(store: Path, tmp_path: Path) -> None:
    assert "a page ends in .html" in call("takes", store, "--html", tmp_path / "x.pdf").output
    assert "does not exist" in call("takes", store, "--html", tmp_path / "no" / "x.html").output
    assert "takes have no column 'cls'" in call("takes", store, "--html", tmp_path / "x.html", "--group", "cls").output
    assert "shows no hits" in call("search", store, "example", "--explain", "--html", tmp_path / "x.html").output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("counts", "most", "expected"),
    [([3, 3], 10, [3, 3]), ([10, 1, 5], 6, [3, 1, 2]), ([4, 4, 4], 2, [1, 1, 0]), ([], 5, []), ([9], 4, [4])],
)
def test_every_group_has_its_share_of_the_figures(counts: list[int], most: int, expected: list[int]) -> None:
    assert shares(counts, most) == expected
