"""Pages convert frames to seconds by the rule of the whole product, and never by a division of their own."""

from __future__ import annotations

import re

import pytest

from kinedex.ops.intervals import shown_seconds
from kinedex.reports.page_environment import page_environment
from tests.code_lines import ROOT

TEMPLATES = sorted((ROOT / "reports" / "pages").glob("*.j2"))


@pytest.mark.parametrize("digits", [0, 1, 2])
def test_a_page_shows_seconds_as_all_of_the_product_does(digits: int) -> None:
    page = page_environment().from_string("{{ frame | seconds(rate, digits) }}")
    for rate in (30.0, 29.97, 120.0):
        for frame in range(400):
            assert page.render(frame=frame, rate=rate, digits=digits) == shown_seconds(frame, rate, digits)


def test_halves_of_the_last_digit_are_rounded_upwards() -> None:
    page = page_environment().from_string("{{ 15 | seconds(120) }} {{ 15 | in_seconds(120) }}")
    assert page.render() == "0.13 0.125"


def test_no_template_divides_frames_by_a_rate() -> None:
    assert TEMPLATES
    assert not [path.name for path in TEMPLATES if re.search(r"/\s*[\w.\[\]]*rate", path.read_text(encoding="utf-8"))]
