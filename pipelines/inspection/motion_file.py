"""Inspect a motion file: format, joints, time, mapping, features, and the reason why it cannot be read."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pyarrow as pa

from kinedex.catalog.features import FeatureSet, load_feature_set
from kinedex.catalog.quality import quality_warnings
from kinedex.catalog.quality_figures import FIGURES
from kinedex.catalog.skeletons.mappings import Format, Mappings, load_mappings
from kinedex.catalog.skeletons.units import body_height
from kinedex.ops.arrays import F64
from kinedex.ops.body import kinematics
from kinedex.ops.body.joint_tree import JOINT_PARENTS
from kinedex.ops.body.plausibility import Plausibility, reasons
from kinedex.ops.body.resample import find_gaps
from kinedex.ops.errors import KinedexError, SourceError
from kinedex.ops.intervals import shown_seconds
from kinedex.pipelines.ingestion.analysis import analyse, figures_of, unknown_feature_warnings
from kinedex.pipelines.inspection.feature_shares import feature_shares
from kinedex.pipelines.inspection.stick_figures import LEFT, MIDDLE, RIGHT, Figure
from kinedex.storage.formats.motion.amass import parse_amass
from kinedex.storage.formats.motion.asf import INCH_M, read_asf
from kinedex.storage.formats.motion.body_models import load_body_model
from kinedex.storage.formats.motion.bvh_parser import parse_bvh
from kinedex.storage.formats.motion.c3d import parse_c3d
from kinedex.storage.formats.motion.figure_poses import Figure as SceneFigure
from kinedex.storage.formats.motion.figures import FigureReader
from kinedex.storage.formats.motion.points import Points, PointsReader
from kinedex.storage.formats.motion.positions import PositionsReader, parse_positions
from kinedex.storage.formats.motion.reader import DEFAULT_SETTINGS, Body, MotionFile, ReadSettings
from kinedex.storage.formats.motion.reader_table import persons_of, read_body, reader_of
from kinedex.storage.formats.motion.single_file import chosen_person, file_beside, motion_ending
from kinedex.storage.formats.motion.skeleton_files import skeleton_doubt
from kinedex.storage.formats.motion.unpacked_files import Unpacked, unpacked

SHOWN = 6
"""The number of frames in the picture, including the first and the last."""

_FORMATS = {
    ".amc": "Acclaim (AMC with an ASF skeleton)", ".bvh": "BVH", ".c3d": "C3D, markers", ".trc": "TRC, positions",
    ".csv": "CSV, positions", ".npz": "NPZ, positions", ".npy": "NPY, positions",
    ".mvnx": "MVNX (Xsens MVN)", ".glb": "glTF", ".gltf": "glTF", ".vrm": "VRM (glTF)", ".vrma": "VRM (glTF)",
    ".fbx": "FBX",
}  # fmt: skip
_UPRIGHT = {"x": "yxz", "y": "xyz", "z": "xzy"}  # up axis → axes drawn to the right, up, and to the right from the side
_AXES = ("x to the right, y up", "z to the right, y up")
_DRAWN = 1e9  # units; a joint farther away is an error of the file and would make the others too small
_RATE_HZ = 30.0  # the analysis rate of a store


@dataclass
class Inspection:
    """The facts about a motion file.

    Attributes
    ----------
    lines : list of (str, str)
        The names and texts of the facts, in order.
    fault : KinedexError or None
        The reason why the file cannot be read; None if it can be read.
    figure : Figure or None
        The picture; None if no positions are known.
    features : pyarrow.Table or None
        Statistics of the features (`feature_shares`); None if there are no words.
    """

    lines: list[tuple[str, str]] = field(default_factory=list)
    fault: KinedexError | None = None
    figure: Figure | None = None
    features: pa.Table | None = None

    def add(self, name: str, text: str) -> None:
        """Add a fact."""
        self.lines.append((name, text))

    def add_all(self, name: str, texts: Iterable[str]) -> None:
        """Add facts on consecutive lines, of which only the first shows the name."""
        for i, text in enumerate(texts):
            self.add("" if i else name, text)


@dataclass(frozen=True)
class _Skeleton:
    """The nodes of a file before mapping, with their figure if their positions are known."""

    form: Format
    nodes: dict[str, int]
    figure: Figure | None = None


def inspect_file(
    file: Path,
    skeleton: str = "auto",
    source: Path | None = None,
    given: ReadSettings = DEFAULT_SETTINGS,
    person: str = "",
) -> Inspection:
    """Collect the facts about a motion file; if it cannot be read, those that are known before the error.

    Parameters
    ----------
    file : Path
        The motion file.
    skeleton : str
        `auto`, the name of a shipped mapping, or the path of one.
    source : Path or None
        The source root, up to which the ASF of an AMC file is searched; by default up to three folders above the file.
    given : ReadSettings
        The rate, gaps and body model given by the user.
    person : str
        The person to describe in a file with several; by default the first, and one line for each of the others.

    Returns
    -------
    Inspection
        The facts, with the reason if the file cannot be read.

    Raises
    ------
    KinedexError
        If it is not a motion file, or there is no such mapping.
    """
    ending = motion_ending(file)
    mappings = load_mappings(skeleton, load_feature_set().joints)
    found = Inspection()
    asf = None
    try:
        asf = file_beside(file, source)
    except KinedexError as fault:
        found.fault = fault
    with unpacked(file, asf) as copy:
        found.add("file", f"{file} ({copy.path.stat().st_size / 1e6:.2f} MB)")
        kind = _FORMATS.get(ending, ending[1:].upper())
        if reader_of(copy.path).format == "amass":
            kind = f"{ending[1:].upper()}, joint angles (AMASS)"
        found.add("format", reader_of(copy.path).title or kind)
        if asf is not None and ending != ".amc":
            found.add("static trial", str(asf))
        elif asf is not None:
            doubt = skeleton_doubt(file, asf)
            found.add("skeleton file", str(asf) if doubt is None else f"{asf} ({doubt})")
        if found.fault is None:
            _inspect(found, copy, ending, mappings, given, person)
    return found


def _inspect(
    found: Inspection, copy: Unpacked, ending: str, mappings: Mappings, given: ReadSettings, person: str
) -> None:
    """Add what a file holds, or the reason why it cannot be read."""
    file, asf, feature_set = copy.path, copy.skeleton, load_feature_set()
    try:
        persons = persons_of(MotionFile(file, asf), mappings)
        chosen = chosen_person(file, asf, mappings, person) if person or not persons else persons[0]
        if persons:
            found.add("persons", f"{len(persons)}: {', '.join(persons)}; each becomes a take")
            _add_persons(found, file, [name for name in persons if name != chosen and not person], mappings, given)
            found.add("person", chosen)
        raw = _raw(found, file, asf, mappings, given, chosen)
        before = len(found.lines)
        if raw is not None and not persons:
            _add_mapping(found, raw, mappings)
        found.figure = raw.figure if raw is not None else None
        body = copy.restated_body(read_body(file, asf, mappings, feature_set.joints, given, person=chosen))
    except KinedexError as fault:
        found.fault = copy.restated_error(fault)
        return
    known = {mapping.name for group in mappings.of_format.values() for mapping in group}
    if body.skeleton not in known:
        found.lines[before:] = [("mapping", f"{body.skeleton}: no mapping fits all these names")]
    elif raw is None or persons:
        found.add("mapping", body.skeleton)
    _add_body(found, body, feature_set, given, ending)
    found.figure = _figure(file, body, feature_set.joints)


def _add_persons(found: Inspection, file: Path, persons: list[str], mappings: Mappings, given: ReadSettings) -> None:
    """Add a line for each of the given persons in a file."""
    joints = load_feature_set().joints
    for person in persons:
        try:
            body = read_body(file, None, mappings, joints, given, person=person)
        except SourceError as fault:
            found.add("", f"{person} cannot be read: {fault.reason}")
            continue
        height = body_height(body.positions, joints)
        tall = "" if height is None else f", {height:.2f} m tall"
        found.add("", f"{person}: mapping {body.skeleton}, {shown_seconds(body.frames, body.rate_hz)} s{tall}")


def _raw(
    found: Inspection, file: Path, asf: Path | None, mappings: Mappings, given: ReadSettings, person: str = ""
) -> _Skeleton | None:
    """Add the facts that are known before mapping, and return the nodes; None for a reader from a plugin."""
    if asf is not None and asf.suffix.lower() == ".asf":
        nodes = read_asf(asf, INCH_M).bones
        _add_nodes(found, nodes)
        return _Skeleton("acclaim", nodes)
    reader = reader_of(file)
    if reader.distribution:
        return None
    if isinstance(reader, PositionsReader):
        points = parse_positions(file)
        names = points.names or mappings.names_in_order(file, len(points.positions))[1]
        named = replace(points, names=names).seen()
        return _raw_points(found, file, "positions", points, named.indices())
    if isinstance(reader, PointsReader):
        points = reader.points(MotionFile(file, person=person), given)
        return _raw_points(found, file, "positions", points, points.seen().indices())
    if reader.format == "amass":
        return _raw_poses(found, file, given)
    if reader.format == "c3d":
        markers = parse_c3d(file)
        axes = _UPRIGHT[markers.up or "z"]
        upright = replace(markers, positions=markers.positions[:, ["xyz".index(axis) for axis in axes]])
        return _raw_points(found, file, "c3d", upright, markers.seen().indices(), axes)
    if isinstance(reader, FigureReader):
        return _raw_scene(found, reader.figure(MotionFile(file, person=person), given), file)
    bvh = parse_bvh(file)
    _add_nodes(found, bvh.indices)
    _add_time(found, bvh.rate_hz, len(bvh.channels))
    shown = _shown(len(bvh.channels))
    positions, _ = kinematics.forward(bvh.nodes, bvh.channels[shown])
    bones = [(i, node.parent, MIDDLE) for i, node in enumerate(bvh.nodes) if node.parent >= 0]
    return _Skeleton("bvh", bvh.indices, _raw_figure(file, positions, bones, _times(shown, bvh.rate_hz)))


def _raw_scene(found: Inspection, scene: SceneFigure, file: Path) -> _Skeleton:
    """Add the facts about the figure of a scene, and return its nodes."""
    _add_nodes(found, scene.names)
    _add_time(found, scene.rate_hz, scene.frames)
    shown = _shown(scene.frames)
    positions, _ = scene.poses.at(np.array(shown), [])
    bones = [(i, parent, MIDDLE) for i, parent in enumerate(scene.parents) if parent >= 0]
    nodes = {name: i for i, name in enumerate(scene.names)}
    return _Skeleton("bvh", nodes, _raw_figure(file, positions, bones, _times(shown, scene.rate_hz)))


def _raw_poses(found: Inspection, file: Path, given: ReadSettings) -> _Skeleton:
    """Add the facts about a file of joint angles, and return its joints, or those of the given body model."""
    poses = parse_amass(file)
    names = poses.names if given.body_model is None else load_body_model(given.body_model, poses.gender).names
    _add_nodes(found, names)
    found.add("figure", f"{poses.gender}, {len(poses.shape)} numbers of shape")
    if poses.rate_hz is not None:
        _add_time(found, poses.rate_hz, len(poses.rotations))
    else:
        found.add("length", f"{len(poses.rotations)} frames; {_NO_RATE}")
    return _Skeleton("amass", {name: i for i, name in enumerate(names)})


def _raw_points(
    found: Inspection, file: Path, form: Format, points: Points, nodes: dict[str, int], axes: str = "xyz"
) -> _Skeleton:
    """Add the facts about a file of points, and return its nodes."""
    count, frames = len(points.positions), points.positions.shape[2]
    if points.names:
        _add_nodes(found, points.names)
    else:
        found.add("nodes", f"{count} without names")
    seen = np.flatnonzero(np.isfinite(points.positions[:, 0]).any(axis=0))
    shown = seen[_shown(len(seen))].tolist() if len(seen) else _shown(frames)
    rate_hz = points.rate_hz or points.clock_hz
    times = _times(shown, rate_hz) if rate_hz else [f"frame {frame}" for frame in shown]
    if rate_hz:
        _add_time(found, rate_hz, frames, "" if points.rate_hz else " (by its column of times)")
    else:
        found.add("length", f"{frames} frames; {_NO_RATE}")
    gaps = find_gaps(points.positions)
    if gaps:
        longest = max(gap.frames for gap in gaps)
        found.add("gaps", f"{len(gaps)} in {len({gap.point for gap in gaps})} points, the longest of {longest} frames")
    dots = [(i, i, MIDDLE) for i in range(count)]
    return _Skeleton(form, nodes, _raw_figure(file, points.positions[:, :, shown], dots, times, axes))


def _raw_figure(
    file: Path, points: F64, bones: list[tuple[int, int, str]], times: list[str], axes: str = "xyz"
) -> Figure | None:
    """Return the figure of a file's joints in its own axes; None if positions are unknown or far away."""
    known = np.isfinite(points).all(axis=1)
    if not known.any(axis=0).all() or not np.nanmax(np.abs(points)) < _DRAWN:
        return None
    ground = float(np.nanmin(points[:, 1]))
    return Figure(
        points=points,
        bones=bones,
        times=times,
        views=[(f"{axes[0]} to the right, {axes[1]} up", 0, 1), (f"{axes[2]} to the right, {axes[1]} up", 2, 1)],
        ground=ground,
        title=f"{file.name}: the file's own joints and axes",
        legend=[],
        note=f"ground line: lowest joint, {axes[1]} = {ground:.4g} units",
    )


def _add_nodes(found: Inspection, nodes: Iterable[str]) -> None:
    names = list(nodes)
    more = f" and {len(names) - 80} more" if len(names) > 80 else ""
    found.add("nodes", f"{len(names)}: {', '.join(names[:80])}{more}")


def _add_time(found: Inspection, rate_hz: float, frames: int, note: str = "") -> None:
    found.add("rate", f"{rate_hz:.6g} Hz{note}")
    found.add("length", f"{frames} frames, {shown_seconds(frames, rate_hz)} s")


def _add_mapping(found: Inspection, raw: _Skeleton, mappings: Mappings) -> None:
    """Add the mapping that matches; if none does, add the nearest one and the nodes that the file lacks."""
    near = mappings.nearest(raw.form, raw.nodes)
    try:
        fit = mappings.detect("", raw.form, raw.nodes)
    except SourceError:
        fit = None
    if fit is not None:
        how = (
            "the only one for the format"
            if len(mappings.of_format[raw.form]) == 1
            else "found by the names of the joints"
        )
        found.add("mapping", f"{fit.mapping.name} ({how}): {fit.mapping.path}")
    elif clause := mappings.stripped(raw.form, raw.nodes):
        found.add("mapping", f"none fits{clause}")
    elif near is not None and not near.known:
        found.add("mapping", "none fits; no mapping has any of the names")
    elif near is not None:
        found.add("mapping", f"none fits; the nearest is {near.called}: {near.mapping.path}")
        for what, node in near.missing.items():
            found.add("", f"lacks {node}, for {what}")
    else:
        found.add("mapping", "none for these names")


_NO_RATE = "the rate is not in the file"


def _rate_note(given: ReadSettings, ending: str, stated: bool) -> str:
    """Return a note on the origin of a rate, which is given or assumed; empty if the rate is the file's own."""
    if given.override_rate_hz or (given.rate_hz and not stated):
        return " (given)"
    if stated:
        return ""
    files = "Acclaim files do" if ending == ".amc" else "the file does"
    return f" (assumed: {files} not contain it)"


def _add_body(found: Inspection, body: Body, feature_set: FeatureSet, given: ReadSettings, ending: str) -> None:
    if not any(name == "rate" for name, _ in found.lines):
        stated = ending != ".amc" and not any(text.endswith(_NO_RATE) for name, text in found.lines if name == "length")
        found.lines = [line for line in found.lines if line[0] != "length"]
        _add_time(found, body.rate_hz, body.frames, _rate_note(given, ending, stated))
    found.add("unit", body.unit)
    valid = np.flatnonzero(body.valid) if body.valid is not None else np.arange(body.frames)
    if len(valid) < body.frames:
        found.add("valid frames", f"{len(valid)} of {body.frames}; the other frames are invalid")
    height = body_height(body.positions[:, :, valid], feature_set.joints)
    if height is not None:
        found.add("height", f"{height:.2f} m, legs and trunk stretched out")
    low = float(np.nanmin(body.positions[:, 1]))
    found.add("lowest point", f"{low:.2f} m")
    figures = figures_of(body, feature_set.joints)
    _add_recognition(found, body, figures, feature_set.joints)
    warnings = [*body.warnings, *unknown_feature_warnings(feature_set, body), *quality_warnings(figures, body.rate_hz)]
    found.add_all("warnings", warnings or ["none"])
    _, _, words = analyse(body, feature_set, _RATE_HZ)
    found.features = feature_shares(words, _RATE_HZ, feature_set, body.unknown)
    shares = dict(zip(*(found.features.column(name).to_pylist() for name in ("feature", "percent")), strict=True))
    names = {f"F{feature.number}": feature.name for feature in feature_set.features}
    on = sorted((name for name, share in shares.items() if share > 0), key=lambda name: -shares[name])
    text = ", ".join(f"{name} {names[name]} {_percent(shares[name])}" for name in on)
    found.add("features on", text or "none in any frame")
    never = [name for name, share in shares.items() if share == 0]
    if never:
        found.add("never on", " ".join(never))


def _add_recognition(found: Inspection, body: Body, figures: Plausibility, joints: tuple[str, ...]) -> None:
    """Add the confidence and evidence of the recognised skeleton, the estimated joints, and the quality figures."""
    if body.evidence or body.confidence < 1:
        found.add("confidence", f"{body.confidence:.2f} of 1")
        found.add_all("evidence", body.evidence)
    if body.estimated:
        found.add("estimated joints", ", ".join(body.estimated))
    found.add_all("up and sides", reasons(body.positions, joints, body.valid))
    lines = []
    for figure in FIGURES:
        value = getattr(figures, figure.name)
        shown = (value or "undecided") if isinstance(value, str) else f"{round(value, 4):.3g}"
        limits = f", expected {figure.limits()}" if figure.limits() else ""
        if figure.name == "fastest_m_s" and figures.fastest is not None:
            limits = ", {} from source frame {}".format(*figures.fastest)
        if value == value:  # not for NaN, the value of a figure that these joints do not determine
            unit = f" {figure.unit}" if figure.unit else ""
            lines.append(f"{figure.name} {shown}{unit}{limits}{': OFF' if figure.off(value) else ''}")
    found.add_all("quality", lines)


def _percent(share: float) -> str:
    return "<1%" if share < 1 else f"{share:.0f}%"


def _figure(file: Path, body: Body, joints: tuple[str, ...]) -> Figure:
    """Return the figure of the mapped joints, with each frame seen from the front of the hips."""
    valid = np.flatnonzero(body.valid) if body.valid is not None else np.arange(body.frames)
    shown = valid[_shown(len(valid))].tolist()
    points = _facing(body.positions[:, :, shown], joints)
    bones = [
        (joints.index(joint), joints.index(parent), _side(joint))
        for joint, parent in JOINT_PARENTS.items()
        if parent is not None and joint in joints and parent in joints
    ]
    ground = float(np.nanmin(body.positions[:, 1]))
    faces = np.isfinite(points[[joints.index("lhip"), joints.index("rhip")]]).all()
    views = ["from the front (its left is on the right)", "from its right (it looks to the right)"]
    return Figure(
        points=points,
        bones=bones,
        times=_times(shown, body.rate_hz),
        views=[(views[0] if faces else _AXES[0], 0, 1), (views[1] if faces else _AXES[1], 2, 1)],
        ground=ground,
        title=f"{file.name}: {body.skeleton}, {body.frames} frames, {shown_seconds(body.frames, body.rate_hz)} s",
        legend=[("left", LEFT), ("right", RIGHT), ("middle", MIDDLE)],
        note=f"ground line: the take's lowest point, y = {ground:.2f} m",
    )


def _facing(points: F64, joints: tuple[str, ...]) -> F64:
    """Turn the points (J, 3, F) about Y so that the line from the right hip to the left lies along X."""
    across = points[joints.index("lhip")] - points[joints.index("rhip")]
    length = np.hypot(across[0], across[2])
    turned = np.isfinite(length) & (length > 0)
    size = np.where(turned, length, 1.0)
    c, s = np.where(turned, across[0] / size, 1.0), np.where(turned, across[2] / size, 0.0)
    return np.stack([c * points[:, 0] + s * points[:, 2], points[:, 1], c * points[:, 2] - s * points[:, 0]], axis=1)


def _side(joint: str) -> str:
    return LEFT if joint[0] == "l" else RIGHT if joint[0] == "r" and joint != "root" else MIDDLE


def _shown(frames: int) -> list[int]:
    return sorted({round(at) for at in np.linspace(0, frames - 1, SHOWN)})


def _times(shown: list[int], rate_hz: float) -> list[str]:
    return [f"{shown_seconds(frame, rate_hz)} s (frame {frame})" for frame in shown]
