"""Read BVH files: named joints and the root's orientation from the channels of the file's own skeleton."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.body_evidence import SAMPLED_FRAMES, Evidence
from kinedex.catalog.skeletons.limb_doubts import limb_doubts
from kinedex.catalog.skeletons.lost_bones import LostBones, lost_bones
from kinedex.catalog.skeletons.mappings import Fit, Format, Mappings
from kinedex.catalog.skeletons.recognition.node_places import (
    exchange_warning,
    exchanged_names,
    twist_nodes,
    with_exchanged,
)
from kinedex.catalog.skeletons.root_units import OTHER_ROOT_UNIT, root_factor
from kinedex.ops.body import kinematics
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.bvh_parser import BvhFile
from kinedex.storage.formats.motion.mapped_body import (
    corrected_rate,
    mapped_orientation,
    posed,
    posed_bytes,
    recognition_evidence,
    recognition_warnings,
    refuse_far,
    skips_spine,
    to_metres,
    turned_upright,
    unit_statement,
)
from kinedex.storage.formats.motion.points import root_orientation
from kinedex.storage.formats.motion.reader import Body, Extent, MotionFile, Reader, ReadSettings
from kinedex.storage.formats.motion.scene_figures import chosen_person
from kinedex.storage.formats.source_files import file_size

F64 = npt.NDArray[np.float64]

_MIN_NODES = 10  # a root with fewer nodes is a prop or a camera
_HEAD_BYTES = 1 << 18  # bytes; enough for the hierarchy of some thousand joints
_KEPT_BYTES = 32 << 20  # bytes of channels that are kept between recognition and reading
_FEW_POSITIONS = 9  # position channels; more belong to files that place every node
_NEARLY_NOTHING = 0.01  # fraction of the length of the OFFSET
_NODES = re.compile(rb"(?<![^\s{}])(ROOT|JOINT)\s+[^\s{}]+", re.IGNORECASE)
_MOTION_LINE = re.compile(rb"^[ \t]*MOTION[ \t\r]*$", re.IGNORECASE | re.MULTILINE)
_SECOND = re.compile(r"#\d+$")


@dataclass(frozen=True)
class Person:
    """One figure of a BVH file.

    Attributes
    ----------
    name : str
        Its name in the file: the prefix of its root, or the root.
    nodes : tuple of Node
        Parents first; node 0 is the root.
    redundant : frozenset of int
        Indices of End Sites at the position of their joint.
    offsets : float64 array (N, 3)
        The OFFSET of every node, also of nodes whose position channels replace it.
    members : tuple of int
        The indices of the nodes in the file.
    """

    name: str
    nodes: tuple[kinematics.Node, ...]
    redundant: frozenset[int]
    offsets: F64
    members: tuple[int, ...]

    @property
    def indices(self) -> dict[str, int]:
        """A dict from node name to index, for all nodes that a skeleton mapping can use."""
        return {node.name: i for i, node in enumerate(self.nodes) if i not in self.redundant}

    @property
    def twists(self) -> frozenset[int]:
        """The indices of the nodes that only divide a bone."""
        return twist_nodes([node.name for node in self.nodes], [node.parent for node in self.nodes])


class BvhReader(Reader):
    """Reads BVH files, which carry their own skeletons and rate."""

    format: ClassVar[Format] = "bvh"
    endings: ClassVar[tuple[str, ...]] = (".bvh",)
    reads_whole: ClassVar[bool] = True

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the rate that replaces the file's, the only setting that affects the result."""
        return settings.override_rate_hz

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Count the frames and estimate the memory of joints, one block of text and stored channels."""
        bvh = BvhFile(file.path, file.data)
        need = posed_bytes(bvh.frames, file_size(file.path), len(bvh.nodes), joints) + 1000 * len(bvh.nodes)
        kept = min(8 * bvh.frames * bvh.columns, _KEPT_BYTES) + 24 * SAMPLED_FRAMES * len(bvh.nodes)
        return Extent(bvh.frames, need + kept, settings.rate_of(bvh.rate_hz, []))

    def persons(self, file: MotionFile, mappings: Mappings) -> tuple[str, ...]:
        """Return the names of the figures of a file with several roots; empty for a file of one figure."""
        if _one_root(file):
            return ()
        found = persons_of(BvhFile(file.path, file.data))
        return tuple(person.name for person in found) if len(found) > 1 else ()

    def read(self, file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings) -> Body:
        """Read a figure of a BVH file.

        Raises
        ------
        SourceError
            The file is damaged, or no mapping fits and no body is recognised.
        """
        bvh = _Motion(BvhFile(file.path, file.data))
        fit, positions, turned, turned_by, restored, *_ = _fitted(bvh, file.person, mappings, joints)
        warnings = [*bvh.file.warnings, *recognition_warnings(fit), *limb_doubts(positions, joints)]
        rate_hz = corrected_rate(file.path, bvh.file.rate_hz, positions, joints, settings, warnings)
        if restored:
            warnings.append(
                f"bones {', '.join(restored)} have no length in the file; mapping '{fit.mapping.name}' gives them one"
            )
        evidence = [*recognition_evidence(fit), *turned_by]
        stated = unit_statement(fit, None, settings)
        unit = to_metres(file.path, positions, stated, joints, warnings, evidence)
        refuse_far(file.path, positions, joints, fit.unknown)
        return Body(
            positions=positions,
            orientation=_orientation(fit, positions, turned, joints, bool(turned_by)),
            rate_hz=rate_hz,
            unit=unit,
            skeleton=fit.mapping.name,
            up=fit.up,
            unknown=fit.unknown,
            warnings=tuple(warnings),
            estimated=tuple(fit.estimated),
            confidence=fit.confidence,
            evidence=tuple(evidence),
        )


class FittedPerson(NamedTuple):
    """A figure of a file with its skeleton mapping.

    Attributes
    ----------
    fit : Fit
        The mapping, rotated if another axis than its own is up.
    positions : float64 array (J, 3, T)
        The named joints in the file's unit.
    turned : float64 array (9, T)
        Rotation matrices of the root, row by row.
    turned_by : tuple of str
        The reasons for rotating the mapping.
    restored : list of str
        Bones without length in the file that were given one.
    nodes : tuple of Node
        The figure's nodes, with the lengths of these bones.
    members : tuple of int
        The indices of the nodes in the file.
    """

    fit: Fit
    positions: F64
    turned: F64
    turned_by: tuple[str, ...]
    restored: list[str]
    nodes: tuple[kinematics.Node, ...]
    members: tuple[int, ...]


def fitted_person(file: BvhFile, person: str, mappings: Mappings, joints: tuple[str, ...]) -> FittedPerson:
    """Return a figure of a BVH file with the mapping that `BvhReader.read` finds for it.

    Raises
    ------
    SourceError
        The file is damaged, has no such person, or no body is recognised.
    """
    return _fitted(_Motion(file), person, mappings, joints)


def _fitted(bvh: _Motion, name: str, mappings: Mappings, joints: tuple[str, ...]) -> FittedPerson:
    try:
        persons = persons_of(bvh.file, _offsets_apart(bvh))
        person = persons[chosen_person(bvh.path, name, [person.name for person in persons])]
        person, doubts, lost = _repaired(person)
        fit = mappings.exact(bvh.path, "bvh", person.indices)
        if fit is None or skips_spine(fit, [node.parent for node in person.nodes], person.offsets, person.twists):
            fit = mappings.recognised(bvh.path, "bvh", _evidence(bvh, person))
        elif fit.fallen:
            fit = mappings.completed(fit, _tree(person))
    except SourceError:
        if bvh.skimmed:
            bvh.file.refuse_faults()  # report a fault of the frames before anything that follows from it
        raise
    if lost is not None:
        fit = lost.marked(fit, [node.name for node in person.nodes])
    fit = replace(fit, doubts=(*doubts, *fit.doubts)) if doubts else fit
    nodes, restored = _restore(person, fit)
    positions, turned = posed(bvh, nodes, fit.root, fit, joints)
    fit, turned_by = turned_upright(fit, _resting(person), positions, joints)
    columns = _root_columns(bvh.file, nodes)
    factor = root_factor(positions, joints) if columns else None
    if factor is not None:
        whole, turned = posed(_Rescaled(bvh, columns, factor), nodes, fit.root, fit, joints)
        positions, doubt = whole, f"{OTHER_ROOT_UNIT}: times {factor:.4g} the feet stand on the floor; it is read so"
        fit = replace(fit, doubts=(*fit.doubts, doubt))
    return FittedPerson(fit, positions, turned, turned_by, restored, nodes, person.members)


def _repaired(person: Person) -> tuple[Person, tuple[str, ...], LostBones | None]:
    """Return a figure with corrected names and estimated lost bones, warnings on the names, and the lost bones."""
    nodes, doubts, lost = _repairs(person.nodes)
    if nodes is person.nodes:
        return person, doubts, lost
    offsets = person.offsets.copy()
    for i, offset in lost.offsets.items() if lost is not None else ():
        offsets[i] = offset
    return replace(person, nodes=nodes, offsets=offsets), doubts, lost


@lru_cache(maxsize=64)  # The takes of an archive share a few hierarchies, and nodes are compared by identity.
def _repairs(
    nodes: tuple[kinematics.Node, ...],
) -> tuple[tuple[kinematics.Node, ...], tuple[str, ...], LostBones | None]:
    """Return nodes with corrected names and offsets of lost bones, warnings on the names, and the lost bones."""
    names, parents = [node.name for node in nodes], [node.parent for node in nodes]
    pairs = exchanged_names(names, parents)
    doubts = tuple(exchange_warning(names, pairs))
    if pairs:
        names = list(with_exchanged(names, pairs))
        nodes = tuple(replace(node, name=name) for node, name in zip(nodes, names, strict=True))
    moved = {
        i
        for i, node in enumerate(nodes)
        if node.name.endswith("_end") or any(step.kind >= kinematics.MOVE_X for step in node.steps)
    }
    lost = lost_bones(names, parents, np.array([node.before for node in nodes]), moved)
    if lost is not None and lost.offsets:
        nodes = tuple(
            replace(node, before=lost.offsets[i]) if i in lost.offsets else node for i, node in enumerate(nodes)
        )
    return nodes, doubts, lost


def _root_columns(file: BvhFile, nodes: Sequence[kinematics.Node]) -> list[int]:
    """Return the position columns of a figure's root; empty if many other nodes have position channels, too."""
    if file.position_channels > _FEW_POSITIONS:
        return []
    return [step.column for step in nodes[0].steps if step.kind >= kinematics.MOVE_X]


class _Rescaled:
    """A motion whose root positions are multiplied by a factor."""

    def __init__(self, motion: _Motion, columns: list[int], factor: float) -> None:
        self.motion, self.columns, self.factor = motion, columns, factor
        self.path, self.frames = motion.path, motion.frames

    def blocks(self) -> Iterator[F64]:
        """Yield the channels of consecutive frames."""
        for block in self.motion.blocks():
            part = block.copy()
            part[:, self.columns] *= self.factor
            yield part


class _Motion:
    """The motion of a file; channels of a small file are parsed once and kept, a long file is sampled first."""

    def __init__(self, file: BvhFile) -> None:
        self.file = file
        self.path, self.frames = file.path, file.frames
        self.kept: list[F64] | None = None
        self.skimmed = False

    def blocks(self) -> Iterator[F64]:
        """Yield the channels of consecutive frames."""
        if self.kept is not None:
            yield from self.kept
        else:
            yield from self.file.blocks()

    def sampled(self, count: int) -> F64:
        """Return the channels of about `count` frames, evenly spaced."""
        if self.kept is None and 8 * self.file.frames * self.file.columns <= _KEPT_BYTES:
            self.kept = [self.file.channels()]
        wanted = np.unique(np.linspace(0, self.frames - 1, count).round().astype(np.int64))
        if self.kept is not None:
            return self.kept[0][wanted]
        self.skimmed = True
        return self.file.frames_at(wanted)


def _one_root(file: MotionFile) -> bool:
    """Return whether the start of a file contains its whole hierarchy, with one root; no frames are read."""
    if file.data is not None:
        head = file.data[:_HEAD_BYTES]
    else:
        try:
            with file.path.open("rb") as stream:
                head = stream.read(_HEAD_BYTES)
        except OSError:
            return False  # the parser reports the fault
    motion = _MOTION_LINE.search(head)
    if motion is None:
        return False
    # the word after either keyword is a name, which may itself be `Root`
    keywords = [found[1].upper() for found in _NODES.finditer(head, 0, motion.start())]
    return keywords.count(b"ROOT") < 2


def _offsets_apart(motion: _Motion) -> frozenset[int]:
    """Return the nodes whose position channels are added to their OFFSET instead of replacing it.

    These are the nodes whose position channels stay near 0. The result is empty unless they are most of the nodes with
    an OFFSET and position channels.
    """
    nodes, offsets = motion.file.nodes, motion.file.offsets
    lengths = np.sqrt((offsets * offsets).sum(axis=1)).tolist()
    moved = {
        i: [step.column for step in node.steps if step.kind >= kinematics.MOVE_X]
        for i, node in enumerate(nodes)
        if node.parent >= 0 and lengths[i]
    }
    moved = {i: columns for i, columns in moved.items() if len(columns) == 3}
    if not moved:
        return frozenset()
    reach = np.abs(motion.sampled(SAMPLED_FRAMES)).max(axis=0).tolist()
    apart = frozenset(
        i for i, columns in moved.items() if max(reach[column] for column in columns) < _NEARLY_NOTHING * lengths[i]
    )
    return apart if 2 * len(apart) > len(moved) else frozenset()


def persons_of(file: BvhFile, apart: frozenset[int] = frozenset()) -> list[Person]:
    """Return the figures of a file: the trees of its roots without small ones (props), or the largest if all are small.

    Parameters
    ----------
    file : BvhFile
        The file.
    apart : frozenset of int, optional
        Nodes whose position channels are added to their OFFSET instead of replacing it.
    """
    all_nodes = tuple(
        replace(node, before=file.offsets[i]) if i in apart else node for i, node in enumerate(file.nodes)
    )
    tops = [0] * len(file.nodes)
    for i, node in enumerate(file.nodes):
        tops[i] = i if node.parent < 0 else tops[node.parent]
    trees = {top: [i for i, other in enumerate(tops) if other == top] for top in dict.fromkeys(tops)}
    large = {top: members for top, members in trees.items() if len(members) >= _MIN_NODES}
    if not large:
        large = dict([max(trees.items(), key=lambda tree: len(tree[1]))])
    if len(trees) == 1:
        return [Person("", all_nodes, file.redundant, file.offsets, tuple(range(len(all_nodes))))]
    found: list[Person] = []
    for top, members in large.items():
        name = _free_name(_root_name(file.nodes[top].name), [person.name for person in found])
        found.append(_person(file, all_nodes, name, members))
    return found


def _root_name(name: str) -> str:
    """Return the prefix of a root's name, or the name if it has none."""
    short = _SECOND.sub("", name)
    return re.split(r"[:|]", short)[0] or short


def _free_name(name: str, used: list[str]) -> str:
    return (
        name if name not in used else next(f"{name}-{i}" for i in range(2, len(used) + 3) if f"{name}-{i}" not in used)
    )


def _person(file: BvhFile, nodes: Sequence[kinematics.Node], name: str, members: list[int]) -> Person:
    """Return the tree of one root, without the suffixes by which its names differ from the names of other trees."""
    index = {old: new for new, old in enumerate(members)}
    plain = [_SECOND.sub("", nodes[old].name.removesuffix("_end")) for old in members]
    ends = ["_end" if nodes[old].name.endswith("_end") else "" for old in members]
    short = [stem + end for stem, end in zip(plain, ends, strict=True)]
    names = short if len(set(short)) == len(short) else [nodes[old].name for old in members]
    own = tuple(
        replace(nodes[old], name=called, parent=index.get(nodes[old].parent, -1))
        for old, called in zip(members, names, strict=True)
    )
    redundant = frozenset(index[old] for old in file.redundant if old in index)
    return Person(name, own, redundant, file.offsets[members], tuple(members))


def _evidence(motion: _Motion, person: Person) -> Evidence:
    """Return the positions of a figure's nodes in sampled frames, and its tree."""
    positions, _ = kinematics.forward(person.nodes, motion.sampled(SAMPLED_FRAMES))
    return replace(_tree(person), positions=positions)


def _tree(person: Person) -> Evidence:
    """Return the tree of a figure's nodes, without any frame."""
    return Evidence(
        names=tuple(node.name for node in person.nodes),
        positions=np.empty((len(person.nodes), 3, 0)),
        parents=tuple(node.parent for node in person.nodes),
        offsets=person.offsets,
    )


def _resting(person: Person) -> F64:
    """Return the positions (N, 3) of the nodes without any rotation."""
    rest = np.zeros((len(person.nodes), 3))
    for i, node in enumerate(person.nodes):
        rest[i] = person.offsets[i] + (rest[node.parent] if node.parent >= 0 else 0.0)
    return rest


def _orientation(fit: Fit, positions: F64, turned: F64, joints: tuple[str, ...], upturned: bool) -> F64:
    """Return the root's orientation: from hips and spine if the root's own axes are unknown, else from the file."""
    if not (fit.recognised or upturned) or {"lhip", "rhip", "root"} & set(fit.unknown):
        return mapped_orientation(fit, turned)
    if not {"chest", "neck", "belly", "head"} <= set(fit.unknown):
        return root_orientation(positions, joints, np.ones(positions.shape[2], np.bool_), [])
    across = positions[joints.index("lhip")] - positions[joints.index("rhip")]
    up = np.broadcast_to(np.array([[0.0], [1.0], [0.0]]), across.shape)
    return kinematics.quaternions(kinematics.frames_along(across, up))


def _restore(person: Person, fit: Fit) -> tuple[tuple[kinematics.Node, ...], list[str]]:
    """Return the nodes, with the mapping's lengths for bones without length, and the names of those bones."""
    nodes, restored = list(person.nodes), []
    twists = person.twists if fit.mapping.bones else frozenset()
    for name, weights in fit.mapping.bones.items():
        index = fit.indices[name]
        moved = any(step.kind >= kinematics.MOVE_X for step in nodes[index].steps)
        if not moved and not nodes[index].before.any():
            offset = sum(weight * _bone(person, fit.indices[other], twists) for other, weight in weights.items())
            nodes[index] = replace(nodes[index], before=np.asarray(offset))
            restored.append(name)
    return tuple(nodes), restored


def _bone(person: Person, node: int, twists: frozenset[int]) -> F64:
    """Return the offset of a node, and of the nodes that only divide the bone that leads to it."""
    offset, above = person.nodes[node].before, person.nodes[node].parent
    while above in twists:
        offset, above = offset + person.nodes[above].before, person.nodes[above].parent
    return offset
