"""Read OpenSim models (.osim): the joints of a skeleton and the markers on it, of versions 3 and 4."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element
from xml.parsers import expat

import numpy as np
import numpy.typing as npt

from kinedex.ops.body import multibody
from kinedex.ops.body.multibody import Function, Joint, Placed
from kinedex.ops.errors import ParameterError, SourceError
from kinedex.storage.formats.motion.reader import MAX_POINTS
from kinedex.storage.formats.motion.text_blocks import BLOCK, LONGEST
from kinedex.storage.formats.source_files import file_size, source_errors

MAX_ELEMENTS, DEEPEST = 500_000, 100
"""The largest number of elements, and the largest depth of nested elements."""


LONGEST_TEXT = 1 << 20
"""The largest number of characters in an element."""


class _Tree:
    """The handlers of the parser, which build the tree; elements with given names are skipped with their content."""

    def __init__(self, path: Path, parser: expat.XMLParserType, skipped: Collection[str]) -> None:
        self._path, self._parser, self._skipped = path, parser, frozenset(skipped)
        self._open = [Element("")]
        self._count = self._hidden = 0

    @property
    def root(self) -> Element:
        return self._open[0][0]

    def _error(self, message: str) -> SourceError:
        return SourceError(self._path, message, line=self._parser.CurrentLineNumber)

    def doctype(self, *_: Any) -> None:
        raise self._error("has a document type declaration, which is not read: remove it")

    def start(self, name: str, attributes: dict[str, str]) -> None:
        self._count += 1
        if self._count > MAX_ELEMENTS or len(self._open) + self._hidden > DEEPEST:
            raise self._error(f"has more than {MAX_ELEMENTS} elements, or more than {DEEPEST} inside each other")
        if self._hidden or name in self._skipped:
            self._hidden += 1
            return
        element = Element(name, attributes)
        self._open[-1].append(element)
        self._open.append(element)

    def end(self, _: str) -> None:
        if self._hidden:
            self._hidden -= 1
        else:
            self._open.pop()

    def characters(self, text: str) -> None:
        if self._hidden or len(self._open[-1]):
            return
        whole = (self._open[-1].text or "") + text
        if len(whole) > LONGEST_TEXT:
            raise self._error(f"has a text of more than {LONGEST_TEXT >> 20} MB in one element")
        self._open[-1].text = whole


def parse_xml(path: Path, skipped: Collection[str] = ()) -> Element:
    """Read an XML file as a tree.

    Parameters
    ----------
    path : Path
        The file.
    skipped : collection of str, optional
        Names of elements that are skipped with their content.

    Returns
    -------
    Element
        The root; the text of an element is that before its first child.

    Raises
    ------
    SourceError
        The file cannot be read, is not XML, has a document type declaration, or is beyond a limit.
    """
    if file_size(path) > LONGEST:
        raise SourceError(path, f"has more than {LONGEST >> 20} MB, which no model of a body has")
    parser = expat.ParserCreate()
    tree = _Tree(path, parser, skipped)
    parser.buffer_text = True
    parser.StartDoctypeDeclHandler = tree.doctype
    parser.StartElementHandler, parser.EndElementHandler = tree.start, tree.end
    parser.CharacterDataHandler = tree.characters
    try:
        with source_errors(path), path.open("rb") as file:
            while data := file.read(BLOCK):
                parser.Parse(data, False)
        parser.Parse(b"", True)
    except expat.ExpatError as fault:
        raise SourceError(path, f"is not XML: {expat.ErrorString(fault.code)}", line=fault.lineno) from None
    except (ValueError, LookupError) as fault:
        raise SourceError(path, f"is in an encoding that is not read: {fault}") from None
    return tree.root


F64 = npt.NDArray[np.float64]

LARGEST = 1e6
"""The largest number of a body model: positions in metres, angles in radians, coefficients of functions."""

NEAREST = 1e-9
"""The smallest distance between knots of a spline, and the smallest length of an axis."""

MAX_KNOTS = 1000
"""The largest number of knots of a spline."""

_SKIPPED = (
    "ForceSet", "attached_geometry", "WrapObjectSet", "FrameGeometry", "VisibleObject", "ContactGeometrySet",
    "ControllerSet", "ProbeSet", "ModelVisualPreferences", "Appearance", "geometry",
)  # fmt: skip

_TURNS: dict[str, str] = {
    "PinJoint": "z", "UniversalJoint": "xy", "GimbalJoint": "xyz", "BallJoint": "xyz", "WeldJoint": "",
    "FreeJoint": "xyz", "SliderJoint": "", "PlanarJoint": "z",
}  # fmt: skip
_SHIFTS: dict[str, str] = {"FreeJoint": "xyz", "SliderJoint": "x", "PlanarJoint": "xy"}
"""A dict from joint type to the axes of its translations; rotations precede translations in its coordinates."""


@dataclass(frozen=True)
class Coordinate:
    """A generalised coordinate.

    Attributes
    ----------
    name : str
        Its name.
    default : float
        Its value without a column or coupling, in radians or metres.
    turns : bool
        True for an angle, which motion files may hold in degrees.
    """

    name: str
    default: float
    turns: bool


@dataclass(frozen=True)
class Coupling:
    """A coordinate that depends on others through a constraint."""

    of: tuple[int, ...]
    function: Function


@dataclass(frozen=True)
class Model:
    """An OpenSim model.

    Attributes
    ----------
    name : str
        Its name.
    coordinates : tuple of Coordinate
        The Q coordinates.
    couplings : Mapping[int, Coupling]
        Index → coupling of the coordinates that depend on others if a motion does not hold them.
    joints : tuple of Joint
        The joints, each after its parent.
    names, bodies : tuple of str
        The names of the joints, and of their child bodies.
    markers : Mapping[str, tuple[int, float64 array (3,)]]
        Marker → index of the joint to whose child body it is fixed, and its position in that body in metres.
    """

    name: str
    coordinates: tuple[Coordinate, ...]
    couplings: Mapping[int, Coupling]
    joints: tuple[Joint, ...]
    names: tuple[str, ...]
    bodies: tuple[str, ...]
    markers: Mapping[str, tuple[int, F64]]


@dataclass
class _Parser:
    """The state while a file is parsed: its path for errors, and the coordinates so far."""

    path: Path
    coordinates: dict[str, Coordinate] = field(default_factory=dict)

    def error(self, what: str, expected: str) -> SourceError:
        return SourceError(self.path, f"{what}: {expected}")

    def numbers(self, element: Element | None, what: str, count: int | None, default: float | None = None) -> F64:
        """Return the numbers of an element's text, or `count` times the default if the element is missing."""
        if element is None and default is not None and count is not None:
            return np.full(count, default)
        words = ((element.text if element is not None else "") or "").split()
        try:
            found = np.array([float(word) for word in words])
        except ValueError:
            found = np.zeros(0)
        if not len(found) or (count is not None and len(found) != count) or not (np.abs(found) <= LARGEST).all():
            size = f"{count} numbers" if count is not None else "numbers"
            raise self.error(what, f"expected {size} within {LARGEST:g}, got {' '.join(words)[:60]!r}")
        return found

    def function(self, element: Element, what: str) -> Function:
        """Return the function that an element describes."""
        kind = element.tag
        if kind == "Constant":
            return multibody.Linear((), float(self.numbers(element.find("value"), f"{what} value", 1, 0.0)[0]))
        if kind == "LinearFunction":
            found = self.numbers(element.find("coefficients"), f"{what} coefficients", None)
            return multibody.Linear(tuple(found[:-1].tolist()), float(found[-1]))
        if kind == "PolynomialFunction":
            found = self.numbers(element.find("coefficients"), f"{what} coefficients", None)
            return multibody.Polynomial(tuple(found.tolist()))
        if kind == "MultiplierFunction":
            factor = float(self.numbers(element.find("scale"), f"{what} scale", 1, 1.0)[0])
            inner = element.find("function")
            if inner is not None and len(inner):
                return multibody.Multiple(self.function(inner[0], what), factor)
        if kind in ("SimmSpline", "NaturalCubicSpline"):
            x, y = (self.numbers(element.find(axis), f"{what} {axis}", None) for axis in "xy")
            try:
                if len(x) <= MAX_KNOTS and (np.diff(x) > NEAREST).all():
                    return multibody.spline(x, y)
            except ParameterError:
                pass
            raise self.error(what, f"expected a {kind} of 2 to {MAX_KNOTS} knots that ascend, got {len(x)}")
        raise self.error(
            what, f"has a function of type {kind}, which is not read; Constant, LinearFunction, PolynomialFunction, "
            "MultiplierFunction and SimmSpline are"
        )  # fmt: skip


def read_osim(path: Path) -> Model:
    """Read an OpenSim model of version 3 (bodies hold their joint) or 4 (a set of joints).

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    SourceError
        The file is not an OpenSim model, or has an unsupported joint or function; the error names it.
    """
    root = parse_xml(path, _SKIPPED)
    model = root if root.tag == "Model" else root.find("Model")
    if model is None:
        raise SourceError(
            path, f"is no OpenSim model: expected <OpenSimDocument> with a <Model>, got <{root.tag[:60]}>"
        )
    parser = _Parser(path)
    found: dict[str, tuple[str, str, Joint]] = {}
    for name, parent, child, element, frames in _joint_elements(model):
        if child in found or child == "ground" or len(found) >= MAX_POINTS:
            raise parser.error(f"joint '{name}'", f"body '{child}' has a joint already, and none may have two")
        found[child] = (name, parent, _joint(parser, name, element, frames))
    if not found:
        raise SourceError(path, "has no joints")
    order = _order(parser, {child: parent for child, (_, parent, _) in found.items()})
    place = {"ground": -1} | {child: i for i, child in enumerate(order)}
    joints = tuple(
        Joint(place[found[child][1]], at.in_parent, at.in_child, at.turns, at.shifts)
        for child in order
        for at in [found[child][2]]
    )
    return Model(
        name=model.get("name", path.stem),
        coordinates=tuple(parser.coordinates.values()),
        couplings=_couplings(parser, model),
        joints=joints,
        names=tuple(found[child][0] for child in order),
        bodies=tuple(order),
        markers=_markers(parser, model, place),
    )


def _last(path: str | None) -> str:
    """Return the last component of a path, such as femur_r of /bodyset/femur_r."""
    return (path or "").strip().rpartition("/")[2]


def _text(element: Element, *names: str) -> str:
    """Return the text of the first child element with one of the names."""
    return next((found.text or "" for name in names if (found := element.find(name)) is not None), "").strip()


Frames = tuple[tuple[Element, ...], tuple[Element, ...]]
"""The elements that position a joint's frame in the parent and in the child body, the outermost first."""


def _joint_elements(model: Element) -> Iterator[tuple[str, str, str, Element, Frames]]:
    """Yield name, parent body, child body, element and frames of every joint in the model."""
    for body in model.iterfind("BodySet/objects/Body"):
        for element in body.iterfind("Joint/*"):
            parent = _text(element, "parent_body")
            yield element.get("name", ""), parent, body.get("name", ""), element, ((element,), (element,))
    for element in model.iterfind("JointSet/objects/*"):
        frames = {frame.get("name", ""): frame for frame in element.iterfind("frames/*")}
        ends: list[tuple[str, tuple[Element, ...]]] = []
        for side in ("parent", "child"):
            name = _last(_text(element, f"socket_{side}_frame", f"connector_{side}_frame_connectee_name"))
            chain: list[Element] = []
            while name in frames and frames[name] not in chain:
                chain.insert(0, frames[name])
                name = _last(_text(frames[name], "socket_parent", "connector_parent_connectee_name"))
            ends.append((name, tuple(chain)))
        (parent, above), (child, below) = ends
        yield element.get("name", ""), parent, child, element, (above, below)


def _placed(parser: _Parser, frames: tuple[Element, ...], keys: tuple[str, str], what: str) -> Placed:
    """Return a frame that is defined through others, each by a translation and an orientation."""
    rotation, origin = np.eye(3), np.zeros(3)
    for frame in frames:
        origin = origin + rotation @ parser.numbers(frame.find(keys[0]), f"{what} {keys[0]}", 3, 0.0)
        angles = parser.numbers(frame.find(keys[1]), f"{what} {keys[1]}", 3, 0.0)
        rotation = rotation @ multibody.euler_xyz(angles)
    return Placed(rotation, origin)


def _joint(parser: _Parser, name: str, element: Element, frames: Frames) -> Joint:
    """Return a joint, without its parent, which is set later."""
    what = f"joint '{name}'"
    old = frames[0][:1] == (element,)
    keys = [("location_in_parent", "orientation_in_parent"), ("location", "orientation")]
    sides = [
        _placed(parser, chain, own if old else ("translation", "orientation"), what)
        for chain, own in zip(frames, keys, strict=True)
    ]
    if _text(element, "reverse") == "true":
        raise parser.error(what, "is reversed, which is not read; open the model in OpenSim 4 and save it again")
    elements = [*element.iterfind("coordinates/Coordinate"), *element.iterfind("CoordinateSet/objects/Coordinate")]
    names = [coordinate.get("name", "") for coordinate in elements]
    turns: tuple[multibody.AxisMotion, ...] = ()
    shifts: tuple[multibody.AxisMotion, ...] = ()
    if element.tag == "CustomJoint":
        turning = {other for other in names if _turns(element, other)}
    elif element.tag in _TURNS:
        turning = set(names[: len(_TURNS[element.tag])])
    else:
        raise parser.error(what, f"is a {element.tag}, which is not read; {', '.join(_TURNS)} and CustomJoint are")
    for other, coordinate in zip(names, elements, strict=True):
        kind = _text(coordinate, "motion_type") if element.tag == "CustomJoint" else ""
        default = float(parser.numbers(coordinate.find("default_value"), f"coordinate '{other}'", 1, 0.0)[0])
        if other in parser.coordinates:
            raise parser.error(f"coordinate '{other}'", "stands twice")
        parser.coordinates[other] = Coordinate(other, default, kind == "rotational" if kind else other in turning)
    if element.tag == "CustomJoint":
        turns, shifts = _spatial(parser, what, element)
    else:
        axes = [*_TURNS[element.tag], *_SHIFTS.get(element.tag, "")]
        if len(names) != len(axes):
            raise parser.error(what, f"expected {len(axes)} coordinates of a {element.tag}, got {len(names)}")
        index = list(parser.coordinates)
        motions = [
            multibody.AxisMotion(np.eye(3)["xyz".index(axis)], (index.index(other),), multibody.Linear((1.0,), 0.0))
            for axis, other in zip(axes, names, strict=True)
        ]
        count = len(_TURNS[element.tag])
        turns, shifts = tuple(motions[:count]), tuple(motions[count:])
    return Joint(-1, sides[0], sides[1], turns, shifts)


def _axis_function(axis: Element) -> Element | None:
    """Return the element of an axis's function, None if missing; version 3 wraps it in <function>, version 4 not."""
    inner = axis.find("function")
    if inner is not None:
        return inner[0] if len(inner) else None
    return next((part for part in axis if part.tag not in ("coordinates", "axis")), None)


def _turns(joint: Element, coordinate: str) -> bool:
    """Return whether a coordinate is the angle about an axis of a custom joint, up to its sign."""
    for axis in joint.iterfind("SpatialTransform/TransformAxis"):
        function = _axis_function(axis)
        slope = ["1"] if function is None else _text(function, "coefficients").lstrip("+-").split()[:1]
        plain = function is None or function.tag == "LinearFunction"
        about = axis.get("name", "").startswith("rotation") and coordinate in _text(axis, "coordinates").split()
        if about and plain and slope and re.fullmatch(r"1(\.0*)?(e[+-]?0+)?", slope[0]):
            return True
    return False


def _spatial(
    parser: _Parser, what: str, joint: Element
) -> tuple[tuple[multibody.AxisMotion, ...], tuple[multibody.AxisMotion, ...]]:
    """Return the rotations and translations of a custom joint."""
    index = list(parser.coordinates)
    found: dict[bool, list[multibody.AxisMotion]] = {True: [], False: []}
    for nth, axis in enumerate(joint.findall("SpatialTransform/TransformAxis")[:6]):
        own = f"{what} {axis.get('name', '')}"
        names = _text(axis, "coordinates").split()
        for name in names:
            if name not in parser.coordinates:
                raise parser.error(own, f"takes the coordinate '{name}', which no joint before it has")
        element = _axis_function(axis)
        if element is not None:
            function = parser.function(element, own)
        else:
            function = multibody.Linear((1.0,) if names else (), 0.0)
        if not _fits(function, len(names)):
            raise parser.error(own, f"has a function that does not go with {len(names)} coordinates")
        direction = parser.numbers(axis.find("axis"), f"{own} axis", 3)
        if not np.linalg.norm(direction) > NEAREST:
            raise parser.error(own, "has an axis without a direction")
        found[nth < 3].append(multibody.AxisMotion(direction, tuple(map(index.index, names)), function))
    return tuple(found[True]), tuple(found[False])


def _fits(function: Function, count: int) -> bool:
    """Return whether a function takes `count` coordinates."""
    if isinstance(function, multibody.Multiple):
        return _fits(function.function, count)
    if isinstance(function, multibody.Linear):
        return len(function.slopes) <= count
    return count == 1


def _order(parser: _Parser, parents: dict[str, str]) -> list[str]:
    """Return the bodies, each after its parent body."""
    order: list[str] = []
    known = {"ground"}
    while len(order) < len(parents):
        ready = [child for child, parent in parents.items() if child not in known and parent in known]
        if not ready:
            child = next(child for child in parents if child not in known)
            raise parser.error(
                f"body '{child}'", f"its parent '{parents[child]}' leads to no body that stands on the ground"
            )
        order += ready
        known.update(ready)
    return order


def _couplings(parser: _Parser, model: Element) -> dict[int, Coupling]:
    """Return the coordinates that a constraint makes dependent on others."""
    index = {name: i for i, name in enumerate(parser.coordinates)}
    found = {}
    for element in model.iterfind("ConstraintSet/objects/CoordinateCouplerConstraint"):
        own = f"constraint '{element.get('name', '')}'"
        names = _text(element, "independent_coordinate_names").split()
        dependent = _text(element, "dependent_coordinate_name")
        function = element.find("coupled_coordinates_function")
        if function is None or not len(function) or dependent not in index or not set(names) <= set(index):
            raise parser.error(own, "expected a function, and coordinates that joints have")
        made = multibody.Multiple(
            parser.function(function[0], own),
            float(parser.numbers(element.find("scale_factor"), f"{own} scale_factor", 1, 1.0)[0]),
        )
        if not _fits(made, len(names)):
            raise parser.error(own, f"has a function that does not go with {len(names)} coordinates")
        found[index[dependent]] = Coupling(tuple(index[name] for name in names), made)
    return found


def _markers(parser: _Parser, model: Element, place: dict[str, int]) -> dict[str, tuple[int, F64]]:
    """Return the markers on bodies."""
    found: dict[str, tuple[int, F64]] = {}
    for element in model.iterfind("MarkerSet/objects/Marker"):
        name = element.get("name", "")
        body = _last(_text(element, "socket_parent_frame", "connector_parent_frame_connectee_name", "body"))
        if name and place.get(body, -1) >= 0 and len(found) < MAX_POINTS:
            found[name] = (place[body], parser.numbers(element.find("location"), f"marker '{name}'", 3))
    return found
