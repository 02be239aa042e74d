"""This module learns motion templates from the clips of a class by warping and averaging (thesis, Section 2.3).

For a large class, only a subset of its clips is averaged fully, which is drawn evenly over actors and lengths.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from kinedex.ops.arrays import F64, I64, U64, Bool
from kinedex.ops.errors import ParameterError
from kinedex.ops.templates.averaging import TOLERANCE, Hard, Method, Soft, average_all, rebalance
from kinedex.ops.templates.warping import Paths, Stack, Weighted, reference_pairs
from kinedex.ops.words import MAX_FEATURES, NO_WORD, bits

Kind = Literal["soft", "hard"]

MAX_ROUNDS = 10
CONVERGED = 0.005

MAX_AVERAGED = 80
"""Maximum number of clips that are averaged in rounds, drawn evenly over actors and lengths; the other clips of a class
are averaged with the result at the end.
"""

REFERENCES = 8
"""Number of references of a class with more than `MAX_AVERAGED` clips; in smaller classes all clips are references."""


@dataclass(frozen=True)
class Template:
    """A soft or hard motion template of N columns.

    Parameters
    ----------
    values : float64 array (N, f)
        Values in [0, 1]; column i − 1 of the matrix is F_i.
    weights : float64 array (N,)
        The weight of each column, about 1.
    feature_weights : float64 array (f,), optional
        The weight of each feature in a comparison; None if all weights are equal.
    """

    values: F64
    weights: F64
    feature_weights: F64 | None = None

    def __len__(self) -> int:
        return len(self.values)

    @property
    def unknown(self) -> Bool:
        """Return a mask (f,) of the features unknown in all clips, which have weight 0 and wildcards in all columns."""
        if self.feature_weights is None:
            return np.zeros(self.values.shape[1], np.bool_)
        unknown: Bool = (self.feature_weights == 0) & (self.values == 0.5).all(axis=0)
        return unknown


@dataclass(frozen=True)
class NamedTemplate:
    """A template with its name, which is the subclass that it represents."""

    name: str
    template: Template
    description: str = ""


@dataclass(frozen=True)
class QuantisedTemplate:
    """A template of 0, 1 and wildcards, stored as bits: bit i − 1 belongs to F_i.

    Parameters
    ----------
    mask : uint64 array (N,)
        The bits that are fixed, for each column.
    value : uint64 array (N,)
        The values of the fixed bits; no bit is set outside the mask.
    feature_weights : float64 array (f,), optional
        The weight of each feature in a distance curve, above 0 for every feature that is fixed in a column; None if all
        weights are equal.
    """

    mask: U64
    value: U64
    feature_weights: F64 | None = None

    def __post_init__(self) -> None:
        if len(self.mask) != len(self.value) or not len(self.mask):
            raise ParameterError("template", "one mask and one value per column", (len(self.mask), len(self.value)))
        if np.any(self.value & ~self.mask):
            raise ParameterError("value", "0 wherever mask is 0", "a value behind a wildcard")
        if self.feature_weights is not None:
            counting = np.flatnonzero(bits(np.bitwise_or.reduce(self.mask, keepdims=True), MAX_FEATURES)[0])
            known = counting[counting < len(self.feature_weights)]
            own = self.feature_weights[known]
            if len(known) < len(counting) or not (np.isfinite(own) & (own > 0)).all():
                raise ParameterError("feature_weights", "above 0 for every feature that counts", own.tolist())

    def __len__(self) -> int:
        return len(self.mask)

    @property
    def fixed(self) -> float:
        """Return the mean number of fixed entries of a column."""
        return float(np.bitwise_count(self.mask).mean())

    def values(self, features: int) -> F64:
        """Return the columns as values, float64 (N, f): 0, 1, and 0.5 for a wildcard."""
        fixed, ones = bits(self.mask, features), bits(self.value, features)
        return np.where(fixed == 1, ones, 0.5)


@dataclass(frozen=True)
class LearnedTemplate:
    """A learned template, with a record of the learning.

    Parameters
    ----------
    template : Template
        The class template.
    rounds : int
        The number of rounds of averaging.
    costs : tuple of float
        The largest DTW cost between two templates, divided by the reference's total weight, before each round and after
        the last round; these are rounds + 1 numbers, or a single 0 if there is only one clip.
    clip_costs : tuple of float
        For each clip the median of its DTW costs to the other clips, or to the references, before the first round,
        relative to the number of entries compared along the path; 0 if there is only one clip.
    """

    template: Template
    rounds: int
    costs: tuple[float, ...]
    clip_costs: tuple[float, ...] = ()


@dataclass(frozen=True)
class AlignmentTask:
    """A task of a worker: P pairs of templates to align, int64 array (P, 2) of indices into the stack."""

    method: Method
    stack: Stack
    pairs: I64


Spread = Callable[[Callable[[AlignmentTask], Paths], Iterable[AlignmentTask]], Iterable[Paths]]
"""A function that applies a function to all pieces and yields the results in order, such as `map` or an executor's."""


Align = Callable[[Stack, I64], Paths]
"""A function that aligns pairs of the templates of a stack."""


def learn_soft(clips: Sequence[U64], features: int) -> LearnedTemplate:
    """Learn the soft motion template of a class (thesis, Section 2.3; Müller and Röder 2006).

    Values are weighted means over the clips; the local cost is the mean over features of |x − y|.

    Parameters
    ----------
    clips : sequence of uint64 array (L_i,)
        The words of each training clip, in the order of the clips' names.
    features : int
        The number of features f, 1 to 63.

    Returns
    -------
    LearnedTemplate
        The template; if there is only one clip, its values are those of the clip.

    Raises
    ------
    ParameterError
        If there are no clips, or a clip is empty, has invalid frames, or has bits beyond the features.
    """
    return learn("soft", clips, features)


def learn(
    kind: Kind,
    clips: Sequence[U64],
    features: int,
    feature_weights: F64 | None = None,
    spread: Spread = map,
    pieces: int = 1,
    actors: Sequence[str] | None = None,
) -> LearnedTemplate:
    """Learn a soft or hard motion template, with the alignments of each round divided among workers.

    Soft templates are those of `learn_soft`. Hard templates (diploma thesis, Section 3.3.1, Eq. 3.1 to 3.6) have the
    values 0, 0.5 (a wildcard) and 1, and the local cost is the number of contradictions. The classical DTW cost between
    a hard template and each of its clips is 0 (diploma thesis, Claim 3.1 in Section 3.3.2).

    The work grows quadratically with the number of clips up to `MAX_AVERAGED`, and linearly beyond. From a larger
    class, `MAX_AVERAGED` clips are drawn, of which `REFERENCES` are references in the first round; the later rounds are
    those of a small class. Finally, each clip that was not drawn is warped to the result once and averaged with the
    result, with the weight of one clip.

    Parameters
    ----------
    kind : str
        "soft" or "hard".
    clips : sequence of uint64 array (L_i,)
        The words of each training clip, in the order of the clips' names.
    features : int
        The number of features f, 1 to 63.
    feature_weights : float64 array (f,), optional
        Weights that are not negative and not all 0; None if all weights are equal. The local cost of soft templates is
        the weighted mean over the features; that of hard templates ignores features of weight 0. Weights only affect
        the alignment, not the averaging of values.
    spread : callable
        The function that applies a function to all pieces of a round, see `Spread`.
    pieces : int
        The number of pieces into which a round is divided; the result does not depend on it.
    actors : sequence of str, optional
        The actor of each clip; by default all are equal. Actors only affect which clips of a large class are drawn.

    Returns
    -------
    LearnedTemplate

    Raises
    ------
    ParameterError
        As in `learn_soft`, or if the weights are invalid.
    """
    _validate(clips, features)
    counts = _checked_weights(feature_weights, features)
    method: Method = Soft(counts) if kind == "soft" else Hard(counts)
    align = partial(_align, method, spread=spread, pieces=pieces)
    compared = 1.0 if kind == "soft" else float(np.count_nonzero(counts))
    drawn, references = _drawn(clips, actors)
    stack = Stack.of(_clips(method, [clips[place] for place in drawn]))
    found, costs, own = _average(method, stack, np.searchsorted(drawn, references), align, compared)
    clip_costs = np.zeros(len(clips))
    clip_costs[drawn] = own
    rest = np.setdiff1d(np.arange(len(clips)), drawn)
    if len(rest):
        others = [clips[place] for place in rest]
        found = _weighed_in(method, found, len(drawn), others, align)
        clip_costs[rest] = _costs_to(method, [clips[place] for place in references], others, align, compared)
    template = Template(method.values(found.columns), found.weights, feature_weights)
    return LearnedTemplate(template, max(len(costs) - 1, 0), tuple(costs or [0.0]), tuple(clip_costs.tolist()))


def _drawn(clips: Sequence[U64], actors: Sequence[str] | None) -> tuple[I64, I64]:
    """Return the indices of the clips to average, and of the references among these."""
    lengths = [len(clip) for clip in clips]
    who = [""] * len(clips) if actors is None else list(actors)
    drawn = evenly_drawn(lengths, who, MAX_AVERAGED)
    if len(drawn) == len(clips):
        return drawn, drawn
    positions = drawn.tolist()
    return drawn, drawn[evenly_drawn([lengths[i] for i in positions], [who[i] for i in positions], REFERENCES)]


def _average(
    method: Method, stack: Stack, references: I64, align: Align, compared: float
) -> tuple[Weighted, list[float], F64]:
    """Return the template of the first reference, the largest cost of each round, and the cost of each clip."""
    costs: list[float] = []
    clip_costs = np.zeros(len(stack))
    while len(stack) > 1:
        pairs = reference_pairs(len(stack), references)
        paths = align(stack, pairs)
        totals = _totals(stack)
        largest = float((paths.costs / totals[pairs].min(axis=1)).max())
        if not costs:
            clip_costs = _medians(paths.costs / totals[pairs].mean(axis=1) / compared, pairs, references, len(stack))
        costs.append(largest)
        rounds = len(costs) - 1
        # The first round is always performed; otherwise, if all costs were equal, the result would be the first clip.
        unchanged = rounds > 0 and abs(largest - costs[-2]) <= TOLERANCE
        if rounds == MAX_ROUNDS or (rounds > 0 and (largest < CONVERGED or unchanged)):
            break
        stack = Stack.of(average_all(method, stack, paths, pairs, references))
        references = np.arange(len(stack))
    last = int(stack.offsets[1])
    return Weighted(stack.columns[:last], stack.weights[:last]), costs, clip_costs


def _weighed_in(method: Method, template: Weighted, count: int, rest: Sequence[U64], align: Align) -> Weighted:
    """Update a template of `count` clips: average it with further clips, each warped to it once, and rebalance."""
    stack = Stack.of([template, *_clips(method, rest)])
    positions = np.arange(len(stack))
    pairs = np.stack([np.zeros(len(rest), np.int64), positions[1:]], axis=1)
    averaged = method.average(stack, 0, align(stack, pairs), positions - 1, count)
    return rebalance(averaged, method.merge)


def _costs_to(method: Method, references: Sequence[U64], clips: Sequence[U64], align: Align, compared: float) -> F64:
    """Return for each clip the median of its costs to references, relative to the number of entries compared."""
    stack = Stack.of(_clips(method, [*references, *clips]))
    count = len(references)
    pairs = np.stack(np.meshgrid(np.arange(count), np.arange(count, len(stack))), axis=-1).reshape(-1, 2)
    costs: F64 = align(stack, pairs).costs / _totals(stack)[pairs].mean(axis=1) / compared
    medians: F64 = np.median(costs.reshape(len(clips), count), axis=1)
    return medians


def _clips(method: Method, clips: Sequence[U64]) -> list[Weighted]:
    return [Weighted(method.start(clip), np.ones(len(clip))) for clip in clips]


def _totals(stack: Stack) -> F64:
    """Return the total weight of each template."""
    return np.array([piece.sum() for piece in np.split(stack.weights, stack.offsets[1:-1])])


def align_piece(piece: AlignmentTask) -> Paths:
    """Align the pairs of a piece; called by workers."""
    return piece.method.align(piece.stack, piece.pairs)


def quantise(template: Template, delta: float) -> QuantisedTemplate:
    """Replace values ≤ delta by 0, values ≥ 1 − delta by 1, and others by a wildcard (thesis, Section 2.3).

    Parameters
    ----------
    template : Template
        A template of at most 63 features. A feature of weight 0 becomes a wildcard in all columns. Other weights are
        kept, and are used in distance curves.
    delta : float
        A number 0 ≤ δ < 0.5; with 0, only values that are equal in all clips are fixed. Values are compared with a
        tolerance of 1e-9.

    Raises
    ------
    ParameterError
        If δ is out of its range.
    """
    if not 0 <= delta < 0.5:
        raise ParameterError("delta", "at least 0 and below 0.5", delta)
    shifts = np.arange(template.values.shape[1], dtype=np.uint64)
    weights = template.feature_weights
    counts = np.ones(len(shifts), np.bool_) if weights is None else weights > 0
    ones = (template.values >= 1 - delta - TOLERANCE) & counts
    zeros = (template.values <= delta + TOLERANCE) & counts
    value = np.bitwise_or.reduce(ones.astype(np.uint64) << shifts, axis=1)
    mask = np.bitwise_or.reduce((ones | zeros).astype(np.uint64) << shifts, axis=1)
    # Equal weights of all features that count are dropped, which gives the same results and is faster.
    alike = weights is None or len(np.unique(weights[counts])) <= 1
    return QuantisedTemplate(mask, value, None if alike else weights)


def _align(method: Method, stack: Stack, pairs: I64, spread: Spread, pieces: int) -> Paths:
    """Align all pairs, at once or in pieces of about equal work."""
    if pieces <= 1 or len(pairs) < 2:
        return method.align(stack, pairs)
    work = np.cumsum(stack.lengths[pairs].prod(axis=1))
    cuts = np.searchsorted(work, work[-1] * np.arange(1, pieces) / pieces) + 1
    tasks = []
    for part in np.split(pairs, np.unique(cuts[cuts < len(pairs)])):
        used, positions = np.unique(part, return_inverse=True)
        tasks.append(AlignmentTask(method, stack.chosen(used), positions.reshape(-1, 2).astype(np.int64)))
    return Paths.joined(list(spread(align_piece, tasks)))


def _medians(costs: F64, pairs: I64, references: I64, count: int) -> F64:
    """Return the median cost of each template's pairs with references."""
    is_reference = np.isin(pairs, references)
    return np.array([np.median(costs[((pairs == i) & is_reference[:, ::-1]).any(axis=1)]) for i in range(count)])


def _validate(clips: Sequence[U64], features: int) -> None:
    if not 1 <= features <= MAX_FEATURES:
        raise ParameterError("features", f"from 1 to {MAX_FEATURES}", features)
    if not clips:
        raise ParameterError("clips", "at least one clip", 0)
    for clip in clips:
        if not len(clip):
            raise ParameterError("clips", "clips of at least one frame", 0)
        if np.any(clip == NO_WORD):
            raise ParameterError("clips", "clips without invalid frames", "NO_WORD")
        if int(clip.max()) >> features:
            raise ParameterError("clips", f"words of {features} bits", int(clip.max()))


def _checked_weights(feature_weights: F64 | None, features: int) -> F64:
    if feature_weights is None:
        return np.ones(features)
    if feature_weights.shape != (features,):
        raise ParameterError("feature_weights", f"of shape ({features},)", feature_weights.shape)
    if not np.isfinite(feature_weights).all() or feature_weights.min() < 0 or feature_weights.max() == 0:
        raise ParameterError("feature_weights", "finite, not negative, and not all 0", feature_weights.tolist())
    return feature_weights


def evenly_drawn(lengths: Sequence[int], actors: Sequence[str], count: int) -> I64:
    """Draw clips evenly over actors, and over the lengths of each actor's clips.

    The clips are sorted by actor, then by length, and divided into `count` equal parts; the middle clip of each part is
    drawn. Hence each actor has the same fraction of the drawn clips as of all clips, up to one clip.

    Parameters
    ----------
    lengths : sequence of int
        The number of frames of each clip.
    actors : sequence of str
        The actor of each clip.
    count : int
        The number of clips to draw; if there are fewer clips, all are drawn.

    Returns
    -------
    int64 array (min(count, n),)
        The indices of the drawn clips, ascending.

    Raises
    ------
    ParameterError
        There is not one actor for each clip, or the number of clips to draw is below 1.

    Examples
    --------
    >>> evenly_drawn([30, 10, 20, 40, 50, 60], ["ann", "ann", "ann", "bob", "bob", "bob"], 2).tolist()
    [2, 4]
    """
    if len(actors) != len(lengths):
        raise ParameterError("actors", f"as many as the {len(lengths)} clips", len(actors))
    if count < 1:
        raise ParameterError("count", "at least 1", count)
    total = len(lengths)
    row = sorted(range(total), key=lambda place: (actors[place], lengths[place], place))
    count = min(count, total)
    chosen = [row[(2 * part + 1) * total // (2 * count)] for part in range(count)]
    return np.array(sorted(chosen), np.int64)
