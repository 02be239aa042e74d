"""Distance curves: how well a template fits a take up to every frame (subsequence DTW)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numba as nb
import numpy as np
import numpy.typing as npt

from ops.errors import ParameterError
from ops.templates import QuantisedTemplate
from ops.words import U64

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

_TABLE_CELLS = 4_000_000  # of a cost table held at once: 32 MB, whatever the length of the takes


def distance_curves(templates: Sequence[QuantisedTemplate], words: U64, ranges: I64 | None = None) -> F64:
    """Return the distance curve of every template (thesis, Eq. 5.1 to 5.3).

    The local cost of a column against a frame is the share of the column's bits that the frame contradicts, 0
    for a column of wildcards alone. Steps (template, take) are (1,1), (1,2) and (2,1); a (2,1) step counts
    the local cost twice. A path starts at any frame, in the template's first column. Time is proportional to
    columns × frames; memory (besides the result) is bounded, however long the take and however many its words.

    Parameters
    ----------
    templates: T templates, of N_1 … N_T columns.
    words: uint64 (L,), the take's words (or those of many takes, with `ranges` that keep them apart).
    ranges: int64 (R, 2), half-open stretches of frames, ascending and apart; each is computed as if it were a
        take of its own. None: all of `words` is one take.

    Returns
    -------
    float64 (T, L): at frame l the cost of the best path that ends there, divided by N; ∞ where none exists
    (about the first N / 2 frames of a stretch, and outside the stretches).

    Raises
    ------
    ParameterError: if the ranges are not ascending stretches within the words.
    """
    stretches = check_ranges(ranges, len(words))
    curves = np.full((len(templates), len(words)), np.inf)
    if not templates or not len(stretches):
        return curves
    masks = np.concatenate([template.mask for template in templates])
    values = np.concatenate([template.value for template in templates])
    offsets = np.concatenate(([0], np.cumsum([len(template) for template in templates]))).astype(np.int64)
    carried = np.empty((2, len(masks)))
    for batch, continues in _batches(stretches, max(1, _TABLE_CELLS // len(masks))):
        if not continues:
            carried[:] = np.inf
        start, stop = int(batch[0, 0]), int(batch[-1, 1])
        vocabulary, codes = np.unique(words[start:stop], return_inverse=True)
        table = local_costs(masks, values, vocabulary)
        fill_curves(table, codes.astype(np.int64), batch - start, offsets, carried, curves[:, start:stop])
    return curves


def start_frames(template: QuantisedTemplate, words: U64, ends: I64, ranges: I64 | None = None) -> I64:
    """Return where the best path that ends at each of some frames begins (thesis, 5.2: the frame a_l).

    A path of N columns that ends at frame l begins at l − 2(N − 1) or later, so a window is enough; ends whose
    windows overlap share one. Among equally cheap paths the one is taken that, read from its end, prefers
    (1,1), then (1,2), then (2,1).

    Parameters
    ----------
    template, words, ranges: as in `distance_curves`.
    ends: int64 (E,), ascending frames at which the curve is finite.

    Returns
    -------
    int64 (E,).

    Raises
    ------
    ParameterError: if an end is outside the words or the ranges, no path ends there, or ends do not ascend.
    """
    stretches = check_ranges(ranges, len(words))
    ends = np.ascontiguousarray(ends, np.int64)
    if np.any(np.diff(ends) <= 0):
        raise ParameterError("ends", "ascending", ends.tolist()[:8])
    home = np.searchsorted(stretches[:, 0], ends, side="right") - 1
    if len(ends) and (home.min() < 0 or np.any(ends >= stretches[home, 1])):
        raise ParameterError("ends", "frames within the ranges", ends.tolist()[:8])
    starts = np.empty(len(ends), np.int64)
    reach = 2 * (len(template) - 1)
    opens = np.maximum(ends - reach, stretches[home, 0]) if len(ends) else ends
    # A group ends where the next window opens after the last end, or belongs to another stretch; and where its table of
    # costs would grow large, which costs another window but no path.
    block = ends // max(reach + 1, _TABLE_CELLS // len(template))
    breaks = np.flatnonzero((opens[1:] > ends[:-1]) | (home[1:] != home[:-1]) | (block[1:] != block[:-1])) + 1
    for group in np.split(np.arange(len(ends)), breaks):
        if not len(group):
            continue
        start, stop = int(opens[group[0]]), int(ends[group[-1]]) + 1
        costs = local_costs(template.mask, template.value, words[start:stop])
        starts[group] = trace_starts(costs, ends[group] - start) + start
        if np.any(starts[group] < start):
            raise ParameterError("ends", "frames at which a path ends", ends[group].tolist()[:8])
    return starts


def check_ranges(ranges: I64 | None, frames: int) -> I64:
    """Return the stretches as int64 (R, 2), empty ones left out; raise ParameterError if they are wrong."""
    if ranges is None:
        return np.array([[0, frames]] if frames else np.empty((0, 2)), np.int64)
    stretches = np.ascontiguousarray(ranges, np.int64).reshape(-1, 2)
    edges = stretches.ravel()
    if len(edges) and (edges[0] < 0 or edges[-1] > frames or np.any(np.diff(edges) < 0)):
        raise ParameterError("ranges", f"ascending stretches within {frames} frames", stretches.tolist()[:4])
    return stretches[stretches[:, 0] < stretches[:, 1]]


def local_costs(masks: U64, values: U64, words: U64) -> F64:
    """Return the local cost of every word against every column, float64 (W, N) (thesis, Eq. 5.2)."""
    counted = np.maximum(np.bitwise_count(masks), 1).astype(np.float64)
    return np.bitwise_count((words[:, None] ^ values) & masks) / counted


def _batches(stretches: I64, frames: int) -> Iterator[tuple[I64, bool]]:
    """Divide stretches into consecutive groups that span so many frames at most; and a longer stretch into blocks.

    The flag says whether the group's first stretch goes on where the block before it ended.
    """
    group: list[tuple[int, int]] = []
    continues = False
    for begin, stop in stretches.tolist():
        start = begin
        if group and stop - group[0][0] > frames:
            yield np.array(group, np.int64), continues
            group, continues = [], False
        while stop - start > frames:
            yield np.array([[start, start + frames]], np.int64), continues
            start, continues = start + frames, True
        group.append((start, stop))
    if group:
        yield np.array(group, np.int64), continues


@nb.njit(cache=True, nogil=True)
def advance(here: F64, last: F64, previous: F64, cost: F64) -> None:
    """Fill columns 2 … of a frame from the two frames before it (kernel; counts from 0 upwards to vectorise)."""
    for n in range(len(here) - 2):
        one, two = last[n + 1], previous[n + 1]
        single = (one if one < two else two) + cost[n]
        double = last[n] + 2.0 * cost[n]
        here[n + 2] = double if double < single else single


@nb.njit(cache=True, nogil=True)
def fill_curves(table: F64, codes: I64, stretches: I64, offsets: I64, carried: F64, curves: F64) -> None:
    """Fill the curves of all templates frame by frame, over their concatenated columns (kernel).

    All three steps advance the take and none stays in its row, so a frame depends on the two frames before
    it only, and the inner loop vectorises. `carried` (2, columns) holds what these two are before the first stretch,
    ∞ where it begins there, and in the end those of the last.
    """
    columns = table.shape[1]
    templates = len(offsets) - 1
    for stretch in range(len(stretches)):
        previous = np.full(columns, np.inf)
        last = np.full(columns, np.inf)
        here = np.full(columns, np.inf)
        if stretch == 0:
            previous[:] = carried[0]
            last[:] = carried[1]
        for frame in range(stretches[stretch, 0], stretches[stretch, 1]):
            cost = table[codes[frame]]
            advance(here, last, previous, cost[2:])
            for t in range(templates):  # the first two columns of a template know nothing of the one before
                first = offsets[t]
                here[first] = cost[first]
                if offsets[t + 1] - first > 1:
                    here[first + 1] = min(last[first], previous[first]) + cost[first + 1]
                curves[t, frame] = here[offsets[t + 1] - 1] / (offsets[t + 1] - first)
            previous, last, here = last, here, previous
        carried[0] = previous
        carried[1] = last


@nb.njit(cache=True, nogil=True)
def trace_starts(costs: F64, ends: I64) -> I64:
    """Carry the start frame of the best path along with its cost; return it at the ends, −1 for none (kernel)."""
    frames, columns = costs.shape
    found = np.empty(len(ends), np.int64)
    distance = np.full((3, columns), np.inf)
    origin = np.full((3, columns), -1, np.int64)
    place = 0
    for frame in range(frames):
        here, last, previous = frame % 3, (frame - 1) % 3, (frame - 2) % 3
        distance[here, 0] = costs[frame, 0]
        origin[here, 0] = frame
        for n in range(1, columns):
            best = distance[last, n - 1] + costs[frame, n]
            start = origin[last, n - 1]
            other = distance[previous, n - 1] + costs[frame, n]
            if other < best:
                best = other
                start = origin[previous, n - 1]
            if n > 1:
                other = distance[last, n - 2] + 2.0 * costs[frame, n]
                if other < best:
                    best = other
                    start = origin[last, n - 2]
            distance[here, n] = best
            origin[here, n] = start
        if place < len(ends) and ends[place] == frame:
            found[place] = origin[here, columns - 1]
            place += 1
    return found
