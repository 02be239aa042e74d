"""Convert mapped nodes to a body: units, rates, plausible positions and the root's orientation, for all readers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from kinedex.catalog.capture_sessions import BY_SESSION, OPEN_RATE, OPEN_SCALE, OPEN_UNIT, WRONG_UNIT
from kinedex.catalog.configs import shipped_configs
from kinedex.catalog.skeletons.body_evidence import SAMPLED_FRAMES
from kinedex.catalog.skeletons.recognition.recognised_tree import judged_up
from kinedex.catalog.skeletons.skeleton_fit import Fit, axes_of_up
from kinedex.catalog.skeletons.units import (
    ADULT_M,
    FEET_M,
    HUMAN_M,
    body_height,
    contradicted_unit,
    guess_unit,
    is_likely_height,
    known_unit,
    rival_unit,
    unlikely_height,
)
from kinedex.ops.body import kinematics
from kinedex.ops.body.tempo import likely_rate
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.reader import ReadSettings, body_bytes
from kinedex.storage.formats.motion.text_blocks import BLOCK, changed

F64 = npt.NDArray[np.float64]

SLOWEST_LIKELY_HZ, FASTEST_LIKELY_HZ = 5.0, 1000.0
"""The range of plausible rates; a stated rate outside it is compared with the motion."""

_FAR = 4.0  # ratio to the likely rate from which a doubtful rate is replaced
_SWUNG = ("lwrist", "rwrist", "lankle", "rankle")


def corrected_rate(
    path: str | Path,
    stated_hz: float,
    positions: F64,
    joints: tuple[str, ...],
    settings: ReadSettings,
    warnings: list[str],
    statement: str = "",
) -> float:
    """Return the rate of a file; if it is implausible, that of its session, or the one at which the motion is likely.

    The 1 Hz of `Frame Time: 1.0`, for example, is implausible.

    Parameters
    ----------
    path : str or Path
        The file that an error names.
    stated_hz : float
        The rate that the file states; NaN, infinite, 0 or negative if its statement is not valid.
    positions : float64 array (J, 3, T)
        The named joints, in any unit.
    joints : tuple of str
        The names of the J joints.
    settings : ReadSettings
        Settings of the user; a rate in them takes precedence over the file's.
    warnings : list of str
        A sentence is appended if another rate than the stated one is used.
    statement : str, optional
        The statement in the file's words, for messages: "Frame Time 1.0"; by default its rate.

    Returns
    -------
    float
        Frames per second.

    Raises
    ------
    SourceError
        The stated rate is not a positive number, and none can be estimated from the motion.
    """
    if settings.override_rate_hz is not None:
        known = math.isfinite(stated_hz) and stated_hz > 0
        return settings.rate_of(stated_hz, warnings) if known else settings.override_rate_hz
    if SLOWEST_LIKELY_HZ <= stated_hz <= FASTEST_LIKELY_HZ:
        return stated_hz
    claim = statement or f"{stated_hz:.6g} Hz"
    if settings.session_hz is not None:
        rate = f"{settings.session_hz:g} Hz, {BY_SESSION}"
        warnings.append(f"{OPEN_RATE}{claim}; it is read at {rate}; if you know the rate, give --rate HZ")
        return settings.session_hz
    tracks = positions[[i for i, joint in enumerate(joints) if joint in _SWUNG]]
    likely = likely_rate(tracks[np.isfinite(tracks).any(axis=(1, 2))])
    stated = math.isfinite(stated_hz) and stated_hz > 0
    if likely is None and not stated:
        raise SourceError(path, f"its rate is not known: it states {claim}, and nothing moves; give --rate HZ")
    if likely is None or (stated and 1 / _FAR <= stated_hz / likely <= _FAR):
        return stated_hz
    warnings.append(
        f"{OPEN_RATE}{claim}, but hands and feet move as they do at about {likely:g} Hz, at which it "
        "is read; if you know the rate, give --rate HZ"
    )
    return likely


_UPRIGHT = 0.8  # cosine of the tilt below which a body does not stand upright
_MOSTLY = 0.9  # share of the frames

FARTHEST_M = 100_000.0
"""The largest plausible distance of a joint from the origin, in metres."""

_BLOCK_SIZE = 2_000_000  # nodes times frames processed at once: some 50 MB of positions, whatever the file's size


DOUBTFUL = 0.6
"""The confidence below which a recognised body causes a warning."""


def recognition_warnings(fit: Fit) -> list[str]:
    """Return warnings about rough estimates, labels that seem to be wrong, and a recognition of low confidence."""
    warnings = list(fit.doubts)
    if fit.rough:
        how = ", ".join(f"{joint} ({fit.estimated[joint]})" for joint in fit.rough)
        warnings.append(f"joints that the file does not show are estimated, and may be more than 5 cm off: {how}")
    if fit.recognised and fit.confidence < DOUBTFUL:
        reasons = "; ".join(fit.reasons)
        warnings.append(f"the body is recognised with a confidence of {fit.confidence:.2f}, check it: {reasons}")
    return warnings


def recognition_evidence(fit: Fit) -> tuple[str, ...]:
    """Return the reasons for a recognition, and a sentence on joints that are estimated or derived from others."""
    if fit.recognised:
        how = ", ".join(f"{joint} ({phrase})" for joint, phrase in fit.estimated.items())
        return (*fit.reasons, f"joints that the file does not hold are estimated: {how}") if how else fit.reasons
    named = ", ".join(f"{joint} ({mix})" for joint, mix in fit.virtual.items())
    built = f"joints that the skeleton lacks are built from others: {named}"
    return (*fit.reasons, built) if named else fit.reasons


class ParsedMotion(Protocol):
    """A motion file that is parsed block by block: `path`, the number of `frames`, and `blocks` of channels (T, C)."""

    path: Path
    frames: int

    def blocks(self) -> Iterator[F64]:
        """Yield the channels of consecutive frames; an array is valid until the next one."""
        ...


def posed(
    motion: ParsedMotion, nodes: tuple[kinematics.Node, ...], oriented: int, fit: Fit, joints: tuple[str, ...]
) -> tuple[F64, F64]:
    """Compute joints and orientation in blocks of frames, so that channels and nodes never exist for all frames.

    Parameters
    ----------
    motion : ParsedMotion
        The file.
    nodes : tuple of Node
        The nodes that its channels move, parents first.
    oriented : int
        Index of the node whose orientation is wanted.
    fit : Fit
        The skeleton mapping that fits the nodes.
    joints : tuple of str
        The names of J joints.

    Returns
    -------
    positions : float64 array (J, 3, T)
        Joint positions in the file's unit.
    turned : float64 array (9, T)
        Rotation matrices of the oriented node, row by row.

    Raises
    ------
    SourceError
        The file is damaged, or was changed while it was read.
    """
    positions, turned = np.empty((len(joints), 3, motion.frames)), np.empty((9, motion.frames))
    step = _step(len(nodes), len(joints))
    at = 0
    for channels in motion.blocks():
        for start in range(0, len(channels), step):
            part = channels[start : start + step]
            stop = at + len(part)
            if stop > motion.frames:
                break
            found, turned[:, at:stop] = kinematics.forward(nodes, part, oriented, fit.nodes)
            fit.apply(found, joints, positions[:, :, at:stop])
            at = stop
    if at != motion.frames:
        raise changed(motion.path)
    return positions, turned


def _step(nodes: int, joints: int) -> int:
    return max(kinematics.BLOCK, _BLOCK_SIZE // max(nodes, joints))


def posed_bytes(frames: int, size: int, nodes: int, joints: int) -> int:
    """Estimate the memory in bytes that `posed` takes for a text of `size` bytes.

    Besides the result these are a block of text, its numbers, and nodes and joints of the frames in it.
    """
    in_block = min(frames, 1 + 2 * frames * BLOCK // max(size, 1), _step(nodes, joints))
    return body_bytes(frames, joints) + 7 * min(size, BLOCK) + in_block * (24 * nodes + 96 * joints + 72)


@dataclass(frozen=True)
class UnitStatement:
    """The statement of a file's unit of length.

    Attributes
    ----------
    unit_m : float, optional
        Metres per unit; None to guess the unit from the size of the body.
    by : str
        The words for the source of the unit, the file or a shipped mapping; its unit is replaced if it gives no human
        height. Empty for the mapping of a user, whose unit is kept.
    session_m : float, optional
        Metres per unit of the other files of the folder, which count where the unit is doubtful.
    """

    unit_m: float | None
    by: str = ""
    session_m: float | None = None


def unit_statement(fit: Fit, file_m: float | None, settings: ReadSettings) -> UnitStatement:
    """Return the unit that a file states (metres, None if it states none), else that of its mapping."""
    by = "it states" if file_m is not None else f"mapping '{fit.mapping.name}' states" if is_shipped(fit) else ""
    return UnitStatement(file_m or fit.mapping.unit_m, by, settings.session_unit_m)


def to_metres(
    path: Path,
    positions: F64,
    stated: UnitStatement,
    joints: tuple[str, ...],
    warnings: list[str],
    evidence: list[str],
    frame: int = 0,
) -> str:
    """Scale positions to metres in place and return the unit in words.

    Parameters
    ----------
    path : Path
        The file, for messages.
    positions : float64 array (J, 3, T)
        Joint positions in the file's unit.
    stated : UnitStatement
        The unit that the file or its mapping states.
    joints : tuple of str
        The names of the J joints.
    warnings : list of str
        A sentence is appended if the unit that a file states is corrected, or if the unit is doubtful.
    evidence : list of str
        A sentence is appended if the unit is guessed.
    frame : int, optional
        First frame in which the body is measured.
    """
    unit_m, measured = stated.unit_m, positions[:, :, frame:]
    unit = f"{unit_m:.6g} m" if unit_m is not None else ""
    if unit_m is None:
        unit_m = _guessed_unit(path, measured, joints, stated, warnings, evidence)
        unit = f"{unit_m:.6g} m (guessed)"
    elif stated.by and (unlikely := unlikely_height(measured, joints, unit_m)) is not None:
        says = f"{stated.by} {unit_m:.6g} m, which makes the body {unlikely:.3g} m high"
        by_session = _session_unit(measured, joints, stated)
        found = by_session or contradicted_unit(measured, joints, unit_m)
        if found is None:
            warnings.append(f"{OPEN_SCALE}: {says}; another one is `unit_m` in a skeleton mapping of your own")
        else:
            name, unit_m, height = found
            unit = f"{unit_m:.6g} m (guessed)"
            so = f", {BY_SESSION}" if by_session is not None else ""
            warnings.append(f"{WRONG_UNIT}: {says}; it is read in {name}{so}, which make it {height:.2f} m high")
    positions *= unit_m
    return unit


def _guessed_unit(
    path: Path,
    positions: F64,
    joints: tuple[str, ...],
    stated: UnitStatement,
    warnings: list[str],
    evidence: list[str],
) -> float:
    """Return the metres of the unit that gives a human height or, if that is doubtful, of the session's unit."""
    name, unit_m, height = guess_unit(path, positions, joints)
    rival = rival_unit(unit_m, height)
    if rival is not None or name in FEET_M or not ADULT_M <= height <= HUMAN_M[1]:
        by_session = _session_unit(positions, joints, stated)
        if by_session is not None:
            name, unit_m, height = by_session
            rival = rival_unit(unit_m, height)
        so = "" if by_session is None else f", {BY_SESSION}"
        parts = [f"{OPEN_UNIT}: in {name} the body is {height:.2f} m high, read so{so}"]
        if rival is not None:
            parts.append(f"in {rival[0]} it would be {rival[1]:.2f} m high")
        elif name in FEET_M:
            parts.append("a rare unit")
        elif not ADULT_M <= height <= HUMAN_M[1]:
            parts.append("no grown person's height")
        warnings.append("; ".join([*parts, "state `unit_m` in a skeleton mapping"]))
    evidence.append(f"its unit of length is guessed: {name}, which makes the body {height:.2f} m high")
    return unit_m


def _session_unit(positions: F64, joints: tuple[str, ...], stated: UnitStatement) -> tuple[str, float, float] | None:
    """Return name and metres of the unit of the folder's other files, and the height in it; None if it is unlikely."""
    height = body_height(positions, joints)
    if stated.session_m is None or height is None:
        return None
    name, unit_m = known_unit(stated.session_m)
    return (name, unit_m, height * unit_m) if is_likely_height(height * unit_m) else None


def refuse_far(
    path: Path,
    positions: F64,
    joints: tuple[str, ...],
    unknown: tuple[str, ...],
    valid: npt.NDArray[np.bool_] | None = None,
) -> None:
    """Raise SourceError if a joint is so far away that a number of the file must be wrong."""
    if positions.min() >= -FARTHEST_M and positions.max() <= FARTHEST_M:
        return
    far = ~(np.abs(positions) <= FARTHEST_M)  # a NaN counts as well: it results from infinities
    far[[joints.index(joint) for joint in unknown]] = False
    if valid is not None:
        far &= valid | ~np.isnan(positions)
    if far.any():
        joint, _, frame = (int(at[0]) for at in np.nonzero(far))
        raise SourceError(
            path, f"joint '{joints[joint]}' is more than {FARTHEST_M / 1000:g} km away in source frame {frame}; is a "
            "number of this frame wrong, or the unit of the file?",
        )  # fmt: skip


def is_shipped(fit: Fit) -> bool:
    """Return whether a fit uses a mapping that comes with kinedex, neither recognised nor the user's."""
    return not fit.recognised and _in_configs(fit.mapping.path)


def skips_spine(fit: Fit, parents: Sequence[int], offsets: F64, twists: frozenset[int]) -> bool:
    """Return whether a shipped mapping skips bones between chest and neck, as Mixamo's does in longer spines.

    Parameters
    ----------
    fit : Fit
        The skeleton mapping that fits the nodes.
    parents : sequence of int
        The parent of each of N nodes.
    offsets : float64 array (N, 3)
        Each node's offset from its parent.
    twists : frozenset of int
        The nodes that only divide a bone.
    """
    chest, neck = fit.joints.get("chest"), fit.joints.get("neck")
    if not is_shipped(fit) or chest is None or neck is None or chest.node is None or neck.node is None:
        return False
    above, node = fit.indices[chest.node], parents[fit.indices[neck.node]]
    long = False
    while node >= 0 and node != above:
        long = long or (bool(offsets[node].any()) and node not in twists)
        node = parents[node]
    return long and node == above


@lru_cache(maxsize=64)
def _in_configs(path: Path) -> bool:
    """Return whether a file is one of the configurations that come with kinedex."""
    return path.is_relative_to(shipped_configs())


def _stands(positions: F64, joints: tuple[str, ...]) -> bool:
    """Return whether a body stands along Y in nearly all of a few frames, so that its up axis is clear."""
    wanted = ("head", "lankle", "rankle")
    if not set(wanted) <= set(joints):
        return False
    head, left, right = (positions[joints.index(joint)] for joint in wanted)
    step = max(1, positions.shape[2] // SAMPLED_FRAMES)
    with np.errstate(over="ignore", invalid="ignore"):  # Absurd numbers are refused later.
        up = head[:, ::step] - 0.5 * (left[:, ::step] + right[:, ::step])
        standing = up[1] > _UPRIGHT * np.sqrt((up * up).sum(axis=0))
    return bool(standing.mean() > _MOSTLY)


def turned_upright(fit: Fit, rest: F64, positions: F64, joints: tuple[str, ...]) -> tuple[Fit, tuple[str, ...]]:
    """Rotate the joints in place if an axis is up that differs from that of a shipped mapping.

    A user's own mapping is kept unchanged.

    Parameters
    ----------
    fit : Fit
        The skeleton mapping that fits the file.
    rest : float64 array (N, 3)
        The file's nodes in the rest pose.
    positions : float64 array (J, 3, T)
        The joints, which are rotated in place.
    joints : tuple of str
        The names of the J joints.

    Returns
    -------
    fit : Fit
        The mapping, rotated like the joints.
    reasons : tuple of str
        The reason for the rotation; empty if nothing is rotated.
    """
    if not is_shipped(fit) or _stands(positions, joints):
        return fit, ()
    frames = np.unique(np.linspace(0, positions.shape[2] - 1, SAMPLED_FRAMES).round().astype(np.int64))
    known = {joint: positions[i][:, frames] for i, joint in enumerate(joints) if joint not in fit.unknown}
    resting = None
    if np.array_equal(fit.mapping.root_axes, fit.mapping.axes):  # else the rest pose is no real pose
        placed = fit.apply(rest[:, :, None], joints)
        resting = {joint: placed[joints.index(joint)][:, 0] for joint in known}
    judged = judged_up(known, resting)
    if judged.axis in ("", "y"):
        return fit, ()
    turn = axes_of_up(judged.axis)
    positions[:] = np.einsum("ab,jbt->jat", turn, positions)
    up = "xyz"[int(np.argmax(np.abs(turn[1] @ fit.mapping.axes)))]
    mapping = replace(fit.mapping, axes=turn @ fit.mapping.axes)
    reason = f"{up} is up in this file, not the axis of mapping '{fit.mapping.name}': {'; '.join(judged.reasons)}"
    return replace(fit, mapping=mapping), (reason,)


def mapped_orientation(fit: Fit, turned: F64, own: F64 | None = None) -> F64:
    """Return the root's quaternions in kinedex's axes, after a change of basis from the file's axes.

    Parameters
    ----------
    fit : Fit
        The skeleton mapping that fits the file.
    turned : float64 array (9, T)
        Rotations of the root in the file's axes.
    own : float64 array (3, 3), optional
        The root's own axes at rest; by default those of the file.

    Returns
    -------
    float64 array (4, T)
        Unit quaternions w, x, y, z; NaN where the root is unknown.
    """
    if "root" in fit.unknown:
        return np.full((4, turned.shape[1]), np.nan)
    root_axes = fit.mapping.root_axes.T
    return kinematics.quaternions(turned, fit.mapping.axes, root_axes if own is None else own @ root_axes)
