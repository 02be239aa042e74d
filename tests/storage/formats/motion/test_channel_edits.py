"""Changed cuts of channels: mirrored, at the origin, at another rate, compared with the same changes of the joints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import kinedex
from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.body.facing_direction import (
    Placement,
    mirrored_positions,
    mirrored_quaternions,
    placement_of,
    start_at_origin,
)
from kinedex.ops.body.resample import covered_frames, resample
from kinedex.ops.errors import ParameterError, SourceError
from kinedex.ops.synth.body import draw_actor
from kinedex.ops.synth.performance import perform_clip
from kinedex.ops.synth.solve import columns
from kinedex.pipelines.ingestion.analysis import analyse
from kinedex.storage.formats.motion.acclaim_writer import Dialect, write_amc, write_asf
from kinedex.storage.formats.motion.amc_cuts import write_amc_cut
from kinedex.storage.formats.motion.bvh_cuts import write_bvh_cut
from kinedex.storage.formats.motion.bvh_parser import parse_bvh
from kinedex.storage.formats.motion.channel_cuts import SourceCut
from kinedex.storage.formats.motion.reader import DEFAULT_SETTINGS, Body
from kinedex.storage.formats.motion.reader_table import read_body
from tests.bvh_files import Joint, bvh_text, dance, mixamo, small, still, write_duet

FEATURES = load_feature_set("body40")
JOINTS = FEATURES.joints
MAPPINGS = load_mappings("auto", JOINTS)


def body_of(path: Path, skeleton: Path | None = None, rate_hz: float | None = None) -> Body:
    given = replace(DEFAULT_SETTINGS, rate_hz=rate_hz)
    return read_body(path, skeleton, MAPPINGS, JOINTS, given, None, "")


def write(cut: SourceCut, folder: Path) -> Body:
    """The body of a cut that is written and read again."""
    path, skeleton = folder / f"cut{cut.source.suffix}", folder / "cut.asf"
    (write_bvh_cut if cut.skeleton is None else write_amc_cut)([path, skeleton], cut)
    return body_of(path, cut.skeleton and skeleton, cut.rate_hz)


def places(body: Body) -> np.ndarray:
    return np.moveaxis(body.positions, 2, 0)


def placement(frame: np.ndarray) -> Placement:
    left, right = (frame[[JOINTS.index(f"{side}{name}") for name in ("hip", "shoulder")]] for side in "lr")
    return placement_of(frame[JOINTS.index("root")], left, right)


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> list[SourceCut]:
    """A BVH file whose left arm is longer and whose hands have unlike fingers' names, and an AMC file."""
    folder = tmp_path_factory.mktemp("sources")
    body = mixamo()
    for joint in body.all():
        if joint.name.endswith("LeftForeArm"):
            joint.offset = (31.0, -2.0, 0.5)
    (folder / "a.bvh").write_text(bvh_text(body, dance(body, 20), newline="\r\n"), newline="")
    actor, dialect = draw_actor(4, 9), Dialect(decimals=6)
    write_asf(folder / "b.asf", actor.body, "b", dialect)
    write_amc(folder / "b.amc", columns(actor.body), perform_clip(actor, "kickRight1Reps", 0, 9).angles, dialect)
    amc = body_of(folder / "b.amc", folder / "b.asf")
    return [
        SourceCut(folder / "a.bvh", None, None, 0, 20, 30.0),
        SourceCut(folder / "b.amc", folder / "b.asf", None, 0, amc.frames, 120.0),
    ]


def check_mirrored(cut: SourceCut, folder: Path) -> None:
    """Check that a mirrored cut is the mirror image of its source, and gives the words of the image."""
    source = body_of(cut.source, cut.skeleton)
    found = write(replace(cut, mirror=True), folder)
    image = np.moveaxis(mirrored_positions(places(source), JOINTS), 0, 2)
    np.testing.assert_allclose(found.positions, image, atol=1e-9)
    turned = replace(source, positions=image, orientation=mirrored_quaternions(source.orientation.T).T)
    words = analyse(turned, FEATURES, 30.0)[2]
    np.testing.assert_array_equal(analyse(found, FEATURES, 30.0)[2], words)


def test_a_mirrored_cut_is_the_mirror_image_and_mirrored_twice_the_source(
    sources: list[SourceCut], tmp_path: Path
) -> None:
    for cut in sources:
        check_mirrored(cut, tmp_path)
        mirrored = tmp_path / f"cut{cut.source.suffix}"
        assert mirrored.read_bytes().split() != cut.source.read_bytes().split()
        (tmp_path / "twice").mkdir(exist_ok=True)
        again = replace(cut, source=mirrored, skeleton=cut.skeleton and tmp_path / "cut.asf", mirror=True)
        write(again, tmp_path / "twice")
        assert (tmp_path / "twice" / mirrored.name).read_bytes().split() == cut.source.read_bytes().split()


def test_a_mirrored_cut_keeps_the_order_of_the_joints(sources: list[SourceCut], tmp_path: Path) -> None:
    write_bvh_cut([tmp_path / "a.bvh"], replace(sources[0], mirror=True))
    source, found = parse_bvh(sources[0].source), parse_bvh(tmp_path / "a.bvh")
    assert [node.name for node in found.nodes] == [node.name for node in source.nodes]
    offsets = {node.name.removeprefix("mixamorig:"): node.before.tolist() for node in found.nodes}
    assert offsets["RightForeArm"] == [-31.0, -2.0, 0.5]
    assert offsets["LeftForeArm"] == [27.0, 0.0, 0.0]


def test_a_cut_in_place_begins_above_the_origin_and_faces_z(sources: list[SourceCut], tmp_path: Path) -> None:
    for cut in sources:
        source = places(body_of(cut.source, cut.skeleton))
        for mirror in (False, True):
            found = places(write(replace(cut, start=2, in_place=True, mirror=mirror, inner=(7, 9)), tmp_path))
            before = (mirrored_positions(source, JOINTS) if mirror else source)[2:]
            np.testing.assert_allclose(found, start_at_origin(before, placement(before[5])), atol=1e-4)
            assert placement(found[5]) == pytest.approx((0, 0, 0), abs=1e-4)


def test_numbers_that_do_not_change_keep_their_text(sources: list[SourceCut], tmp_path: Path) -> None:
    cut = sources[0]
    write_bvh_cut([tmp_path / "a.bvh"], replace(cut, in_place=True))
    before, after = (path.read_bytes().splitlines() for path in (cut.source, tmp_path / "a.bvh"))
    assert [row.split()[6:] for row in after[-20:]] == [row.split()[6:] for row in before[-20:]]
    assert after[:-20] == before[:-20]
    write_bvh_cut([tmp_path / "a.bvh"], replace(cut, rate_hz=10.0))
    rows = (tmp_path / "a.bvh").read_bytes().splitlines()
    assert [row.split() for row in rows[-7:]] == [row.split() for row in before[-20::3]]


@pytest.mark.parametrize("rate_hz", [15.0, 24.0, 50.0, 75.5])
def test_a_cut_at_another_rate_moves_alike(sources: list[SourceCut], tmp_path: Path, rate_hz: float) -> None:
    for cut in sources:
        source = body_of(cut.source, cut.skeleton)
        found = write(replace(cut, rate_hz=rate_hz), tmp_path)
        assert found.rate_hz == rate_hz
        straight = resample(source.positions, source.orientation, source.rate_hz, rate_hz)
        np.testing.assert_allclose(found.positions, straight.positions, atol=0.01)


def test_a_cut_that_is_read_again_has_as_many_frames(sources: list[SourceCut], tmp_path: Path) -> None:
    path = tmp_path / "fifty.bvh"
    path.write_text(bvh_text(mixamo(), dance(mixamo(), 90), frame_time="0.02"))
    for cut in (*sources, SourceCut(path, None, None, 0, 90, 50.0)):
        take = kinedex.read(cut.source)
        for start, stop in ((0, len(take)), (3, 11), (len(take) - 5, len(take))):
            first, last = covered_frames(start, stop, int(take.info["source_frames"]), cut.source_rate_hz, 30.0)
            body = write(replace(cut, start=first, stop=last), tmp_path)
            words = analyse(body, FEATURES, 30.0)[2]
            assert len(words) == stop - start
            if stop - start == len(take):
                np.testing.assert_array_equal(words, take.words())


def test_one_person_of_several_is_mirrored(tmp_path: Path) -> None:
    source = write_duet(tmp_path / "duet.bvh", 6)
    alone = SourceCut(source, None, "Ben", 0, 6, 30.0)
    write_bvh_cut([tmp_path / "ben.bvh"], alone)
    write_bvh_cut([tmp_path / "mirrored.bvh"], replace(alone, mirror=True))
    check_mirrored(replace(alone, source=tmp_path / "ben.bvh", person=None), tmp_path)
    assert (tmp_path / "mirrored.bvh").read_bytes() == (tmp_path / "cut.bvh").read_bytes()


def test_what_the_channels_cannot_express_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.bvh"

    def refused(body: Joint, message: str, **changes: object) -> None:
        path.write_text(bvh_text(body, still(body)))
        with pytest.raises(SourceError, match=message):
            write_bvh_cut([tmp_path / "out.bvh"], replace(SourceCut(path, None, None, 0, 3, 30.0), **changes))
        assert not (tmp_path / "out.bvh").exists()

    body = mixamo()
    hand = next(joint for joint in body.all() if joint.name.endswith("RightHand"))
    hand.children.append(Joint("Sword", (1.0, 2.0, 3.0)))
    refused(body, r"cannot be mirrored: 'Sword' of one side has no partner .* --joints", mirror=True)
    body = mixamo()
    arm = next(joint for joint in body.all() if joint.name.endswith("LeftArm"))
    arm.channels = ("Xrotation", "Yrotation", "Zrotation")
    refused(body, "'mixamorig:LeftArm' has the channels Xrotation Yrotation Zrotation, its partner", mirror=True)
    body = mixamo()
    body.channels, body.offset = ("Zrotation", "Xrotation", "Yrotation"), (5.0, 100.0, 0.0)
    refused(body, r"its root 'mixamorig:Hips' has the channels Zrotation .* three positions", in_place=True)
    refused(small(), "no skeleton mapping fits its names", mirror=True)
    path.write_text(bvh_text(mixamo(), still(mixamo())))
    with pytest.raises(ParameterError, match="rate_hz must be from 1 to 10000"):
        write_bvh_cut([tmp_path / "out.bvh"], SourceCut(path, None, None, 0, 3, 30.0, rate_hz=0.5))


@pytest.mark.shared
def test_real_takes_are_mirrored_exactly(shared: Path, tmp_path: Path) -> None:
    data = shared / "data"
    for source in (data / "hdm05/takes/HDM_mm_take05.amc", data / "cmu/02/02_05.amc"):
        skeleton = next(iter(source.parent.glob("*.asf")))
        frames = kinedex.read(source).info["source_frames"]
        check_mirrored(SourceCut(source, skeleton, None, 0, frames, 120.0), tmp_path)
    for source in (*sorted((data / "bandai").rglob("*.bvh"))[::200], data / "wild/pybvh/cmu_12_01_walk.bvh"):
        frames = len(parse_bvh(source).channels)
        check_mirrored(SourceCut(source, None, None, 0, frames, 30.0), tmp_path)
