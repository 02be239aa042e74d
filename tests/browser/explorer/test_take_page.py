"""The page of a take in a real browser: it plays, zooms and selects, and an address opens the same view."""

from __future__ import annotations

import re

from playwright.sync_api import Browser, Locator, Page, expect

from tests.browser.explorer.conftest import WAIT_MS, Open

TAKE = "/take/x_al_long_1"


def frame_of(page: Page) -> int:
    return int(str(page.locator(".player-now").text_content()).rpartition(" ")[2])


def box_of(place: Locator) -> tuple[float, float, float]:
    """Return left edge, width and the height of the second row of the lanes on the screen."""
    box = place.bounding_box()
    assert box is not None
    return box["x"], box["width"], box["y"] + 30


def hovered_frame(page: Page, x: float, y: float) -> int:
    page.mouse.move(x, y)
    tip = page.locator(".lanes-tip")
    expect(tip).to_contain_text(re.compile(r"frame \d+"))
    return int(re.findall(r"frame (\d+)", str(tip.text_content()))[0])


def hovered_frames(page: Page, left: float, right: float, y: float) -> int:
    """Return how many frames there are from one place of the lanes to another."""
    return hovered_frame(page, right, y) - hovered_frame(page, left, y)


def test_a_take_plays_zooms_and_selects(open_page: Open) -> None:
    page = open_page(TAKE)
    expect(page.get_by_role("heading", name="x_al_long_1")).to_be_visible()
    expect(page.get_by_role("img", name="The motion of x_al_long_1")).to_be_visible()
    expect(page.get_by_text("Ground truth").first).to_be_visible()
    expect(page.locator(".player-note")).to_be_hidden()

    page.keyboard.press(" ")
    page.wait_for_function("() => !document.querySelector('.player-now').textContent.endsWith('frame 0')")
    page.keyboard.press(" ")
    page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    stopped = frame_of(page)
    page.keyboard.press("ArrowRight")
    page.wait_for_function(f"() => document.querySelector('.player-now').textContent.endsWith('frame {stopped + 1}')")
    on = page.locator(".pose-features li:not([hidden])").all_text_contents()
    reading = page.evaluate(
        f"""async () => {{
            const take = await (await fetch('/api/take?name=x_al_long_1')).json();
            return (await fetch(`/api/takes/${{take.take_id}}/pose?frame={stopped + 1}`)).json();
        }}"""
    )
    assert on == reading["on"]

    left, width, y = box_of(page.locator(".lanes-area"))
    before = hovered_frames(page, left + 0.25 * width, left + 0.75 * width, y)
    page.mouse.wheel(0, -400)
    for _ in range(WAIT_MS // 50):  # lanes and tip are drawn in the next frames
        after = hovered_frames(page, left + 0.25 * width, left + 0.75 * width, y)
        if after < 0.7 * before:
            break
        page.wait_for_timeout(50)
    assert 0 < after < 0.7 * before

    page.mouse.move(left + 0.3 * width, y)
    page.mouse.down()
    page.mouse.move(left + 0.5 * width, y, steps=3)
    page.mouse.up()
    expect(page).to_have_url(re.compile(r"from=\d+&to=\d+"))
    found = re.search(r"from=(\d+)&to=(\d+)", page.url)
    assert found is not None
    interval = f"from={found.group(1)}&to={found.group(2)}"
    for name, address in (("Search by this", "ask"), ("Label this", "label")):
        link = page.get_by_role("link", name=name)
        assert link.get_attribute("href") == f"/{address}?take=x_al_long_1&{interval}"
    page.reload()
    length = int(found.group(2)) - int(found.group(1))
    expect(page.get_by_text(re.compile(rf"\b{length} frames"))).to_be_visible()
    # what the archive has like it stands beside it, without another click
    expect(page.get_by_text("Most like the selection")).to_be_visible()
    alike = page.get_by_role("list", name="Most like the selection, the best first").get_by_role("link")
    expect(alike.first.or_(page.get_by_text("No other interval below"))).to_be_visible()


def test_a_column_of_a_template_shows_the_pose_of_its_hit_and_the_clip_plays_beside_it(open_page: Open) -> None:
    page = open_page(f"{TAKE}?pick=reel@33&frame=66")
    image = page.get_by_role("img", name="The template reel")
    hit = page.get_by_text(re.compile(r"from [\d.]+ s to [\d.]+ s, cost"))
    expect(hit).to_be_visible()
    times = [float(one) for one in re.findall(r"([\d.]+) s", str(hit.text_content()))]
    box = image.bounding_box()
    assert box is not None
    shown = []
    for share in (0.02, 0.98):
        before = page.locator(".player-now").text_content()
        page.mouse.move(box["x"] + share * box["width"], box["y"] + 5)
        page.wait_for_function("one => document.querySelector('.player-now').textContent !== one", arg=before)
        shown.append(frame_of(page) / 30)
    assert times[0] <= shown[0] < shown[1] <= times[1]
    page.get_by_role("button", name="Beside its nearest clip").click()
    expect(page).to_have_url(re.compile("step=hit"))
    expect(page.get_by_text(re.compile(r"Beside x_(al|bo)_reel_1"))).to_be_visible()


def test_the_lanes_are_a_table_and_keys_are_listed(open_page: Open) -> None:
    page = open_page(TAKE)
    page.get_by_text("Lanes as a table").click()
    page.get_by_label("Lane", exact=True).select_option(label="Ground truth: Ground truth (3)")
    rows = page.get_by_role("row")
    expect(rows).to_have_count(4)
    expect(rows.nth(2)).to_contain_text("reel")
    rows.nth(2).get_by_role("button").click()
    expect(page).to_have_url(re.compile(r"from=\d+"))
    page.locator("body").press("?")
    expect(page.get_by_role("dialog", name="Keys")).to_contain_text("Play or pause")


def test_a_wrong_name_is_an_error_with_the_nearest_one(open_page: Open) -> None:
    page = open_page("/take")
    expect(page.get_by_role("link", name="x_al_long_1")).to_be_visible()
    page.get_by_label("Name of a take").fill("bo_long")
    expect(page.get_by_role("link")).not_to_contain_text(["x_al_long_1"])
    page.get_by_role("link", name="x_bo_long_1").click()
    expect(page.get_by_role("heading", name="x_bo_long_1")).to_be_visible()


def pinch(page: Page, x: float, y: float) -> None:
    """Move two fingers apart, from left and right of a place."""
    session = page.context.new_cdp_session(page)

    def touch(kind: str, *places: float) -> None:
        points = [{"x": place, "y": y, "id": number} for number, place in enumerate(places)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    touch("touchStart", x - 20)
    touch("touchStart", x - 20, x + 20)
    for apart in range(30, 80, 10):
        touch("touchMove", x - apart, x + apart)
    touch("touchEnd")


def test_without_webgl_the_motion_is_drawn_as_lines_and_two_fingers_go_closer(
    browser: Browser, explorer: str, executable: str
) -> None:
    plain = browser.browser_type.launch(executable_path=executable, args=["--no-sandbox", "--disable-3d-apis"])
    try:
        page = plain.new_context(viewport={"width": 390, "height": 900}, has_touch=True, is_mobile=True).new_page()
        page.set_default_timeout(WAIT_MS)
        faults: list[str] = []
        page.on("pageerror", lambda fault: faults.append(str(fault)))
        page.context.request.get(explorer)
        page.goto(explorer.split("/?")[0] + TAKE)
        expect(page.get_by_text("bones are drawn as lines")).to_be_visible()
        expect(page.locator(".player-note")).to_be_hidden()
        canvas = page.locator(".player-box canvas")
        before = canvas.evaluate("canvas => canvas.toDataURL()")
        box = canvas.bounding_box()
        assert box is not None
        pinch(page, box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.wait_for_function(
            "before => document.querySelector('.player-box canvas').toDataURL() !== before", arg=before
        )
        # the lanes follow two fingers, too
        page.locator(".lanes").scroll_into_view_if_needed()
        strip = page.locator(".lanes-strip")
        before = strip.evaluate("canvas => canvas.toDataURL()")
        area = page.locator(".lanes-area").bounding_box()
        assert area is not None
        pinch(page, area["x"] + area["width"] / 2, min(area["y"] + area["height"] / 2, 600))
        page.wait_for_function("before => document.querySelector('.lanes-strip').toDataURL() !== before", arg=before)
        assert not faults
    finally:
        plain.close()
