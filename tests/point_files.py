"""Files of points for tests, as other programs write them: a standing body that walks, with any names."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tests.bodies import STANDING, standing

JOINTS = tuple(STANDING)


def walk(frames: int = 5) -> np.ndarray:
    """The standing figure, walking along Z: (frames, joints, 3) in metres, its joints in the order of `JOINTS`."""
    from tests.oracles.features import JOINTS as ORDER

    points = standing(frames)[[ORDER.index(joint) for joint in JOINTS]].transpose(2, 0, 1).copy()
    points[:, :, 2] += np.arange(frames)[:, None] * 0.01
    return points


def _cell(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.6f}"


def motive_csv(
    points: np.ndarray, names: Sequence[str], *, kind: str = "Bone", version: str = "1.23", rate: float = 120.0,
    unit: str = "Millimeters", space: str = "Global", timecode: bool = False,
) -> str:  # fmt: skip
    """A file of Motive: bones have a rotation, which says nothing here, before their position."""
    turn = ("X", "Y", "Z", "W") if "Marker" not in kind else ()
    parts = [("Rotation", axis) for axis in turn] + [("Position", axis) for axis in "XYZ"]
    extra = ["TimeCode"] if timecode else []
    first = ["", *([""] * len(extra))]

    def row(title: str, cells: Sequence[str]) -> str:
        return ",".join([first[0], title, *([""] * len(extra)), *(cell for cell in cells for _ in parts)])

    stated = {
        "Format Version": version, "Take Name": "walk, again", "Capture Frame Rate": "240.000000",
        "Export Frame Rate": f"{rate:.6f}", "Capture Start Time": "2024-01-02 03.04.05.678 PM",
        "Total Frames in Take": len(points), "Total Exported Frames": len(points), "Rotation Type": "Quaternion",
        "Length Units": unit, "Coordinate Space": space,
    }  # fmt: skip
    head = ",".join(f'{key},"{value}"' if "," in str(value) else f"{key},{value}" for key, value in stated.items())
    lines = [head, "", row("Type", [kind] * len(names)), row("Name", names), row("ID", ["A1:B2"] * len(names))]
    lines += [row("Parent", ["Root"] * len(names))] if version >= "1.24" else []
    lines += [",".join(["", "", *extra, *(part for _ in names for part, _ in parts)])]
    lines += [",".join(["Frame", "Time (Seconds)", *extra, *(axis for _ in names for _, axis in parts)])]
    for t, places in enumerate(points):
        cells = [cell for place in places for cell in (["0.0"] * (len(parts) - 3) + [_cell(x) for x in place])]
        lines.append(",".join([str(t), f"{t / rate:.6f}", *(["15:26:46:12.02"] if timecode else []), *cells]))
    return "\r\n".join([*lines, ""])


def nexus_csv(
    points: np.ndarray, names: Sequence[str], *, rate: float = 100.0, unit: str = "mm", title: str = "Trajectories",
    before: str = "", after: str = "",
) -> str:  # fmt: skip
    """A file of Nexus: a section of points, perhaps between others."""
    wide = 2 + 3 * len(names)
    lines = [title + "," * (wide - 1), f"{rate:g}" + "," * (wide - 1), ",," + ",,,".join(names) + ",,"]
    lines += ["Frame,Sub Frame" + ",X,Y,Z" * len(names), ",," + ",".join([unit] * (wide - 2))]
    lines += [f"{t + 7},0," + ",".join(map(_cell, row.ravel())) for t, row in enumerate(points)]
    return before + "\r\n".join([*lines, ""]) + after


def workstation_csv(points: np.ndarray, names: Sequence[str], *, rate: float = 100.0) -> str:
    """A file of Workstation or BodyBuilder: lines of a title, and no units."""
    lines = ["Title", "Date:", "Time:", "Type:", 'Description:,""', 'Notes:,""', "", "TRAJECTORIES", f"{rate:g},Hz"]
    lines += ["," + ",,,".join(names) + ",,", "Field #" + ",X,Y,Z" * len(names)]
    lines += [f"{t + 1}," + ",".join(map(_cell, row.ravel())) for t, row in enumerate(points)]
    return "\n".join([*lines, ""])


def arena_csv(
    points: np.ndarray, names: Sequence[str], *, rate: float = 100.0, version: str = "1.1", hand: str = "righthanded",
    bodies: bool = False,
) -> str:  # fmt: skip
    """A file of Tracking Tools or Arena: markers of version 1.1 have names, others have none; NaN is unseen.

    With `bodies` the points are the origins of rigid bodies.
    """
    kind = "rigidbody" if version == "1.1" else "trackable"
    lines = ['comment,"OptiTrack Export Data"' if version == "1.1" else 'comment,"NaturalPoint Trackable Export Data"']
    lines += ['comment,"== frame: Details frame of exported data in the following format:"', hand]
    lines += ["info,version,1.1"] * (version == "1.1") + [f"info,framecount,{len(points)}"]
    lines += [f'{kind},"{name}",{i + 1},3,0,0,0,0,0,.1,0,.1,0' for i, name in enumerate(names) if bodies]
    for t, row in enumerate(points):
        seen = [(i, *place) for i, place in enumerate(row) if not np.isnan(place).any()]
        cells = [f"frame,{t},{t / rate:.8f}", str(len(seen) if bodies else 0)]
        at = {i: f"{x:.8f},{y:.8f},{z:.8f}" for i, x, y, z in seen}
        if bodies:
            cells += [f"{i + 1},{place},0,0,0,1,0,0,0" for i, place in at.items()]
            cells += ["1,0.1,0.2,0.3,0"] if version == "1" else ["0"]
        else:
            cells += [str(len(at)), *(f"{place},{i}" + f",{names[i]}" * (version == "1.1") for i, place in at.items())]
        lines += [",".join(cells), f'{kind},{t},{t / rate:.8f},"Rigid Body 1",1,0,0,0.0']
    return "\n".join([*lines, ""])


DEVICES = "Devices,,,\r\n1000,,,\r\n,,Force,,\r\nFrame,Sub Frame,Fx,Fy\r\n,,N,N\r\n7,0,1.5,2\r\n7,1,1.5,2\r\n,,,\r\n"
"""A section of force plates, as Nexus writes it before the trajectories."""


def qualisys_tsv(
    points: np.ndarray, names: Sequence[str], *, rate: float = 100.0, heads: bool = True, leading: int = 2,
    missing: str = "0.000", included: str = "3D",
) -> str:  # fmt: skip
    """A file of Qualisys Track Manager; a marker that was not seen is at 0, 0, 0, or is NULL, or empty."""
    keys = {
        "NO_OF_FRAMES": len(points), "NO_OF_CAMERAS": 8, "NO_OF_MARKERS": len(names), "FREQUENCY": f"{rate:g}",
        "NO_OF_ANALOG": 0, "ANALOG_FREQUENCY": 0, "DESCRIPTION": "--", "TIME_STAMP": "2024-01-02, 03:04:05.678\t123.45",
        "DATA_INCLUDED": included, "MARKER_NAMES" if included == "3D" else "BODY_NAMES": "\t".join(names),
    }  # fmt: skip
    lines = [f"{key}\t{value}" for key, value in keys.items()]
    if heads:
        columns = [*("Frame", "Time")[:leading], *(f"{name} {axis}" for name in names for axis in "XYZ")]
        lines.append("\t".join(columns))
    for t, row in enumerate(points):
        cells = [missing if np.isnan(x) else f"{x:.3f}" for x in row.ravel()]
        lines.append("\t".join([*(str(t + 1), f"{t / rate:.5f}")[:leading], *cells]))
    return "\r\n".join([*lines, ""])


def keypoints_of(names: Sequence[str], frames: int) -> np.ndarray:
    """The standing figure, walking, as keypoints of some names such as left_hip: (frames, points, 3) in metres."""
    middle = {"neck": "neck", "mid_hip": "root", "head_top": "headtop"}
    feet = {"big_toe": (0.0, 0.0, 0.0), "small_toe": (0.04, 0.0, -0.02), "foot_index": (0.0, 0.0, 0.0)}
    pose = []
    for name in names:
        side, _, part = name.partition("_")
        out = np.array([1.0 if side == "left" else -1.0, 1.0, 1.0])
        if name in middle:
            pose.append(np.array(STANDING[middle[name]]))
        elif f"{side[0]}{part}" in STANDING:
            pose.append(np.array(STANDING[f"{side[0]}{part}"]))
        elif part in feet:
            pose.append(np.array(STANDING[f"{side[0]}toes"]) + out * feet[part])
        elif part == "heel":
            pose.append(np.array(STANDING[f"{side[0]}ankle"]) + np.array([0.0, -0.06, -0.05]))
        elif part in ("pinky", "index", "thumb"):
            pose.append(
                np.array(STANDING[f"{side[0]}fingers"]) + out * {"pinky": -0.02, "index": 0.02, "thumb": 0.04}[part]
            )
        else:  # the face
            pose.append(np.array([0.0, 1.62, 0.1]) + out * np.array([0.0 if name == "nose" else 0.04, 0.0, 0.0]))
    walked = np.repeat(np.array(pose, float)[None], frames, axis=0)
    walked[:, :, 2] += np.arange(frames)[:, None] * 0.01
    return walked
