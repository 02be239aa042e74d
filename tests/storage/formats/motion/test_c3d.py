"""C3D files: markers by name, what is occluded, rates, units, axes and counts; and files that contradict themselves."""

from __future__ import annotations

import contextlib
import struct
from pathlib import Path

import c3d
import ezc3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.c3d import parse_c3d
from kinedex.storage.formats.motion.reader import Body, MotionFile, ReadSettings
from kinedex.storage.formats.motion.reader_table import persons_of, read_body
from tests.bodies import STANDING
from tests.c3d_files import LABELS, c3d_bytes, standing_markers, write_c3d, z_up

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # py-c3d warns of parameters that files lack

JOINTS = load_feature_set().joints
AUTO = load_mappings("auto", JOINTS)


def read(path: Path, given: ReadSettings = ReadSettings()) -> Body:  # noqa: B008
    return read_body(path, None, AUTO, JOINTS, given)


def walking(path: Path, frames: int = 30, **point: object) -> Path:
    return write_c3d(path, 1000 * z_up(standing_markers(frames)), **point)  # type: ignore[arg-type]


def joint(body: Body, name: str) -> np.ndarray:
    return body.positions[JOINTS.index(name)]


def test_markers_become_a_standing_body_in_metres_with_y_up(tmp_path: Path) -> None:
    body = read(write_c3d(tmp_path / "a.c3d", 1000 * standing_markers(30)))
    assert (body.skeleton, body.rate_hz, body.unit, body.valid) == ("recognised markers", 120.0, "0.001 m", None)
    assert (body.unknown, body.warnings) == ((), ())
    assert body.estimated == ("lknee", "lankle", "rknee", "rankle", "lelbow", "relbow")  # of one marker each
    for name, place in STANDING.items():
        np.testing.assert_allclose(joint(body, name)[:, 0], place, atol=0.16, err_msg=name)
    for left in ("lhip", "lknee", "lankle", "ltoes", "lshoulder", "lelbow", "lwrist", "lfingers"):
        right = joint(body, f"r{left[1:]}")
        np.testing.assert_allclose(joint(body, left) * [[-1], [1], [1]], right, atol=1e-5)
    np.testing.assert_allclose(np.abs(body.orientation[0]), 1.0, atol=0.02)  # it faces +Z
    np.testing.assert_allclose(np.diff(joint(body, "root")[2]), 0.01, atol=1e-6)


def test_subjects_names_do_not_matter_and_two_subjects_are_two_persons(tmp_path: Path) -> None:
    points = 1000 * z_up(standing_markers(3))
    ann = tuple(f"Ann:{label}" for label in LABELS)
    body = read(write_c3d(tmp_path / "a.c3d", points, ann))
    np.testing.assert_array_equal(body.positions, read(walking(tmp_path / "b.c3d", 3)).positions)
    both = (*ann, *(f"Bo:{label}" for label in LABELS), *(f"Box:corner {i}" for i in range(12)))
    path = write_c3d(tmp_path / "c.c3d", np.concatenate([points, points + 900.0, points[:12] - 900.0]), both)
    assert persons_of(MotionFile(path), AUTO) == ("Ann", "Bo")
    with pytest.raises(SourceError, match="the markers of 2 persons, Ann, Bo; ingest makes a take of each"):
        read(path)
    ann_alone, bo = (read_body(path, None, AUTO, JOINTS, person=person) for person in ("Ann", "Bo"))
    np.testing.assert_array_equal(ann_alone.positions, body.positions)
    np.testing.assert_allclose(bo.positions, body.positions + 0.9)


def test_a_label_that_two_markers_have_names_neither_unless_one_is_never_seen(tmp_path: Path) -> None:
    points = np.concatenate([1000 * z_up(standing_markers(3)), np.full((1, 3, 3), np.nan)])
    assert read(write_c3d(tmp_path / "a.c3d", points, (*LABELS, "LKNE"))).warnings == ()
    points[-1] = 5.0
    markers = parse_c3d(write_c3d(tmp_path / "b.c3d", points, (*LABELS, "LKNE")))
    assert markers.names[-1] == "LKNE (2)"
    assert markers.warnings == ["several markers are called LKNE; none of them is used"]
    assert read(tmp_path / "b.c3d").unknown == ("lknee",)


def test_more_markers_than_one_list_of_labels_holds_and_markers_without_a_label(tmp_path: Path) -> None:
    points = np.arange(300 * 3 * 2.0).reshape(300, 3, 2) + 1.0
    markers = parse_c3d(write_c3d(tmp_path / "a.c3d", points, tuple(f"m{i}" for i in range(300))))
    assert markers.names == tuple(f"m{i}" for i in range(300))
    np.testing.assert_array_equal(markers.positions, points)


def test_what_is_occluded_is_a_gap_whatever_the_way_it_is_written(tmp_path: Path) -> None:
    points = standing_markers(8)
    points[0, :, 2:4] = np.nan  # residual −1
    points[1, :, 5] = 0.0  # at the origin, with a residual of 0
    markers = parse_c3d(write_c3d(tmp_path / "a.c3d", points))
    assert np.argwhere(np.isnan(markers.positions[:, 0])).tolist() == [[0, 2], [0, 3], [1, 5]]
    np.testing.assert_allclose(markers.positions[2:], points[2:], rtol=1e-6)


@pytest.mark.parametrize(("up", "order"), [("Y", [0, 1, 2]), ("Z", [2, 0, 1]), ("X", [1, 2, 0])])
def test_the_file_s_own_word_on_what_is_up_counts(tmp_path: Path, up: str, order: list[int]) -> None:
    expected = read(walking(tmp_path / "a.c3d", 4))
    points = 1000 * standing_markers(4)[:, order]
    body = read(write_c3d(tmp_path / "b.c3d", points, Y_SCREEN=[f"+{up}"]))
    np.testing.assert_allclose(joint(body, "headtop")[1], joint(expected, "headtop")[1], atol=1e-6)
    across, apart = (joint(of, "lhip") - joint(of, "rhip") for of in (body, expected))
    np.testing.assert_allclose(np.linalg.norm(across, axis=0), np.linalg.norm(apart, axis=0), atol=1e-6)
    assert (joint(body, "lknee")[1] < joint(body, "lhip")[1]).all()
    minus = read(write_c3d(tmp_path / "c.c3d", points, Y_SCREEN=[f"-{up}"]))
    np.testing.assert_array_equal(minus.positions, body.positions)
    assert minus.warnings == (f"POINT:Y_SCREEN is -{up}; {up} is taken to point up",)


def test_units_and_rates_are_the_file_s_own(tmp_path: Path) -> None:
    walk = z_up(standing_markers(4))
    expected = read(walking(tmp_path / "a.c3d", 4))
    for unit, scale in (("m", 1.0), ("cm", 100.0), ("in", 1 / 0.0254)):
        body = read(write_c3d(tmp_path / "b.c3d", walk * scale, unit=unit, rate=99.5))
        np.testing.assert_allclose(body.positions, expected.positions, atol=1e-5)
        assert body.rate_hz == 99.5
    assert read(tmp_path / "b.c3d", ReadSettings(override_rate_hz=50.0)).rate_hz == 50.0
    guessed = read(write_c3d(tmp_path / "c.c3d", walk * 1000, unit="parsec"))
    assert guessed.unit == "0.001 m (guessed)"
    assert guessed.warnings[0].startswith("its unit 'parsec' is none of m, cm, mm, in")
    contradicted = bytearray((tmp_path / "a.c3d").read_bytes())
    struct.pack_into("<f", contradicted, 20, 60.0)
    (tmp_path / "d.c3d").write_bytes(contradicted)
    body = read(tmp_path / "d.c3d")
    assert body.rate_hz == 120.0
    assert body.warnings == ("its parameters state 120 Hz, which counts, its header 60 Hz",)


def test_a_take_begins_with_the_first_frame_that_is_there(tmp_path: Path) -> None:
    body = read(walking(tmp_path / "a.c3d", 5, first=1367))
    assert body.warnings == ("it begins with frame 1368 of its recording, which is source frame 0 here",)
    np.testing.assert_array_equal(body.positions, read(walking(tmp_path / "b.c3d", 5)).positions)


@pytest.mark.parametrize("output", [True, False])
def test_more_frames_than_a_word_can_count(tmp_path: Path, output: bool) -> None:
    points = np.broadcast_to(np.arange(1, 70_001) / 100, (3, 3, 70_000)).copy()
    more = {"LONG_FRAMES": [70_000.0]} if output else {}
    markers = parse_c3d(write_c3d(tmp_path / "a.c3d", points, ("a", "b", "c"), **more))
    assert markers.positions.shape == (3, 3, 70_000)
    np.testing.assert_allclose(markers.positions, points, rtol=1e-6)
    warning = "the file states 65535 frames, the most that it can state, and holds 70000"
    assert markers.warnings == ([] if output else [warning])


def test_analog_channels_cost_nothing_and_stretches_have_no_seam(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = parse_c3d(walking(tmp_path / "a.c3d", 50))
    monkeypatch.setattr("kinedex.storage.formats.motion.c3d._BLOCK_NUMBERS", 7 * len(LABELS))
    with_forces = parse_c3d(walking(tmp_path / "b.c3d", 50, analog=12))
    np.testing.assert_array_equal(with_forces.positions, plain.positions)
    assert with_forces.names == plain.names


def _pyc3d(path: Path) -> np.ndarray:
    """The markers (N, 3, T) as py-c3d reads them, NaN where the residual is negative."""
    with path.open("rb") as file:
        frames = [points.astype(float) for _, points, _ in c3d.Reader(file).read_frames(copy=True)]
    read = np.stack(frames)
    return np.where(read[:, :, 3:4] < 0, np.nan, read[:, :, :3]).transpose(1, 2, 0)


def _ezc3d(path: Path) -> np.ndarray:
    """The same as ezc3d reads them."""
    data = ezc3d.c3d(str(path))["data"]
    hidden = data["meta_points"]["residuals"][0] < 0
    return np.where(hidden[:, None], np.nan, np.moveaxis(data["points"][:3], 0, 1))


@pytest.mark.parametrize("analog", [0, 6])
@pytest.mark.parametrize("scale", [-1.0, 0.1])
@pytest.mark.parametrize("processor", ["Intel", "DEC", "MIPS"])
def test_frames_of_all_processors_are_read_as_py_c3d_reads_them(
    tmp_path: Path, processor: str, scale: float, analog: int
) -> None:
    points = 1000 * z_up(standing_markers(50))
    points[3, :, 5:9] = np.nan
    path = tmp_path / "a.c3d"
    path.write_bytes(c3d_bytes(points, processor=processor, scale=scale, analog=analog))
    found = parse_c3d(path)
    assert (found.names, found.rate_hz, found.unit_m, found.warnings) == (LABELS, 120.0, 0.001, [])
    np.testing.assert_allclose(found.positions, _pyc3d(path), rtol=1e-6)
    np.testing.assert_allclose(found.positions, points, atol=0.051 if scale > 0 else 1e-3)
    if processor != "MIPS" and not analog:  # ezc3d reads no MIPS, and takes the analog samples for markers
        np.testing.assert_array_equal(found.positions, _ezc3d(path))


@pytest.mark.parametrize("processor", ["Intel", "DEC", "MIPS"])
def test_more_frames_than_a_word_counts_are_read_by_the_fields_of_the_trial(tmp_path: Path, processor: str) -> None:
    points = np.broadcast_to(np.arange(1, 70_001) / 100, (3, 3, 70_000)).copy()
    path = tmp_path / "a.c3d"
    path.write_bytes(c3d_bytes(points, ("a", "b", "c"), processor=processor))
    found = parse_c3d(path)
    assert found.warnings == []
    np.testing.assert_allclose(found.positions, points, rtol=1e-6)


@pytest.mark.parametrize("labels", [300, 4000])
def test_parameters_of_more_than_255_blocks_are_read(tmp_path: Path, labels: int) -> None:
    points = 1000 * standing_markers(3)
    data = bytearray(c3d_bytes(points))
    start = (struct.unpack_from("<H", data, 16)[0] - 1) * 512
    filler = b"".join(  # parameters without meaning between the group TRIAL and the end of all
        struct.pack("<bb", 6, 9) + f"M{i:05}".encode() + struct.pack("<HbBBB", 36, -1, 1, 30, 0) + b"x" * 30
        for i in range(labels)
    )
    end = data.index(b"ACTUAL_END_FIELD")
    at = end + 16 + struct.unpack_from("<H", data, end + 16)[0]
    grown = bytes(data[:at]) + filler + b"\0\0"
    blocks = -(-(len(grown) - 512) // 512)
    grown = bytearray(grown.ljust(512 * (1 + blocks), b"\0") + bytes(data[start:]))
    grown[514] = blocks & 0xFF
    struct.pack_into("<H", grown, 16, 2 + blocks)
    (tmp_path / "a.c3d").write_bytes(grown)
    np.testing.assert_allclose(parse_c3d(tmp_path / "a.c3d").positions, points, atol=1e-3)


@pytest.mark.shared
def test_real_files_are_read_as_ezc3d_and_py_c3d_read_them(shared: Path) -> None:
    for path in sorted((shared / "data").glob("*/*.c3d")) + sorted((shared / "data" / "wild").glob("*/*.c3d")):
        found = parse_c3d(path).positions
        for other in (_ezc3d(path), _pyc3d(path)):
            lost = np.isnan(other).any(axis=1) | (other == 0).all(axis=1)
            np.testing.assert_array_equal(found, np.where(lost[:, None], np.nan, other), err_msg=path.name)


def test_a_file_cut_off_keeps_the_frames_that_are_there_and_says_so(tmp_path: Path) -> None:
    data = walking(tmp_path / "a.c3d", 100).read_bytes()
    whole = parse_c3d(tmp_path / "a.c3d")
    (tmp_path / "b.c3d").write_bytes(data[: len(data) // 2])
    cut = parse_c3d(tmp_path / "b.c3d")
    frames = cut.positions.shape[2]
    assert 40 < frames < 50
    np.testing.assert_array_equal(cut.positions, whole.positions[:, :, :frames])
    assert cut.warnings == [f"the file states 100 frames, it holds {frames}, which are kept"]


def _patched(data: bytes, at: int, form: str, value: float) -> bytes:
    changed = bytearray(data)
    struct.pack_into(form, changed, at, value)
    return bytes(changed)


def _value(data: bytes, name: bytes) -> int:
    """Return the offset of a parameter's dimensions (or its value): after name, offset of the next, type and count."""
    return data.index(name) + len(name) + 4


FAULTS = {
    "empty": (lambda data: b"", "is no C3D file"),
    "text": (lambda data: b"hello " * 500, "is no C3D file"),
    "parameters beyond the end": (lambda data: _patched(data, 0, "<B", 255), "is no C3D file"),
    "numbers of no processor": (lambda data: _patched(data, 512 + 3, "<B", 87), "in the order of processor 87"),
    "cut in the parameters": (lambda data: data[:700], "parameter"),
    "cut in the header": (lambda data: data[:300], "is no C3D file"),
    "no frames": (lambda data: data[: (struct.unpack_from("<H", data, 16)[0] - 1) * 512 + 20], "holds no frames"),
    "frames that begin nowhere": (
        lambda data: _patched(data.replace(b"DATA_START", b"DATA_STOPS", 1), 16, "<H", 60000),
        "should begin at block 60000",
    ),
    "a count of no markers": (lambda data: _patched(data, _value(data, b"USED"), "<H", 0), "1 to 10000 markers"),
    "a count of too many": (lambda data: _patched(data, _value(data, b"USED"), "<H", 60000), "it states 60000"),
    "dimensions beyond all bounds": (
        lambda data: _patched(data, _value(data, b"LABELS"), "<B", 255), "POINT:LABELS is larger",
    ),
    "infinity": (
        lambda data: _patched(data, (struct.unpack_from("<H", data, 16)[0] - 1) * 512 + 16, "<f", float("inf")),
        "marker 'LBWT' is infinitely far away in source frame 0",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_wrong_with_a_file_is_said(tmp_path: Path, fault: str) -> None:
    change, message = FAULTS[fault]
    path = tmp_path / "a.c3d"
    path.write_bytes(change(walking(path, 6).read_bytes()))
    with pytest.raises(SourceError, match=message):
        parse_c3d(path)


@pytest.fixture(scope="module")
def seed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, bytes]:
    path = tmp_path_factory.mktemp("c3d") / "a.c3d"
    return path, walking(path, 4, analog=2, Y_SCREEN=["+Z"]).read_bytes()


@settings(max_examples=150)
@given(
    at=st.lists(st.tuples(st.floats(0, 0.999), st.integers(0, 255)), min_size=1, max_size=12), cut=st.floats(0.1, 1.0)
)
def test_broken_bytes_are_a_fault_of_the_file_or_do_no_harm(
    seed: tuple[Path, bytes], at: list[tuple[float, int]], cut: float
) -> None:
    path, data = seed
    changed = bytearray(data[: int(cut * len(data))])
    for place, byte in at:
        changed[int(place * min(len(changed), 4096))] = byte
    path.with_name("b.c3d").write_bytes(changed)
    with contextlib.suppress(SourceError):
        assert parse_c3d(path.with_name("b.c3d")).positions.size < 1e7


def test_a_long_occlusion_makes_its_frames_invalid_and_says_whose(tmp_path: Path) -> None:
    points = standing_markers(100)
    points[LABELS.index("LKNE"), :, 10:20] = np.nan
    points[LABELS.index("LKNE"), :, 40:60] = np.nan
    points[LABELS.index("RTOE"), :, 90:] = np.nan
    body = read(write_c3d(tmp_path / "a.c3d", 1000 * z_up(points)))
    assert body.valid is not None
    assert np.flatnonzero(~body.valid).tolist() == list(range(40, 60))
    assert np.isnan(joint(body, "lknee")[:, 40:60]).all()
    assert np.isfinite(joint(body, "rknee")).all()
    assert np.isnan(body.orientation[:, 40:60]).all()
    assert np.isfinite(body.orientation[:, body.valid]).all()
    assert body.warnings == (
        "gaps closed along straight lines: LKNE 10 frames (longest 10), RTOE 10 frames (longest 10)",
        "20 of 100 source frames are invalid and have no word; points that the mapping 'recognised markers' takes are "
        "missing for more than 12 frames: LKNE 20 frames (longest 20); `fill_gap_frames: 20` closes all gaps along "
        "straight lines; `kinedex stabilise` fills them by the motion around them and by what the archive knows",
    )
    closed = read(tmp_path / "a.c3d", ReadSettings(fill_gap_frames=20))
    assert closed.valid is None
    np.testing.assert_allclose(joint(closed, "lknee")[0, 50], joint(closed, "rknee")[0, 50], atol=1e-5)
    none = read(tmp_path / "a.c3d", ReadSettings(fill_gap_frames=0))
    assert none.valid is not None
    assert np.count_nonzero(~none.valid) == 40


@pytest.mark.parametrize("label", ["LKNE", "LFWT", "CLAV"])
@pytest.mark.parametrize("far", [3e38, 1e20, 1e9])
def test_a_marker_that_is_too_far_away_is_a_fault_and_no_gap(tmp_path: Path, label: str, far: float) -> None:
    points = 1000 * z_up(standing_markers(6))
    points[LABELS.index(label), :, 2] = [far, -far, far]
    with pytest.raises(SourceError, match=r"(far|km) away"), np.errstate(all="ignore"):
        read(write_c3d(tmp_path / "a.c3d", points))


def test_frames_that_fill_their_last_block_and_one_more_are_whole(tmp_path: Path) -> None:
    path = walking(tmp_path / "a.c3d", 16)
    data = path.read_bytes()
    assert not read(path).warnings
    start = (int.from_bytes(data[16:18], "little") - 1) * 512
    path.write_bytes(data[: start + 16 * 16 * len(LABELS)].ljust((len(data) // 512 + 1) * 512, b"\0"))
    assert read(path).frames == 16


def test_the_nearest_mapping_is_the_one_that_knows_the_markers(tmp_path: Path) -> None:
    points = 1000 * standing_markers(3)[:3]
    with pytest.raises(SourceError, match=r"no human body is recognised among its points: .* 3 of 3 labels are known"):
        read(write_c3d(tmp_path / "a.c3d", points, LABELS[:3]))


def test_a_take_without_a_whole_frame_does_not_come_in(tmp_path: Path) -> None:
    points = standing_markers(60)
    points[LABELS.index("LKNE"), :, :30] = np.nan
    points[LABELS.index("RKNE"), :, 30:] = np.nan
    path = write_c3d(tmp_path / "a.c3d", 1000 * z_up(points))
    with pytest.raises(SourceError, match=r"no frame is whole: .* LKNE 30 frames \(longest 30\), RKNE 30 frames"):
        read(path, ReadSettings(fill_gap_frames=5))


def test_a_body_that_is_not_seen_at_first_is_measured_where_it_is(tmp_path: Path) -> None:
    points = standing_markers(60)
    points[:, :, :30] = np.nan
    (own := tmp_path / "own.yaml").write_text(
        AUTO.of_format["c3d"][[m.name for m in AUTO.of_format["c3d"]].index("hdm05-c3d")]
        .path.read_text()
        .replace("unit_m: 0.001", "unit_m: guess")
    )
    path = write_c3d(tmp_path / "a.c3d", 100 * z_up(points), unit="")
    body = read_body(path, None, load_mappings(str(own), JOINTS), JOINTS)
    assert body.unit == "0.01 m (guessed)"
    assert body.valid is not None
    assert np.flatnonzero(body.valid).tolist() == list(range(30, 60))


@pytest.mark.shared
def test_markers_of_a_real_take_make_limbs_of_one_length_on_both_sides(shared: Path) -> None:
    body = read(shared / "data" / "c3d" / "HDM_bd_05-01_01_120.c3d")
    assert (body.skeleton, body.rate_hz, body.frames, body.valid) == ("hdm05-c3d", 120.0, 5920, None)
    # The lengths of the actor's Acclaim skeleton, which was solved on such markers, and how much they may vary here.
    lengths = {
        ("lhip", "rhip"): (0.153, 0.01), ("lhip", "lknee"): (0.414, 0.03), ("rhip", "rknee"): (0.414, 0.03),
        ("lknee", "lankle"): (0.394, 0.01), ("rknee", "rankle"): (0.394, 0.01), ("root", "belly"): (0.125, 0.015),
        ("belly", "chest"): (0.124, 0.015), ("chest", "neck"): (0.125, 0.015), ("neck", "head"): (0.191, 0.01),
        ("head", "headtop"): (0.101, 0.015), ("lelbow", "lwrist"): (0.254, 0.03), ("relbow", "rwrist"): (0.254, 0.03),
        ("lshoulder", "lelbow"): (0.273, 0.04), ("rshoulder", "relbow"): (0.273, 0.05),
    }  # fmt: skip
    for (a, b), (expected, tolerance) in lengths.items():
        found = np.linalg.norm(joint(body, a) - joint(body, b), axis=0)
        assert np.median(found) == pytest.approx(expected, abs=tolerance), (a, b)
        assert np.std(found) < 0.03, (a, b)
    for side in "lr":
        for part, most in (("hip", 0.012), ("ankle", 0.006)):
            found = np.linalg.norm(joint(body, f"{side}knee") - joint(body, f"{side}{part}"), axis=0)
            assert np.std(found) < most * np.median(found), (side, part)
    assert (joint(body, "neck")[1] > joint(body, "root")[1] + 0.3).all()
    assert joint(body, "rtoes")[1].min() == pytest.approx(0.03, abs=0.02)


@pytest.mark.shared
def test_files_of_several_vendors_come_in_or_say_what_they_lack(shared: Path) -> None:
    found = {name: read(shared / "data" / "c3d" / f"{name}.c3d") for name in ("Qualisys", "BTS", "03_rolling")}
    assert [(body.skeleton, body.rate_hz, body.frames) for body in found.values()] == [
        ("recognised markers", 200.0, 340),
        ("recognised markers", 100.0, 675),
        ("recognised markers", 175.0, 2305),
    ]
    assert "it begins with frame 705 of its recording, which is source frame 0 here" in found["Qualisys"].warnings
    valid = found["BTS"].valid
    assert valid is not None
    assert np.count_nonzero(valid) == 150
    rolling = found["03_rolling"]
    assert rolling.warnings[0] == "it begins with frame 1368 of its recording, which is source frame 0 here"
    assert rolling.valid is not None
    assert np.count_nonzero(rolling.valid) > 1300  # it lies on its markers: half of them are hidden at a time
    assert rolling.filled_frames > 1300
    for side in "lr":
        thigh = np.linalg.norm(joint(rolling, f"{side}hip") - joint(rolling, f"{side}knee"), axis=0)[rolling.valid]
        assert np.median(thigh) == pytest.approx(0.44, abs=0.05)
        assert np.std(thigh) < 0.035
    with pytest.raises(SourceError, match=r"no human body is recognised among its points: .* labels .*Marker_1"):
        read(shared / "data" / "c3d" / "Optotrak.c3d")


@pytest.mark.shared
@pytest.mark.parametrize("name", ["c3d/Vicon.c3d", "wild/pyomeca/markers.trc", "wild/pyomeca/markers.csv"])
def test_a_set_of_markers_for_one_arm_is_a_body_of_which_one_arm_is_known(shared: Path, name: str) -> None:
    body = read(shared / "data" / name)
    assert {joint for joint in body.unknown if joint[0] != "r"} == {
        f"l{part}" for part in ("knee", "ankle", "toes", "shoulder", "elbow", "wrist", "fingers")
    }
    assert "rshoulder" in body.estimated
    for a, b, length in (("shoulder", "elbow", 0.28), ("elbow", "wrist", 0.26), ("wrist", "fingers", 0.08)):
        found = np.linalg.norm(joint(body, f"r{a}") - joint(body, f"r{b}"), axis=0)
        assert np.median(found) == pytest.approx(length, abs=0.03), (a, b)
    assert (joint(body, "neck")[1] > joint(body, "root")[1] + 0.3).all()
    hips = joint(body, "lhip") - joint(body, "rhip")
    across = joint(body, "neck") - joint(body, "rshoulder")
    assert ((hips * across).sum(axis=0) > 0).all()  # the right arm, though no label says so
