"""Rounds that stabilise a track by priors: hits, allocation, terms, another track, the guard (thesis, Chapter 6)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from kinedex.ops.body.kinematic_chain import ChainBody, Poses
from kinedex.ops.errors import ParameterError
from kinedex.ops.priors.allocation import ARCHIVE, POSE, PriorRow, allocate, prior_rows
from kinedex.ops.priors.archive_poses import relative_turns
from kinedex.ops.priors.constraints import CONSTRAINTS
from kinedex.ops.priors.guard import GUARD, LOCAL_GUARD, LOCAL_S, allowed_ratios, cost_ratios, refuted_frames
from kinedex.ops.priors.hits import Hit, at_rate, cut_to, find_hits
from kinedex.ops.priors.motion import Motion
from kinedex.ops.priors.terms import TrackState, make_terms
from kinedex.ops.tracking.prior_terms import PriorTerms
from kinedex.ops.words import U64

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]
Bool = npt.NDArray[np.bool_]

LOGICAL = "logical"
"""The kind of priors that stands for all constraints."""

KINDS = (LOGICAL, POSE, ARCHIVE)
"""The kinds of priors: those of the thesis, and the poses of the archive."""

FAR_RAD = 0.7
"""A node that is farther than this from its prior starts from the prior, in radians."""

LEAST_TRIED_S = 5 / 30
"""Another hit is tried where it covers frames of a withdrawn one for so many seconds at least."""

_LOCAL_REASON = f"over {LOCAL_S:g} s the observations fit {LOCAL_GUARD:g} times as badly as without priors, or worse"

_WHOLE_REASON = "with this round's priors all frames together fit the observations worse than before it"

SETTLED_RAD, SETTLED_M = 0.01, 0.01
"""A round is the last one if no turn and no place has moved by more."""


class Track(Protocol):
    """The result of a tracker, see `ops.tracking.take_tracker.TakeTrack`."""

    @property
    def poses(self) -> Poses:
        """The poses."""

    @property
    def positions(self) -> F64:
        """The joints (T, J, 3) in metres."""

    @property
    def costs(self) -> F64:
        """The cost of the observations in each frame (T,), which the guard compares."""


class Tracker(Protocol):
    """A tracker with its observations."""

    @property
    def body(self) -> ChainBody:
        """The body."""

    @property
    def rate_hz(self) -> float:
        """Frames per second."""

    @property
    def carries_over(self) -> bool:
        """True where a prior changes later frames too, and can lower the costs, as on silhouettes alone."""

    def track(self, start: Poses, priors: PriorTerms | None) -> Track:
        """Track the recording again from a start, with the terms of priors."""

    def nodes_seen(self, track: Track) -> Bool:
        """Return the nodes whose keypoints the cameras agree on, bool (T, K)."""

    def restart(self, poses: Poses, nodes_seen: Bool) -> Poses:
        """Return poses to start again from, interpolated where nodes are not seen."""


@dataclass(frozen=True)
class Settings:
    """Settings of priors.

    Attributes
    ----------
    kinds : tuple of str
        Kinds of priors, of `KINDS`.
    threshold : float
        τ > 0: a hit costs less.
    rounds : int
        The most rounds.
    guard : float
        A hit is withdrawn where the track with its priors fits the observations worse than the track without by more
        than this factor, less for a hit that costs more, see `ops.priors.guard.allowed_ratios`; infinite for no guard.
    factors : mapping of str to float
        Factors of the weights of kinds or constraints, 1 by default.
    words_rate_hz : float
        Frames per second of the words.
    attempts : int
        How often hits of a round are judged; from the second time on other hits take the place of those withdrawn.
    """

    kinds: tuple[str, ...] = (ARCHIVE,)
    threshold: float = 0.13
    rounds: int = 2
    guard: float = GUARD
    factors: Mapping[str, float] = field(default_factory=dict)
    words_rate_hz: float = 30.0
    attempts: int = 2

    def __post_init__(self) -> None:
        unknown = [kind for kind in self.kinds if kind not in KINDS]
        if unknown or not self.kinds:
            raise ParameterError("kinds", f"of {', '.join(KINDS)}", list(self.kinds))
        strange = [name for name in self.factors if name not in (*KINDS, *CONSTRAINTS)]
        if strange or not all(np.isfinite(value) and value >= 0 for value in self.factors.values()):
            known = ", ".join((*KINDS, *CONSTRAINTS))
            raise ParameterError("factors", f"not negative, for kinds of {known}", dict(self.factors))
        if not self.threshold > 0:
            raise ParameterError("threshold", "above 0", self.threshold)
        if not self.guard >= 0:
            raise ParameterError("guard", "0 or above", self.guard)
        for name, value in (("rounds", self.rounds), ("attempts", self.attempts)):
            if value < 1:
                raise ParameterError(name, "1 or more", value)

    @property
    def weights(self) -> dict[str, float]:
        """The factor of each kind and constraint that is used."""
        weights = {}
        for kind in self.kinds:
            for one in CONSTRAINTS if kind == LOGICAL else (kind,):
                weights[str(one)] = self.factors.get(one, self.factors.get(kind, 1.0))
        return weights


@dataclass(frozen=True, eq=False)
class Round:
    """The priors and the result of one round.

    Attributes
    ----------
    rows : tuple of PriorRow
        The priors that it allocated, kept or withdrawn.
    costs : float64 array (T,)
        The cost of the observations in each frame after it.
    moved_mm : float64 array (T, J)
        How far each joint moved in it.
    """

    rows: tuple[PriorRow, ...]
    costs: F64
    moved_mm: F64


@dataclass(frozen=True, eq=False)
class StabilisedTrack:
    """A track after all rounds.

    Attributes
    ----------
    track : Track
        The track; the one without priors itself where no prior was left.
    rounds : tuple of Round
        What each round did.
    moved_mm : float64 array (T, J)
        How far each joint is from the track without priors.
    """

    track: Track
    rounds: tuple[Round, ...]
    moved_mm: F64


def stabilise(
    tracker: Tracker,
    without: Track,
    words: Callable[[Track], U64],
    motions: Sequence[Motion],
    settings: Settings | None = None,
) -> StabilisedTrack:
    """Stabilise a track by priors of an archive.

    Parameters
    ----------
    tracker : Tracker
        The tracker with its observations.
    without : Track
        The track without priors; that of a whole take has been restarted.
    words : callable
        Returns the words of a track, uint64 (L,), at the rate of the settings; their first frame is that of the track.
    motions : sequence of Motion
        What the archive knows.
    settings : Settings, optional
        The settings.

    Returns
    -------
    StabilisedTrack

    Notes
    -----
    Where priors carry over to frames that no hit covers, the guard judges a round as a whole too: one that raises the
    sum of the costs of all frames is undone, and is the last.
    """
    chosen = settings or Settings()
    current, rounds = without, []
    for number in range(1, chosen.rounds + 1):
        before = current
        current, rows = _round(tracker, before, without, words, motions, chosen, number)
        if tracker.carries_over and np.isfinite(chosen.guard) and current.costs.sum() > before.costs.sum():
            current, rows = before, [replace(row, kept=False, reason=row.reason or _WHOLE_REASON) for row in rows]
        rounds.append(Round(tuple(rows), current.costs, _moved_mm(before, current)))
        if _settled(before, current):
            break
    return StabilisedTrack(current, tuple(rounds), _moved_mm(without, current))


def _round(
    tracker: Tracker, before: Track, without: Track, words: Callable[[Track], U64], motions: Sequence[Motion],
    settings: Settings, number: int,
) -> tuple[Track, list[PriorRow]]:  # fmt: skip
    """Run one round; return its track and what it allocated.

    Hits that the observations refute are withdrawn, and other hits that explain their frames are tried in their place.
    Where all hits stand, archive poses are withdrawn from the frames that refute them. The last attempt has only what
    stood, and is not judged again.
    """
    frames, weights = len(before.costs), settings.weights
    state = state_of(tracker, before)
    found = find_hits([motion.template for motion in motions], words(before), settings.threshold)
    hits, others = (at_rate(part, settings.words_rate_hz, tracker.rate_hz, frames) for part in found)
    numbers, refuted = list(range(len(hits))), list[PriorRow]()
    start: Poses | None = None
    for attempt in range(settings.attempts + 1):
        allocation = allocate(hits, frames, settings.threshold)
        rows = prior_rows(allocation, motions, weights, number, numbers)
        if not rows:
            return without, refuted
        terms = make_terms(state, allocation, motions, weights)
        track = tracker.track(round_start(tracker, state, terms) if start is None else start, terms)
        if attempt == settings.attempts:
            return track, refuted + rows
        ratios = cost_ratios(allocation, track.costs, without.costs)
        limits = allowed_ratios(allocation.qualities, settings.guard)
        bad = np.flatnonzero(ratios > limits).tolist()
        reasons = {numbers[place]: _reason(ratios[place], limits[place]) for place in bad}
        refuted += [replace(row, kept=False, reason=reasons[row.hit]) for row in rows if row.hit in reasons]
        free = np.flatnonzero(np.isin(allocation.owners, bad))
        if bad:
            used = max(numbers) + 1
            stood = [place for place in range(len(hits)) if place not in bad]
            hits, numbers = [hits[place] for place in stood], [numbers[place] for place in stood]
            if attempt + 1 < settings.attempts:
                tried = cut_to(others, free, LEAST_TRIED_S * tracker.rate_hz)
                hits, numbers, others = hits + tried, numbers + list(range(used, used + len(tried))), []
        elif ARCHIVE in weights and np.isfinite(settings.guard):
            wrong = refuted_frames(allocation, track.costs, without.costs, tracker.rate_hz)
            free = np.flatnonzero(wrong)
            gone = _cut(hits, numbers, free, 1)
            withdrawn = prior_rows(allocate(gone[0], frames, settings.threshold), motions, weights, number, gone[1])
            refuted += [replace(row, kept=False, reason=_LOCAL_REASON) for row in withdrawn]
            hits, numbers = _cut(hits, numbers, np.flatnonzero(~wrong), LEAST_TRIED_S * tracker.rate_hz)
        if not len(free):
            return track, refuted + rows
        start = Poses(*(part.copy() for part in track.poses))
        start.places[free], start.turns[free] = without.poses.places[free], without.poses.turns[free]
    raise AssertionError("the last attempt returns")


def _cut(hits: Sequence[Hit], numbers: Sequence[int], frames: I64, least: float) -> tuple[list[Hit], list[int]]:
    """Return the parts of hits that lie in some frames, and the number of each hit."""
    found = [(part, number) for hit, number in zip(hits, numbers, strict=True) for part in cut_to([hit], frames, least)]
    return [part for part, _ in found], [number for _, number in found]


def _reason(ratio: float, limit: float) -> str:
    return f"the observations fit {ratio:.2f} times as badly as without priors, more than {limit:.2f}"


def state_of(tracker: Tracker, track: Track) -> TrackState:
    """Return a track as the state that priors are allocated to."""
    positions = np.ascontiguousarray(np.moveaxis(track.positions, 0, 2))
    return TrackState(tracker.body, track.poses, positions, tracker.nodes_seen(track), tracker.rate_hz)


def round_start(tracker: Tracker, state: TrackState, terms: PriorTerms) -> Poses:
    """Return the start of a round: the track before it, and the priors where it is not to be trusted.

    A node with an archive or pose prior starts from it where it is not seen, where it is farther than `FAR_RAD` from
    it, or where neither hip is seen; other nodes are interpolated where they are not seen, as in a restart.

    Parameters
    ----------
    tracker : Tracker
        The tracker.
    state : TrackState
        The track before the round.
    terms : PriorTerms
        The terms of the round.
    """
    hips = [state.body.chain.nodes.index(name) for name in ("lhip", "rhip")]
    lost = np.flatnonzero(~state.nodes_seen[:, hips].any(axis=1))
    given = (terms.turn_weights > 0).all(axis=2)  # a constraint weighs one axis of an elbow alone
    apart = np.zeros(given.shape)
    apart[given] = np.linalg.norm(relative_turns(terms.turn_targets[given], state.poses.turns[given]), axis=1)
    moved = ~state.nodes_seen | (apart > FAR_RAD)
    moved[lost] = True
    moved &= given
    again = tracker.restart(state.poses, state.nodes_seen)
    return Poses(again.places, np.where(moved[:, :, None, None], terms.turn_targets, again.turns))


def _moved_mm(before: Track, after: Track) -> F64:
    moved: F64 = 1000.0 * np.linalg.norm(after.positions - before.positions, axis=2)
    return moved


def _settled(before: Track, after: Track) -> bool:
    """Return True where no turn and no place moved by more than `SETTLED_RAD` and `SETTLED_M`."""
    turned = np.linalg.norm(relative_turns(before.poses.turns, after.poses.turns), axis=-1)
    return bool(
        turned.max(initial=0.0) <= SETTLED_RAD
        and np.abs(after.poses.places - before.poses.places).max(initial=0.0) <= SETTLED_M
    )
