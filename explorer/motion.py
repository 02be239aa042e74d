"""Motions for the page: joint positions as 16-bit integers, of one take as a stream and of many small intervals.

An answer is a sequence of blocks. A block is a header of 48 bytes and the positions of consecutive stored frames,
everything little-endian:

    bytes 0 to 3      the letters KNX1
    bytes 4 to 19     uint32: stored frames F, joints J, first analysis frame, step (analysis frames per stored frame)
    bytes 20 to 39    float32: analysis frames per second, metres per unit, and the origin x, y, z in metres
    bytes 40 to 47    zero
    from byte 48      int16 (F, J, 3): position = origin + unit * number; −32768 is an unknown coordinate

Every block has its own origin and unit, so that a walk of kilometres is as precise as a step on the spot: the
error of a coordinate is at most half a unit. A take is cut into blocks that extend over at most 65 m, so that a unit is
at most 1 mm; it is larger only where joints of the same frame are farther apart.

`GET /api/takes/ID/motion` answers with the blocks of a take; `POST /api/figures` with a count (uint32), and for each
figure its length in bytes (uint32) and one block, which is moved and turned so that the body begins above the origin
and faces the viewer (+Z) with its left towards +X.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import Annotated

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from pydantic import Field
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from kinedex.explorer.endpoints import RequestBody, get, post, take_of
from kinedex.explorer.open_archive import Archive
from kinedex.ops.arrays import F32
from kinedex.ops.body.facing_direction import Placement, facing_yaw, start_at_origin
from kinedex.ops.cache import Cache
from kinedex.ops.cancellation import check_cancelled
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.ops.intervals import Interval
from kinedex.storage.snapshot.frames import read_intervals
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store

MAGIC = b"KNX1"
HEADER_BYTES = 48
UNKNOWN = -32_768
"""The number that stands for an unknown coordinate."""

FINEST_M = 0.0001
"""The smallest unit in metres."""

BLOCK_FRAMES = 3600
"""Maximum number of stored frames of a block, up to which blocks grow: two minutes, 520 KB."""

WIDEST_M = 65.0
"""Maximum extent of a block of several frames along an axis, for a unit of 1 mm."""

FIRST_FRAMES = 150
"""The number of stored frames of the first block, which is short so that the first pose is shown soon."""

MAX_FIGURES = 500
"""Maximum number of figures of one answer."""

_LARGEST = 32_767
_HEADER = struct.Struct("<4s4I5f8x")


class PositionCache:
    """A cache of the joint positions of recently read takes, with a limit of memory; several threads may use it.

    Parameters
    ----------
    most_bytes : int
        The largest size in bytes; above it, the least recently used takes are dropped.
    """

    def __init__(self, most_bytes: int = 64_000_000) -> None:
        self._most_bytes = most_bytes
        self._held: Cache[tuple[str, int, int], F32] = Cache(most_bytes, lambda one: one.nbytes)

    def positions(self, store: Store, take_id: int) -> F32:
        """Return the positions of a take, float32 (T, J, 3) in metres, NaN where unknown."""
        name, held = name_of(store, take_id), self._at_hand(store, take_id)
        if held is not None:
            return held
        joints = store.feature_set.joints
        _, table = next(store.frames_of([name], joints))
        read = _positions(table, joints)
        fits = read.nbytes <= self._most_bytes
        return self._held.put(_key(store, take_id), read) if fits else read

    def intervals(self, store: Store, items: Sequence[Interval]) -> Iterator[tuple[int, F32]]:
        """Yield the index and the positions of each interval, in any order; takes not cached are read in part."""
        missing = []
        for place, one in enumerate(items):
            held = self._at_hand(store, store.take_ids[one.take])
            if held is None:
                missing.append(place)
            else:
                yield place, held[one.start : one.stop]
        asked = [(store.take_ids[items[place].take], items[place].start, items[place].stop) for place in missing]
        joints = store.feature_set.joints
        for number, table in read_intervals(store.checked, store.manifest, asked, joints):
            yield missing[number], _positions(table, joints)

    def _at_hand(self, store: Store, take_id: int) -> F32 | None:
        return self._held.get(_key(store, take_id))


def _key(store: Store, take_id: int) -> tuple[str, int, int]:
    return str(store.path), store.manifest.version, take_id


POSITIONS = PositionCache()
"""The cache of the positions of recently requested takes."""


def _positions(table: pa.Table, joints: Sequence[str]) -> F32:
    """Return the positions in rows of a frames part, float32 (T, J, 3)."""
    return np.ascontiguousarray(joint_positions(table, joints).transpose(2, 0, 1))


def motion_blocks(
    cache: PositionCache, store: Store, take_id: int, first: int = 0, stop: int | None = None, step: int = 1
) -> Iterator[bytes]:
    """Yield the blocks of a take, in the format that the module describes.

    Parameters
    ----------
    cache : PositionCache
        The cache of joint positions.
    store : Store
        The store of the take.
    take_id : int
        The take.
    first, stop : int, optional
        Analysis frames; by default the whole take. An empty range yields one block without frames.
    step : int, optional
        Every step-th frame from the first on is sent.

    Raises
    ------
    KinedexError
        No take has this id.
    ParameterError
        The range is not within the take, or the step is not positive.
    """
    frames = frames_of(store, take_id)
    end = frames if stop is None else stop
    if not 0 <= first <= end <= frames:
        raise ParameterError("first and stop", f"a range within [0, {frames}), the frames of the take", (first, end))
    if step < 1:
        raise ParameterError("step", "at least 1", step)
    return _blocks(cache.positions(store, take_id)[first:end:step], store.rate_hz, first, step)


def _blocks(positions: F32, rate_hz: float, first: int, step: int) -> Iterator[bytes]:
    start, length = 0, FIRST_FRAMES
    while start < len(positions) or start == 0:
        part = positions[start : start + length]
        while len(part) > 1 and _extent(part) > WIDEST_M:
            part = part[: len(part) // 2]
        yield packed_positions(part, rate_hz, first + start * step, step)
        start, length = start + max(len(part), 1), min(4 * length, BLOCK_FRAMES)


def _extent(positions: F32) -> float:
    """Return the largest extent of known places along an axis, in metres."""
    low, high = _bounds(positions)
    return float(np.nan_to_num(high - low, neginf=0.0).max(initial=0.0))


def _bounds(positions: npt.NDArray[np.floating]) -> tuple[npt.NDArray[np.floating], npt.NDArray[np.floating]]:
    """Return the smallest and the largest known x, y and z; infinite for a coordinate that is never known."""
    # frames first: a pass along the long axis is ten times as fast as one along three numbers
    low = np.fmin.reduce(np.fmin.reduce(positions, 0, initial=np.inf), 0, initial=np.inf)
    return low, np.fmax.reduce(np.fmax.reduce(positions, 0, initial=-np.inf), 0, initial=-np.inf)


def name_of(store: Store, take_id: int) -> str:
    """Return the name of a take; raise a KinedexError if there is none of this id."""
    if take_id not in store.take_names:
        raise KinedexError(f"{store.path}: no take has the id {take_id}; `Store.takes()` lists those that are")
    return store.take_names[take_id]


def frames_of(store: Store, take_id: int) -> int:
    """Return the number of analysis frames of a take; raise a KinedexError if there is none of this id."""
    name_of(store, take_id)
    return store.take_frames[take_id]


def check_frame(store: Store, take_id: int, frame: int) -> None:
    """Raise a ParameterError if a take has no such frame."""
    frames = frames_of(store, take_id)
    if not 0 <= frame < frames:
        raise ParameterError("frame", f"from 0 to {frames - 1}, the frames of the take", frame)


def check_interval(store: Store, one: Interval, what: str) -> None:
    """Raise a ParameterError if an interval, called `what` in the message, is not within its take."""
    total = store.take_frames[store.take_ids[one.take]]
    if not 0 <= one.start < one.stop <= total:
        raise ParameterError(what, f"0 <= start < stop <= {total}, the frames of the take", (one.start, one.stop))


def packed_positions(positions: npt.NDArray[np.floating], rate_hz: float, first: int = 0, step: int = 1) -> bytes:
    """Encode joint positions as one block of bytes, in the format that the module describes.

    Parameters
    ----------
    positions : float array (F, J, 3)
        Metres, Y up; NaN where unknown.
    rate_hz : float
        Analysis frames per second.
    first : int
        Analysis frame of the first row.
    step : int
        Analysis frames from each row to the next.
    """
    places = np.asarray(positions, np.float64)
    low, high = _bounds(places)
    seen = np.isfinite(low) & np.isfinite(high)
    origin = np.where(seen, (np.where(seen, low, 0.0) + np.where(seen, high, 0.0)) / 2, 0.0).astype(np.float32)
    farthest = np.maximum(high - origin, origin - low)[seen].max(initial=0.0)
    unit = np.float32(max(FINEST_M, float(farthest) / (_LARGEST - 1)))
    numbers = np.rint((places - origin) / np.float64(unit))
    known = np.isfinite(numbers)
    if not known.all():
        numbers[~known] = UNKNOWN
    frames, joints = places.shape[:2]
    header = _HEADER.pack(MAGIC, frames, joints, first, step, rate_hz, unit, *origin.tolist())
    return header + numbers.astype("<i2").tobytes()


def figures(cache: PositionCache, store: Store, items: Sequence[Interval], frames: int) -> bytes:
    """Return many small motions in one answer, in the format that the module describes.

    Parameters
    ----------
    cache : PositionCache
        The cache of joint positions.
    store : Store
        The store of the takes.
    items : sequence of Interval
        The intervals, at most `MAX_FIGURES`; the answer has their order.
    frames : int
        The largest number of stored frames of a figure, at least 1; of longer intervals only every second, third, …
        frame is sent.

    Raises
    ------
    KinedexError
        The store has no take with one of the ids.
    ParameterError
        There are too many intervals, an interval is not within its take, or the number of frames is not positive.
    """
    if len(items) > MAX_FIGURES:
        raise ParameterError("items", f"at most {MAX_FIGURES} intervals", len(items))
    if frames < 1:
        raise ParameterError("frames", "at least 1", frames)
    for number, one in enumerate(items, 1):
        check_interval(store, one, f"interval {number}")
    found: list[bytes] = [b""] * len(items)
    for place, positions in cache.intervals(store, items):
        check_cancelled()
        one = items[place]
        step = -(-one.frames // frames)
        turned = facing_viewer(positions[::step], store.feature_set.joints)
        found[place] = packed_positions(turned, store.rate_hz, one.start, step)
    parts = [struct.pack("<I", len(found))]
    for block in found:
        parts += [struct.pack("<I", len(block)), block]
    return b"".join(parts)


def facing_viewer(positions: npt.NDArray[np.floating], joints: Sequence[str]) -> npt.NDArray[np.float64]:
    """Move and turn a motion so that its body begins above the origin and faces +Z; heights are unchanged.

    The direction is that of the first frame in which both hips (or both shoulders) are known. A motion without such a
    frame is only moved.

    Parameters
    ----------
    positions : float array (T, J, 3)
        Metres, Y up; NaN where unknown.
    joints : sequence of str
        Names of the joints.
    """
    places = np.asarray(positions, np.float64)
    known: npt.NDArray[np.bool_] = np.asarray(np.isfinite(places).all(axis=2))
    rows = np.flatnonzero(known.any(axis=1))
    if not len(rows):
        return places
    yaws = np.full(len(places), np.nan)
    for pair in (("lhip", "rhip"), ("lshoulder", "rshoulder")):
        if set(pair) <= set(joints) and not np.isfinite(yaws).any():
            left, right = (places[:, [joints.index(name)]] for name in pair)
            yaws = facing_yaw(left, right)
    whole = np.flatnonzero(np.isfinite(yaws))
    row = int(whole[0]) if len(whole) else int(rows[0])
    root = joints.index("root") if "root" in joints else 0
    x, _, z = places[row, root] if known[row, root] else places[row][known[row]].mean(axis=0)
    return start_at_origin(places, Placement(float(x), float(z), float(yaws[row]) if len(whole) else 0.0))


class FigureItem(RequestBody):
    """An interval of a take."""

    take_id: int
    start: int
    stop: int


class FiguresRequest(RequestBody):
    """Intervals to be shown as small figures."""

    items: Annotated[list[FigureItem], Field(max_length=MAX_FIGURES)]
    frames: Annotated[int, Field(ge=1, le=2000)] = 120


def whole_number(request: Request, name: str, absent: int | None = None) -> int:
    """Return a parameter of an address that is a whole number.

    Parameters
    ----------
    request : Request
        The request.
    name : str
        Name of the parameter.
    absent : int, optional
        The value if the parameter is missing; by default a missing parameter is an error.

    Raises
    ------
    ParameterError
        It is missing, or no whole number.
    """
    text = request.query_params.get(name)
    if text is None and absent is not None:
        return absent
    try:
        return int(text or "")
    except ValueError:
        raise ParameterError(name, f"a whole number in the address, such as {name}=30", text) from None


def _motion(archive: Archive, request: Request) -> Response:
    store, take = take_of(archive, request)
    first, step = whole_number(request, "first", 0), whole_number(request, "step", 1)
    stop = whole_number(request, "stop", frames_of(store, take))
    blocks = motion_blocks(POSITIONS, store, take, first, stop, step)
    return StreamingResponse(blocks, media_type="application/octet-stream")


def _figures(archive: Archive, asked: FiguresRequest, _request: Request) -> bytes:
    store = archive.store()
    items = [Interval(name_of(store, one.take_id), one.start, one.stop) for one in asked.items]
    return figures(POSITIONS, store, items, asked.frames)


routes = [get("/api/takes/{take:int}/motion", _motion), post("/api/figures", _figures, FiguresRequest)]
