"""Motions that a report carries, so that a click on a segment shows it: joint positions, packed to a few bytes a
frame."""

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
"""What a report carries of its own accord; with everything else it stays below 20 MB."""

UNSEEN = -32_768
"""Stands for a coordinate that is not known."""

_STEP = 2  # every second frame: 15 a second, and the player goes between them
_MOST = 32_000

Embed = Literal["auto", "all", "none"] | list[str]


@dataclass(frozen=True)
class Motion:
    """One take as the player reads it.

    frames: of the take, at the analysis rate. step: one of so many frames is kept. rate_hz: of those. unit_m: metres a
    unit. data: base64 of zlib-compressed little-endian int16 (3 J, T'): x, y and z of every joint in units, each row as
    differences in time.
    """

    take: str
    frames: int
    step: int
    rate_hz: float
    unit_m: float
    data: str


@dataclass(frozen=True)
class Motions:
    """What a report carries: the motions, the joints in their order, the parent of each (−1: none), and a word on
    it."""

    motions: tuple[Motion, ...]
    joints: tuple[str, ...]
    parents: tuple[int, ...]
    remark: str

    @property
    def takes(self) -> frozenset[str]:
        """The names of the takes whose motion is carried."""
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
    takes: those with a timeline, in their order on the page; or by name the takes of the store that one is laid out of,
        end to end. wanted: "auto": as many of them, from the first, as fit into `MOST_BYTES`; "all" of them, "none", or
        these by name. stage: whose parameter `wanted` is.

    Raises
    ------
    KinedexError: a take is asked for that has no timeline.
    """
    parts = takes if isinstance(takes, Mapping) else {name: (name,) for name in takes}
    if isinstance(wanted, list):
        unknown = [name for name in wanted if name not in takes]
        if unknown:
            raise KinedexError(f"embed: no timeline is of a take '{unknown[0]}'{did_you_mean(unknown[0], takes)}")
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


def pack(take: str, positions: npt.NDArray[np.floating], rate_hz: float) -> Motion:
    """Pack the positions of one take, (J, 3, T) in metres; NaN is not known."""
    kept = np.asarray(positions, np.float64)[:, :, ::_STEP]
    known = np.isfinite(kept)
    reach = float(np.abs(kept[known]).max()) if known.any() else 0.0
    unit_m = max(0.001, reach / _MOST)
    whole = np.where(known, np.round(np.where(known, kept, 0.0) / unit_m), UNSEEN).astype(np.int16)
    rows = whole.reshape(-1, whole.shape[2])
    steps = np.diff(rows, axis=1, prepend=np.int16(0))  # int16 wraps around, and the player's does as well
    data = base64.b64encode(zlib.compress(steps.astype("<i2").tobytes(), 9)).decode("ascii")
    return Motion(take, positions.shape[2], _STEP, rate_hz / _STEP, unit_m, data)


def motions_json(motions: Motions | None) -> Markup:
    """The motions as JSON that may stand inside a script element: no tag can begin in it."""
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
    why = "as asked for" if wanted != "auto" else "the first ones, as many as fit into the page"
    return (
        f"Click a segment to see the motion. It is embedded for {len(carried)} of the {shown} takes with a timeline "
        f"({few([one.take for one in carried])}), {why} ({megabytes}); `--set {key}=all`, or a list of names, changes "
        "that."
    )
