"""This module decodes takes: it finds the sequence of motion templates that best explains all frames of a take.

The thesis labels each frame independently, with the nearest template (Chapter 5). Decoding instead finds an
explanation: a sequence of templates, with background in between. A frame that is assigned to a column of a template has
the likelihood of its word under that column's feature values; a background frame has the likelihood of its word under
the background postures (`ops.annotation.background`). The value of an explanation is the sum of the log ratios of these
two likelihoods over the labelled frames, less costs. Dynamic programming finds the explanation with the greatest value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinedex.ops.annotation.background import log_likelihoods
from kinedex.ops.annotation.decoding_kernels import (
    MAX_STEP,
    Columns,
    Costs,
    Frames,
    backwards,
    forwards,
    recomputed_at,
    rival_values,
)
from kinedex.ops.arrays import F64, I64, U64, Bool
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.errors import ParameterError
from kinedex.ops.templates.templates import QuantisedTemplate, Template

BLOCK_FRAMES = 32
"""The block length in frames: a template's promising ranges are widened to multiples of it."""

STANDING_OUT = 0.05
"""The value per frame, in nats per feature, at which a segment's background factor in `margins` is 1 − 1 / e."""


@dataclass(frozen=True)
class Decoding:
    """The parameters of decoding, in nats per frame and feature; chosen on clips of excluded actors.

    Parameters
    ----------
    smoothing : float
        Likelihoods are limited to the range from `smoothing` to 1 − `smoothing`.
    entry : float
        The cost of each segment, which suppresses short segments.
    skip : float
        The cost of each skipped column (at most two successive columns may be skipped), which allows fast performances.
    stay : float
        The cost of a frame in which a segment stays in its first or its last column, which keeps segments short.
    gain : float
        A constant that is added to the value of every labelled frame. With a greater gain, more frames are labelled;
        with a lower one, which may be negative, more frames are background.
    """

    smoothing: float = 0.03
    entry: float = 0.7
    skip: float = 0.02
    stay: float = 0.1
    gain: float = -0.01

    def __post_init__(self) -> None:
        if not 0.0 < self.smoothing < 0.5:
            raise ParameterError("smoothing", "above 0 and below 0.5", self.smoothing)
        for name in ("entry", "skip", "stay"):
            if not getattr(self, name) >= 0.0:
                raise ParameterError(name, "0 or more", getattr(self, name))
        if not np.isfinite(self.gain):
            raise ParameterError("gain", "finite", self.gain)

    @property
    def costs(self) -> Costs:
        """Return the costs as the tuple that kernels take."""
        return Costs(float(self.entry), float(self.skip), float(self.stay))


@dataclass(frozen=True, order=True)
class ExplainedSegment:
    """A segment of a take that decoding assigns to a template.

    Parameters
    ----------
    start, stop : int
        The half-open range of frames.
    template : int
        The index of the template.
    value : float
        The value that the segment contributes to the explanation, after subtraction of all costs.
    """

    start: int
    stop: int
    template: int
    value: float


def _linear(templates: Sequence[Template], usual: F64, decoding: Decoding) -> tuple[F64, F64]:
    """Return slopes (f, C) and intercepts (C,) of the score of a word in a column, which is linear in the word's bits.

    The score is the log likelihood of the word under the column, divided by the number f of features, plus the gain.
    """
    values = np.concatenate([template.values for template in templates])
    if usual.ndim != 2 or values.shape[1] != usual.shape[1]:
        raise ParameterError("usual", f"postures of {values.shape[1]} features", usual.shape)
    shares = np.clip(values, decoding.smoothing, 1.0 - decoding.smoothing)
    on, off = np.log(shares), np.log1p(-shares)
    features = values.shape[1]
    return np.ascontiguousarray((on - off).T) / features, off.sum(axis=1) / features + decoding.gain


def _offsets(words: U64, usual: F64, decoding: Decoding) -> F64:
    """Return for each word its negative log likelihood under the background, divided by the number of features.

    The postures `usual` describe the background; see `ops.annotation.background`.
    """
    return -log_likelihoods(words, usual, decoding.smoothing) / usual.shape[1]


def frames_of(words: U64 | Frames, usual: F64, decoding: Decoding) -> Frames:
    """Return the frames of a take in the form that kernels expect; reuse the result for several calls on one take."""
    if isinstance(words, Frames):
        return words
    vocabulary, codes = np.unique(words, return_inverse=True)
    return Frames(np.ascontiguousarray(words), _offsets(vocabulary, usual, decoding)[codes])


def concatenated_columns(templates: Sequence[Template], usual: F64, decoding: Decoding) -> Columns:
    """Concatenate the columns of all templates for `explain` and `margins`; reuse the result for many takes.

    Parameters
    ----------
    templates : sequence of Template
        T templates.
    usual : float64 array (K, f)
        The usual postures, see `ops.annotation.background.background`.
    decoding : Decoding
        The parameters of decoding.
    """
    slopes, intercepts = _linear(templates, usual, decoding)
    lengths = np.array([len(template) for template in templates], np.int64)
    firsts = np.cumsum(lengths + MAX_STEP) - lengths
    real = np.concatenate([np.arange(first, first + length) for first, length in zip(firsts, lengths, strict=True)])
    width = int(lengths.sum()) + MAX_STEP * len(lengths)
    columns = Columns(np.zeros((len(slopes), width)), np.full(width, -np.inf), firsts, lengths)
    columns.slopes[:, real], columns.intercepts[real] = slopes, intercepts
    return columns


def explain(
    templates: Sequence[Template],
    usual: F64,
    words: U64 | Frames,
    decoding: Decoding,
    ranges: Sequence[I64] | None = None,
    columns: Columns | None = None,
    promising: I64 | None = None,
    loose: I64 | None = None,
) -> list[ExplainedSegment]:
    """Find the explanation of a take with the greatest value.

    A segment begins in a template's first column and ends in its last. From one frame to the next it may advance by
    one, two or three columns, where each skipped column costs `skip`. A column may also last for two or three frames,
    and the first and the last column for any number of frames. Segments do not overlap. The frames between them are
    background and have the value 0.

    Parameters
    ----------
    templates : sequence of Template
        T templates.
    usual : float64 array (K, f)
        The usual postures, see `ops.annotation.background.background`.
    words : uint64 array (L,) or Frames
        The words of one take, or the result of `frames_of` for them.
    decoding : Decoding
        The parameters of decoding.
    ranges : sequence of int64 array (R, 2), optional
        For each template the half-open ranges that it may explain, ascending and disjoint; None for all frames.
    columns : Columns, optional
        The result of `concatenated_columns` for the same templates; computed if it is not given.
    promising : int64 array (R, 3), optional
        The result of `ops.annotation.promising_ranges` for the same arguments, with which the same explanation is found
        faster.
    loose : int64 array (R, 3), optional
        The result of `ops.annotation.promising_ranges.loose_ranges`, which is meant for calls without `ranges`. With
        it, the same explanation is found faster, and its values are the same to the last bit.

    Returns
    -------
    list of ExplainedSegment
        The segments in order of time; none if no explanation has a value above 0. Of templates that fit equally well,
        the first is chosen.

    Raises
    ------
    ParameterError
        If the templates have no or different numbers of features.
    """
    frames = frames_of(words, usual, decoding)
    if not templates or not len(frames.words):
        return []
    columns = columns or concatenated_columns(templates, usual, decoding)
    allowed, changes = _allowed(ranges, len(templates), len(frames.words))
    if promising is not None:
        allowed, changes = _allowed_and_promising(allowed, changes, promising)
    origins = np.maximum(changes[:-1] - MAX_STEP + 1, 0)
    if loose is not None:
        allowed, changes = _allowed_and_promising(allowed, changes, loose)
        origins = recomputed_at(frames.words)[np.maximum(changes[:-1] - MAX_STEP + 1, 0)]
    value, winner = forwards(frames, columns, decoding.costs, allowed, changes, origins)
    found = backwards(frames, columns, decoding.costs, allowed, value, winner)
    return [
        ExplainedSegment(int(start), int(stop), int(template), float(value[stop] - value[start]))
        for start, stop, template in reversed(found)
    ]


def margins(
    found: Sequence[ExplainedSegment],
    templates: Sequence[Template],
    classes: I64,
    usual: F64,
    words: U64 | Frames,
    decoding: Decoding,
    columns: Columns | None = None,
    promising: I64 | None = None,
) -> F64:
    """Return for each segment a margin, which compares it with the other classes and with the background.

    Parameters
    ----------
    found, templates, classes, usual, words, decoding, columns, promising
        As in `exclusive_shares`.

    Returns
    -------
    float64 array (S,)
        Margins from 0 to 1: `exclusive_shares` times 1 − exp(−v / `STANDING_OUT`), where v is the value per frame.
    """
    a_frame = np.array([one.value / (one.stop - one.start) for one in found])
    alone = exclusive_shares(found, templates, classes, usual, words, decoding, columns, promising)
    return alone * -np.expm1(-a_frame / STANDING_OUT)


def exclusive_shares(
    found: Sequence[ExplainedSegment],
    templates: Sequence[Template],
    classes: I64,
    usual: F64,
    words: U64 | Frames,
    decoding: Decoding,
    columns: Columns | None = None,
    promising: I64 | None = None,
) -> F64:
    """Return for each segment the fraction of its value that other classes cannot attain in the same frames.

    Parameters
    ----------
    found : sequence of ExplainedSegment
        S segments that `explain` returned for these words.
    templates : sequence of Template
        T templates.
    classes : int64 array (T,)
        The class of each template.
    usual : float64 array (K, f)
        The usual postures, see `ops.annotation.background.background`.
    words : uint64 array (L,) or Frames
        The words of the take, or the result of `frames_of` for them.
    decoding : Decoding
        The parameters of decoding.
    columns : Columns, optional
        See `explain`.
    promising : int64 array (R, 3), optional
        See `explain`.

    Returns
    -------
    float64 array (S,)
        1 − rival / value, from 0 to 1, where rival is the greatest value that templates of other classes attain in the
        same frames. It is 0 if other classes explain the frames as well, and 1 if no other class explains the frames
        better than the background.
    """
    if not found:
        return np.empty(0)
    frames = frames_of(words, usual, decoding)
    columns = columns or concatenated_columns(templates, usual, decoding)
    starts, stops = (np.array([getattr(one, name) for one in found], np.int64) for name in ("start", "stop"))
    of_template = np.asarray(classes, np.int64)
    labels = of_template[[one.template for one in found]]
    rivals = of_template != labels[:, None]
    if promising is not None:
        rivals &= _overlap(promising, starts, stops, len(templates))
    others = rival_values(frames, columns, decoding.costs, rivals, starts, stops)
    return np.clip(1.0 - others / np.array([one.value for one in found]), 0.0, 1.0)


def _overlap(promising: I64, starts: I64, stops: I64, templates: int) -> Bool:
    """Return for each segment the templates that have a promising range in it, bool (S, T)."""
    found = np.zeros((len(starts), templates), bool)
    for own, start, stop in zip(found, starts.tolist(), stops.tolist(), strict=True):
        own[promising[(promising[:, 1] < stop) & (promising[:, 2] > start), 0]] = True
    return found


def _allowed_and_promising(allowed: Bool, changes: I64, promising: I64) -> tuple[Bool, I64]:
    """Restrict the result of `_allowed` to the blocks of frames that contain promising ranges of a template.

    Ranges are widened to blocks, because a change of the active templates takes longer than a few more frames.
    """
    blocks = np.zeros((len(allowed), -(-int(changes[-1]) // BLOCK_FRAMES) + 1), np.int64)
    np.add.at(blocks, (promising[:, 0], promising[:, 1] // BLOCK_FRAMES), 1)
    np.add.at(blocks, (promising[:, 0], (promising[:, 2] - 1) // BLOCK_FRAMES + 1), -1)
    within = np.cumsum(blocks[:, :-1], axis=1) > 0
    both = np.repeat(within, BLOCK_FRAMES, axis=1)[:, : int(changes[-1])]
    if allowed.shape[1]:
        both &= allowed
    edges = BLOCK_FRAMES * (1 + np.flatnonzero((within[:, 1:] != within[:, :-1]).any(axis=0)))
    return both, np.union1d(changes, edges)


def _allowed(ranges: Sequence[I64] | None, templates: int, frames: int) -> tuple[Bool, I64]:
    """Return the frames in which each template may occur, and the frames at which the set of these templates changes.

    The first array is bool (T, L), or (T, 0) if all templates may occur everywhere; the second ascends from 0 to L.
    """
    if ranges is None:
        return np.ones((templates, 0), bool), np.array([0, frames])
    if len(ranges) != templates:
        raise ParameterError("ranges", f"one array for each of {templates} templates", len(ranges))
    allowed = np.zeros((templates, frames), bool)
    edges = [np.array([0, frames])]
    for index, own in enumerate(ranges):
        for start, stop in np.asarray(own, np.int64).reshape(-1, 2):
            allowed[index, start:stop] = True
        edges.append(np.clip(np.asarray(own, np.int64).ravel(), 0, frames))
    return allowed, np.unique(np.concatenate(edges))


def least_costs(
    templates: Sequence[QuantisedTemplate], words: U64, ranges: Sequence[I64], chosen: I64, starts: I64, stops: I64
) -> F64:
    """Return for each segment the smallest distance of its template over all paths that end in the segment.

    A path to a template of N columns has at most 2 N − 1 frames. Therefore the distance curve is only computed for the
    segment and the 2 (N − 1) frames before it.

    Parameters
    ----------
    templates : sequence of QuantisedTemplate
        T templates.
    words : uint64 array (L,)
        One word for each frame; `NO_WORD` if the frame is invalid.
    ranges : sequence of int64 array (R, 2)
        For each template the half-open ranges in which it is matched, ascending and disjoint.
    chosen : int64 array (S,)
        The template of each segment.
    starts, stops : int64 array (S,)
        The half-open range of each segment, within one of the ranges of its template.

    Returns
    -------
    float64 array (S,)
        The distances; ∞ if no path ends in the segment.
    """
    costs = np.full(len(chosen), np.inf)
    for index in np.unique(chosen).tolist():
        own, template = np.flatnonzero(chosen == index), templates[index]
        within = ranges[index][np.searchsorted(ranges[index][:, 0], starts[own], side="right") - 1, 0]
        begins = np.maximum(starts[own] - 2 * (len(template) - 1), within)
        edges = np.concatenate([[0], np.cumsum(stops[own] - begins)])
        parts = [words[begin:stop] for begin, stop in zip(begins.tolist(), stops[own].tolist(), strict=True)]
        pieces = np.stack([edges[:-1], edges[1:]], axis=1)
        curve = distance_curves([template], np.concatenate(parts), pieces)[0]
        inside = np.stack([edges[1:] - (stops[own] - starts[own]), edges[1:]], axis=1)
        costs[own] = [curve[first:end].min() for first, end in inside.tolist()]
    return costs
