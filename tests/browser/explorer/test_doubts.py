"""The page of doubtful files in a browser: refused files are brought in by clicks, and warnings are accepted."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, expect
from typer.testing import CliRunner

from kinedex.catalog.skeletons.recognition.landmarks import load_landmarks
from kinedex.catalog.skeletons.recognition.named_points import nodes_of_landmarks
from kinedex.commands.cli import app
from kinedex.storage.store.store import open_store
from tests.browser.explorer.conftest import WAIT_MS, Open
from tests.browser.explorer.test_accessibility import violations
from tests.c3d_files import LABELS, standing_markers, write_c3d, z_up

Serve = Callable[..., str]

_ARM = {
    "ACRO_tip": "racromion", "EPICl": "relbowlat", "EPICm": "relbowmed", "STYLr": "rwristrad", "STYLu": "rwristuln",
    "INDEX": "rhand2", "LASTC": "rhand5",
}  # fmt: skip

REFUSED: dict[str, dict[str, str]] = {
    "wild/pyCGM/Movement_trial.csv": {
        "PELO": "root", "LFEO": "lknee", "RFEO": "rknee", "LTIO": "lankle", "RTIO": "rankle", "LTOO": "ltoes",
        "RTOO": "rtoes", "LCLO": "lshoulder", "RCLO": "rshoulder", "LHUO": "lelbow", "RHUO": "relbow",
        "LRAO": "lwrist", "RRAO": "rwrist", "LHNO": "lfingers", "RHNO": "rfingers", "TRXO": "neck", "HEDO": "head",
    },
    "c3d/Vicon.c3d": {f"Daphnee:{marker}": landmark for marker, landmark in _ARM.items()},
    "wild/pyomeca/markers.trc": _ARM,
    "wild/pyomeca/markers.csv": _ARM,
    "wild/opensim-core/abdbonepin.trc": {
        "gu": "rshoulder", "centelbow": "relbow", "centijc7": "neck", "centpxt8": "chest", "acc": "rclavicle",
    },
}  # fmt: skip
"""Files of real data that are refused, and what a person who knows their marker sets says that their nodes are."""

MOST_SECONDS = 180.0
"""The longest time that bringing them in may take."""


def ingest(store: Path, source: Path) -> Path:
    done = CliRunner().invoke(
        app, ["ingest", str(store), str(source), "--executor", "serial", "--set", "patterns=['.']"], prog_name="kinedex"
    )
    assert done.exit_code in (0, 1, 3), done.output
    return store


def refused(store: Path) -> set[str]:
    return {
        row["source"] for row in open_store(store).sql("SELECT source FROM doubts WHERE kind = 'refused'").to_pylist()
    }


def name_nodes(page: Page, named: Mapping[str, str]) -> None:
    """Name nodes of the file that is shown, each by a click on its row and one on the name."""
    names = page.get_by_role("region", name="Names")
    for node, name in named.items():
        page.get_by_role("region", name="Nodes").get_by_role("button", name=node, exact=True).click()
        names.get_by_role("button", name=name, exact=True).click()
        expect(names.get_by_role("button", name=name, exact=True)).to_have_attribute("aria-pressed", "true")


def keep(page: Page) -> None:
    """Keep the mapping of the file that is shown, and wait until its folder has been read again."""
    page.get_by_role("button", name="Keep and read again").click()
    status = page.get_by_role("region", name="Mapping").get_by_role("status")
    expect(status).to_contain_text("again: done", timeout=2 * WAIT_MS)


@pytest.fixture
def trials(tmp_path: Path) -> Path:
    """A store of a folder with two trials whose labels say nothing, and two of a known marker set with a gap."""
    source = tmp_path / "trials"
    source.mkdir()
    points = 1000 * z_up(standing_markers(60))
    for name in ("one", "two"):
        write_c3d(source / f"{name}.c3d", points, tuple(f"M<{i}>" for i in range(len(LABELS))))
    for number in (1, 2):
        gap = points.copy()
        gap[0, :, 20 : 20 + 2 * number] = np.nan
        write_c3d(source / f"gap_{number}.c3d", gap)
    return ingest(tmp_path / "store", source)


def test_a_trial_whose_labels_say_nothing_comes_in_by_clicks(open_page_of: Open, serve: Serve, trials: Path) -> None:
    page = open_page_of(serve(trials), "/doubts")
    page.get_by_role("region", name="Refused").get_by_role("button").click()
    page.get_by_role("button", name="one.c3d").click()
    expect(page.get_by_text("It is refused")).to_be_visible()
    landmarks = nodes_of_landmarks(load_landmarks().read(LABELS))
    named = {f"M<{i}>": landmarks[label] for i, label in enumerate(LABELS) if label in landmarks}
    first, *others = named
    # one by a click on the point itself
    point = page.locator(f'circle[data-node="{first}"]').bounding_box()
    assert point is not None
    page.mouse.click(point["x"] + point["width"] / 2, point["y"] + point["height"] / 2)
    names = page.get_by_role("region", name="Names")
    expect(names.get_by_role("heading")).to_have_text(first)
    expect(names).to_contain_text("Taken for nothing: no known name")
    names.get_by_role("button", name=named[first], exact=True).click()
    expect(names).to_contain_text(f"Taken for {named[first]}: named by you")
    expect(page.get_by_text("No body yet")).to_be_visible()
    some = [node for node in others if named[node][1:] in ("asis", "psis", "kneelat", "anklelat", "acromion", "toe2")]
    name_nodes(page, {node: named[node] for node in some})
    expect(page.get_by_role("img", name="The body that the names make")).to_be_visible()
    figures = page.get_by_role("region", name="Figures of quality")
    expect(figures).to_contain_text(f"beside 2 takes of {trials.parent / 'trials'}")
    expect(page.get_by_role("region", name="Words")).to_contain_text("feet_apart")
    expect(page.get_by_label("The same by command")).to_contain_text("kinedex mapping new")
    assert violations(page) == []
    keep(page)
    expect(page.get_by_role("region", name="Refused")).to_have_count(0)
    rows = open_store(trials).sql("SELECT skeleton FROM takes WHERE name IN ('one', 'two')").to_pylist()
    assert rows == [{"skeleton": "one"}, {"skeleton": "one"}]
    page.reload()
    expect(page.get_by_text("No file has this doubt any more.")).to_be_visible()


def test_a_warning_is_accepted_once(open_page_of: Open, serve: Serve, trials: Path) -> None:
    page = open_page_of(serve(trials), "/doubts")
    cause = page.get_by_role("button", name="gaps closed along straight lines")
    cause.click()
    files = page.get_by_role("region", name="Files of this cause")
    files.get_by_role("button", name="Accept", exact=True).first.click()
    expect(files.get_by_role("button", name="Accepted; take it back")).to_have_count(1)
    expect(page.get_by_label("The same by command")).to_contain_text("kinedex takes accept")
    expect(cause).to_contain_text("1")
    files.get_by_role("button", name="Accept all").click()
    expect(cause).to_contain_text("accepted")
    assert open_store(trials).sql("SELECT * FROM doubts WHERE accepted").num_rows == 2


def test_an_explorer_that_is_read_only_shows_trials_and_keeps_nothing(
    open_page_of: Open, serve: Serve, trials: Path
) -> None:
    page = open_page_of(serve(trials, "--read-only"), "/doubts")
    page.get_by_role("region", name="Refused").get_by_role("button").click()
    page.get_by_role("button", name="one.c3d").click()
    name_nodes(page, {"M<0>": "lasis"})
    expect(page.get_by_role("button", name="Keep and read again")).to_be_disabled()
    expect(page.get_by_text("This explorer is read-only")).to_be_visible()


@pytest.mark.shared
def test_five_refused_files_of_real_data_come_in_by_clicks_within_three_minutes(
    open_page_of: Open, serve: Serve, shared: Path, tmp_path: Path
) -> None:
    source = tmp_path / "source"
    for name in (*REFUSED, "wild/pyCGM/Sample_Static.csv", "wild/opensim-core/subject01_static.trc"):
        if (place := shared / "data" / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(place, source / name)
    store = ingest(tmp_path / "store", source)
    before = refused(store)
    assert before <= REFUSED.keys()
    page = open_page_of(serve(store), "/doubts")
    begin = time.monotonic()
    for name, named in REFUSED.items():
        if name not in before or name not in refused(store):
            continue  # read by a mapping that was kept for another file, or by recognition
        page.get_by_role("region", name="Refused").get_by_role("button").first.click()
        page.get_by_role("button", name=name, exact=True).click()
        name_nodes(page, named)
        expect(page.get_by_role("img", name="The body that the names make")).to_be_visible()
        keep(page)
    seconds = time.monotonic() - begin
    assert refused(store) == set()
    takes = {row["source"]: row for row in open_store(store).sql("SELECT * FROM takes").to_pylist()}
    kept = open_store(store).manifest.mappings
    assert {takes[name]["skeleton"] for name in before} <= kept.keys()
    print(f"{len(before)} files came in by {len(kept)} mappings in {seconds:.0f} s")
    assert seconds < MOST_SECONDS
