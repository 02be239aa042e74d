"""Motions inside of a page, for its player: joint positions, packed to a few bytes per frame."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from kinedex.catalog.skeletons.joint_tree import JOINT_PARENTS
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.pipelines.console.wording import few
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store

MOST_BYTES = 12_000_000
"""Largest size of the motions of a page unless more are requested; the page then has less than 20 MB."""

UNSEEN = -32_768
"""The number that stands for an unknown coordinate."""

_STEP = 2  # every second frame: 15 per second; the player interpolates
_MOST = 32_000

Embed = Literal["auto", "all", "none"] | list[str]


@dataclass(frozen=True)
class Motion:
    """A take, or a piece of one, in the form that the player reads.

    Attributes
    ----------
    take : str
        Name of the take.
    first, frames : int
        The first analysis frame, and the number of them.
    total : int
        Analysis frames of the take.
    step : int
        Every step-th frame is stored.
    rate_hz : float
        Stored frames per second.
    unit_m : float
        Metres per unit of the coordinates.
    data : str
        Base64 of zlib-compressed little-endian int16 (3 J, T'): x, y and z of every joint in units, each row as
        differences over time.
    """

    take: str
    first: int
    frames: int
    total: int
    step: int
    rate_hz: float
    unit_m: float
    data: str


@dataclass(frozen=True)
class Motions:
    """The motions of a page, the joints in their order, the parent of each (−1 for none), and a remark."""

    motions: tuple[Motion, ...]
    joints: tuple[str, ...]
    parents: tuple[int, ...]
    remark: str

    @property
    def takes(self) -> frozenset[str]:
        """Return the names of the takes."""
        return frozenset(motion.take for motion in self.motions)


def embed(
    store: Store,
    takes: Sequence[str] | Mapping[str, Sequence[str]],
    wanted: Embed = "auto",
    stage: str = "report",
) -> Motions:
    """Pack the motions of takes.

    Parameters
    ----------
    store : Store
        The store of the takes.
    takes : sequence of str, or mapping of str to sequence of str
        The takes with a timeline, in the order of the page; a mapping gives the takes of the store that each one joins.
    wanted : {"auto", "all", "none"} or list of str
        "auto" packs as many takes, from the first, as fit into `MOST_BYTES`; a list packs these.
    stage : str
        Stage whose parameter `wanted` is, for the remark.

    Returns
    -------
    Motions
        The packed motions.

    Raises
    ------
    KinedexError
        If a take of the list has no timeline.
    """
    parts = takes if isinstance(takes, Mapping) else {name: (name,) for name in takes}
    if isinstance(wanted, list):
        unknown = [name for name in wanted if name not in takes]
        if unknown:
            raise KinedexError(
                f"embed: no take with a timeline is named '{unknown[0]}'{did_you_mean(unknown[0], takes)}"
            )
    chosen = [] if wanted == "none" else list(wanted) if isinstance(wanted, list) else list(takes)
    joints = tuple(joint for joint in store.feature_set.joints if joint in JOINT_PARENTS)
    parents = tuple(joints.index(parent) if (parent := JOINT_PARENTS[joint]) in joints else -1 for joint in joints)
    packed: list[Motion] = []
    size = 0
    for name in chosen:
        positions = [joint_positions(store.frames(part), joints) for part in parts[name]]
        motion = pack(name, np.concatenate(positions, axis=2), store.rate_hz)
        if wanted == "auto" and size + len(motion.data) > MOST_BYTES:
            break
        packed.append(motion)
        size += len(motion.data)
    return Motions(tuple(packed), joints, parents, _remark(packed, len(takes), wanted, size, f"{stage}.embed"))


def pack(
    take: str, positions: npt.NDArray[np.floating], rate_hz: float, first: int = 0, total: int | None = None
) -> Motion:
    """Pack the positions of a take or of a piece of it.

    Parameters
    ----------
    take : str
        Name of the take.
    positions : float array (J, 3, T)
        Metres, Y up; NaN where unknown.
    rate_hz : float
        Frames per second.
    first : int
        Frame of the take that the piece begins with.
    total : int or None
        Frames of the take; None for those of `positions`.
    """
    kept = np.asarray(positions, np.float64)[:, :, ::_STEP]
    known = np.isfinite(kept)
    largest = float(np.abs(kept[known]).max()) if known.any() else 0.0
    unit_m = max(0.001, largest / _MOST)
    whole = np.where(known, np.round(np.where(known, kept, 0.0) / unit_m), UNSEEN).astype(np.int16)
    rows = whole.reshape(-1, whole.shape[2])
    steps = np.diff(rows, axis=1, prepend=np.int16(0))  # int16 wraps around, as that of the player does
    data = base64.b64encode(zlib.compress(steps.astype("<i2").tobytes(), 9)).decode("ascii")
    frames = positions.shape[2]
    return Motion(take, first, frames, frames if total is None else total, _STEP, rate_hz / _STEP, unit_m, data)


def motions_json(motions: Motions | None) -> Markup:
    """Return the motions as JSON for a script element, in which no tag can begin."""
    if motions is None:
        return Markup("")
    text = json.dumps(asdict(motions), ensure_ascii=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c"))


def _remark(carried: Sequence[Motion], shown: int, wanted: Embed, size: int, key: str) -> str:
    if not carried:
        return f"No motion is embedded; `--set {key}=all` embeds all that have a timeline."
    megabytes = f"{size / 1e6:.1f} MB"
    if len(carried) == shown:
        return f"Click a segment to see the motion. It is embedded for every take with a timeline ({megabytes})."
    why = "as requested" if wanted != "auto" else "the first ones, as many as fit into the page"
    return (
        f"Click a segment to see the motion. It is embedded for {len(carried)} of the {shown} takes with a timeline "
        f"({few([one.take for one in carried])}), {why} ({megabytes}); set `--set {key}=all` or a list of names for "
        "others."
    )
