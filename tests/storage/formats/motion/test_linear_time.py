"""Files with very many points, names or digits take time in proportion to their size; the time-out is the test."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion import position_tables
from kinedex.storage.formats.motion.positions import _AXIS, is_positions_csv, parse_csv, parse_trc

POINTS = 10_000


@pytest.mark.timeout(60)
def test_ten_thousand_points_are_read(tmp_path: Path) -> None:
    names = [f"p{i}" for i in range(POINTS)]
    csv = tmp_path / "a.csv"
    csv.write_text(",".join(f"{name}_{axis}" for name in names for axis in "xyz") + "\n" + ",".join(["1"] * 3 * POINTS))
    assert parse_csv(csv).positions.shape == (POINTS, 3, 1)
    trc = tmp_path / "a.trc"
    head = f"PathFileType\t4\nDataRate\tNumFrames\tNumMarkers\tUnits\n120\t1\t{POINTS}\tm\nFrame#\tTime\t"
    trc.write_text(head + "\t\t\t".join(names) + "\n\n1\t0.0\t" + "\t".join(["1"] * 3 * POINTS) + "\n")
    assert parse_trc(trc).positions.shape == (POINTS, 3, 1)


def test_a_line_without_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(position_tables, "LONGEST", 1 << 20)
    monkeypatch.setattr(position_tables, "BLOCK", 1 << 16)
    path = tmp_path / "a.csv"
    path.write_text("a_x,a_y,a_z\n" + "1," * (1 << 20))
    with pytest.raises(SourceError, match="has a line of more than 1 million characters"):
        parse_csv(path)


@pytest.mark.timeout(60)
def test_blanks_within_the_name_of_a_column_are_skipped_once(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("head" + " " * 500_000 + "top_y,a_x,a_y,a_z\n1,1,1,1\n")
    assert is_positions_csv(path)
    with pytest.raises(SourceError, match="top_x' is missing in the header"):
        parse_csv(path)


@pytest.mark.parametrize(
    ("name", "point"), [("a_x", "a"), ("a  :  X", "a"), ("a z", "a"), ("a._y", "a."), ("a_ _x", "a_"), ("__y", "_")]
)
def test_a_column_is_a_point_and_an_axis(name: str, point: str) -> None:
    found = _AXIS.fullmatch(name)
    assert found is not None
    assert found.groups() == (point, name[-1])


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_blocks_of_any_size_give_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, end: str) -> None:
    path = tmp_path / "a.csv"
    rows = [f"{i},{i}.5,{i}e-3,é" for i in range(50)]
    path.write_bytes(end.join(["a_x,a_y,a_z,name", *(row.replace("é", "") for row in rows[:20]), "", *rows]).encode())
    found = []
    for size in (1 << 20, 7, 100):
        monkeypatch.setattr(position_tables, "BLOCK", size)
        with pytest.raises(SourceError) as fault:
            parse_csv(path)
        found.append((fault.value.line, fault.value.reason))
    assert found == [(23, "column 'name': not a number: 'é'")] * 3
    path.write_bytes(end.join(["a_x,a_y,a_z", *(row[:-2] for row in rows)]).encode("latin-1"))
    whole = [parse_csv(path).positions.tobytes()]
    for numbers in (3, 30):
        monkeypatch.setattr(position_tables, "_NUMBERS", numbers)
        whole.append(parse_csv(path).positions.tobytes())
    assert len(set(whole)) == 1
