"""Estimate a joint with hidden markers from three other markers of its segment, learned where all are visible."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from kinedex.catalog.skeletons.skeleton_fit import Mix
from kinedex.ops.arrays import F64

_MOST = 6  # most stand-ins of a joint
_MOST_LABELS = 6  # most labels of a segment; more make no better triples
_FARTHEST = 2.0  # largest coordinate of a joint in the axes of a triple; beyond, it amplifies marker noise too much
_FLAT = 0.05  # sine of an angle below which three markers lie on a line


def stand_ins(places: Mapping[str, F64], target: F64, labels: Sequence[str], tolerance: float) -> list[Mix]:
    """Return mixes of three markers each that place a joint in the sampled frames in which it is hidden.

    Parameters
    ----------
    places : Mapping of str to float64 array (3, K)
        The markers in K sampled frames; NaN where one is not seen.
    target : float64 array (3, K)
        The joint in the same frames; NaN where its own markers are hidden.
    labels : sequence of str
        The markers of its segment.
    tolerance : float
        The largest median error of a stand-in in frames where the joint is visible, in the unit of the places.
    """
    seen = np.isfinite(target).all(axis=0)
    triples = list(combinations(labels[:_MOST_LABELS], 3))
    if seen.all() or not seen.any() or not triples:
        return []
    corners = np.stack([np.stack([places[label] for label in triple]) for triple in triples])  # (n, 3, 3, K)
    origin, first, second = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        normal = np.cross(first, second, axis=1)
        lengths = [np.sqrt((vector * vector).sum(axis=1, keepdims=True)) for vector in (first, second, normal)]
        normal = normal / lengths[2] * lengths[0]
        flat = ~(lengths[2] > _FLAT * lengths[0] * lengths[1])[:, 0]
    basis = np.stack([first, second, normal], axis=-1).transpose(0, 2, 1, 3)  # (n, K, 3, 3)
    known = np.isfinite(basis).all(axis=(2, 3)) & ~flat
    basis[~known] = np.eye(3)
    whole = known & seen
    found = np.linalg.solve(basis, np.where(whole[..., None], (target - origin).transpose(0, 2, 1), 0.0)[..., None])[
        ..., 0
    ]
    hidden, mixes = ~seen, list[Mix]()
    weights = [np.median(found[i][whole[i]], axis=0) if whole[i].any() else None for i in range(len(triples))]
    order = sorted(range(len(triples)), key=lambda i: -int((known[i] & hidden).sum()))
    for i in order:
        shares = weights[i]
        if shares is None or not (known[i] & hidden).any() or len(mixes) == _MOST:
            continue
        if max(abs(shares[0]), abs(shares[1]), abs(1 - shares[0] - shares[1]), abs(shares[2])) > _FARTHEST:
            continue
        place = origin[i] + np.einsum("kab,b->ak", basis[i], shares)
        if np.median(np.linalg.norm(place - target, axis=0)[whole[i]]) > tolerance:
            continue
        a, b, c = triples[i]
        mixes.append(
            Mix(
                (
                    (a, round(float(1 - shares[0] - shares[1]), 6)),
                    (b, round(float(shares[0]), 6)),
                    (c, round(float(shares[1]), 6)),
                ),
                plane=(a, b, c),
                out=round(float(shares[2]), 6),
            )
        )
        hidden = hidden & ~known[i]
    return mixes
