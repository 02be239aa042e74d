"""Units that a file states and its body contradicts: read with the likely one, and reported."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.storage.formats.motion.reader_table import read_body
from tests.bodies import standing
from tests.oracles.features import JOINTS


def write_trc(path: Path, body: np.ndarray, unit: str) -> None:
    """A TRC file of named joints in numbers as they are, whatever the unit of its header."""
    rows = body.transpose(2, 0, 1).reshape(body.shape[2], -1)
    header = [
        "PathFileType\t4\t(X/Y/Z)\ta.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"30\t30\t{len(rows)}\t{len(JOINTS)}\t{unit}\t30\t1\t{len(rows)}",
        "Frame#\tTime\t" + "\t\t\t".join(JOINTS),
        "\t\t" + "\t".join(f"{axis}{i + 1}" for i in range(len(JOINTS)) for axis in "XYZ"),
    ]
    lines = [f"{t + 1}\t{t / 30:.6f}\t" + "\t".join(f"{value:.6f}" for value in row) for t, row in enumerate(rows)]
    path.write_text("\n".join([*header, *lines]) + "\n")


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1.0), ("m", 1000.0), ("m", 1.0), ("mm", 1000.0)])
def test_a_body_comes_in_as_high_as_it_is_whatever_the_header_states(tmp_path: Path, unit: str, factor: float) -> None:
    write_trc(tmp_path / "a.trc", standing(4) * factor, unit)
    body = read_body(tmp_path / "a.trc", None, load_mappings("auto", tuple(JOINTS)), tuple(JOINTS))
    assert np.abs(body.positions - standing(4)).max() < 1e-5
    wrong = [warning for warning in body.warnings if "its unit of length is wrong" in warning]
    assert len(wrong) == (unit == "mm") ^ (factor == 1000.0)


@pytest.mark.parametrize(("factor", "name"), [(1000.0, "mm"), (100.0, "cm"), (10.0, "dm"), (1 / 0.0254, "inches")])
def test_a_shipped_mapping_gives_way_to_the_unit_that_makes_a_human(tmp_path: Path, factor: float, name: str) -> None:
    write_trc(tmp_path / "a.trc", standing(4) * factor, "")
    body = read_body(tmp_path / "a.trc", None, load_mappings("auto", tuple(JOINTS)), tuple(JOINTS))
    assert np.abs(body.positions - standing(4)).max() < 1e-5
    (warning,) = [warning for warning in body.warnings if "its unit of length is wrong: mapping" in warning]
    assert f"it is read in {name}" in warning
