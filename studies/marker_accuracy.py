"""`python -m studies.marker_accuracy DATA`: compare joints from markers with those that models computed of them.

DATA is a folder with `c3d` and `wild`. The first table has the joints of files that hold markers and the joint centres
of Vicon's Plug-in Gait: these are hidden, the body is read from the markers, and each joint is compared with its
centre. The second table has files with markers on both sides of knees, ankles or elbows, read without the inner ones
and compared with the middle of both. The third places hip centres by several regressions, and compares them with those
of Plug-in Gait. The fourth compares markers with the bodies of OpenSim in the same trial, whose origins are joints in
its model, also by direction. Distances are in cm, their mean and the largest of 95 % of the frames.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import Format, load_mappings
from kinedex.catalog.skeletons.recognition.landmarks import load_landmarks
from kinedex.ops.arrays import F64
from kinedex.ops.errors import KinedexError
from kinedex.storage.formats.motion.c3d import C3dReader, parse_c3d
from kinedex.storage.formats.motion.points import Points, PointsReader, body_of_points, evidence_of
from kinedex.storage.formats.motion.reader import DEFAULT_SETTINGS, Body, MotionFile
from kinedex.storage.formats.motion.reader_table import read_body, reader_of
from kinedex.storage.formats.motion.subjects import points_of_person
from studies.point_mutations import COMPUTED

JOINTS = load_feature_set().joints
MAPPINGS = load_mappings("auto", JOINTS)
CENTRES = {
    f"{side}{joint}": side.upper() + point
    for joint, point in {
        "hip": "FEP", "knee": "FEO", "ankle": "TIO", "shoulder": "CLO", "elbow": "HUO", "wrist": "RAO",
    }.items()
    for side in "lr"
}  # fmt: skip
"""The points of Plug-in Gait that are joint centres: origins of segments, and the upper end of the thigh."""

INNER = {"knee": "kneemed", "ankle": "anklemed", "elbow": "elbowmed"}
"""Joints that lie amid two markers, each with the landmark of its inner one."""

OPENSIM = ("wild/Pose2Sim_Blender/Moco_markers.trc", "wild/Pose2Sim_Blender/Moco_motion.csv")
"""The markers and the bodies of a trial of OpenSim."""

Distances = dict[str, F64]


def recordings(data: Path) -> Iterator[tuple[Path, Points]]:
    """Yield the files of points below `c3d` and `wild` that can be read, with their points; one of equal names."""
    known = set[str]()
    for path in sorted(path for part in ("c3d", "wild") for path in (data / part).rglob("*")):
        if path.suffix.lower() not in (".c3d", ".trc", ".csv") or path.stem in known:
            continue
        known.add(path.stem)
        try:
            reader = reader_of(path)
            if isinstance(reader, C3dReader):
                persons = reader.persons(MotionFile(path), MAPPINGS)
                yield path, points_of_person(parse_c3d(path), persons[0] if persons else "")
            elif isinstance(reader, PointsReader):
                yield path, reader.named(reader.points(MotionFile(path), DEFAULT_SETTINGS), MAPPINGS)
        except KinedexError:
            continue


def computed(points: Points) -> list[str]:
    """Return the labels of results of Plug-in Gait, which are no markers."""
    return [name for name in points.names if COMPUTED.match(name)]


def without(points: Points, hidden: Collection[str]) -> Points:
    """Return the points but those of the given labels."""
    kept = [i for i, name in enumerate(points.names) if name not in hidden]
    return replace(points, names=tuple(points.names[i] for i in kept), positions=points.positions[kept].copy())


def body_of(path: Path, points: Points) -> Body:
    """Return the body of points as the reader of their file makes it, in the file's own axes."""
    form: Format = "c3d" if path.suffix.lower() == ".c3d" else "positions"
    seen = points.seen()
    evidence = evidence_of(seen, getattr(points, "up", None))
    fit = MAPPINGS.detect(path, form, seen.indices(), evidence)
    fit = replace(fit, mapping=replace(fit.mapping, axes=np.eye(3)))
    copy = replace(seen, positions=seen.positions.copy(), rate_hz=seen.rate_hz or seen.clock_hz or 100.0)
    return body_of_points(copy, copy.names, fit, JOINTS, DEFAULT_SETTINGS, [])


def distances_to_model(path: Path, points: Points) -> tuple[str, Distances]:
    """Return the mapping's name, and for each joint with a centre the distances in cm between both."""
    index = points.indices()
    body = body_of(path, without(points, computed(points)))
    unit_m = float(body.unit.split()[0])
    return body.skeleton, {
        joint: _apart(body, joint, unit_m * points.positions[index[label]])
        for joint, label in CENTRES.items()
        if label in index
    }


def distances_to_middles(path: Path, points: Points) -> Distances:
    """Return the distances in cm by which joints move without the inner one of their two markers; empty if none has."""
    reading = load_landmarks().read(points.names)
    inner = {
        f"{side}{joint}": reading.labels[side + landmark][0]
        for joint, landmark in INNER.items()
        for side in "lr"
        if side + landmark in reading.labels
    }
    if not reading.skin or not inner:
        return {}
    whole, part = body_of(path, points), body_of(path, without(points, inner.values()))
    return {joint: _apart(part, joint, whole.positions[JOINTS.index(joint)]) for joint in inner}


def _apart(body: Body, joint: str, truth: F64) -> F64:
    valid = slice(None) if body.valid is None else body.valid
    away = 100 * np.linalg.norm(body.positions[JOINTS.index(joint)] - truth, axis=0)[valid]
    return np.asarray(away[np.isfinite(away)])


def hip_errors(points: Points) -> dict[str, float]:
    """Return the mean distances in cm, over both hips, of several regressions from the hips of Plug-in Gait.

    Harrington et al. (2007) give the place of a hip in the axes of the pelvis by its width PW and depth PD, or with the
    length LL of the leg; by PW alone as refitted by Sangeux (2015). Lengths are in millimetres.
    """
    index = points.indices()
    at = {
        name: np.nanmean(points.positions[index[name]], axis=1) * 1000 * (points.unit_m or 0.001)
        for name in ("LASI", "RASI", "LPSI", "RPSI", "LKNE", "LANK", "RKNE", "RANK", "LFEP", "RFEP")
    }
    front, back = (at["LASI"] + at["RASI"]) / 2, (at["LPSI"] + at["RPSI"]) / 2
    left = at["LASI"] - at["RASI"]
    left = left / np.linalg.norm(left)
    ahead = front - back - left * ((front - back) @ left)
    ahead = ahead / np.linalg.norm(ahead)
    width, depth = float(np.linalg.norm(at["LASI"] - at["RASI"])), float(np.linalg.norm(front - back))
    found = defaultdict(list)
    for side, sign in (("L", 1.0), ("R", -1.0)):
        leg = np.linalg.norm(at[f"{side}ASI"] - at[f"{side}KNE"]) + np.linalg.norm(at[f"{side}KNE"] - at[f"{side}ANK"])
        ways = {
            "PW and PD": (-0.24 * depth - 9.9, 0.33 * width + 7.3, -0.30 * width - 10.9),
            "PW, PD and LL": (
                -0.24 * depth - 9.9, 0.28 * depth + 0.16 * width + 7.9, -0.16 * width - 0.04 * leg - 7.1,
            ),
            "PW alone": (-0.138 * width - 10.4, 0.33 * width + 7.3, -0.305 * width - 10.9),
        }  # fmt: skip
        for way, (x, y, z) in ways.items():
            place = front + x * ahead + sign * y * left + z * np.cross(ahead, left)
            found[way].append(float(np.linalg.norm(place - at[f"{side}FEP"])) / 10)
    return {way: float(np.mean(errors)) for way, errors in found.items()}


def offsets_to_opensim(markers: Path, bodies: Path) -> Distances:
    """Return where joints from markers lie beside those of OpenSim's bodies, in cm, (3, frames): outwards, up, ahead.

    OpenSim's frames are fewer. Outwards is along the line of the hips, up is Y.
    """
    ours, theirs = (read_body(path, None, MAPPINGS, JOINTS) for path in (markers, bodies))
    times = np.arange(theirs.frames) / theirs.rate_hz
    own = np.arange(ours.frames) / ours.rate_hz
    within = times <= own[-1]
    left, right = (theirs.positions[JOINTS.index(joint)][:, within] for joint in ("lhip", "rhip"))
    across = (left - right) * np.array([1.0, 0.0, 1.0])[:, None]
    across /= np.linalg.norm(across, axis=0)
    up = np.zeros_like(across)
    up[1] = 1.0
    found = {}
    for joint in CENTRES:
        track = np.stack([np.interp(times[within], own, row) for row in ours.positions[JOINTS.index(joint)]])
        beside = 100 * (track - theirs.positions[JOINTS.index(joint)][:, within])
        side = 1.0 if joint.startswith("l") else -1.0
        axes = (side * across, up, np.cross(across, up, axis=0))
        found[joint] = np.stack([(beside * axis).sum(axis=0) for axis in axes])
    return found


def _offset_table(offsets: Distances) -> Table:
    """Return the distances from OpenSim's joints and their parts, left and right together."""
    table = Table("joint", "mean, cm", "outwards", "up", "ahead", title="From markers, against OpenSim's bodies")
    for joint in dict.fromkeys(name[1:] for name in offsets):
        both = np.concatenate([offsets[side + joint] for side in "lr"], axis=1)
        means = (np.linalg.norm(both, axis=0).mean(), *both.mean(axis=1))
        table.add_row(joint, *(f"{mean:.1f}" for mean in means))
    return table


def _show(console: Console, title: str, rows: list[tuple[str, str, Distances]]) -> None:
    """Print the distances by joint and file, left and right together, and those over all files."""
    table = Table("joint", "file", "read by", "mean, cm", "95 %, cm", "frames", title=title)
    joints = list(dict.fromkeys(joint[1:] for _, _, found in rows for joint in found))
    for joint in joints:
        means = []
        for name, skeleton, found in rows:
            away = np.concatenate([found.get(side + joint, np.empty(0)) for side in "lr"])
            if len(away):
                means.append(float(away.mean()))
                figures = (f"{means[-1]:.1f}", f"{np.percentile(away, 95):.1f}", str(len(away)))
                table.add_row(joint, name, skeleton, *figures)
        table.add_row(joint, f"mean of {len(means)}", "", f"{np.mean(means):.1f}", "", "", end_section=True)
    console.print(table)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    console = Console(width=140)
    by_model: list[tuple[str, str, Distances]] = []
    by_middle: list[tuple[str, str, Distances]] = []
    hips = Table("hips by", "file", "mean, cm")
    for path, points in recordings(parser.parse_args().data):
        try:
            if set(CENTRES.values()) & set(points.names) and len(computed(points)) < len(points.names):
                by_model.append((path.name, *distances_to_model(path, points)))
                for way, error in hip_errors(points).items():
                    hips.add_row(way, path.name, f"{error:.1f}")
            if middles := distances_to_middles(path, points):
                by_middle.append((path.name, "", middles))
        except KinedexError as fault:
            console.print(f"{path.name}: {fault}", markup=False)
    _show(console, "From markers alone, against Plug-in Gait", by_model)
    _show(console, "Without the inner marker, against the middle of both", by_middle)
    console.print(hips)
    markers, bodies = (parser.parse_args().data / name for name in OPENSIM)
    if markers.is_file() and bodies.is_file():
        console.print(_offset_table(offsets_to_opensim(markers, bodies)))


if __name__ == "__main__":
    main()
