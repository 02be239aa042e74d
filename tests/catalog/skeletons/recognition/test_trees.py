"""Bodies are recognised in skeleton trees of many dialects, whatever their names and axes; others are refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.body_evidence import Evidence
from kinedex.catalog.skeletons.mappings import load_skeleton
from kinedex.catalog.skeletons.recognition.named_joints import polyline_point
from kinedex.catalog.skeletons.recognition.proposal import mapping_yaml
from kinedex.catalog.skeletons.recognition.recognised_tree import propose_tree, recognise_tree
from kinedex.ops.errors import SourceError
from tests.skeleton_dialects import DIALECTS, PLACES, Dialect, evidence_of

JOINTS = load_feature_set().joints
NEAR_M = 0.05


@pytest.mark.parametrize("name", DIALECTS)
def test_a_body_of_a_dialect_comes_in_with_its_joints_in_place(name: str) -> None:
    evidence, truth = evidence_of(DIALECTS[name])
    fit = recognise_tree("x", evidence, JOINTS)
    assert fit.unknown == ()
    placed = dict(zip(JOINTS, fit.apply(evidence.positions, JOINTS), strict=True))
    far = {joint: np.linalg.norm(placed[joint] - place, axis=0).max() for joint, place in truth.items()}
    assert {joint: round(float(d), 3) for joint, d in far.items() if d > NEAR_M} == {}
    assert fit.confidence > 0.6 or name == "nameless"


TURNS = {
    "x up": np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "z up": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "-y up": np.diag([-1.0, -1.0, 1.0]),
}


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("name", ["lafan1", "unreal", "nameless"])
def test_a_turned_body_comes_in_upright_with_the_same_joints(name: str, turn: str) -> None:
    straight, _ = evidence_of(DIALECTS[name], 24)
    turned, _ = evidence_of(DIALECTS[name], 24, TURNS[turn])
    fits = [recognise_tree("x", evidence, JOINTS) for evidence in (straight, turned)]
    assert fits[0].joints == fits[1].joints
    heights = [
        fit.apply(evidence.positions, JOINTS)[:, 1] for fit, evidence in zip(fits, (straight, turned), strict=True)
    ]
    np.testing.assert_allclose(heights[1], heights[0], atol=1e-9)
    assert np.linalg.det(fits[1].mapping.axes) == pytest.approx(1.0)


def test_a_mirrored_nameless_body_has_its_sides_exchanged() -> None:
    straight, _ = evidence_of(DIALECTS["nameless"])
    mirrored, _ = evidence_of(DIALECTS["nameless"], turn=np.diag([-1.0, 1.0, 1.0]))
    left, right = (recognise_tree("x", evidence, JOINTS).joints for evidence in (straight, mirrored))
    for joint in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist"):
        assert (left[f"l{joint}"], left[f"r{joint}"]) == (right[f"r{joint}"], right[f"l{joint}"])


HEELS = {
    "a heel and no toes": "{}Heel {}Foot heel/",
    "a heel with a tip farther away than the toes": "{}Heel {}Foot heel/{}Heel_end {}Heel spur/{}Toe {}Foot ball/",
    "a calcaneus farther away than the toes": "{}Calcaneus {}Foot spur/{}Toe {}Foot ball/",
    "an end without a name behind the foot": "{}Toe {}Foot ball/{}Foot_end {}Foot spur/",
    "toes that hang from the heel": "{}Heel {}Foot heel/{}Toe {}Heel toe/",
}
"""Nodes below the foot; a spur lies behind the heel, farther from the ankle than the ball of the foot."""


@pytest.mark.parametrize("foot", HEELS)
def test_a_heel_is_no_tip_of_the_foot_by_which_the_body_would_face_backwards(
    foot: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(PLACES, "spur", (0.10, 0.0, -0.16))
    lines = DIALECTS["lafan1"].lines.replace("{}Toe {}Foot ball/{}Toe_end {}Toe toe/", HEELS[foot])
    evidence, truth = evidence_of(Dialect(lines))
    fit = recognise_tree("x", evidence, JOINTS)
    assert np.linalg.det(fit.mapping.axes) == pytest.approx(1.0)
    assert fit.confidence > 0.9
    placed = dict(zip(JOINTS, fit.apply(evidence.positions, JOINTS), strict=True))
    assert all(np.linalg.norm(placed[joint] - place, axis=0).max() < NEAR_M for joint, place in truth.items())
    assert placed["ltoes"][2, 0] > placed["lankle"][2, 0] + 0.08  # ahead


def test_named_sides_on_the_wrong_side_are_left_handed_axes_and_doubtful() -> None:
    evidence, _ = evidence_of(DIALECTS["mmd"], turn=np.diag([-1.0, 1.0, 1.0]))
    fit = recognise_tree("x", evidence, JOINTS)
    assert np.linalg.det(fit.mapping.axes) == pytest.approx(-1.0)
    assert fit.confidence < 0.6
    assert any("left-handed" in reason for reason in fit.reasons)
    left, right = (fit.apply(evidence.positions, JOINTS)[JOINTS.index(joint)] for joint in ("lhip", "rhip"))
    toes, ankle = (fit.apply(evidence.positions, JOINTS)[JOINTS.index(joint)] for joint in ("ltoes", "lankle"))
    assert np.cross([0, 1, 0], (toes - ankle)[:, 0]) @ (left - right)[:, 0] > 0


@settings(max_examples=60)
@given(
    dialect=st.sampled_from(["lafan1", "poser", "smpl", "unity", "genea"]),
    prefix=st.sampled_from(["", "mixamorig:", "Bob_", "ORG-", "rig|", "Character1_"]),
    case=st.sampled_from([str, str.lower, str.upper]),
    sides=st.sampled_from([("Left_", "Right_"), ("l_", "r_"), ("L.", "R."), ("left ", "right "), ("LFT_", "RGT_")]),
)
def test_a_consistent_renaming_gives_the_same_mapping(
    dialect: str, prefix: str, case: Callable[[str], str], sides: tuple[str, str]
) -> None:
    plain, _ = evidence_of(DIALECTS[dialect], 4)
    renamed, _ = evidence_of(replace(DIALECTS[dialect], sides=sides), 4)
    # lower case glues what capitals keep apart, so the words are parted first
    parted = [re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name) for name in renamed.names]
    renamed = replace(renamed, names=tuple(prefix + case(name) for name in parted))
    index = [{name: i for i, name in enumerate(evidence.names)} for evidence in (plain, renamed)]
    nodes = [
        {
            joint: None if mix is None else [(index[which][n] if not mix.of_joints else n, w) for n, w in mix.weights]
            for joint, mix in recognise_tree("x", evidence, JOINTS).joints.items()
        }
        for which, evidence in enumerate((plain, renamed))
    ]
    assert nodes[0] == nodes[1]


def part_of(evidence: Evidence, kept: Callable[[str], bool]) -> Evidence:
    """Some nodes of a body, each below the nearest one above it that is kept."""
    assert evidence.parents is not None
    assert evidence.offsets is not None
    index = [i for i, name in enumerate(evidence.names) if kept(name)]
    rest = np.zeros((len(evidence.names), 3))
    for i, parent in enumerate(evidence.parents):
        rest[i] = evidence.offsets[i] + (rest[parent] if parent >= 0 else 0.0)
    parents = []
    for i in index:
        parent = evidence.parents[i]
        while parent >= 0 and parent not in index:
            parent = evidence.parents[parent]
        parents.append(index.index(parent) if parent >= 0 else -1)
    offsets = np.array([rest[i] - (rest[index[p]] if p >= 0 else 0) for i, p in zip(index, parents, strict=True)])
    return Evidence(tuple(evidence.names[i] for i in index), evidence.positions[index], tuple(parents), offsets)


@pytest.mark.parametrize(
    ("words", "unknown"),
    [
        (("PELVIS", "HIP", "KNEE", "ANKLE", "FOOT"), ("neck", "head", "lwrist", "belly")),
        (("PELVIS", "SPINE", "NECK", "HEAD", "SHOULDER", "ELBOW", "WRIST", "HAND", "CLAV"), ("lhip", "rtoes", "lknee")),
    ],
)
def test_half_a_body_comes_in_with_the_joints_that_it_has(words: tuple[str, ...], unknown: tuple[str, ...]) -> None:
    whole, truth = evidence_of(DIALECTS["azure"])
    half = part_of(whole, lambda name: name.startswith(words))
    fit = recognise_tree("x", half, JOINTS)
    assert set(unknown) <= set(fit.unknown)
    placed = dict(zip(JOINTS, fit.apply(half.positions, JOINTS), strict=True))
    for joint in set(truth) - set(fit.unknown):
        assert np.linalg.norm(placed[joint] - truth[joint], axis=0).max() < NEAR_M


def chain(*names: str) -> Evidence:
    """Nodes one above the other."""
    offsets = np.tile([0.0, 0.3, 0.0], (len(names), 1))
    return Evidence(names, np.cumsum(offsets, axis=0)[:, :, None], tuple(range(-1, len(names) - 1)), offsets)


def hand() -> Evidence:
    """A hand alone, with five fingers."""
    fingers = ("Thumb", "Index", "Middle", "Ring", "Pinky")
    names = ("Hand", *(f"{finger}{i}" for finger in fingers for i in (1, 2, 3)))
    parents = (-1, *(0 if i == 1 else 3 * f + i - 1 for f in range(5) for i in (1, 2, 3)))
    offsets = np.array([[0, 0, 0], *([0.02 * f if i == 1 else 0, 0.05, 0] for f in range(5) for i in (1, 2, 3))])
    places = np.zeros_like(offsets)
    for i, parent in enumerate(parents):
        places[i] = offsets[i] + (places[parent] if parent >= 0 else 0)
    return Evidence(names, places[:, :, None], parents, offsets)


def dog() -> Evidence:
    """A standing dog under the names of a human: the trunk level, four legs alike, and a tail."""
    evidence, _ = evidence_of(DIALECTS["lafan1"], 1)
    places = evidence.positions[:, :, 0].copy()
    for i, name in enumerate(evidence.names):
        if name.startswith(("Spine", "Neck", "Head")):
            places[i] = [0, 0.6, 0.9 * (places[i][1] - 0.97) / 0.45]
        if "Shoulder" in name:
            places[i] = [0.05 * np.sign(places[i][0]), 0.6, 0.8]
        for word, height in (("Arm", 0.55), ("ForeArm", 0.3), ("Hand", 0.05), ("Hand_end", 0.0)):
            if name[-len(word) - 4 :].replace("Left", "").replace("ight", "").lstrip("R") == word:
                places[i] = [0.1 * np.sign(places[i][0]), height, 0.8]
        for word, height in (("UpLeg", 0.55), ("Leg", 0.3), ("Foot", 0.05)):
            if name in (f"Left{word}", f"Right{word}"):
                places[i] = [0.1 * np.sign(places[i][0]), height, 0.0]
    places[evidence.names.index("Hips")] = [0, 0.6, 0]
    assert evidence.parents is not None
    offsets = np.array([places[i] - (places[p] if p >= 0 else 0) for i, p in enumerate(evidence.parents)])
    names, parents = (*evidence.names, "Tail", "Tail1"), (*evidence.parents, 0, len(evidence.names))
    places = np.vstack([places, [0, 0.6, -0.2], [0, 0.6, -0.4]])
    return Evidence(names, places[:, :, None], parents, np.vstack([offsets, [0, 0, -0.2], [0, 0, -0.2]]))


def creature(*limbs: tuple[str, float, tuple[tuple[float, float], ...]]) -> Evidence:
    """A creature with pairs of limbs along a level back: the name of each, where it is along the back, and its joints.

    Joints are distances from the middle and heights.
    """
    nodes = [("root", "", (0.0, 0.6, 0.0)), ("spine", "root", (0.0, 0.6, 0.5)), ("head", "spine", (0.0, 0.8, 0.9))]
    for name, along, joints in limbs:
        for side, sign in (("l", 1.0), ("r", -1.0)):
            above = "spine" if along > 0.3 else "root"
            for i, (far, high) in enumerate(joints):
                nodes.append((f"{name}{i}_{side}", above, (sign * far, high, along)))
                above = nodes[-1][0]
    names = tuple(name for name, _, _ in nodes)
    parents = tuple(names.index(parent) if parent else -1 for _, parent, _ in nodes)
    places = np.array([place for _, _, place in nodes])
    offsets = np.array([places[i] - (places[p] if p >= 0 else 0.0) for i, p in enumerate(parents)])
    return Evidence(names, places[:, :, None], parents, offsets)


LEG = ((0.1, 0.58), (0.1, 0.3), (0.1, 0.05), (0.1, 0.0))
SPIDER_LEG = ((0.1, 0.6), (0.4, 0.8), (0.7, 0.4), (0.8, 0.0))
WING = ((0.1, 0.6), (0.4, 0.65), (0.8, 0.6), (1.0, 0.55))


@pytest.mark.parametrize(
    ("evidence", "kind"),
    [
        (chain("Hips", "Spine", "Neck", "Head"), "not human"),
        (chain("camera", "camera_end"), "not human"),
        (chain("ground", "pendulum", "pendulum2", "bob"), "not human"),
        (hand(), "not human"),
        (dog(), "not human"),
        (creature(("rear_leg", 0.0, LEG), ("front_leg", 0.5, LEG)), "not human"),
        (creature(("bone_a", 0.0, LEG), ("bone_b", 0.5, LEG)), "not human"),
        (creature(("leg", 0.0, LEG), ("wing", 0.5, WING)), "not human"),
        (creature(*((f"leg{i}", 0.2 * i, SPIDER_LEG) for i in range(4))), "not human"),
    ],
    ids=["a chain", "a camera", "a pendulum", "a hand", "a dog", "a horse", "a nameless horse", "a bird", "a spider"],
)
def test_what_is_no_human_is_refused_with_the_kind_of_reason(evidence: Evidence, kind: str) -> None:
    with pytest.raises(SourceError, match=f"no body is recognised: {kind}"):
        recognise_tree("x", evidence, JOINTS)
    load_proposal = mapping_yaml(propose_tree(evidence, JOINTS))
    assert "joints:" in load_proposal


@pytest.mark.parametrize("name", ["lafan1", "genesis", "kinect", "nameless"])
def test_the_mapping_that_is_written_out_places_the_same_joints(tmp_path: Path, name: str) -> None:
    evidence, _ = evidence_of(DIALECTS[name])
    fit = recognise_tree("x", evidence, JOINTS)
    (tmp_path / "own.yaml").write_text(mapping_yaml(fit, "own"))
    own = load_skeleton(tmp_path / "own.yaml", JOINTS)
    nodes = {node: i for i, node in enumerate(evidence.names)}
    np.testing.assert_allclose(
        own.apply("x", nodes, evidence.positions, JOINTS), fit.apply(evidence.positions, JOINTS), atol=1e-5
    )


@given(
    lengths=st.lists(st.floats(0.0, 10.0), min_size=1, max_size=7).filter(lambda lengths: sum(lengths) > 0.1),
    share=st.floats(0.0, 1.0),
)
def test_a_share_of_a_polyline_is_where_small_steps_lead(lengths: list[float], share: float) -> None:
    """The slow twin walks along the polyline in small steps."""
    i, part = polyline_point(lengths, share)
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    steps = np.linspace(0, ends[-1], 20_001)
    walked = steps[np.searchsorted(steps, share * ends[-1] * (1 - 1e-12))]
    assert ends[i] + part * lengths[i] == pytest.approx(walked, abs=ends[-1] / 10_000)
