"""This module tracks a person through depth frames by two hypotheses and a vote in each frame (thesis, Section 8.4).

The local hypothesis is fitted from the previous pose, which is extrapolated by the last movement. The database
hypothesis is fitted from poses of the database. The vote chooses the hypothesis of lower cost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.arrays import F32, F64, I64, Bool
from kinedex.ops.body.joint_tree import JOINTS, PARENTS
from kinedex.ops.depth.cones import ConeBody, body_distance
from kinedex.ops.depth.extrema import COUNT, ExtremaBuffers, extrema_buffers, find_source, geodesic_extrema, tips_first
from kinedex.ops.depth.facing_direction import facing_from_points, point_centre, sample_step
from kinedex.ops.depth.graph import (
    EDGE_M,
    GraphBuffers,
    build_graph,
    edge_threshold,
    graph_buffers,
    nearest_person,
    restrict_cloud,
    split_people,
)
from kinedex.ops.depth.image_search import DepthView
from kinedex.ops.depth.lookup import (
    JUMP_M,
    TURN_FRAMES,
    TURNED_SHARE,
    Lookup,
    Proposals,
    add_rotated,
    best_of_rows,
    propose_start,
)
from kinedex.ops.depth.points import FrameCloud, Preparation
from kinedex.ops.depth.pose_fit import (
    PRINTED_STEPS,
    RETRIEVED_SIGMA_M,
    SIGMA_M,
    STEPS,
    Form,
    PoseCost,
    PoseFit,
    cost_of,
)
from kinedex.ops.depth.pose_index import PoseIndex
from kinedex.ops.depth.thinned_poses import facing_of, place_directions
from kinedex.ops.errors import ParameterError

Hypothesis = Literal["local", "database"]

MIN_POINTS = 200
"""Minimum number of points of a frame that shows a person."""

ABSENT_S, MISSING_S = 0.5, 0.2
"""Durations in seconds after which the tracker restarts, if no person is in view and if frames are missing."""

TRIAL_STEPS = 2
"""Number of steps of the short fit by which candidates are compared."""

_TOWARDS = np.array([0.0, 0.0, 1.0])  # the assumed facing direction at a start: towards the camera

SHARE = 0.7
"""Fraction of the last movement by which poses are extrapolated, chosen on clips of two actors with two cameras."""


@dataclass(frozen=True)
class TrackerSettings:
    """The settings of a tracker.

    Attributes
    ----------
    form : str
        "best", or "printed" for the form printed in the thesis.
    hypotheses : tuple of str
        The hypotheses to use, a subset of "local" and "database". Without "database", the database is only used for the
        first pose. Without "local", candidates are not compared with the previous pose.
    candidates : int
        The number of database poses that are tried in a frame, not counting one that faces another direction; 1 in the
        thesis.
    rate_hz : float
        Frames per second.

    Raises
    ------
    ParameterError
        A setting is invalid.
    """

    form: Form = "best"
    hypotheses: tuple[Hypothesis, ...] = ("local", "database")
    candidates: int = 3
    rate_hz: float = 30.0

    def __post_init__(self) -> None:
        if self.form not in ("best", "printed"):
            raise ParameterError("form", "'best' or 'printed'", self.form)
        if not self.hypotheses or not set(self.hypotheses) <= {"local", "database"}:
            raise ParameterError("hypotheses", "one or both of 'local' and 'database'", self.hypotheses)
        if self.candidates < 1:
            raise ParameterError("candidates", "at least 1", self.candidates)
        if not (np.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise ParameterError("rate_hz", "positive and finite", self.rate_hz)

    @property
    def is_printed(self) -> bool:
        """Return True for the form printed in the thesis."""
        return self.form == "printed"

    @property
    def most_candidates(self) -> int:
        """Return the maximum number of candidates in a frame's result."""
        return self.candidates if self.is_printed else self.candidates + 1


class Candidate(NamedTuple):
    """A pose of the database that the lookup proposed for a frame.

    Attributes
    ----------
    row : int
        The row of the pose in the database.
    lookup_cost : float
        The cost of the pose in the lookup (thesis, Eq. 8.6).
    map : int
        The index in `Proposals.maps` of the map by which the pose was found.
    cost : float
        The cost of the pose in the vote after the trial steps; NaN for a single pose, which is not tried.
    ends : float
        The root mean square distance of the pose's end effectors from the extrema in metres.
    """

    row: int
    lookup_cost: float
    map: int
    cost: float
    ends: float


class FrameResult(NamedTuple):
    """The result of a frame, with the intermediate results that explain it.

    Attributes
    ----------
    pose : float64 array (24, 3)
        The joints in metres; NaN without a person.
    hypothesis : str or None
        The hypothesis that was chosen; None without a person.
    cost_local, cost_database : float
        The costs of the two hypotheses in the vote; NaN for a missing hypothesis.
    row : int
        The row of the database from which the database hypothesis was fitted; −1 without one.
    local, database : float64 array (24, 3) or None
        The two hypotheses.
    extrema : float64 array (20, 3)
        The geodesic extrema in metres; NaN where there are fewer.
    facing : float64 array (3,)
        The horizontal facing direction by which extrema were rotated.
    centre : float64 array (3,)
        The centre of the points.
    points, components, links : int
        The numbers of points, components and links of the graph.
    maps : int64 array (M, 5)
        The assignments of end effectors to extrema that were tried.
    sums : float64 array (M,)
        For each assignment the sum of distances from the previous end effectors; NaN for an assignment that was found
        without them.
    candidates : tuple of Candidate
        The poses that were tried, ordered by lookup cost, followed by the pose that faces another direction. At a
        start, only the best poses are included. All poses are different rows of the database.
    unseen : bool array (24,)
        Joints whose cones are nearest to no point.
    started : bool
        True if there was no previous pose.
    people : int
        The number of people in the frame. The person nearest to the last pose is tracked, at a start the person nearest
        to the middle of the image.
    parts : tuple of PoseCost or None
        The costs of the local and of the database hypothesis with their parts; None for a missing hypothesis.
    box : tuple of int
        The bounding box of the person in the strided image: first column, first row, and the column and the row after
        the last.
    """

    pose: F64
    hypothesis: Hypothesis | None
    cost_local: float
    cost_database: float
    row: int
    local: F64 | None
    database: F64 | None
    extrema: F64
    facing: F64
    centre: F64
    points: int
    components: int
    links: int
    maps: I64
    sums: F64
    candidates: tuple[Candidate, ...]
    unseen: Bool
    started: bool
    people: int
    parts: tuple[PoseCost | None, PoseCost | None]
    box: tuple[int, int, int, int]

    @property
    def cost(self) -> float:
        """Return the cost of the chosen hypothesis; NaN without a person."""
        return {"local": self.cost_local, "database": self.cost_database}.get(self.hypothesis or "", np.nan)


class _Scene(NamedTuple):
    """The points of a frame with their extrema, centre and facing direction, and numbers of components and people."""

    cloud: FrameCloud
    extrema: F64
    centre: F64
    facing: F64
    components: int
    links: int
    people: int


class Reconstructor:
    """Reconstructs the poses of one person from the depth frames of a recording, one after the other.

    Parameters
    ----------
    body : ConeBody
        The surface.
    bone_lengths : float64 array (24,)
        The person's bone lengths in metres.
    directions : float32 array (N, 24, 3)
        The pose database: unit directions of bones.
    preparation : Preparation
        The preparation that converts frames to points.
    view : DepthView
        The camera, with the stride and the rotation of the preparation.
    settings : TrackerSettings, optional
        The settings of the tracker.

    Raises
    ------
    ParameterError
        The database is empty, or arrays have other shapes.
    """

    def __init__(
        self,
        body: ConeBody,
        bone_lengths: F64,
        directions: F32,
        preparation: Preparation,
        view: DepthView,
        settings: TrackerSettings | None = None,
    ) -> None:
        self.body, self.bone_lengths, self.preparation = body, np.asarray(bone_lengths, np.float64), preparation
        self.settings = settings or TrackerSettings()
        self.height = body.standing_height(self.bone_lengths)
        printed = self.settings.is_printed
        self._steps = PRINTED_STEPS if printed else STEPS
        index = PoseIndex(place_directions(directions, self.bone_lengths))
        self.lookup = Lookup(index, 1 if printed else self.settings.candidates, 5 if printed else 6)
        self._poses = PoseFit(body, self.height, view)
        self._graph: GraphBuffers | None = None
        self._extrema: ExtremaBuffers | None = None
        self._joints = cone_joints(body)
        self.restart()

    def restart(self) -> None:
        """Discard the tracked person, so that the next frame starts without a previous pose."""
        self._pose: F64 | None = None
        self._before: F64 | None = None  # the pose of the frame before the last one, if that was tracked continuously
        self._last: F64 | None = None  # the extrema of the last frame
        self._facing = _TOWARDS.copy()
        self._absent = self._missing = self._frames = 0

    def skip(self, frames: int = 1) -> None:
        """Skip missing frames; after more than `MISSING_S` of them the tracker restarts."""
        self._missing += frames
        self._before = None
        if self._missing > MISSING_S * self.settings.rate_hz + 1e-9:
            self.restart()

    def step(self, image: npt.ArrayLike) -> FrameResult:
        """Reconstruct the pose of the next frame.

        Parameters
        ----------
        image : float32 array (H, W)
            Depths in metres; 0 where nothing was measured.

        Returns
        -------
        FrameResult
            The pose with the intermediate results that explain it.

        Raises
        ------
        ParameterError
            The image does not have the size for which the preparation was made.
        """
        cloud = self.preparation.prepare(image)
        self._missing = 0
        if len(cloud.points) < MIN_POINTS:
            return self._nobody(cloud)
        scene = self._look(cloud)
        self._poses.look(scene.cloud)
        self._absent = 0
        result = self._vote(scene, self._pose)
        self._last = scene.extrema[:5]
        self._before = self._pose if result.hypothesis == "local" else None
        self._pose = self._pose if result.hypothesis is None else result.pose
        return result

    def _nobody(self, cloud: FrameCloud) -> FrameResult:
        self._absent += 1
        self._before = None
        started = self._pose is None
        if self._absent > ABSENT_S * self.settings.rate_hz + 1e-9:
            self.restart()
        nowhere = np.full(3, np.nan)
        return FrameResult(
            np.full((len(JOINTS), 3), np.nan), None, np.nan, np.nan, -1, None, None, np.full((COUNT, 3), np.nan),
            nowhere, nowhere, len(cloud.points), 0, 0, np.empty((0, 5), np.int64), np.empty(0), (),
            np.ones(len(JOINTS), np.bool_), started, 0, (None, None), cloud.box,
        )  # fmt: skip

    def _look(self, cloud: FrameCloud) -> _Scene:
        """Return the extrema, the centre and the facing direction of the nearest person in a frame's points."""
        pixels = self.preparation.shape[0] * self.preparation.shape[1]
        if self._graph is None:
            self._graph = graph_buffers(pixels)
        threshold = EDGE_M if self.settings.is_printed else edge_threshold(cloud)
        graph = build_graph(cloud, threshold, self._graph)
        people = split_people(cloud, graph)
        if people:
            cloud = restrict_cloud(cloud, people[nearest_person(cloud, people, self._pose)])
            graph = build_graph(cloud, threshold, self._graph)
        if self._extrema is None:
            self._extrema = extrema_buffers(pixels)
        source = find_source(cloud, graph, 0.0) if self.settings.is_printed else find_source(cloud, graph)
        nodes = np.empty(0, np.int32)
        if source >= 0:
            found = geodesic_extrema(graph, source, buffers=self._extrema)
            nodes = (found if self.settings.is_printed else tips_first(cloud, graph, found, self._extrema)).nodes
        centre = point_centre(cloud.points)
        if self._pose is None or self.settings.is_printed:
            self._facing = facing_from_points(cloud.points, centre, self._facing)
        else:
            facing = np.empty(3)
            facing_of(self._pose, facing)
            self._facing = facing if facing.any() else self._facing
        counts = (graph.components, graph.links, max(1, len(people)))
        return _Scene(cloud, cloud.points[nodes], centre, self._facing.copy(), *counts)

    def _vote(self, scene: _Scene, previous: F64 | None) -> FrameResult:
        """Fit both hypotheses, and choose the one with the lower cost; at equal costs the local hypothesis.

        A database pose that faces another direction must cost less than `TURNED_SHARE` of the local hypothesis.
        """
        local = database = pose = None
        cost_local = cost_database = np.nan
        parts: list[PoseCost | None] = [None, None]
        hypothesis: Hypothesis | None = None
        row, proposals = -1, _NO_PROPOSALS
        candidates: tuple[Candidate, ...] = ()
        if previous is not None and "local" in self.settings.hypotheses:
            local = self._fit(self._beginning(previous, scene), self._steps, SIGMA_M)
            parts[0] = cost = self._cost(local, scene)
            cost_local = cost.total
            pose, hypothesis = local, "local"
        if previous is None or "database" in self.settings.hypotheses:
            proposals = self._propose(scene, previous)
            candidates, best, database = self._try(proposals, scene, previous is None)
            if database is not None:
                row = candidates[best].row
                parts[1] = cost = self._cost(database, scene)
                cost_database = cost.total
                is_turned = previous is not None and proposals.rotations[best] != 0.0
                if not cost_local * (TURNED_SHARE if is_turned else 1.0) <= cost_database:
                    pose, hypothesis = database, "database"
        return FrameResult(
            np.full((len(JOINTS), 3), np.nan) if pose is None else pose, hypothesis, cost_local, cost_database, row,
            local, database, _padded(scene.extrema), scene.facing, scene.centre, len(scene.cloud.points),
            scene.components, scene.links, proposals.maps, proposals.sums, candidates,
            self._unseen(pose, scene.cloud), previous is None, scene.people,
            (parts[0], parts[1]), scene.cloud.box,
        )  # fmt: skip

    def _beginning(self, previous: F64, scene: _Scene) -> F64:
        """Return the initial pose of the local fit: the previous pose, or its extrapolation if that has a lower cost.

        In the form printed in the thesis, it is always the previous pose.
        """
        if self._before is None or self.settings.is_printed:
            return previous
        moved = predicted_pose(previous, self._before)
        return moved if self._cost(moved, scene).total < self._cost(previous, scene).total else previous

    def _propose(self, scene: _Scene, previous: F64 | None) -> Proposals:
        """Look up poses for the current facing direction, and at intervals for another direction.

        After a jump of an extremum, the lowest extrema are also tried as feet. In the form printed in the thesis, only
        the current facing direction is used.
        """
        extrema, centre, facing = scene.extrema, scene.centre, scene.facing
        if previous is None and not self.settings.is_printed:
            return propose_start(self.lookup, extrema, centre, facing)
        first = extrema[:5]
        jumped = self._last is None or bool(
            (np.linalg.norm(first[:, None] - self._last[None], axis=2).min(axis=1, initial=np.inf) > JUMP_M).any()
        )
        compare = "local" in self.settings.hypotheses
        found = self.lookup.propose(extrema, centre, facing, previous, compare=compare, jumped=jumped)
        if self.settings.is_printed:
            return found
        self._frames += 1
        if self._frames % TURN_FRAMES:
            return found
        return add_rotated(found, self.lookup, extrema, centre, facing, self._frames // TURN_FRAMES - 1)

    def _try(
        self, proposals: Proposals, scene: _Scene, is_start: bool
    ) -> tuple[tuple[Candidate, ...], int, F64 | None]:
        """Compare proposals by a short fit of two steps, and fit the best one in full.

        Return the candidates (without a previous pose only the best), the index of the chosen candidate, and its pose.
        """
        poses, costs = list(proposals.poses), [np.nan] * len(proposals.poses)
        if len(poses) > 1:
            poses = [self._fit(pose, TRIAL_STEPS, (RETRIEVED_SIGMA_M[0],) * 2) for pose in poses]
            costs = [self._cost(pose, scene).total for pose in poses]
        chosen = [*range(len(poses))]
        if is_start:
            chosen = best_of_rows(proposals, costs, self.settings.most_candidates)
        candidates = tuple(
            Candidate(
                int(proposals.rows[k]), float(proposals.costs[k]), int(proposals.origins[k]), float(costs[k]),
                float(proposals.ends[k]),
            )
            for k in chosen
        )  # fmt: skip
        if not chosen:
            return candidates, -1, None
        if not is_start:
            best = int(np.argmin(costs)) if len(poses) > 1 else 0
            return candidates, best, self._fit(poses[best], self._steps, RETRIEVED_SIGMA_M)
        fits = [self._fit(poses[k], self._steps, RETRIEVED_SIGMA_M) for k in chosen]
        best = int(np.argmin([self._cost(pose, scene).total for pose in fits]))
        return candidates, best, fits[best]

    def _fit(self, pose: F64, steps: int, sigma: tuple[float, float]) -> F64:
        return self._poses.fit(pose, steps, sigma, self.settings.form)

    def _cost(self, pose: F64, scene: _Scene) -> PoseCost:
        """Return the cost of a pose in the vote (thesis, Eq. 8.7 to 8.9)."""
        return cost_of(self._poses, pose, scene.extrema, self.settings.form)

    def _unseen(self, pose: F64 | None, cloud: FrameCloud) -> Bool:
        """Return a mask (24,) of the joints whose cones are nearest to no point."""
        if pose is None:
            return np.ones(len(JOINTS), np.bool_)
        sample = cloud.points[:: sample_step(len(cloud.points))]
        seen = np.unique(body_distance(self.body, pose, sample, self.height).cone)
        unseen: Bool = np.any(self._joints, axis=0) & ~np.any(self._joints[seen], axis=0)
        return unseen


_NO_PROPOSALS = Proposals(
    np.empty((0, len(JOINTS), 3)), np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty(0, np.int64),
    np.empty((0, 5), np.int64), np.empty(0), np.empty(0),
)  # fmt: skip


def _padded(extrema: F64) -> F64:
    padded: F64 = np.full((COUNT, 3), np.nan)
    padded[: len(extrema)] = extrema
    return padded


def cone_joints(body: ConeBody) -> Bool:
    """Return a mask (C, 24), True where a joint determines an end of a cone."""
    joints: Bool = np.zeros((len(body.cone_names), len(JOINTS)), np.bool_)
    for c in range(len(joints)):
        joints[c, body.joints[c][body.shares[c] > 0]] = True
    return joints


def predicted_pose(pose: F64, before: F64, share: float = SHARE) -> F64:
    """Return the extrapolated pose of the next frame; its bones keep their lengths.

    The root moves on by a fraction of its last movement, and the direction of each bone by the same fraction of its
    last change.

    Parameters
    ----------
    pose, before : float64 array (24, 3)
        The last pose and the pose before, with the same bone lengths, in metres.
    share : float, optional
        The fraction.
    """
    predicted = np.empty_like(pose)
    _predict(pose, before, share, PARENTS, predicted)
    return predicted


@njit(cache=True, nogil=True)
def _predict(pose: F64, before: F64, share: float, parents: I64, predicted: F64) -> None:
    for j in range(len(parents)):
        parent = parents[j]
        if parent < 0:
            for axis in range(3):
                predicted[j, axis] = pose[j, axis] + share * (pose[j, axis] - before[j, axis])
            continue
        square, turned = 0.0, 0.0
        for axis in range(3):
            bone = pose[j, axis] - pose[parent, axis]
            moved = bone + share * (bone - before[j, axis] + before[parent, axis])
            predicted[j, axis] = moved
            square += bone * bone
            turned += moved * moved
        scale = math.sqrt(square / turned) if turned > 0.0 else 0.0
        for axis in range(3):
            predicted[j, axis] = predicted[parent, axis] + scale * predicted[j, axis]
