"""This module stabilises a track by priors from an archive, in several rounds (thesis, Chapter 6).

In each round, hits of motions are searched in the track, priors are allocated to frames, and the recording is tracked
again with the terms of these priors (Sections 6.4.2 and 6.4.3). A guard, which is not in the thesis, then withdraws the
priors of hits with which the track fits the observations worse than a track without priors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from kinedex.ops.arrays import F64, I64, U64, Bool
from kinedex.ops.body.kinematic_chain import ChainBody, Poses
from kinedex.ops.errors import ParameterError
from kinedex.ops.priors.allocation import (
    ARCHIVE,
    POSE,
    Allocation,
    MotionHit,
    PriorRow,
    allocate,
    at_rate,
    cut_to,
    find_hits,
    prior_rows,
)
from kinedex.ops.priors.archive_poses import PriorMotion, actor_deviation, relative_rotations
from kinedex.ops.priors.constraints import (
    BENT_RAD,
    CONSTRAINTS,
    Constraint,
    PositionPulls,
    Side,
    front_pulls,
    ground_pulls,
    joined,
    straight_elbow,
)
from kinedex.ops.tracking.observations import PriorTerms, no_priors

LOGICAL = "logical"
"""The kind of priors that comprises all constraints."""

KINDS = (LOGICAL, POSE, ARCHIVE)
"""The kinds of priors: those of the thesis, and archive poses."""

FAR_RAD = 0.7
"""Angle in radians between a node and its prior above which the tracker starts this node from the prior."""

MIN_TRIED_S = 5 / 30
"""Minimum time in seconds that another hit must cover of withdrawn frames to be tried."""

GUARD = 1.12
"""Ratio of observation costs, with to without priors, above which a hit's priors are withdrawn (docs/studies.md)."""

LOCAL_GUARD, LOCAL_S = 1.05, 0.5
"""Ratio of costs over a window, in seconds, above which archive poses are withdrawn locally (docs/studies.md)."""

_LOCAL_REASON = f"over {LOCAL_S:g} s the observations fit {LOCAL_GUARD:g} times as badly as without priors, or worse"

_WHOLE_REASON = "with this round's priors all frames together fit the observations worse than before it"

SETTLED_RAD, SETTLED_M = 0.01, 0.01
"""Greatest change of a rotation in radians and of a position in metres at which the rounds end."""

POSE_RAD = 0.15
"""Standard deviation in radians of a rotation about its prior, in addition to the spread of the archive."""

SEEN_SHARE = 0.3
"""Factor of the weight of archive poses for nodes whose keypoints are consistent between cameras."""

SPREAD_S = 1 / 3
"""Time in seconds for which a node must be seen for its residuals to have the same weight as the archive's spread."""


class Track(Protocol):
    """The interface of a tracker's result, see `ops.tracking.take_tracker.TakeTrack`."""

    @property
    def poses(self) -> Poses:
        """Return the poses."""

    @property
    def positions(self) -> F64:
        """Return the joint positions (T, J, 3) in metres."""

    @property
    def costs(self) -> F64:
        """Return the cost of the observations in each frame (T,), which the guard compares."""


class Tracker(Protocol):
    """The interface of a tracker with its observations."""

    @property
    def body(self) -> ChainBody:
        """Return the body."""

    @property
    def rate_hz(self) -> float:
        """Return the frames per second."""

    @property
    def carries_over(self) -> bool:
        """Return True if a prior also changes later frames and can lower their costs, as with silhouettes alone."""

    def track(self, start: Poses, priors: PriorTerms | None) -> Track:
        """Track the recording again from initial poses, with the terms of priors."""

    def nodes_seen(self, track: Track) -> Bool:
        """Return a mask (T, K) of the nodes whose keypoints are consistent between cameras."""

    def restart(self, poses: Poses, nodes_seen: Bool) -> Poses:
        """Return initial poses for tracking again, interpolated where nodes are not seen."""


@dataclass(frozen=True)
class Settings:
    """The settings of stabilisation.

    Attributes
    ----------
    kinds : tuple of str
        The kinds of priors to use, of `KINDS`.
    threshold : float
        The threshold τ > 0; a minimum of a distance curve below it is a hit.
    rounds : int
        The maximum number of rounds.
    guard : float
        Maximum ratio of the observation costs with and without the priors of a hit; hits above it are withdrawn. The
        limit is lower for hits of higher cost, see `allowed_ratios`. Infinite to disable the guard.
    factors : mapping of str to float
        Factors of the weights of kinds or constraints, 1 by default.
    words_rate_hz : float
        Frames per second of the words.
    attempts : int
        The number of times that the hits of a round are judged; in each further attempt, other hits replace the hits
        that were withdrawn.
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
        """Return the factor of each kind and constraint that is used."""
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
        The allocated priors, kept or withdrawn.
    costs : float64 array (T,)
        The cost of the observations in each frame after the round.
    moved_mm : float64 array (T, J)
        The distance in millimetres that each joint moved in the round.
    """

    rows: tuple[PriorRow, ...]
    costs: F64
    moved_mm: F64


@dataclass(frozen=True, eq=False)
class StabilisedTrack:
    """The result of stabilisation: the track after all rounds.

    Attributes
    ----------
    track : Track
        The track; the track without priors itself if no prior was kept.
    rounds : tuple of Round
        The priors and results of each round.
    moved_mm : float64 array (T, J)
        The distance of each joint from the track without priors, in millimetres.
    """

    track: Track
    rounds: tuple[Round, ...]
    moved_mm: F64


def stabilise(
    tracker: Tracker,
    without: Track,
    words: Callable[[Track], U64],
    motions: Sequence[PriorMotion],
    settings: Settings | None = None,
) -> StabilisedTrack:
    """Stabilise a track by priors learned from an archive.

    Parameters
    ----------
    tracker : Tracker
        The tracker with its observations.
    without : Track
        The track without priors; for a complete take, after its restart.
    words : callable
        A function that returns the words of a track, uint64 (L,), at the rate of the settings; the first frames of
        words and track coincide.
    motions : sequence of PriorMotion
        The motions of the archive.
    settings : Settings, optional
        The settings.

    Returns
    -------
    StabilisedTrack

    Notes
    -----
    If priors also affect frames that no hit covers (`Tracker.carries_over`), the guard also judges each round as a
    whole: a round that raises the total cost is undone and ends the iteration.
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
    tracker: Tracker, before: Track, without: Track, words: Callable[[Track], U64], motions: Sequence[PriorMotion],
    settings: Settings, number: int,
) -> tuple[Track, list[PriorRow]]:  # fmt: skip
    """Run one round, and return its track and the allocated priors; without any hit, the track without priors.

    Hits that contradict the observations are withdrawn, and other hits for the same frames are tried instead. If all
    hits are accepted, archive poses are withdrawn from single frames whose observations contradict them. The last
    attempt has only accepted priors, and is not judged again.
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
                tried = cut_to(others, free, MIN_TRIED_S * tracker.rate_hz)
                hits, numbers, others = hits + tried, numbers + list(range(used, used + len(tried))), []
        elif ARCHIVE in weights and np.isfinite(settings.guard):
            wrong = refuted_frames(allocation, track.costs, without.costs, tracker.rate_hz)
            free = np.flatnonzero(wrong)
            gone = _cut(hits, numbers, free, 1)
            withdrawn = prior_rows(allocate(gone[0], frames, settings.threshold), motions, weights, number, gone[1])
            refuted += [replace(row, kept=False, reason=_LOCAL_REASON) for row in withdrawn]
            hits, numbers = _cut(hits, numbers, np.flatnonzero(~wrong), MIN_TRIED_S * tracker.rate_hz)
        if not len(free):
            return track, refuted + rows
        start = Poses(*(part.copy() for part in track.poses))
        start.positions[free], start.rotations[free] = without.poses.positions[free], without.poses.rotations[free]
    raise AssertionError("the last attempt returns")


def _cut(
    hits: Sequence[MotionHit], numbers: Sequence[int], frames: I64, least: float
) -> tuple[list[MotionHit], list[int]]:
    """Return the parts of hits that lie in the given frames, with the number of each hit."""
    found = [(part, number) for hit, number in zip(hits, numbers, strict=True) for part in cut_to([hit], frames, least)]
    return [part for part, _ in found], [number for _, number in found]


def _reason(ratio: float, limit: float) -> str:
    return f"the observations fit {ratio:.2f} times as badly as without priors, more than {limit:.2f}"


def state_of(tracker: Tracker, track: Track) -> TrackState:
    """Return a track in the form in which priors are allocated to it."""
    positions = np.ascontiguousarray(np.moveaxis(track.positions, 0, 2))
    return TrackState(tracker.body, track.poses, positions, tracker.nodes_seen(track), tracker.rate_hz)


def round_start(tracker: Tracker, state: TrackState, terms: PriorTerms) -> Poses:
    """Return the initial poses of a round: the previous track, with priors where this track is unreliable.

    A node with an archive or pose prior starts from the prior in frames in which the node is not seen, differs from the
    prior by more than `FAR_RAD`, or neither hip is seen. Other nodes that are not seen are interpolated, as in a
    restart.

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
    given = (terms.turn_weights > 0).all(axis=2)  # a constraint has weight on only one axis, that of an elbow
    apart = np.zeros(given.shape)
    apart[given] = np.linalg.norm(relative_rotations(terms.turn_targets[given], state.poses.rotations[given]), axis=1)
    moved = ~state.nodes_seen | (apart > FAR_RAD)
    moved[lost] = True
    moved &= given
    again = tracker.restart(state.poses, state.nodes_seen)
    return Poses(again.positions, np.where(moved[:, :, None, None], terms.turn_targets, again.rotations))


def _moved_mm(before: Track, after: Track) -> F64:
    moved: F64 = 1000.0 * np.linalg.norm(after.positions - before.positions, axis=2)
    return moved


def _settled(before: Track, after: Track) -> bool:
    """Return True if no rotation or position changed by more than `SETTLED_RAD` and `SETTLED_M`."""
    turned = np.linalg.norm(relative_rotations(before.poses.rotations, after.poses.rotations), axis=-1)
    return bool(
        turned.max(initial=0.0) <= SETTLED_RAD
        and np.abs(after.poses.positions - before.poses.positions).max(initial=0.0) <= SETTLED_M
    )


def cost_ratios(allocation: Allocation, costs: F64, without: F64) -> F64:
    """Return for each hit the ratio of the observation costs of the track with priors and without.

    Parameters
    ----------
    allocation : Allocation
        The hits of the frames.
    costs : float64 array (T,)
        The cost of the observations in each frame of the track with priors.
    without : float64 array (T,)
        The cost of the observations in each frame of the track without priors.

    Returns
    -------
    float64 array (H,)
        The ratio of the sums over the frames of each hit; 1 if a hit has no frame, or both sums are 0; ∞ if only the
        sum without priors is 0.

    Raises
    ------
    ParameterError
        If the costs are not those of all frames.
    """
    if not len(costs) == len(without) == len(allocation.owners):
        raise ParameterError("costs", f"those of {len(allocation.owners)} frames", (len(costs), len(without)))
    positions = allocation.owners + 1  # frames without a hit are counted in bin 0
    ours, theirs = (np.bincount(positions, weights=c, minlength=len(allocation.hits) + 1)[1:] for c in (costs, without))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(theirs > 0, ours / theirs, np.where(ours > 0, np.inf, 1.0))


def allowed_ratios(qualities: F64, guard: float) -> F64:
    """Return the largest cost ratio at which each hit is still accepted.

    The limit falls linearly from `guard` for hits of cost 0 to 1 for hits of cost τ. In experiments with takes of known
    and unknown motion, the priors of hits with a cost of 0.10 to 0.13 did harm at ratios of 1.03 and more, whereas
    those of hits with a cost below 0.06 were useful up to a ratio of 1.07.

    Parameters
    ----------
    qualities : float64 array (H,)
        1 − cost / τ of each hit.
    guard : float
        The largest ratio of a hit of cost 0; infinite to accept all hits.

    Returns
    -------
    float64 array (H,)
    """
    if not np.isfinite(guard):
        return np.full(len(qualities), np.inf)
    limits: F64 = 1.0 + (guard - 1.0) * qualities
    return limits


def refuted_frames(allocation: Allocation, costs: F64, without: F64, rate_hz: float) -> Bool:
    """Return the frames around which a track fits the observations worse than the track without priors does.

    A hit may be right as a whole but wrong in some frames. Moving averages of costs over `LOCAL_S` are compared. If
    their ratio exceeds `LOCAL_GUARD` in a frame, the priors of all frames within the window are withdrawn.

    Parameters
    ----------
    allocation : Allocation
        The hits of T frames.
    costs, without : float64 array (T,)
        The cost of the observations in each frame of the track with priors, and of the track without priors.
    rate_hz : float
        Frames per second.

    Returns
    -------
    bool array (T,)
        True in the frames whose priors are withdrawn.
    """
    half = max(1, round(0.5 * LOCAL_S * rate_hz))
    window = np.ones(2 * half + 1)
    ours, theirs = (np.convolve(one, window)[half:-half] for one in (costs, without))
    worse = (allocation.owners >= 0) & (ours > LOCAL_GUARD * theirs)
    return np.convolve(worse, window)[half:-half] > 0.5


@dataclass(frozen=True, eq=False)
class TrackState:
    """A track in the form in which priors are allocated to it.

    Attributes
    ----------
    body : ChainBody
        The body.
    poses : Poses
        The poses of the body.
    positions : float64 array (J, 3, T)
        The joints of the body in metres, Y up.
    nodes_seen : bool array (T, K)
        The nodes whose keypoints are consistent between cameras.
    rate_hz : float
        Frames per second.
    """

    body: ChainBody
    poses: Poses
    positions: F64
    nodes_seen: Bool
    rate_hz: float


def make_terms(
    state: TrackState, allocation: Allocation, motions: Sequence[PriorMotion], weights: Mapping[str, float]
) -> PriorTerms:
    """Return the terms of an allocation, which remain constant during the round.

    Parameters
    ----------
    state : TrackState
        The track before the round.
    allocation : Allocation
        The hits of its frames.
    motions : sequence of PriorMotion
        The motions of the archive.
    weights : mapping of str to float
        The factor of each kind of priors that is used: "archive", "pose" and constraints.

    Returns
    -------
    PriorTerms
    """
    terms = no_priors(len(allocation.owners), len(state.body.chain.nodes))
    borrowed = allocation.lenders >= 0
    for place, hit in enumerate(allocation.hits):
        table, frames = motions[hit.motion].poses, allocation.frames(place)
        if ARCHIVE in weights and table is not None and len(frames):
            borrowed[frames] = False
            _add_archive(terms, state, allocation, motions, place, weights[ARCHIVE])
    if POSE in weights:
        _add_lent(terms, state, allocation, np.flatnonzero(borrowed), weights[POSE])
    return _with_constraints(terms, state, allocation, motions, weights)


def _add_archive(
    terms: PriorTerms,
    state: TrackState,
    allocation: Allocation,
    motions: Sequence[PriorMotion],
    place: int,
    weight: float,
) -> None:
    """Add the archive's rotations, corrected by the actor's deviation, and tilts to the frames of a hit."""
    table = motions[allocation.hits[place].motion].poses
    assert table is not None
    frames = allocation.frames(place)
    columns = allocation.columns[frames]
    means, quality = table.means[columns], weight * allocation.qualities[place]
    way = actor_deviation(means, state.poses.rotations[frames], state.nodes_seen[frames], state.rate_hz)
    terms.turn_targets[frames, 1:] = (means @ way.rotations)[:, 1:]
    variance = actual_variance(table.spreads[columns], way.residuals, way.seen_s)
    need = np.where(state.nodes_seen[frames], SEEN_SHARE, 1.0)[:, :, None]
    terms.turn_weights[frames, 1:] = (need * quality / (variance + POSE_RAD**2))[:, 1:]
    terms.tilt_targets[frames] = table.tilts[columns]
    terms.tilt_weights[frames] = quality / POSE_RAD**2


def actual_variance(spreads: F64, residuals: F64, seen_s: F64) -> F64:
    """Return the variance of rotations about the archive's rotations, from its spread and the hit's residuals.

    Where the cameras are consistent for a node, they show how well the hit fits it: the variances of the archive and of
    the residuals are averaged, with the weights `SPREAD_S` and the time for which the node is seen. Therefore hits of a
    wrong class have a weaker influence, as have limbs that people move in different ways.

    Parameters
    ----------
    spreads : float64 array (E, K, 3)
        The spread in the archive in each frame, in radians.
    residuals : float64 array (K, 3)
        Root mean square of the residuals, in radians; NaN if a node is hardly seen.
    seen_s : float64 array (K,)
        The time for which each node is seen, in seconds.
    """
    share = np.where(np.isnan(residuals), 0.0, (seen_s / (SPREAD_S + seen_s))[:, None])
    variance: F64 = (1.0 - share) * spreads**2 + share * np.nan_to_num(residuals) ** 2
    return variance


def _add_lent(terms: PriorTerms, state: TrackState, allocation: Allocation, frames: I64, weight: float) -> None:
    """Add as priors the rotations and tilts of the frames whose poses are borrowed."""
    lent = state.poses.rotations[allocation.lenders[frames]]
    quality = weight * allocation.qualities[allocation.owners[frames]] / POSE_RAD**2
    terms.turn_targets[frames, 1:] = lent[:, 1:]
    terms.turn_weights[frames, 1:] = quality[:, None, None]
    terms.tilt_targets[frames] = lent[:, 0, 1, :]
    terms.tilt_weights[frames] = quality


def _with_constraints(
    terms: PriorTerms,
    state: TrackState,
    allocation: Allocation,
    motions: Sequence[PriorMotion],
    weights: Mapping[str, float],
) -> PriorTerms:
    """Add the terms of the marked regions that the track passes through, and return all terms."""
    # index −1, of frames without a hit, selects the appended 0
    quality = np.append(allocation.qualities, 0.0)[allocation.owners]
    pulls: list[PositionPulls] = []
    regions: dict[tuple[Constraint, Side], Bool] = {}
    for place, hit in enumerate(allocation.hits):
        own = allocation.owners == place
        for mark in motions[hit.motion].marks:
            inside = own & (allocation.columns >= mark.start) & (allocation.columns < mark.stop)
            key = (mark.constraint, mark.side)
            regions[key] = regions.get(key, np.zeros_like(own)) | inside
    for (constraint, side), marked in sorted(regions.items()):
        if constraint not in weights or not marked.any():
            continue
        if constraint == "elbow_bent":
            node, straight, target = straight_elbow(state.body, state.poses, marked, side)
            straight &= ~terms.turn_weights[:, node].any(axis=1)
            terms.turn_targets[straight, node] = target
            axis = state.body.chain.axes_of(node)[0].direction
            terms.turn_weights[straight, node, axis] = weights[constraint] * quality[straight] / BENT_RAD**2
            continue
        if constraint == "foot_on_ground":
            found = ground_pulls(state.body, state.positions, marked, side)
        else:
            found = front_pulls(state.body, state.poses, state.positions, marked, constraint, side, state.rate_hz)
        pulls.append(found._replace(weights=found.weights * weights[constraint] * quality[found.frames]))
    positions = joined(pulls)
    return PriorTerms(
        terms.turn_targets, terms.turn_weights, terms.tilt_targets, terms.tilt_weights, positions.frames,
        positions.joints,
        positions.directions, positions.targets, positions.weights,
    )  # fmt: skip
