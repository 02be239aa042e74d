"""The page on the quality of takes has every figure with its limits, and every fault of the study."""

from __future__ import annotations

from pathlib import Path

from kinedex.catalog.quality_figures import FIGURES
from studies.plausibility import FAULTS

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "quality.md").read_text(encoding="utf-8")


def test_the_page_has_each_figure_with_its_meaning_and_limits() -> None:
    for figure in FIGURES:
        unit = figure.unit or ("text" if figure.type == "VARCHAR" else "")
        assert f"| `{figure.name}` | {unit} | {figure.meaning} | {figure.limits()} | {figure.source} |" in PAGE


def test_the_page_has_each_fault_of_the_study_and_no_take_warned_of_as_it_is() -> None:
    for fault in FAULTS:
        assert f"\n| {fault} | " in PAGE
    assert "\n| none: as it is | 0 of 193 | 0 of 19 | 0 of 658 |" in PAGE
