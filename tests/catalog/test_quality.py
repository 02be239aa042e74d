"""Warnings on figures: none on a body that moves like a person, one for each fault, with limits and a way out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.quality import quality_columns, quality_warnings
from kinedex.catalog.quality_figures import FIGURES
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.body.plausibility import Plausibility
from kinedex.storage.formats.motion.reader_table import read_body
from kinedex.storage.formats.motion.single_file import skeleton_beside
from studies.plausibility import FAULTS, Take
from tests.ops.body.test_plausibility import swinging
from tests.oracles.features import JOINTS

UNSEEN = {
    "rate × 2",
    "rate × 4",
    "left knee 10 cm too high",
    "neck 8 cm too low",
    "neck 12 cm too low",
    "a wrist that stays from the middle on",
}
"""Faults that do not show in every take."""


def test_a_body_that_moves_like_a_person_is_not_warned_of() -> None:
    assert Take(swinging(), JOINTS, 30.0).warnings() == []
    assert Take(np.zeros((24, 3, 0)), JOINTS, 30.0).warnings() == []


@pytest.mark.parametrize("fault", sorted(FAULTS.keys() - UNSEEN))
def test_each_fault_is_warned_of(fault: str) -> None:
    assert FAULTS[fault](Take(swinging(), JOINTS, 30.0)).warnings()


def test_a_warning_names_figure_limits_and_way_out() -> None:
    z_up, tall, slow = (
        FAULTS[fault](Take(swinging(), JOINTS, 30.0)).warnings()
        for fault in ("Z up, read as Y up", "unit × 10", "frame time 1.0")
    )
    assert "state `up: z` in a skeleton mapping whose `up` is y" in z_up[0]
    assert tall[0].startswith("height_m is 17.6 m, expected 0.8 to 2.3 m")
    assert "`unit_m`" in tall[0]
    assert "give it by --rate, such as --rate " in slow[-1]


def test_a_body_whose_limbs_never_turn_is_warned_of() -> None:
    found = quality_warnings(Plausibility(speed_m_s=2.0, tempo_hz=0.0, acceleration_m_s2=0.0), 30.0)
    assert any("too slow for a person" in warning for warning in found)


def test_unknown_figures_are_null_and_not_off() -> None:
    columns = quality_columns(Plausibility())
    assert list(columns) == [figure.name for figure in FIGURES]
    assert set(columns.values()) == {None, "", 0.0}
    assert quality_warnings(Plausibility(), 30.0) == []


def test_figures_have_names_of_columns_meanings_and_sources_of_limits() -> None:
    for figure in FIGURES:
        assert figure.name.isidentifier()
        assert figure.meaning
        assert bool(figure.source) == bool(figure.limits()), figure.name


FILES = (
    "hdm05/clips/lieDownFloor/*.amc", "hdm05/clips/hopBothLegs1hops/*.amc", "hdm05/takes/*1.amc", "cmu/01/*8.amc",
    "cmu/02/*.amc", "bandai/dataset-1/*dash*.bvh", "bandai/dataset-1/*bye*.bvh", "bandai/dataset-2/*elderly_00*.bvh",
)  # fmt: skip


@pytest.mark.parametrize("pattern", FILES)
def test_takes_of_the_archives_are_not_warned_of(shared: Path, pattern: str) -> None:
    joints = load_feature_set().joints
    mappings = load_mappings("auto", joints)
    files = sorted((shared / "data").glob(pattern))
    assert files
    for file in files:
        body = read_body(file, skeleton_beside(file) if file.suffix == ".amc" else None, mappings, joints)
        assert Take(body.positions, joints, body.rate_hz).warnings() == [], file
