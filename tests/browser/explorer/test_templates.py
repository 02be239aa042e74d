"""The Templates page in a browser: a template is pointed at, edited, compared, saved, and searched by its clips."""

from __future__ import annotations

import re
from pathlib import Path

from playwright.sync_api import expect

from kinedex.pipelines.templates.store_ranking import RankingQuestion, rank_store
from kinedex.storage.store.store import open_store
from tests.browser.explorer.conftest import Open


def test_a_template_is_edited_by_keys_and_saved(open_page: Open, store: Path, tmp_path: Path) -> None:
    page = open_page("/runs")
    expect(page.get_by_role("heading", name="Runs", exact=True)).to_be_visible()
    page.keyboard.press("g")
    page.keyboard.press("p")
    expect(page.get_by_role("navigation", name="Templates").get_by_role("link")).to_have_count(3)
    page.get_by_role("link", name="reel").click()
    template = page.get_by_role("article", name="reel")
    table = template.get_by_role("region", name="Before and after")
    expect(table).to_contain_text("as learned")
    expect(table.get_by_role("row").filter(has_text="edited")).to_have_count(0)

    matrix = template.get_by_role("application")
    matrix.focus()
    for key in ("ArrowDown", "ArrowRight", "ArrowRight", "ArrowDown"):
        page.keyboard.press(key)
    pose = template.get_by_role("complementary", name="Pose at the column")
    expect(pose).to_contain_text("column 3 of")
    expect(pose).to_contain_text("lhand_forwards")
    expect(pose.get_by_role("img")).to_have_count(1)
    page.keyboard.press("x")
    expect(template.get_by_label("Weight of lhand_forwards")).to_have_value("0")
    template.get_by_label("Weight of rhand_fast").fill("2.5")
    template.get_by_role("slider", name="First column that is kept").press("ArrowRight")
    tau = template.get_by_label("Threshold τ")
    tau.fill("0.15")
    expect(page).to_have_url(re.compile("tau=0.15"))
    curve = template.get_by_role("img", name=re.compile("F of the training clips over τ: τ = 0.150 has F "))
    expect(curve).to_be_visible()
    assert "lhand_forwards%22%3A0" in page.url
    assert "from=1" in page.url
    edited = table.get_by_role("row").filter(has_text="edited")
    expect(edited).to_have_count(2)
    expect(edited.first).to_contain_text("0.150 used")
    expect(page.get_by_role("contentinfo")).to_contain_text("reel.yaml --tau 0.15")
    expect(template.get_by_text("learn_templates.template_files")).to_contain_text("reel.yaml")

    with page.expect_download() as saved:
        template.get_by_role("button", name="Save as YAML").click()
    file = tmp_path / saved.value.suggested_filename
    saved.value.save_as(file)
    assert file.name == "reel.yaml"
    assert "lhand_forwards: 0, rhand_fast: 2.5" in file.read_text()
    (ranking,) = rank_store(open_store(store), [str(file)], RankingQuestion(0.05, 0.15, 5)).rankings
    assert ranking.name == "reel"

    page.reload()
    expect(template.get_by_label("Weight of rhand_fast")).to_have_value("2.5")
    template.get_by_role("heading", name="reel").click()
    page.keyboard.press("0")
    expect(table.get_by_role("row").filter(has_text="edited")).to_have_count(0)
    expect(template.get_by_label("Weight of rhand_fast")).to_have_value("1")


def test_two_templates_are_compared_and_clips_lead_on(open_page: Open) -> None:
    page = open_page("/templates?template=reel")
    template = page.get_by_role("article", name="reel")
    template.get_by_label("The other template").select_option("jig")
    both = template.get_by_role("region", name="What distinguishes two")
    expect(both).to_contain_text("reel and jig contradict each other")
    expect(both.get_by_role("listitem")).to_have_count(8)
    clips = template.get_by_role("region", name="Clips")
    expect(clips.get_by_role("listitem")).to_have_count(2)
    expect(clips.get_by_role("link").first).to_have_attribute("href", re.compile("/take/x_.._reel_1"))
    page.keyboard.press("j")
    expect(page.get_by_role("article", name="waltz")).to_be_visible()
    page.get_by_role("link", name="Search by its clips").click()
    expect(page.get_by_role("option").first).to_be_visible()
    assert len(re.findall("x_.._waltz_1", page.url)) == 2
    page.go_back()
    page.get_by_text("Keyframe queries").click()
    expect(page.get_by_text("This store has no learned keyframe query")).to_be_visible()
