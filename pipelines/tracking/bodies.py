"""Determine the bodies of tracked people: from a take, from the track itself, or as the mean body of an archive."""

from __future__ import annotations

import numpy as np

from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.arrays import F64
from kinedex.ops.body.kinematic_chain import ChainBody
from kinedex.ops.body.pose_fit import measured_body
from kinedex.ops.errors import KinedexError, ParameterError, did_you_mean
from kinedex.ops.tracking.body_estimate import estimate_body, mean_body
from kinedex.pipelines.recordings.truth import take_places
from kinedex.storage.snapshot.schemas import RECORDED_FORMATS
from kinedex.storage.store.store import Store

MOST_ACTORS = 50
"""The largest number of actors of an archive from which the mean body is computed."""

_USUAL_M = {
    "belly": 0.12, "chest": 0.12, "neck": 0.14, "head": 0.1, "headtop": 0.16, "shoulder": 0.18, "elbow": 0.28,
    "wrist": 0.25, "fingers": 0.1, "knee": 0.42, "ankle": 0.42, "toes": 0.15,
}  # fmt: skip
_USUAL_HIP = (0.1, -0.08, 0.0)


def usual_body() -> ChainBody:
    """Return a default body for stores without a take of any actor."""
    chain = load_kinematic_chain()
    offsets = np.zeros((len(chain.joints), 3))
    for j, (name, rest) in enumerate(zip(chain.joints, chain.rest, strict=True)):
        if rest.measured:
            offsets[j] = np.array(_USUAL_HIP) * (1.0 if name.startswith("l") else -1.0, 1.0, 1.0)
        elif rest.along is not None:
            offsets[j] = np.array(rest.along) * (_USUAL_M.get(name) or _USUAL_M[name[1:]])
    for j, rest in enumerate(chain.rest):
        if rest.along is None and not rest.measured and rest.start != j:
            offsets[j] = offsets[rest.start]
    return ChainBody(chain, offsets)


def take_joints(store: Store, take: str) -> F64:
    """Return the joint positions (J, 3, T) of the kinematic chain in a take of the store in metres, NaN if unknown."""
    return take_places(store, take, load_kinematic_chain().joints)


def take_body(store: Store, take: str, where: str) -> ChainBody:
    """Return the body (bone offsets) of the actor of a take.

    Parameters
    ----------
    store : Store
        The store.
    take : str
        The take, which needs all joints.
    where : str
        The place that names the take, for messages.

    Raises
    ------
    KinedexError
        There is no such take, or it lacks joints.
    """
    if take not in store.take_ids:
        near = did_you_mean(take, store.take_ids)
        raise KinedexError(f"{where}: the store has no take '{take}'{near}; name one, or write `body: estimate`")
    try:
        return measured_body(load_kinematic_chain(), take_joints(store, take))
    except ParameterError as fault:
        raise KinedexError(
            f"{where}: take '{take}' lacks joints that lengths are measured from ({fault}); name another take of the "
            "person, or write `body: estimate`"
        ) from None


def archive_body(store: Store) -> ChainBody:
    """Return the mean body of a store's actors, by the longest take of each; the default body if there are none."""
    rows = store.take_rows.select(["name", "actor", "format", "frames"]).to_pylist()
    longest: dict[str, tuple[int, str]] = {}
    for row in rows:
        if row["format"] not in RECORDED_FORMATS:
            key = row["actor"] or ""
            longest[key] = max(longest.get(key, (0, "")), (row["frames"], row["name"]))
    bodies = []
    for actor in sorted(longest)[:MOST_ACTORS]:
        try:
            bodies.append(measured_body(load_kinematic_chain(), take_joints(store, longest[actor][1])))
        except ParameterError:
            continue  # the body of this take lacks joints
    return mean_body(load_kinematic_chain(), bodies or [usual_body()])


def body_of_places(places: F64, mean: ChainBody) -> ChainBody:
    """Return the body of a 3D track, with missing lengths from the mean body in proportion.

    Parameters
    ----------
    places : float64 array (T, J, 3)
        Joint positions of the kinematic chain in metres; NaN if a joint is not tracked.
    mean : ChainBody
        The mean body.

    Raises
    ------
    KinedexError
        The positions of hips and shoulders are impossible for a body.
    """
    try:
        return measured_body(mean.chain, np.ascontiguousarray(places.transpose(1, 2, 0)))
    except ParameterError:
        shown = np.isfinite(places.sum(axis=2))
        joints = np.flatnonzero(shown.any(axis=0))
        seen = np.where(shown[:, joints], 3, 0)
        return estimate_body(mean.chain, places[:, joints], seen, joints, mean).body
