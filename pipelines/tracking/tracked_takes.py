"""Takes that were tracked or stabilised: bodies of a kinematic chain with their poses, and their names."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.catalog.features import FeatureSet
from kinedex.ops.body.kinematic_chain import ChainBody, Poses, forward
from kinedex.ops.body.kinematics import quaternions
from kinedex.pipelines.recordings.recorded_takes import Provenance
from kinedex.storage.formats.motion.reader import Body
from kinedex.storage.snapshot.schemas import TRACK_FORMAT

Bool = npt.NDArray[np.bool_]

TRACKED, STABILISED = "_tracked", "_stabilised"
"""The suffixes of the names of takes that were tracked from a recording, and of those that were stabilised."""

UNSEEN_S = 0.5
"""The gap, in seconds, above which frames that no camera has seen are invalid."""


@dataclass(frozen=True, eq=False)
class Track:
    """A take that was tracked or stabilised.

    Attributes
    ----------
    name : str
        Its name.
    provenance : Provenance
        Its origin.
    body : ChainBody
        The body, with its bone lengths.
    poses : Poses
        Its poses, at the rate of the recording.
    rate_hz : float
        Frames per second of the poses.
    valid : bool array (T,)
        False in frames within gaps of the observations longer than `UNSEEN_S`.
    recipe : str
        A hash of everything except its files that determines the track.
    actor : str, optional
        The actor.
    warnings : tuple of str
        Warnings about the take.
    """

    name: str
    provenance: Provenance
    body: ChainBody
    poses: Poses
    rate_hz: float
    valid: Bool
    recipe: str
    actor: str | None = None
    warnings: tuple[str, ...] = ()

    @property
    def format(self) -> str:
        """The format of the take."""
        return TRACK_FORMAT

    def joints(self, features: FeatureSet) -> Body:
        """Return the joints as those of a motion file, in the order of a feature set."""
        chain = self.body.chain
        positions, turned = forward(self.body, self.poses)
        at = {name: positions[j] for j, name in enumerate(chain.joints)}
        unknown = tuple(joint for joint in features.joints if joint not in at)
        nowhere = np.full((3, positions.shape[2]), np.nan)
        return Body(
            positions=np.stack([at.get(joint, nowhere) for joint in features.joints]),
            orientation=quaternions(turned[:, 0].reshape(-1, 9).T),
            rate_hz=self.rate_hz,
            unit="metre",
            skeleton=chain.name,
            unknown=unknown,
            warnings=self.warnings,
            valid=None if self.valid.all() else self.valid,
        )


def observed_frames(seen: Bool, rate_hz: float) -> Bool:
    """Return the valid frames of a track: all except those in gaps of the observations longer than 0.5 s.

    Parameters
    ----------
    seen : bool array (T,)
        The frames in which something was observed.
    rate_hz : float
        Frames per second.
    """
    valid = seen.copy()
    edges = np.flatnonzero(np.diff(np.concatenate([[True], seen, [True]])))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        if stop - start <= UNSEEN_S * rate_hz:
            valid[start:stop] = True
    return valid


def stabilised_name(take: str) -> str:
    """Return the name of a take after stabilisation; the suffix of a tracked take is replaced."""
    return take.removesuffix(TRACKED) + STABILISED
