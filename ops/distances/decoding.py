"""The best explanation of a take by motion templates in a row: one label a frame, found by dynamic programming.

Where the thesis labels every frame by the nearest template on its own (Chapter 5), this asks for the row of templates,
with background in between, that explains all frames best together. A frame that belongs to a template's column has the
likelihood of that column's feature values; in the background it has the likelihood of features on average. The value
of an explanation is the sum of the logarithms of the ratio of both, and the explanation of the greatest value is found
exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba as nb
import numpy as np
import numpy.typing as npt

from ops.errors import ParameterError
from ops.templates.templates import Template
from ops.words import NO_WORD, U64, bits

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]
Bool = npt.NDArray[np.bool_]

_TABLE_CELLS = 4_000_000  # of a table of log ratios held at once: 32 MB, whatever the length of the take
_REACH = 3  # the longest step, in columns and in frames

TOLERANCE = 1e-9
"""Values closer than this are equal."""


@dataclass(frozen=True)
class Decoding:
    """What is asked of an explanation, in nats per frame and feature; chosen on clips of actors left out.

    smoothing: likelihoods lie between this and 1 − this, however sure a template is.
    entry: what each segment costs: short-lived gains are not worth a label.
    skip: what leaving out a column costs (two may be left out at once), so that haste is possible but not free.
    stay: what a frame costs in which a segment stays in its first or its last column, so that it does not grow for
    nothing. gain: added to every labelled frame. A greater one labels more, a lower one (below 0) leaves more to the
    background.
    """

    smoothing: float = 0.05
    entry: float = 1.0
    skip: float = 0.05
    stay: float = 0.1
    gain: float = -0.06

    def __post_init__(self) -> None:
        if not 0.0 < self.smoothing < 0.5:
            raise ParameterError("smoothing", "above 0 and below 0.5", self.smoothing)
        for name in ("entry", "skip", "stay"):
            if not getattr(self, name) >= 0.0:
                raise ParameterError(name, "0 or more", getattr(self, name))
        if not np.isfinite(self.gain):
            raise ParameterError("gain", "finite", self.gain)


@dataclass(frozen=True, order=True)
class Explained:
    """Frames [start, stop) that a template explains; value: what they add to the explanation, entry cost included."""

    start: int
    stop: int
    template: int
    value: float


def background(words: Sequence[U64], features: int) -> F64:
    """The share of valid frames in which each feature is on, float64 (f,); one half each where there is no frame."""
    on, frames = np.zeros(features), 0
    for one in words:
        valid = one[one != NO_WORD]
        on += bits(valid, features).sum(axis=0)
        frames += len(valid)
    return on / frames if frames else np.full(features, 0.5)


def log_ratios(templates: Sequence[Template], usual: F64, words: U64, decoding: Decoding) -> F64:
    """How much likelier a word is in a column than in the background, in nats per feature.

    Parameters
    ----------
    templates: of N_1 … N_T columns over f features. usual: float64 (f,), see `background`. words: uint64 (V,).

    Returns
    -------
    float64 (V, C), C = N_1 + … + N_T: the mean over features of log P(bit | column) − log P(bit | background), plus the
    gain; −∞ for `NO_WORD`.
    """
    ratios = linear_ratios(templates, usual, decoding)
    return _table(*ratios, words)


def linear_ratios(templates: Sequence[Template], usual: F64, decoding: Decoding) -> tuple[F64, F64]:
    """The log ratios as a linear function of a word's bits: slopes (f, C) and intercepts (C,)."""
    columns = np.concatenate([template.values for template in templates])
    if columns.shape[1] != len(usual):
        raise ParameterError("usual", f"one share for each of {columns.shape[1]} features", len(usual))
    low, high = decoding.smoothing, 1.0 - decoding.smoothing
    usual = np.clip(usual, low, high)
    on = np.log(np.clip(columns, low, high) / usual)
    off = np.log(np.clip(1.0 - columns, low, high) / (1.0 - usual))
    features = len(usual)
    return np.ascontiguousarray((on - off).T) / features, off.sum(axis=1) / features + decoding.gain


def _table(slopes: F64, intercepts: F64, words: U64) -> F64:
    """The log ratio of every word in every column, (V, C)."""
    ratios: F64 = bits(words, len(slopes)).astype(np.float64) @ slopes
    ratios += intercepts
    ratios[words == NO_WORD] = -np.inf
    return ratios


def explain(
    templates: Sequence[Template],
    usual: F64,
    words: U64,
    decoding: Decoding,
    ranges: Sequence[I64] | None = None,
    linear: tuple[F64, F64] | None = None,
) -> list[Explained]:
    """Find the explanation of a take that has the greatest value.

    A segment begins in a template's first column and ends in its last. From frame to frame it stays there (in the
    first and in the last column only), goes on by one column, or by two or three (each column left out costs `skip`);
    or a column lasts two or three frames. Segments do not overlap; frames between them are background, of value 0.

    Parameters
    ----------
    templates: T templates. usual: float64 (f,), see `background`. words: uint64 (L,), one take's.
    ranges: for each template int64 (R, 2), the half-open stretches it may explain, ascending and apart; None:
    everywhere. linear: `linear_ratios` of the templates, where they are known already.

    Returns
    -------
    The segments in order. What labels no frame is worth 0; of templates that fit equally the first is taken.

    Raises
    ------
    ParameterError: the templates have no or different numbers of features.
    """
    if not templates or not len(words):
        return []
    lengths = np.array([len(template) for template in templates])
    columns, firsts = _padded(lengths)
    allowed = _allowed(ranges, len(templates), len(words))
    value, winner = np.zeros(len(words) + 1), np.full(len(words) + 1, -1)
    scores = np.full((4, len(columns)), -np.inf)
    slopes, intercepts = np.zeros((len(usual), len(columns))), np.full(len(columns), -np.inf)
    slopes[:, columns], intercepts[columns] = linear_ratios(templates, usual, decoding) if linear is None else linear
    step = max(1, _TABLE_CELLS // len(columns))
    for start in range(0, len(words), step):
        stop = min(start + step, len(words))
        early = max(start - _REACH + 1, 0)
        vocabulary, codes = np.unique(words[early:stop], return_inverse=True)
        table = _table(slopes, intercepts, vocabulary)
        advance(
            table, codes, start, start - early, firsts, lengths, allowed, decoding.entry, decoding.skip,
            decoding.stay, scores, value, winner,
        )  # fmt: skip
    found = []
    at = len(words)
    while at > 0:
        if winner[at] < 0:
            at -= 1
            continue
        index = int(winner[at])
        start = _begin(templates[index], usual, words, decoding, allowed[index], value, at)
        found.append(Explained(start, at, index, float(value[at] - value[start])))
        at = start
    return found[::-1]


def margins(
    found: Sequence[Explained],
    templates: Sequence[Template],
    classes: I64,
    usual: F64,
    words: U64,
    decoding: Decoding,
) -> F64:
    """How much of a segment's value its class alone can give: the confidence in its label.

    Parameters
    ----------
    found: what `explain` returned for these words. classes: int64 (T,), the class of each template.

    Returns
    -------
    float64 (len(found),), from 0 (the frames are explained as well without the class) to 1 (nothing else explains them
    better than the background): 1 − rivals / value, rivals being the greatest value that the templates of other
    classes reach on the same frames.
    """
    result = np.empty(len(found))
    if not found:
        return result
    slopes, intercepts = linear_ratios(templates, usual, decoding)
    home = np.repeat(classes, [len(template) for template in templates])
    for place, one in enumerate(found):
        label = classes[one.template]
        others = [template for template, other in zip(templates, classes, strict=True) if other != label]
        linear = slopes[:, home != label], intercepts[home != label]
        rivals = explain(others, usual, words[one.start : one.stop], decoding, linear=linear)
        result[place] = 1.0 - sum(rival.value for rival in rivals) / one.value
    return np.clip(result, 0.0, 1.0)


def _begin(template: Template, usual: F64, words: U64, decoding: Decoding, allowed: Bool, value: F64, stop: int) -> int:
    """The frame in which the segment of a template that ends before `stop` begins.

    Where a segment began is not carried through the pass over all templates, which it would slow down; its own
    template is gone over once more, in a window that grows until it holds a segment of the value that is known.
    """
    window = 2 * len(template)
    while True:
        first = max(stop - window, 0)
        vocabulary, codes = np.unique(words[first:stop], return_inverse=True)
        table = log_ratios([template], usual, vocabulary, decoding)
        limit = allowed[first:stop] if len(allowed) else allowed
        score, begun = trace_begin(
            table, codes, limit, decoding.entry, decoding.skip, decoding.stay, value[first : stop + 1]
        )
        if begun >= 0 and (first == 0 or score >= value[stop] - TOLERANCE):
            return first + int(begun)
        window *= 2


def _padded(lengths: I64) -> tuple[Bool, I64]:
    """Columns laid end to end with `_REACH` empty ones before each template: which are real, and where templates
    begin."""
    firsts = np.cumsum(lengths + _REACH) - lengths
    real = np.zeros(int(firsts[-1] + lengths[-1]), bool)
    for first, length in zip(firsts, lengths, strict=True):
        real[first : first + length] = True
    return real, firsts.astype(np.int64)


def _allowed(ranges: Sequence[I64] | None, templates: int, frames: int) -> Bool:
    """In which frames each template may be, bool (T, L); (T, 0) where all may be everywhere."""
    if ranges is None:
        return np.ones((templates, 0), bool)
    if len(ranges) != templates:
        raise ParameterError("ranges", f"one array for each of {templates} templates", len(ranges))
    allowed = np.zeros((templates, frames), bool)
    for index, stretches in enumerate(ranges):
        for start, stop in np.asarray(stretches, np.int64).reshape(-1, 2):
            allowed[index, start:stop] = True
    return allowed


@nb.njit(cache=True, nogil=True)
def advance(
    table: F64,
    codes: I64,
    first_frame: int,
    before: int,
    firsts: I64,
    lengths: I64,
    allowed: Bool,
    entry: float,
    skip: float,
    stay: float,
    scores: F64,
    value: F64,
    winner: I64,
) -> None:
    """Go on with an explanation, frame by frame over the columns of all templates (kernel).

    codes: rows of the table, of the `before` frames before the first one and of those that are to be done. scores: the
    best value of each column in frame f, in row f mod 4. value (L + 1,): the greatest value of the frames before f;
    winner: the template whose segment ends there, or −1.
    """
    for place in range(before, len(codes)):
        frame = first_frame + place - before
        here, last = scores[frame % 4], scores[(frame - 1) % 4]
        now = table[codes[place]]
        once, twice = table[codes[max(place - 1, 0)]], table[codes[max(place - 2, 0)]]
        step_on(here[3:], now[3:], once[3:], twice[3:], last, scores[(frame - 2) % 4], scores[(frame - 3) % 4], skip)
        greatest, ends = value[frame], -1
        for template in range(len(firsts)):
            first = firsts[template]
            end = first + lengths[template] - 1
            if allowed.shape[1] > 0 and not allowed[template, frame]:
                here[first : end + 1] = -np.inf
                continue
            here[first] = max(last[first] - stay, value[frame] - entry) + now[first]
            here[end] = max(here[end], last[end] - stay + now[end])
            if here[end] > greatest:
                greatest, ends = here[end], template
        value[frame + 1] = greatest
        winner[frame + 1] = ends


@nb.njit(cache=True, nogil=True)
def step_on(here: F64, now: F64, once: F64, twice: F64, last: F64, second: F64, third: F64, skip: float) -> None:
    """The best value in every column but the first three, from the frames before (kernel; without branches, to
    vectorise).

    now, once, twice: log ratios in this frame and the two before it. last, second, third: values in the three before
    it.
    """
    for n in range(len(here)):
        best = last[n + 2]
        other = last[n + 1] - skip
        best = other if other > best else best
        other = last[n] - (skip + skip)
        best = other if other > best else best
        other = second[n + 2] + once[n]
        best = other if other > best else best
        other = third[n + 2] + (twice[n] + once[n])
        best = other if other > best else best
        here[n] = best + now[n]


@nb.njit(cache=True, nogil=True)
def trace_begin(
    table: F64, codes: I64, allowed: Bool, entry: float, skip: float, stay: float, value: F64
) -> tuple[float, int]:
    """The value of the best segment of one template that ends with the last frame, and the frame it begins in (kernel).

    codes: rows of the table, of L frames. value (L + 1,): the greatest value of all that is before each frame.
    """
    columns = table.shape[1]
    scores = np.full((4, columns), -np.inf)
    origins = np.full((4, columns), -1, np.int64)
    for frame in range(len(codes)):
        here, last = frame % 4, (frame - 1) % 4
        for n in range(columns):
            best, begun = -np.inf, -1
            now = table[codes[frame], n]
            if n == 0:
                best, begun = value[frame] - entry, frame
            if (n in (0, columns - 1)) and scores[last, n] - stay > best:
                best, begun = scores[last, n] - stay, origins[last, n]
            for left_out in range(min(n, 3)):
                score = scores[last, n - 1 - left_out] - skip * left_out
                if score > best:
                    best, begun = score, origins[last, n - 1 - left_out]
            spent = 0.0
            for lasts in range(2, 4):
                if n > 0 and frame >= lasts:
                    spent += table[codes[frame - lasts + 1], n]
                    score = scores[(frame - lasts) % 4, n - 1] + spent
                    if score > best:
                        best, begun = score, origins[(frame - lasts) % 4, n - 1]
            if len(allowed) > 0 and not allowed[frame]:
                best, begun = -np.inf, -1
            scores[here, n] = best + now
            origins[here, n] = begun
    return scores[(len(codes) - 1) % 4, columns - 1], origins[(len(codes) - 1) % 4, columns - 1]
