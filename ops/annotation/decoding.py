"""The best explanation of a take by motion templates in a row: one label a frame, found by dynamic programming.

Where the thesis labels every frame by the nearest template on its own (Chapter 5), this asks for the row of templates,
with background in between, that explains all frames best together. A frame that belongs to a template's column has the
likelihood of that column's feature values; in the background it has the likelihood of its word in the usual postures
(`ops.annotation.background`). The value of an explanation is the sum of the logarithms of the ratio of both, and the
explanation of the greatest value is found exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.ops.annotation.background import background, log_likelihoods
from kinedex.ops.annotation.decoding_kernels import REACH, Bool, Columns, Costs, Frames, backwards, forwards, rivals
from kinedex.ops.errors import ParameterError
from kinedex.ops.templates.templates import Template
from kinedex.ops.words import NO_WORD, U64, bits

__all__ = ["Decoding", "Explained", "background", "confidences", "explain", "lay_columns", "log_ratios", "margins"]

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

STANDING_OUT = 0.05
"""Value per frame, in nats per feature, that makes a segment stand out from the background by 1 − 1 / e. Chosen so that
confidences are shares of right labels, about: see `studies.decoding`."""


@dataclass(frozen=True)
class Decoding:
    """What is asked of an explanation, in nats per frame and feature; chosen on clips of actors left out.

    smoothing: likelihoods lie between this and 1 − this, however sure a template or a posture is.
    entry: what each segment costs: short-lived gains are not worth a label.
    skip: what leaving out a column costs (two may be left out at once), so that haste is possible but not free.
    stay: what a frame costs in which a segment stays in its first or its last column, so that it does not grow for
    nothing. gain: added to every labelled frame. A greater one labels more, a lower one (below 0) leaves more to the
    background.
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
        """What the kernels ask."""
        return Costs(float(self.entry), float(self.skip), float(self.stay))


@dataclass(frozen=True, order=True)
class Explained:
    """Frames [start, stop) that a template explains; value: what they add to the explanation, entry cost included."""

    start: int
    stop: int
    template: int
    value: float


def log_ratios(templates: Sequence[Template], usual: F64, words: U64, decoding: Decoding) -> F64:
    """How much likelier a word is in a column than in the background, in nats per feature.

    Parameters
    ----------
    templates: of N_1 … N_T columns over f features. usual: float64 (K, f), see `background`. words: uint64 (V,).

    Returns
    -------
    float64 (V, C), C = N_1 + … + N_T: (log P(word | column) − log P(word | background)) / f, plus the gain; −∞ for
    `NO_WORD`.
    """
    slopes, intercepts = _linear(templates, usual, decoding)
    ratios: F64 = bits(words, len(slopes)).astype(np.float64) @ slopes + intercepts
    ratios += _offsets(words, usual, decoding)[:, None]
    ratios[words == NO_WORD] = -np.inf
    return ratios


def _linear(templates: Sequence[Template], usual: F64, decoding: Decoding) -> tuple[F64, F64]:
    """log P(word | column) / f, plus the gain, linear in the bits of a word: slopes (f, C), intercepts (C,)."""
    values = np.concatenate([template.values for template in templates])
    if usual.ndim != 2 or values.shape[1] != usual.shape[1]:
        raise ParameterError("usual", f"postures of {values.shape[1]} features", usual.shape)
    shares = np.clip(values, decoding.smoothing, 1.0 - decoding.smoothing)
    on, off = np.log(shares), np.log1p(-shares)
    features = values.shape[1]
    return np.ascontiguousarray((on - off).T) / features, off.sum(axis=1) / features + decoding.gain


def _offsets(words: U64, usual: F64, decoding: Decoding) -> F64:
    """−log P(word | background) / f of each frame."""
    return -log_likelihoods(words, usual, decoding.smoothing) / usual.shape[1]


def _frames(words: U64, usual: F64, decoding: Decoding) -> Frames:
    vocabulary, codes = np.unique(words, return_inverse=True)
    return Frames(np.ascontiguousarray(words), _offsets(vocabulary, usual, decoding)[codes])


def lay_columns(templates: Sequence[Template], usual: F64, decoding: Decoding) -> Columns:
    """All templates end to end, as `explain` and `margins` need them: laid once where there are many takes."""
    slopes, intercepts = _linear(templates, usual, decoding)
    lengths = np.array([len(template) for template in templates], np.int64)
    firsts = np.cumsum(lengths + REACH) - lengths
    real = np.concatenate([np.arange(first, first + length) for first, length in zip(firsts, lengths, strict=True)])
    columns = int(lengths.sum()) + REACH * len(lengths)
    laid = Columns(np.zeros((len(slopes), columns)), np.full(columns, -np.inf), firsts, lengths)
    laid.slopes[:, real], laid.intercepts[real] = slopes, intercepts
    return laid


def explain(
    templates: Sequence[Template],
    usual: F64,
    words: U64,
    decoding: Decoding,
    ranges: Sequence[I64] | None = None,
    columns: Columns | None = None,
) -> list[Explained]:
    """Find the explanation of a take that has the greatest value.

    A segment begins in a template's first column and ends in its last. From frame to frame it stays there (in the
    first and in the last column only), goes on by one column, or by two or three (each column left out costs `skip`);
    or a column lasts two or three frames. Segments do not overlap; frames between them are background, of value 0.

    Parameters
    ----------
    templates: T templates. usual: float64 (K, f), see `background`. words: uint64 (L,), one take's.
    ranges: for each template int64 (R, 2), the half-open stretches it may explain, ascending and apart; None:
        everywhere. columns: `lay_columns` of the same, where they are laid already.

    Returns
    -------
    The segments in order. What labels no frame is worth 0; of templates that fit equally the first is taken.

    Raises
    ------
    ParameterError: the templates have no or different numbers of features.
    """
    if not templates or not len(words):
        return []
    frames = _frames(words, usual, decoding)
    columns = columns or lay_columns(templates, usual, decoding)
    allowed, changes = _allowed(ranges, len(templates), len(words))
    value, winner = forwards(frames, columns, decoding.costs, allowed, changes)
    found = backwards(frames, columns, decoding.costs, allowed, value, winner)
    return [
        Explained(int(start), int(stop), int(template), float(value[stop] - value[start]))
        for start, stop, template in reversed(found)
    ]


def confidences(
    found: Sequence[Explained],
    templates: Sequence[Template],
    classes: I64,
    usual: F64,
    words: U64,
    decoding: Decoding,
    columns: Columns | None = None,
) -> F64:
    """How sure the labels are, from 0 to 1: what only their class can explain, and better than the background does.

    Returns
    -------
    float64 (len(found),): `margins`, whose parameters these are, times 1 − exp(−v / `STANDING_OUT`), v being the value
    of a segment per frame.
    """
    a_frame = np.array([one.value / (one.stop - one.start) for one in found])
    sure = margins(found, templates, classes, usual, words, decoding, columns)
    return sure * -np.expm1(-a_frame / STANDING_OUT)


def margins(
    found: Sequence[Explained],
    templates: Sequence[Template],
    classes: I64,
    usual: F64,
    words: U64,
    decoding: Decoding,
    columns: Columns | None = None,
) -> F64:
    """How much of a segment's value its class alone can give.

    Parameters
    ----------
    found: what `explain` returned for these words. classes: int64 (T,), the class of each template. columns: see
        `explain`.

    Returns
    -------
    float64 (len(found),), from 0 (the frames are explained as well without the class) to 1 (nothing else explains them
    better than the background): 1 − rivals / value, rivals being the greatest value that the templates of other
    classes reach on the same frames.
    """
    if not found:
        return np.empty(0)
    frames = _frames(words, usual, decoding)
    columns = columns or lay_columns(templates, usual, decoding)
    starts, stops = (np.array([getattr(one, name) for one in found], np.int64) for name in ("start", "stop"))
    labels = np.asarray(classes, np.int64)[[one.template for one in found]]
    others = rivals(frames, columns, decoding.costs, np.asarray(classes, np.int64), starts, stops, labels)
    return np.clip(1.0 - others / np.array([one.value for one in found]), 0.0, 1.0)


def _allowed(ranges: Sequence[I64] | None, templates: int, frames: int) -> tuple[Bool, I64]:
    """In which frames each template may be, bool (T, L), or (T, 0) where all may be everywhere; and the frames in which
    that changes, from 0 to L."""
    if ranges is None:
        return np.ones((templates, 0), bool), np.array([0, frames])
    if len(ranges) != templates:
        raise ParameterError("ranges", f"one array for each of {templates} templates", len(ranges))
    allowed = np.zeros((templates, frames), bool)
    edges = [np.array([0, frames])]
    for index, stretches in enumerate(ranges):
        for start, stop in np.asarray(stretches, np.int64).reshape(-1, 2):
            allowed[index, start:stop] = True
        edges.append(np.clip(np.asarray(stretches, np.int64).ravel(), 0, frames))
    return allowed, np.unique(np.concatenate(edges))
