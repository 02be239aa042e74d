"""Jumps of takes made from depth: frames whose pose is from the pose database, with the costs of the hypotheses."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow.compute as pc

from kinedex.pipelines.reconstruction.reconstructed_takes import explained_votes
from kinedex.storage.store.store import Store

MOST_JUMPS = 30
"""Maximum number of jumps of a take in its table: of more, those that reduced the cost most."""

MARGIN_S = 0.5
"""Seconds that are played before and after a jump."""


@dataclass(frozen=True)
class Jump:
    """A frame whose pose is from the pose database.

    Attributes
    ----------
    source_frame : int
        Frame of the recording, from 0.
    seconds : float
        Its time.
    direction : str
        Direction of time that it was found in.
    archive_take, archive_frame : str, int
        The take and frame of the archive that the pose is from.
    candidate : int
        Its number among the candidates of the frame, from 1.
    lookup_cost, trial_cost, cost : float or None
        The cost of the pose in the lookup, after a short fit, and in the vote.
    followed_cost : float or None
        The cost in the vote of the pose that was tracked from the frame before; None if there is none.
    start, stop : int
        Analysis frames around it.
    """

    source_frame: int
    seconds: float
    direction: str
    archive_take: str
    archive_frame: int
    candidate: int
    lookup_cost: float | None
    trial_cost: float | None
    cost: float
    followed_cost: float | None
    start: int
    stop: int


@dataclass(frozen=True)
class Jumps:
    """The jumps of a take.

    Attributes
    ----------
    shown : tuple of Jump
        Those in the table, in order of time.
    total : int
        The number of all.
    """

    shown: tuple[Jump, ...] = ()
    total: int = 0


def jumps_of(store: Store, stage: str, rows: Sequence[Mapping[str, Any]]) -> dict[str, Jumps]:
    """Return the jumps of takes by their names.

    Parameters
    ----------
    store : Store
        The store.
    stage : str
        The stage that has reconstructed, "<pipeline>/<stage>".
    rows : sequence of dict
        The rows of `reconstructions` of the takes.
    """
    votes = explained_votes(store, stage, [str(row["take"]) for row in rows])
    lent = votes.filter(pc.and_(votes.column("winner"), pc.equal(votes.column("hypothesis"), "database")))
    local = votes.filter(pc.equal(votes.column("hypothesis"), "local")).select(
        ["take", "source_frame", "direction", "cost"]
    )
    followed = {
        (take, frame, way): cost
        for take, frame, way, cost in zip(*(column.to_pylist() for column in local.columns), strict=True)
    }
    found: dict[str, list[Jump]] = defaultdict(list)
    of_take = {str(row["take"]): row for row in rows}
    for one in lent.to_pylist():
        row = of_take[one["take"]]
        before = followed.get((one["take"], one["source_frame"], one["direction"]))
        found[one["take"]].append(_jump(one, before, row["rate_hz"], store.take_frames[row["take_id"]], store.rate_hz))
    return {take: _most_telling(jumps) for take, jumps in found.items()}


def _jump(vote: Mapping[str, Any], followed: float | None, source_hz: float, total: int, rate_hz: float) -> Jump:
    seconds = vote["source_frame"] / source_hz
    return Jump(
        vote["source_frame"], seconds, vote["direction"], vote["archive_take"], vote["archive_frame"],
        vote["candidate"], vote["lookup_cost"], vote["trial_cost"], vote["cost"], followed,
        max(0, min(round((seconds - MARGIN_S) * rate_hz), total - 1)),
        max(1, min(round((seconds + MARGIN_S) * rate_hz), total)),
    )  # fmt: skip


def _most_telling(jumps: Sequence[Jump]) -> Jumps:
    """Return the jumps that a table shows: starts of tracking, then the jumps that reduced the cost most."""

    def gain(one: Jump) -> float:
        return float("inf") if one.followed_cost is None else one.followed_cost - one.cost

    chosen = sorted(jumps, key=lambda one: (-gain(one), one.source_frame))[:MOST_JUMPS]
    return Jumps(tuple(sorted(chosen, key=lambda one: one.source_frame)), len(jumps))
