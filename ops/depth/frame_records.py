"""This module packs the results of tracked frames, so that a long recording fits in memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.depth.extrema import COUNT
from kinedex.ops.depth.pose_fit import PoseCost
from kinedex.ops.depth.tracker import Candidate, FrameResult, Hypothesis

_HYPOTHESES: tuple[Hypothesis | None, ...] = (None, "local", "database")
_FIRST_ROOM = 256
_CANDIDATE = [
    ("row", "<i4"), ("lookup_cost", "<f8"), ("cost", "<f8"), ("ends", "<f8"),
    ("number", "<i4"), ("map", "i1", (5,)), ("sum", "<f8"),
]  # fmt: skip


def _layout(candidates: int) -> np.dtype[np.void]:
    """Return the fields of the record of a frame with at most this number of candidates."""
    fields = [
        ("is_image", "?"), ("hypothesis", "i1"), ("started", "?"), ("people", "<i4"), ("row", "<i4"),
        ("pose", "<f8", (len(JOINTS), 3)), ("extrema", "<f4", (COUNT, 3)), ("facing", "<f8", (3,)),
        ("centre", "<f8", (3,)), ("costs", "<f8", (2, 4)), ("sizes", "<i4", (3,)), ("unseen", "?", (len(JOINTS),)),
        ("box", "<i4", (4,)), ("maps", "<i4"), ("tried", "i1"), ("candidates", _CANDIDATE, (candidates,)),
    ]  # fmt: skip
    return np.dtype(fields)  # type: ignore[no-any-return, arg-type, unused-ignore]


class FrameRecords(Sequence[FrameResult | None]):
    """The results of frames in order of time, in packed form; `records[t]` is None for a frame without an image.

    The poses of the two hypotheses are dropped, extrema are rounded to float32, and of the assignments of end effectors
    to extrema only those by which a candidate was found are kept; others become 0.

    Parameters
    ----------
    candidates : int
        The largest number of candidates of a frame.
    frames : int, optional
        The number of frames to allocate; more can be appended.
    """

    def __init__(self, candidates: int, frames: int = _FIRST_ROOM) -> None:
        self._rows = np.zeros(max(1, frames), _layout(candidates))
        self._length = 0

    def append(self, result: FrameResult | None) -> None:
        """Add the result of the next frame; None for one without an image."""
        if self._length == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        self._length += 1
        self[self._length - 1] = result

    def reverse(self) -> None:
        """Reverse the order of the frames."""
        self._rows = self._rows[: self._length][::-1]

    @property
    def poses(self) -> F64:
        """Return the poses, float64 (T, 24, 3); NaN without an image or a person."""
        rows = self._rows[: self._length]
        return np.where(rows["is_image"][:, None, None], rows["pose"], np.nan)

    @property
    def costs(self) -> F64:
        """Return the cost of each chosen pose, float64 (T,); NaN without an image or a person."""
        rows = self._rows[: self._length]
        totals = np.concatenate([np.full((self._length, 1), np.nan), rows["costs"][:, :, 0]], axis=1)
        found: F64 = np.where(rows["is_image"], totals[np.arange(self._length), rows["hypothesis"]], np.nan)
        return found

    @property
    def nbytes(self) -> int:
        """Return the size of the records in bytes."""
        return self._rows[: self._length].nbytes

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[FrameResult | None]:
        return (self[t] for t in range(self._length))

    def __setitem__(self, t: int, result: FrameResult | None) -> None:
        row = self._rows[range(self._length)[t]]
        row["is_image"] = result is not None
        if result is None:
            return
        row["hypothesis"] = _HYPOTHESES.index(result.hypothesis)
        for name in ("started", "people", "row", "pose", "extrema", "facing", "centre", "unseen", "box"):
            row[name] = getattr(result, name)
        row["sizes"] = result.points, result.components, result.links
        row["costs"] = np.nan
        for k, cost in enumerate(result.parts):
            if cost is not None:
                row["costs"][k] = cost
        row["maps"], row["tried"] = len(result.maps), len(result.candidates)
        for k, one in enumerate(result.candidates):
            ends = result.maps[one.map]
            row["candidates"][k] = (one.row, one.lookup_cost, one.cost, one.ends, one.map, ends, result.sums[one.map])

    def __getitem__(self, t: int) -> FrameResult | None:  # type: ignore[override]
        row = self._rows[range(self._length)[t]]
        if not row["is_image"]:
            return None
        maps, sums = np.zeros((row["maps"], 5), np.int64), np.full(row["maps"], np.nan)
        candidates = []
        for one in row["candidates"][: row["tried"]]:
            maps[one["number"]], sums[one["number"]] = one["map"], one["sum"]
            numbers = (int(one["row"]), float(one["lookup_cost"]), int(one["number"]))
            candidates.append(Candidate(*numbers, float(one["cost"]), float(one["ends"])))
        local, database = (None if np.isnan(one[0]) else PoseCost(*one.tolist()) for one in row["costs"])
        points, components, links = row["sizes"].tolist()
        return FrameResult(
            pose=row["pose"], hypothesis=_HYPOTHESES[row["hypothesis"]], cost_local=float(row["costs"][0, 0]),
            cost_database=float(row["costs"][1, 0]), row=int(row["row"]), local=None, database=None,
            extrema=row["extrema"].astype(np.float64), facing=row["facing"], centre=row["centre"], points=points,
            components=components, links=links, maps=maps, sums=sums, candidates=tuple(candidates),
            unseen=row["unseen"], started=bool(row["started"]), people=int(row["people"]), parts=(local, database),
            box=tuple(row["box"].tolist()),
        )  # fmt: skip
