"""The study of round trips: every form that leaves a store is read again as it was written."""

from __future__ import annotations

from pathlib import Path

from kinedex.pipelines.export.request import FILE_FORMATS
from studies.round_trips import FILMS, round_trips, synthetic, table


def test_every_form_comes_back(tmp_path: Path) -> None:
    found = list(round_trips(synthetic(tmp_path)[2], tmp_path))
    assert {one.form.partition(",")[0] for one in found} >= {
        name for name, form in FILE_FORMATS.items() if form.joints
    } - {*FILMS}
    assert "amc, channels" in {one.form for one in found}
    for one in found:
        chain = one.form == "bvh, joints"  # bones of fixed length
        assert not one.error_mm > (20.0 if chain else 0.01), one
        assert chain or one.differ_at_rate == 0, one
        assert all(one.others.values()), one
    assert table(found).count("\n") == len(found) + 2
