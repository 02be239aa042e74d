"""Point clouds in PCD and PLY are the depth images that they were made of, and headers that lie are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from kinedex.ops.depth.lzf import decompress
from kinedex.ops.errors import ParameterError, SourceError
from kinedex.storage.formats.depth.clouds import Cloud, check_camera, cloud_depths, fitted_matrix
from kinedex.storage.formats.depth.pcd import read_pcd, read_ply
from tests.depth_files import SIZE, camera, cloud_points, lzf, pcd, ply, room, with_person

SEEN = camera()
DEPTHS = with_person(room(SEEN), SEEN)
DEPTHS[:2] = 0
POINTS = cloud_points(SEEN, DEPTHS)
ENCODINGS = ("ascii", "binary", "binary_compressed")
ORDERS = ("ascii", "binary_little_endian", "binary_big_endian")


def saved(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_an_organised_cloud_is_the_image_and_has_its_intrinsics(tmp_path: Path, encoding: str, colour: bool) -> None:
    cloud = read_pcd(saved(tmp_path / "0.pcd", pcd(POINTS, encoding, SIZE, colour)))
    assert cloud.size == SIZE
    assert cloud_depths(cloud, SEEN) == pytest.approx(DEPTHS, rel=1e-6)
    assert fitted_matrix(cloud) == pytest.approx(SEEN.matrix, rel=1e-4)
    check_camera(cloud, SEEN)


@pytest.mark.parametrize("more", [False, True])
@pytest.mark.parametrize("order", ORDERS)
def test_other_clouds_are_projected_into_the_camera(tmp_path: Path, order: str, more: bool) -> None:
    seen = POINTS[np.isfinite(POINTS[:, 2])]
    mixed = np.random.default_rng(0).permutation(np.concatenate([seen, 1.2 * seen[::3]]))  # hidden points behind
    cloud = read_ply(saved(tmp_path / "0.ply", ply(mixed, order, more)))
    assert cloud.size is None
    assert cloud_depths(cloud, SEEN) == pytest.approx(DEPTHS, rel=1e-6)
    assert cloud_depths(cloud, SEEN, 0.5) == pytest.approx(DEPTHS / 2, rel=1e-6)


def test_the_given_cloud_has_the_numbers_of_the_page(shared: Path) -> None:
    cloud = read_pcd(shared / "data" / "depth" / "cloud" / "person.pcd")
    assert cloud.size == (640, 480)
    measured = np.isfinite(cloud.points[:, 2])
    assert measured.sum() == 242_749
    z = cloud.points[measured, 2]
    assert (round(float(z.min()), 3), round(float(z.max()), 3)) == (0.607, 3.779)
    matrix = fitted_matrix(cloud)
    assert matrix.round(1).tolist() == [[525.0, 0, 319.5], [0, 525.0, 239.5], [0, 0, 1]]
    depths = cloud_depths(cloud, camera(matrix=matrix, size=(640, 480)))
    assert (depths > 0).sum() == 242_749
    alone = Cloud(cloud.path, cloud.points)
    assert np.array_equal(cloud_depths(alone, camera(matrix=matrix, size=(640, 480))), depths)


def test_axes_of_opengl_are_turned_and_a_world_s_are_refused(tmp_path: Path) -> None:
    turned = POINTS * [1, -1, -1]
    assert cloud_depths(read_pcd(saved(tmp_path / "0.pcd", pcd(turned, "binary", SIZE))), SEEN) == pytest.approx(
        DEPTHS, rel=1e-6
    )
    with pytest.raises(SourceError, match="points lie behind the camera; expected its own axes"):
        read_pcd(saved(tmp_path / "1.pcd", pcd(POINTS - [0, 0, 3.5], "binary", SIZE)))


def test_a_camera_that_does_not_fit_is_refused_with_the_one_that_does() -> None:
    cloud = Cloud(Path("0.pcd"), POINTS, SIZE)
    with pytest.raises(
        SourceError, match=r"pixels off their rows and columns with this camera; fx 28, fy 28, cx 15\.5"
    ):
        check_camera(cloud, camera(matrix=np.array([[40.0, 0, 15.5], [0, 40.0, 11.5], [0, 0, 1]])))
    with pytest.raises(SourceError, match="has 32 × 24 pixels, and its camera 64 × 48; with the images scaled by"):
        check_camera(cloud, camera(size=(64, 48)))
    shuffled = Cloud(Path("0.pcd"), np.random.default_rng(0).permutation(POINTS), SIZE)
    with pytest.raises(SourceError, match="are no image of a pinhole camera"):
        fitted_matrix(shuffled)
    with pytest.raises(SourceError, match="without rows and columns"):
        fitted_matrix(Cloud(Path("0.ply"), POINTS))


GOOD = pcd(POINTS[64:72], "binary")
PACKED = pcd(POINTS[64:72], "binary_compressed")
TEXT = pcd(POINTS[64:72], "ascii")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (GOOD[:-1], "claims 96 bytes of points, and has 95: is it cut off"),
        (GOOD + b"x", "claims 96 bytes of points, and has 97: the header does not fit its data"),
        (GOOD.replace(b"WIDTH 8", b"WIDTH 9"), "POINTS 8 is not WIDTH 9 times HEIGHT 1"),
        (GOOD.replace(b"WIDTH 8", b"WIDTH 1000000000").replace(b"POINTS 8", b"POINTS 1000000000"),
         "claims 1,000,000,000 points of 12 bytes, and a frame has 1 to"),
        (TEXT.replace(b"WIDTH 8", b"WIDTH 4000000").replace(b"POINTS 8", b"POINTS 4000000"),
         "claims 4,000,000 points, and has .* is it cut off"),
        (GOOD.replace(b"WIDTH 8", b"WIDTH -8"), "WIDTH must be a whole number, got '-8'"),
        (GOOD.replace(b"FIELDS x y z", b"FIELDS x y w"), "expected the fields x, y and z once"),
        (GOOD.replace(b"SIZE 4 4 4", b"SIZE 4 4 3"), "got F3"),
        (GOOD.replace(b"COUNT 1 1 1", b"COUNT 1 1 1 1"), "must have as many entries"),
        (GOOD.replace(b"DATA binary", b"DATA zip"), "DATA must be ascii, binary or binary_compressed, got 'zip'"),
        (GOOD.replace(b"HEIGHT 1\n", b""), "is no PCD: no line HEIGHT before DATA"),
        (GOOD.replace(b"HEIGHT 1\n", b"HEIGHT 1\nHEIGHT 2\n"), "0.pcd:9: HEIGHT stands twice"),
        (b"hello", "is no PCD: no line DATA"),
        (PACKED[:-3], "is it cut off"),
        (PACKED[:-2] + b"\xff\xff", "compressed data are damaged"),
        (TEXT.replace(b" ", b" one ", 0)[:-40], "0.pcd:|claims 8 points"),
        (TEXT[:-1] + b" 7\n", "0.pcd:19: expected 3 numbers, got 4"),
        (TEXT[:-1] + b"x\n", "0.pcd:19: expected 3 numbers, got '"),
        (TEXT + b"1 2 3\n", "claims 8 points, and has more: the header does not fit"),
    ],
)  # fmt: skip
def test_pcd_that_lies_is_refused(tmp_path: Path, data: bytes, message: str) -> None:
    with pytest.raises(SourceError, match=message):
        read_pcd(saved(tmp_path / "0.pcd", data))


LITTLE = ply(POINTS[64:72], "binary_little_endian")
MORE = ply(POINTS[64:72], "binary_big_endian", more=True)
ROWS = ply(POINTS[64:72], "ascii")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (LITTLE[:-1], "claims 96 bytes of points, and has 95"),
        (LITTLE + b"\0", "the header does not fit its data"),
        (MORE[:-30], "is it cut off"),
        (LITTLE.replace(b"vertex 8", b"vertex 1000000000"), "claims 1,000,000,000 points of 12 bytes"),
        (ROWS.replace(b"vertex 8", b"vertex 4000000"), "claims 4,000,000 points, and has .* bytes"),
        (LITTLE.replace(b"vertex 8", b"vertex -8"), "0.ply:4: expected a format, an element or a property"),
        (LITTLE.replace(b"float z", b"list uchar float z"), "has lists before or in its vertices"),
        (LITTLE.replace(b"float z", b"float w"), "vertices must have one property z, got 0"),
        (LITTLE.replace(b"element vertex 8\n", b""), "expected a format, an element or a property, got 'property"),
        (LITTLE.replace(b"vertex", b"point"), "has no element vertex"),
        (LITTLE.replace(b"binary_little_endian", b"binary_middle_endian"), "0.ply:2: expected a format"),
        (LITTLE.replace(b"format binary_little_endian 1.0\n", b""), "expected `format` with one of ascii"),
        (b"ply\nformat ascii 1.0\n", "is no PLY"),
        (ROWS.replace(b"element vertex", b"element edge 5000000\nelement vertex"), "claims 5,000,000 rows before"),
        (ROWS.replace(b"element vertex", b"element edge 50\nelement vertex"), "and has fewer: is it cut off"),
        (ROWS[:-30], "claims 8 points|expected 3 numbers"),
        (ROWS[:-1] + b"_1\n", "0.ply:16: expected 3 numbers, got '"),
    ],
)
def test_ply_that_lies_is_refused(tmp_path: Path, data: bytes, message: str) -> None:
    with pytest.raises(SourceError, match=message):
        read_ply(saved(tmp_path / "0.ply", data))


@given(st.binary(max_size=300), st.integers(0, 6))
def test_what_lzf_packs_it_unpacks(data: bytes, repeats: int) -> None:
    whole = data * repeats
    assert decompress(lzf(whole), len(whole)).tobytes() == whole


def test_lzf_of_another_size_or_without_a_past_is_refused() -> None:
    packed = lzf(b"abcabcabcabc")
    for size in (11, 13, 10**12, -1):
        with pytest.raises(ParameterError, match=r"data must|size must"):
            decompress(packed, size)
    for damaged in (b"\x05ab", b"\x20\x00", b"\xe0", b"\xe0\x01", b"\x20"):
        with pytest.raises(ParameterError, match="data must"):
            decompress(damaged, 8)


@given(arrays.arrays(np.float32, (30, 3), elements=st.floats(0.5, 8, width=32)), st.sampled_from(ENCODINGS + ORDERS))
def test_points_are_read_to_the_bit(tmp_path_factory: pytest.TempPathFactory, points, encoding: str) -> None:
    path = tmp_path_factory.getbasetemp() / "round"
    if encoding in ENCODINGS:
        found = read_pcd(saved(path.with_suffix(".pcd"), pcd(points, encoding)))
    else:
        found = read_ply(saved(path.with_suffix(".ply"), ply(points, encoding, more=True)))
    assert (found.points == points).all()
    if encoding == "ascii":
        assert (read_ply(saved(path.with_suffix(".ply"), ply(points, encoding))).points == points).all()
