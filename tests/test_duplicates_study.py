"""The copies that the study of duplicates plants, and the nearest seconds of takes that are none."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.body.joint_tree import JOINTS, PARENTS
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.storage.formats.motion.reader_table import read_body
from kinedex.storage.store.store import open_store
from studies.nearest_seconds import nearest_seconds
from studies.planted_copies import Copy, at_rate, mirrored, on_another_body, part, planted
from tests.pipelines.archives import context, write_archive

F32 = npt.NDArray[np.float32]


@pytest.fixture(scope="module")
def take() -> tuple[F32, float]:
    """A dance of five seconds at 120 frames a second, in joints."""
    return np.cumsum(np.random.default_rng(0).normal(0, 0.002, (600, 24, 3)), axis=0).astype(np.float32) + _rest(), 120


def _rest() -> F32:
    return np.random.default_rng(1).uniform(-0.3, 0.3, (24, 3)).astype(np.float32) + np.float32([0, 1, 0])


def directions(positions: F32) -> F32:
    """Return the directions of all bones."""
    bones = positions[:, 1:] - positions[:, PARENTS[1:]]
    unit: F32 = bones / np.linalg.norm(bones, axis=2, keepdims=True)
    return unit


def limbs(positions: F32) -> F32:
    """Return the distances of all joints from the root, which do not depend on where the body faces."""
    far: F32 = np.linalg.norm(positions - positions[:, :1], axis=2)
    return far


def test_another_body_moves_its_bones_in_the_same_directions(take: tuple[F32, float]) -> None:
    other = on_another_body(take[0], np.random.default_rng(2))
    assert np.allclose(directions(other), directions(take[0]), atol=1e-3)
    assert not np.allclose(other, take[0], atol=0.02)


def test_a_mirrored_mirror_image_is_the_body(take: tuple[F32, float]) -> None:
    assert np.array_equal(mirrored(mirrored(take[0])), take[0])
    assert np.array_equal(mirrored(take[0])[:, JOINTS.index("lknee"), 1], take[0][:, JOINTS.index("rknee"), 1])


def test_another_rate_keeps_the_time(take: tuple[F32, float]) -> None:
    slow = at_rate(take[0], 1 / 2)
    assert np.allclose(slow, take[0][::2][: len(slow)], atol=1e-6)
    assert np.allclose(at_rate(take[0], 1.0, 7), take[0][7:], atol=1e-6)


def test_short_takes_are_not_trimmed_to_nothing(take: tuple[F32, float]) -> None:
    assert len(part(take[0], 120, 1 / 3, 0.5)) == 200
    assert len(part(take[0][:200], 120, 1 / 3, 0.5)) == 180
    assert len(part(take[0][:100], 120, 1 / 3, 0.5)) == 100


def test_every_kind_of_copy_is_read_as_the_motion_that_it_is_a_copy_of(take: tuple[F32, float], tmp_path: Path) -> None:
    source = write_archive(tmp_path / "in", {"x_dance.amc": 300})
    mappings = load_mappings("auto", JOINTS)
    body = read_body(source / "x_dance.amc", source / "x.asf", mappings, JOINTS)
    places = np.ascontiguousarray(body.positions.transpose(2, 0, 1), np.float32)
    for kind, make in planted(places, body.rate_hz, np.random.default_rng(3)):
        copy: Copy = make()
        copy.write(tmp_path, "copy")
        (file,) = (path for path in tmp_path.glob("copy.*"))
        read = read_body(file, None, mappings, JOINTS).positions.transpose(2, 0, 1)
        file.unlink()
        assert np.allclose(read[..., 1], copy.positions[..., 1], atol=1e-5), kind
        assert np.allclose(limbs(read), limbs(copy.positions), atol=1e-5), kind


def test_two_halves_of_a_second_are_nearest_where_they_are_the_same(tmp_path: Path) -> None:
    source = write_archive(tmp_path / "in", {"x_dance.amc": 400, "x_other.amc": 400})
    (source / "x_same.amc").write_bytes((source / "x_dance.amc").read_bytes())
    run_pipeline("ingest", tmp_path / "store", assignments={"source": str(source)}, terminal=context(tmp_path).terminal)
    store = open_store(tmp_path / "store")
    assert load_feature_set().joints == JOINTS
    first, nearest, *rest = nearest_seconds(store, ())
    assert first == "3 takes, 0 known pairs, 1 other pairs with a second nearer than 10 mm"
    assert re.match(r"  0.0 mm: x_dance at (\S+) s and x_same at \1 s", nearest)
    assert rest == []
    (line,) = nearest_seconds(store, {frozenset(("x_dance", "x_same"))})
    assert line.startswith("3 takes, 1 known pairs, 0 other pairs")
