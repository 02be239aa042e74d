"""OpenSim models and motions for tests: a standing person whose joints are of every kind, in versions 3 and 4."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tests.bodies import STANDING

_LIMBS = (
    ("femur", "pelvis", "hip", "BallJoint", "hip"), ("tibia", "femur", "knee", "Knee", "knee"),
    ("talus", "tibia", "ankle", "PinJoint", "ankle"), ("calcn", "talus", "subtalar", "WeldJoint", "ankle"),
    ("toes", "calcn", "mtp", "PinJoint", "toes"), ("humerus", "torso", "acromial", "Custom3", "shoulder"),
    ("ulna", "humerus", "elbow", "PinJoint", "elbow"), ("hand", "ulna", "radius_hand", "UniversalJoint", "wrist"),
)  # fmt: skip

BODIES: dict[str, tuple[str, str, str, str]] = {
    "pelvis": ("ground", "ground_pelvis", "Custom6", "root"),
    **{
        f"{body}_{s}": (parent if parent in ("pelvis", "torso") else f"{parent}_{s}", f"{name}_{s}", kind, f"{s}{at}")
        for s in "rl"
        for body, parent, name, kind, at in _LIMBS
    },
    "torso": ("pelvis", "back", "GimbalJoint", "belly"),
    "head": ("torso", "neck", "PlanarJoint", "neck"),
}
"""Body → its parent, its joint, the joint's kind, and the joint of the standing figure that it stands in for."""

MARKERS = {"Top": ("head", "headtop"), "RFIN": ("hand_r", "rfingers"), "LFIN": ("hand_l", "lfingers")}
"""Marker → its body, and the joint of the standing figure where it is."""

KNOTS = ((0.0, 0.5, 1.0, 1.5, 2.0), tuple(0.01 * x**3 for x in (0.0, 0.5, 1.0, 1.5, 2.0)))
"""The knees shift forward by a cubic polynomial of their angle, which a spline through its values reproduces."""

TWIST = (0.1, 0.2, 0.3)
"""Angles of the frames of pin joints in both bodies: they turn about an axis aslant, and cancel each other at zero."""

_COUNTS = {"BallJoint": 3, "PinJoint": 1, "WeldJoint": 0, "GimbalJoint": 3, "PlanarJoint": 3, "UniversalJoint": 2}


def _axis(name: str, axis: str, function: str, coordinates: str, version: int) -> str:
    inner = f"<function>{function}</function>" if version == 3 else function
    within = f"<coordinates>{coordinates}</coordinates><axis>{axis}</axis>{inner}"
    return f'<TransformAxis name="{name}">{within}</TransformAxis>'


def _linear(slope: float = 1.0) -> str:
    return f'<LinearFunction name="function"><coefficients> {slope} 0</coefficients></LinearFunction>'


def _transform(kind: str, names: Sequence[str], version: int) -> str:
    still = '<Constant name="function"><value>0</value></Constant>'
    unit = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
    if kind == "Knee":
        x, y = (" ".join(map(repr, axis)) for axis in KNOTS)
        shift = f'<SimmSpline name="function"><x>{x}</x><y>{y}</y></SimmSpline>'
        lift = f"<MultiplierFunction name='function'><function>{still}</function><scale>2</scale></MultiplierFunction>"
        parts = [("z", _linear(), names[0]), ("x", still, ""), ("y", still, "")]
        parts += [("x", shift, names[0]), ("y", lift, names[0]), ("z", still, "")]
    else:
        rotations = [(axis, _linear(), name) for axis, name in zip("zxy", names[:3], strict=True)]
        parts = [*rotations, *((axis, _linear(), name) for axis, name in zip("xyz", names[3:], strict=False))]
        parts += [(axis, still, "") for axis in "xyz"[len(parts) - 3 :]]
    titles = [f"{what}{i}" for what in ("rotation", "translation") for i in (1, 2, 3)]
    axes = [_axis(t, unit[a], f, c, version) for t, (a, f, c) in zip(titles, parts, strict=True)]
    return f"<SpatialTransform>{''.join(axes)}</SpatialTransform>"


def coordinates() -> list[str]:
    """The names of all coordinates."""
    return [name for body in BODIES for name in _names(body)]


def _names(body: str) -> list[str]:
    _, joint, kind, _ = BODIES[body]
    if body == "pelvis":
        return ["pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz"]
    count = {"Knee": 1, "Custom3": 3}.get(kind, _COUNTS.get(kind, 0))
    return [f"{joint}_angle" if count == 1 else f"{joint}_q{i}" for i in range(count)]


def _vector(values: Sequence[float]) -> str:
    return " ".join(f"{x!r}" for x in np.asarray(values, float).tolist())


def model(version: int = 4) -> str:
    """The text of the model: at rest all coordinates are zero, but for the height of the pelvis."""
    joints, bodies = [], []
    for body, (parent, name, kind, at) in BODIES.items():
        tag = kind if kind.endswith("Joint") else "CustomJoint"
        place = np.array(STANDING[at]) - (STANDING[BODIES[parent][3]] if parent in BODIES else STANDING["root"])
        twist = TWIST if kind == "PinJoint" else (0, 0, 0)
        own = "".join(
            f'<Coordinate name="{c}"><default_value>{1.0 if c == "pelvis_ty" else 0}</default_value>'
            + (
                f"<motion_type>{'translational' if c[-2] == 't' else 'rotational'}</motion_type>"
                if version == 3
                else ""
            )
            + "</Coordinate>"
            for c in _names(body)
        )
        transform = _transform(kind, _names(body), version) if tag == "CustomJoint" else ""
        if version == 3:
            joint = (
                f'<{tag} name="{name}"><parent_body>{parent}</parent_body>'
                f"<location_in_parent>{_vector(place)}</location_in_parent>"
                f"<orientation_in_parent>{_vector(twist)}</orientation_in_parent>"
                f"<location>0 0 0</location><orientation>{_vector(twist)}</orientation>"
                f"<CoordinateSet><objects>{own}</objects></CoordinateSet><reverse>false</reverse>{transform}</{tag}>"
            )
            bodies.append(f'<Body name="{body}"><mass>1</mass><Joint>{joint}</Joint></Body>')
            continue
        bodies.append(f'<Body name="{body}"><mass>1</mass></Body>')
        path = "/ground" if parent == "ground" else f"/bodyset/{parent}"
        frames = "".join(
            f'<PhysicalOffsetFrame name="{frame}_offset"><socket_parent>{where}</socket_parent>'
            f"<translation>{_vector(shift)}</translation><orientation>{_vector(twist)}</orientation></PhysicalOffsetFrame>"
            for frame, where, shift in ((parent, path, place), (body, f"/bodyset/{body}", (0, 0, 0)))
        )
        joints.append(
            f'<{tag} name="{name}"><socket_parent_frame>{parent}_offset</socket_parent_frame>'
            f"<socket_child_frame>{body}_offset</socket_child_frame>"
            f"<coordinates>{own}</coordinates><frames>{frames}</frames>{transform}</{tag}>"
        )
    return _document(version, bodies, joints)


def _document(version: int, bodies: list[str], joints: list[str]) -> str:
    markers = ""
    for name, (body, at) in MARKERS.items():
        place = _vector(np.array(STANDING[at]) - STANDING[BODIES[body][3]])
        socket = (
            f"<body>{body}</body>" if version == 3 else f"<socket_parent_frame>/bodyset/{body}</socket_parent_frame>"
        )
        markers += f'<Marker name="{name}">{socket}<location>{place}</location></Marker>'
    coupler = (
        '<CoordinateCouplerConstraint name="toes"><coupled_coordinates_function>'
        "<LinearFunction><coefficients>0.5 0</coefficients></LinearFunction></coupled_coordinates_function>"
        "<independent_coordinate_names>ankle_r_angle</independent_coordinate_names>"
        "<dependent_coordinate_name>mtp_r_angle</dependent_coordinate_name></CoordinateCouplerConstraint>"
    )
    ground = '<Body name="ground"><mass>0</mass></Body>' if version == 3 else ""
    grounded = '<Ground name="ground"/>' if version == 4 else ""
    joint_set = f"<JointSet><objects>{''.join(joints)}</objects></JointSet>" if version == 4 else ""
    head = f'<OpenSimDocument Version="{version}0000">\n<Model name="standing">{grounded}'
    return (
        f'<?xml version="1.0" encoding="UTF-8" ?>\n{head}'
        f"<BodySet><objects>{ground}{''.join(bodies)}</objects></BodySet>{joint_set}"
        f"<ConstraintSet><objects>{coupler}</objects></ConstraintSet>"
        f"<MarkerSet><objects>{markers}</objects></MarkerSet></Model>\n</OpenSimDocument>\n"
    )


def motion(
    values: dict[str, Sequence[float]], *, rate: float = 100.0, degrees: str = "yes", states: bool = False
) -> str:
    """A motion of coordinates, in the unit of the header; states have the path of their joint."""
    frames = len(next(iter(values.values())))
    names = [f"/jointset/joint/{name}/value" if states else name for name in values]
    extra = [f"/jointset/joint/{name}/speed" for name in values] if states else []
    lines = ["Coordinates", "version=1", f"nRows={frames}", f"nColumns={1 + len(names) + len(extra)}"]
    lines += [f"inDegrees={degrees}"] if degrees else []
    lines += ["Units are S.I. units (second, meters, Newtons, ...)", "endheader", "\t".join(["time", *names, *extra])]
    for t in range(frames):
        cells = [t / rate, *(values[name][t] for name in values), *(0.5 for _ in extra)]
        lines.append("\t".join(f"{x:16.10f}" for x in cells))
    return "\n".join([*lines, ""])
