"""Real BVH archives: one take in two formats is one motion, and the names of another skeleton's takes are right."""

from __future__ import annotations

import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.body import features
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.formats.motion.reader import Body
from kinedex.storage.formats.motion.reader_table import read_body
from kinedex.storage.store.store import Store, open_store
from tests.pipelines.archives import context

pytestmark = pytest.mark.shared

FEATURES = load_feature_set()
MAPPINGS = load_mappings("auto", FEATURES.joints)


def words(body: Body) -> np.ndarray:
    return features.words(body.positions, body.orientation, body.rate_hz, FEATURES.rules)


def on(words: np.ndarray, feature: str) -> np.ndarray:
    return (words >> np.uint64(FEATURES.feature(feature).number - 1)) & np.uint64(1) == 1


@pytest.fixture(scope="module")
def pair(shared: Path) -> tuple[Body, Body]:
    """CMU 01_01 as AMC and as BVH; the BVH begins with a rest frame."""
    folder = shared / "data" / "cmu" / "same_take_amc_and_bvh"
    amc = read_body(folder / "01_01.amc", folder / "01.asf", MAPPINGS, FEATURES.joints)
    return amc, read_body(folder / "01_01.bvh", None, MAPPINGS, FEATURES.joints)


def test_one_take_in_two_formats_has_the_same_joints(pair: tuple[Body, Body]) -> None:
    amc, bvh = pair
    assert (bvh.skeleton, bvh.rate_hz, bvh.frames) == ("cmu-bvh", 120.0, amc.frames + 1)
    apart = np.linalg.norm(bvh.positions[:, :, 1:] - amc.positions, axis=1)
    assert apart.max() < 0.0025
    below = [FEATURES.joints.index(joint) for joint in ("root", "lhip", "ltoes", "rankle", "rtoes", "belly", "chest")]
    assert apart[below].max() < 0.00005


def test_one_take_in_two_formats_has_the_same_words(pair: tuple[Body, Body]) -> None:
    amc, bvh = (words(body) for body in pair)
    different = amc ^ bvh[1:]
    assert (different == 0).mean() >= 0.97
    assert np.bitwise_count(different).sum() < 0.001 * 40 * len(amc)


def test_one_take_in_two_formats_turns_alike(pair: tuple[Body, Body]) -> None:
    amc, bvh = pair
    cosine = np.abs(np.sum(amc.orientation * bvh.orientation[:, 1:], axis=0))
    assert np.rad2deg(2 * np.arccos(np.clip(cosine, 0, 1))).max() < 0.01


KINDS = (
    "walk_normal",
    "run_normal",
    "raise-up-right-hand_normal",
    "raise-up-left-hand_normal",
    "walk-turn-left_normal",
)


@pytest.fixture(scope="module")
def bandai(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Store:
    """A sample of the archive: four takes of each kind above."""
    source = tmp_path_factory.mktemp("bandai")
    for kind in KINDS:
        for path in sorted((shared / "data" / "bandai" / "dataset-2").glob(f"*_{kind}_*.bvh"))[:4]:
            shutil.copy(path, source)
    store = tmp_path_factory.mktemp("store") / "store"
    summary = Ingest().run(context(store), Ingest.parameters(source=str(source)))
    assert (summary["takes"], summary["left_out"]) == (20, 0)
    return open_store(store)


def of_kind(store: Store, kind: str) -> list[np.ndarray]:
    ids = store.takes(f"name LIKE '%\\_{kind}\\_%' ESCAPE '\\'")["take_id"].to_list()
    assert len(ids) == 4
    return [store.words([take]).words for take in ids]


def test_every_take_comes_in_with_its_skeleton_and_rate(bandai: Store) -> None:
    takes = bandai.takes()
    assert set(takes["skeleton"]) == {"bandai"}
    assert set(takes["unit"]) == {"0.01 m"}
    assert set(takes["source_rate_hz"]) == {30.0}


@pytest.mark.parametrize("kind", ["walk_normal", "run_normal"])
def test_who_goes_has_one_foot_behind_and_then_the_other(bandai: Store, kind: str) -> None:
    for take in of_kind(bandai, kind):
        right, left = on(take, "rfoot_behind"), on(take, "lfoot_behind")
        behind = [side for side, _ in _runs(np.where(right & ~left, "r", np.where(left & ~right, "l", "")))]
        assert len(behind) >= 4
        assert all(one != other for one, other in pairwise(behind))
        assert not on(take, "rhand_above_neck").any()
        assert on(take, "root_fast").mean() > 0.8


def _runs(sides: np.ndarray) -> list[tuple[str, int]]:
    """Stretches in which one foot alone is behind, frames with none or both left out."""
    runs: list[tuple[str, int]] = []
    for side in sides[sides != ""]:
        if runs and runs[-1][0] == side:
            runs[-1] = (side, runs[-1][1] + 1)
        else:
            runs.append((str(side), 1))
    return runs


@pytest.mark.parametrize(("side", "other"), [("right", "left"), ("left", "right")])
def test_the_hand_that_is_raised_is_the_one_above_the_neck(bandai: Store, side: str, other: str) -> None:
    for take in of_kind(bandai, f"raise-up-{side}-hand_normal"):
        assert on(take, f"{side[0]}hand_above_neck").mean() > 0.2
        assert not on(take, f"{other[0]}hand_above_neck").any()
        assert not on(take, "root_fast").mean() > 0.1


def test_who_turns_while_walking_turns(bandai: Store) -> None:
    assert any(on(take, "root_turning").any() for take in of_kind(bandai, "walk-turn-left_normal"))
    assert not any(on(take, "root_turning").any() for take in of_kind(bandai, "walk_normal"))


@pytest.mark.slow
def test_the_whole_archive_comes_in(shared: Path, tmp_path: Path) -> None:
    summary = Ingest().run(context(tmp_path / "store"), Ingest.parameters(source=str(shared / "data" / "bandai")))
    assert (summary["takes"], summary["left_out"]) == (658, 0)
