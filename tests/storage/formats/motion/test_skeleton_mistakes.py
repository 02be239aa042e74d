"""A skeleton file with one mistake has every joint in its place, or says that it may not."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from studies.acclaim_mutations import acclaim_files, acclaim_mutations
from studies.acclaim_mutations import write as write_acclaim
from studies.mutations import judged, read, read_beside
from studies.skeleton_mutations import BvhText, bvh_files, bvh_mutations, parse, write
from tests.bvh_files import bvh_text, dance, mixamo
from tests.real_data import SHARED

BODIES: dict[str, Callable[[str], str]] = {
    "by a mapping": lambda text: text,
    "recognised": lambda text: (
        text.replace("UpLeg", "Thigh").replace("ForeArm", "Elbow").replace("HandMiddle1", "Fingers")
    ),
}
"""Changes of a Mixamo file: none, or names that no mapping has."""


@pytest.fixture(params=BODIES)
def file(request: pytest.FixtureRequest, tmp_path: Path) -> BvhText:
    root = mixamo()
    path = tmp_path / "plain.bvh"
    path.write_text(BODIES[request.param](bvh_text(root, dance(root, 40))))
    return parse(path)


def outcomes(file: BvhText, path: Path, name: str) -> list[tuple[str, str, str]]:
    """Return the outcome of each mutation of a name that is not read rightly, with what it changed."""
    write(path, file)
    control = read(path)
    found = []
    for mutation in bvh_mutations(file):
        if mutation.name == name:
            write(path, mutation.file)
            outcome = judged(path, control, mutation.knowable)
            found.append((outcome.kind, mutation.what, outcome.detail))
    assert found
    return [one for one in found if one[0] != "right"]


@pytest.mark.parametrize("mistake", ["added twist joint", "joint renamed", "left and right exchanged"])
def test_a_wrong_name_or_a_divided_bone_moves_no_joint(mistake: str, file: BvhText, tmp_path: Path) -> None:
    found = outcomes(file, tmp_path / "take.bvh", mistake)
    inner = [one for one in found if not re.search("End$|Middle|Fingers|Toe", one[1])]
    assert inner == []
    assert [one for one in found if one[0] not in ("estimated", "warned")] == []


def test_a_bone_without_length_is_estimated_and_reported(file: BvhText, tmp_path: Path) -> None:
    found = outcomes(file, tmp_path / "take.bvh", "bone of no length")
    assert [one for one in found if one[0] not in ("estimated", "warned")] == []
    path = tmp_path / "take.bvh"
    collar = next(one for one in bvh_mutations(file) if one.name == "bone of no length" and "LeftShoulder" in one.what)
    write(path, collar.file)
    body = read(path)
    assert "lclavicle" in body.estimated
    assert body.warnings[0] == "bone mixamorig:LeftShoulder has no length in the file; the other side's is taken"


def test_exchanged_names_are_reported(file: BvhText, tmp_path: Path) -> None:
    path = tmp_path / "take.bvh"
    exchanged = next(
        one for one in bvh_mutations(file) if one.name == "left and right exchanged" and "Foot" in one.what
    )
    write(path, exchanged.file)
    (warning,) = read(path).warnings
    assert warning.startswith("the names 'mixamorig:RightFoot' and 'mixamorig:LeftFoot' are exchanged")


def test_a_renamed_node_of_a_mapping_is_reported(tmp_path: Path) -> None:
    root, path = mixamo(), tmp_path / "take.bvh"
    path.write_text(bvh_text(root, dance(root, 5)).replace("mixamorig:Spine1", "mixamorig:Qx7"))
    body = read(path)
    assert body.skeleton == "mixamo"
    assert body.warnings == (
        "its names are those of mapping 'mixamo' but for 1, read by place in the tree: 'mixamorig:Qx7' is 'Spine1'",
    )


@pytest.mark.skipif(not (SHARED / "data" / "wild").is_dir(), reason="no ../shared/data/wild")
def test_the_files_of_the_study_with_wrong_names_are_read_rightly(tmp_path: Path) -> None:
    for file in bvh_files(SHARED / "data"):
        if file.name != "bvh_test3.bvh":  # its many fingers take long
            for mistake in ("added twist joint", "joint renamed", "left and right exchanged"):
                assert outcomes(file, tmp_path / "take.bvh", mistake) == [], file.name
            found = outcomes(file, tmp_path / "take.bvh", "bone of no length")
            assert [one for one in found if one[0] not in ("warned", "not knowable")] == [], file.name


@pytest.mark.parametrize("name", ["root in another unit than offsets", "other unit", "origin far away"])
@pytest.mark.skipif(not (SHARED / "data" / "wild").is_dir(), reason="no ../shared/data/wild")
def test_no_file_of_the_study_moves_silently_by_its_unit(name: str, tmp_path: Path) -> None:
    for file in bvh_files(SHARED / "data"):
        found = outcomes(file, tmp_path / "take.bvh", name)
        assert [one for one in found if one[0] not in ("warned", "refused")] == [], file.name


@pytest.mark.skipif(not (SHARED / "data" / "cmu").is_dir(), reason="no ../shared/data/cmu")
def test_no_joint_of_an_acclaim_file_moves_silently(tmp_path: Path) -> None:
    files = acclaim_files(SHARED / "data")
    wanted = {
        "joint renamed": ("right",),
        "bone of no length": ("right", "warned"),
        "neighbour's skeleton": ("refused",),
    }
    wanted |= {"unit lying": ("warned",), "root in another unit than offsets": ("warned",)}
    control = read_beside(write_acclaim(tmp_path, files[0]))
    assert control.warnings == ()
    for mutation in acclaim_mutations(files[0], files):
        if mutation.name in wanted:
            path = write_acclaim(tmp_path, mutation.file)
            outcome = judged(path, control, mutation.knowable, read_beside)
            assert outcome.kind in wanted[mutation.name], (mutation.name, mutation.what, outcome)
