"""Figures: trees of nodes in a scene with their transforms over time, and the bodies that they make.

The readers of glTF, FBX and MVNX files give figures in metres and with Y up, by what the files state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.evidence import SAMPLED_FRAMES, Evidence
from kinedex.catalog.skeletons.mappings import Fit, Mappings
from kinedex.catalog.skeletons.units import body_height, guess_unit
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.mapped_body import mapped_orientation, refuse_far, virtual_joint_warnings
from kinedex.storage.formats.motion.reader import Body, ReadSettings, body_bytes

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

AT_ONCE = 1024
"""Frames that are posed at once."""

HEIGHTS_M = (0.4, 2.6)
"""Heights of a body, along legs and trunk, for which the unit that a file states is believed."""


class Poses(Protocol):
    """The motion of a figure: places of its nodes and turns of one of them, in metres with Y up."""

    def at(self, frames: I64, oriented: int) -> tuple[F64, F64]:
        """Return the places (N, 3, K) in K frames, and the rotations (9, K) of a node from its rest pose."""
        ...


@dataclass(frozen=True)
class Figure:
    """A tree of named nodes.

    Attributes
    ----------
    names : tuple of str
        Names of N nodes, all different.
    parents : tuple of int
        Index of each node's parent, before it; −1 for a root.
    rest : float64 array (N, 3)
        Places of the nodes in the rest pose, in metres, Y up.
    poses : Poses
        The motion.
    frames : int
        The number of frames.
    rate_hz : float
        Frames per second that the file states or that its times suggest.
    evidence : tuple of str
        Sentences on how the file was read, for `kinedex inspect`.
    warnings : tuple of str
        Reservations about the file.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    rest: F64
    poses: Poses
    frames: int
    rate_hz: float
    evidence: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def unique_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names, later ones of equal names with a number: `Hips`, `Hips (2)`."""
    taken: set[str] = set()
    found = []
    count: dict[str, int] = {}
    for name in names:
        own = name
        while own in taken:
            count[name] = count.get(name, 1) + 1
            own = f"{name} ({count[name]})"
        taken.add(own)
        found.append(own)
    return tuple(found)


def figure_bytes(frames: int, nodes: int, joints: int) -> int:
    """Return the memory of a figure's body, and of the nodes of a block of frames between it and the file."""
    return body_bytes(frames, joints) + min(frames, AT_ONCE) * (600 * nodes + 96 * joints)


def body_of_figure(
    path: Path, figure: Figure, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings
) -> Body:
    """Make a body of a figure.

    The file's own unit and axes count before those of the mapping; a unit that makes no human height is guessed anew.

    Parameters
    ----------
    path : Path
        The file that errors name.
    figure : Figure
        The figure.
    mappings : Mappings
        Skeleton mappings; those of BVH files serve all trees.
    joints : tuple of str
        The named joints, in the order of the result.
    settings : ReadSettings
        Settings of the user.

    Raises
    ------
    SourceError
        No mapping fits, the unit cannot be guessed, or a joint is absurdly far away.
    """
    sampled = np.unique(np.linspace(0, figure.frames - 1, SAMPLED_FRAMES).round().astype(np.int64))
    above = np.array(figure.parents)
    offsets = figure.rest - np.where(above[:, None] < 0, 0.0, figure.rest[above])
    evidence = Evidence(figure.names, figure.poses.at(sampled, 0)[0], figure.parents, offsets, "y", 1.0)
    fit = mappings.detect(path, "bvh", {name: i for i, name in enumerate(figure.names)}, evidence)
    warnings = list(figure.warnings)
    rate_hz = settings.rate_of(figure.rate_hz, warnings)
    positions, turned = _posed(figure, fit, joints)
    unit = _scale(path, positions, joints, warnings)
    refuse_far(path, positions, joints, fit.unknown)
    return Body(
        positions=positions,
        orientation=mapped_orientation(fit, turned),
        rate_hz=rate_hz,
        unit=unit,
        skeleton=fit.mapping.name,
        unknown=fit.unknown,
        warnings=(*warnings, *virtual_joint_warnings(fit)),
        estimated=tuple(fit.estimated),
        confidence=fit.confidence,
        evidence=(*figure.evidence, *fit.reasons),
    )


def _posed(figure: Figure, fit: Fit, joints: tuple[str, ...]) -> tuple[F64, F64]:
    """Return the joints (J, 3, T) and the root's rotation from its rest pose (9, T), computed in blocks of frames."""
    positions, turned = np.empty((len(joints), 3, figure.frames)), np.empty((9, figure.frames))
    for start in range(0, figure.frames, AT_ONCE):
        part = np.arange(start, min(start + AT_ONCE, figure.frames))
        places, turned[:, part] = figure.poses.at(part, fit.root)
        positions[:, :, part] = fit.apply(places, joints)
    return positions, turned


def _scale(path: Path, positions: F64, joints: tuple[str, ...], warnings: list[str]) -> str:
    """Scale positions in place where the stated unit makes no human height, and return the unit in words."""
    height = body_height(positions, joints)
    if height is None or HEIGHTS_M[0] <= height <= HEIGHTS_M[1]:
        return "1 m"
    name, unit_m, guessed = guess_unit(path, positions, joints)
    warnings.append(
        f"by the unit that the file states, the body is {height:.4g} m high; its lengths are read as {name}, which "
        f"make it {guessed:.2f} m high"
    )
    positions *= unit_m
    return f"{unit_m:.6g} m (guessed)"


def chosen_person(path: Path, person: str, persons: Sequence[str]) -> int:
    """Return the index of the person to read; a SourceError lists those of the file where it is not clear which."""
    if not persons or (len(persons) == 1 and not person):
        return 0
    if person in persons:
        return list(persons).index(person)
    listed = ", ".join(f"'{name}'" for name in persons[:20])
    if person:
        raise SourceError(path, f"has no person '{person}'; it has {listed}")
    raise SourceError(path, f"holds {len(persons)} figures or clips: {listed}; give one of them as `person`")
