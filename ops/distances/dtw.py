"""Distance curves: how well a template fits a take up to every frame (subsequence DTW)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ops.distances.costs import F64, I64, CodedWords, cost_table, encode, lay_out
from ops.distances.sweep import pieces_of, sweep, trace_paths
from ops.errors import ParameterError
from ops.templates.templates import QuantisedTemplate
from ops.words import U64

_TABLE_CELLS = 4_000_000  # of a cost table held at once: 32 MB, whatever the length of the takes
_PIECE = 4096  # frames of a stretch that are computed apart from the rest of it


def distance_curves(
    templates: Sequence[QuantisedTemplate],
    words: U64,
    ranges: I64 | None = None,
    dtype: type[np.floating[Any]] = np.float64,
) -> npt.NDArray[Any]:
    """Return the distance curve of every template (thesis, Eq. 5.1 to 5.3).

    The local cost of a column against a frame is the share of the column's bits that the frame contradicts, of their
    weight where features have weights (Σ_f weight_f · contradicted_f / Σ_f weight_f over the fixed entries f), 0 for
    a column of wildcards alone, ∞ for a frame without a word. Steps (template, take) are (1,1), (1,2) and (2,1); a
    (2,1) step counts the local cost twice. A path starts at any frame, in the template's first column. Time is
    proportional to columns × frames. Memory, besides the result, is 20 to 28 bytes a frame while the words are numbered
    and 4 to 12 after that; tables of costs and sums are bounded, however long the take and however many its words.

    Parameters
    ----------
    templates: T templates, of N_1 … N_T columns.
    words: uint64 (L,), the take's words (or those of many takes, with `ranges` that keep them apart).
    ranges: int64 (R, 2), half-open stretches of frames, ascending and apart; each is computed as if it were a
        take of its own. None: all of `words` is one take.
    dtype: float64; or float32, twice as fast, within `ops.distances.costs.error_bound` of float64.

    Returns
    -------
    dtype (T, L): at frame l the cost of the best path that ends there, divided by N; ∞ where none exists
    (about the first N / 2 frames of a stretch, across frames without a word, and outside the stretches).

    Raises
    ------
    ParameterError: if the ranges are not ascending stretches within the words.
    """
    stretches = check_ranges(ranges, len(words))
    curves = np.full((len(templates), len(words)), np.inf, dtype)
    if not templates or not len(stretches):
        return curves
    layout = lay_out(templates)
    reach = 2 * (int(layout.lengths.max()) - 1)
    room = max(1, _TABLE_CELLS // len(layout.masks))
    # Where the words together are few, one table serves all frames; else stretches of frames get tables of their own.
    start, stop = int(stretches[0, 0]), int(stretches[-1, 1])
    coded = encode(words[start:stop])
    few = len(coded.vocabulary) <= room
    for pieces in _batches(pieces_of(stretches, _PIECE if few else min(_PIECE, room), reach), stop if few else room):
        if not few:
            start, stop = int(pieces[0, 0]), int(pieces[-1, 2])
            coded = encode(words[start:stop])
        table = cost_table(layout, coded.vocabulary, dtype)
        sweep(table, coded.codes, pieces - start, layout.firsts, layout.lasts, curves[:, start:stop])
    curves /= layout.lengths[:, None].astype(dtype)
    return curves


def start_frames(template: QuantisedTemplate, words: U64, ends: I64, ranges: I64 | None = None) -> I64:
    """Return where the best path that ends at each of some frames begins (thesis, 5.2: the frame a_l).

    Among equally cheap paths the one is taken that, read from its end, prefers (1,1), then (1,2), then (2,1).

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
    starts, distances = best_paths(template, words, ends, ranges)
    if np.any(np.isinf(distances)):
        raise ParameterError("ends", "frames at which a path ends", np.asarray(ends)[np.isinf(distances)].tolist()[:8])
    return starts


def best_paths(
    template: QuantisedTemplate,
    words: U64,
    ends: I64,
    ranges: I64 | None = None,
    limits: F64 | None = None,
    coded: CodedWords | None = None,
) -> tuple[I64, F64]:
    """Return where the best path that ends at each of some frames begins, and its distance.

    A path of N columns that ends at frame l begins at l − 2(N − 1) or later, so a window is enough; ends that
    lie close together share one.

    Parameters
    ----------
    template, words, ranges: as in `distance_curves`.
    ends: int64 (E,), ascending frames.
    limits: float64 (E,), what the distances are known not to exceed: dearer cells need not be computed.
    coded: `encode(words)`, where it is known: then each word's costs are computed once.

    Returns
    -------
    int64 (E,), −1 where no path ends; float64 (E,), what `distance_curves` has there.

    Raises
    ------
    ParameterError: if an end is outside the words or the ranges, or ends do not ascend.
    """
    stretches = check_ranges(ranges, len(words))
    ends = np.ascontiguousarray(ends, np.int64)
    if np.any(np.diff(ends) <= 0):
        raise ParameterError("ends", "ascending", ends.tolist()[:8])
    home = np.searchsorted(stretches[:, 0], ends, side="right") - 1
    if len(ends) and (home.min() < 0 or np.any(ends >= stretches[home, 1])):
        raise ParameterError("ends", "frames within the ranges", ends.tolist()[:8])
    starts, sums = np.empty(len(ends), np.int64), np.empty(len(ends))
    if not len(ends):
        return starts, sums
    columns = len(template)
    reach = 2 * (columns - 1)
    opens = np.maximum(ends - reach, stretches[home, 0])
    # A window of its own costs 0.75 N² cells; a shared one N for each frame between two ends. One that would grow large
    # is divided, which costs another window but no path.
    block = ends // max(reach + 1, _TABLE_CELLS // columns)
    apart = (np.diff(ends) > 0.75 * columns) | (home[1:] != home[:-1]) | (block[1:] != block[:-1])
    groups = np.concatenate(([0], np.flatnonzero(apart) + 1, [len(ends)])).astype(np.int64)
    layout = lay_out([template])
    most = np.full(len(groups) - 1, np.inf)
    if limits is not None:
        most = np.maximum.reduceat(limits, groups[:-1]) * columns * (1 + 1e-9)
    if coded is None:
        coded = CodedWords(np.ascontiguousarray(words, np.uint64), np.arange(len(words), dtype=np.int32))
    trace_paths(
        coded.vocabulary, coded.codes, layout.values[:columns], layout.parts[:, :columns], layout.worths[:, :columns],
        layout.counted[:columns], ends, opens, groups, most, starts, sums,
    )  # fmt: skip
    return starts, sums / columns


def check_ranges(ranges: I64 | None, frames: int) -> I64:
    """Return the stretches as int64 (R, 2), empty ones left out; raise ParameterError if they are wrong."""
    if ranges is None:
        return np.array([[0, frames]] if frames else np.empty((0, 2)), np.int64)
    stretches = np.ascontiguousarray(ranges, np.int64).reshape(-1, 2)
    edges = stretches.ravel()
    if len(edges) and (edges[0] < 0 or edges[-1] > frames or np.any(np.diff(edges) < 0)):
        raise ParameterError("ranges", f"ascending stretches within {frames} frames", stretches.tolist()[:4])
    return stretches[stretches[:, 0] < stretches[:, 1]]


def _batches(pieces: I64, frames: int) -> Iterator[I64]:
    """Divide pieces into consecutive groups that span so many frames at most, and at least one piece."""
    first = 0
    for place in range(1, len(pieces) + 1):
        if place == len(pieces) or pieces[place, 2] - pieces[first, 0] > frames:
            yield pieces[first:place]
            first = place
