"""This module aligns example clips with the template of their class by classical DTW."""

from __future__ import annotations

import numpy as np

from kinedex.ops.arrays import I64
from kinedex.ops.errors import ParameterError
from kinedex.ops.templates.templates import Template
from kinedex.ops.templates.warping import align
from kinedex.ops.words import NO_WORD, U64, bits


def clip_frames(template: Template, words: U64) -> I64:
    """Return the frame of a clip that corresponds to each column of a template.

    The clip is aligned by classical DTW; the local cost is the mean over features of |x − y| (by the template's feature
    weights where it has some). Of equally cheap steps, read from the end, (1,1) comes first, then the one in which the
    template advances alone, then the clip.

    Parameters
    ----------
    template : Template
        The soft template of the clip's class, of N columns.
    words : uint64 array (L,)
        The words of the clip.

    Returns
    -------
    int64 array (N,)
        The mean of the frames that the path pairs with each column, rounded, halves to the even frame.

    Raises
    ------
    ParameterError
        If the clip is empty or has invalid frames.
    """
    if not len(words) or np.any(words == NO_WORD):
        raise ParameterError("words", "those of a clip of at least one frame, all valid", len(words))
    features = template.values.shape[1]
    weights = np.ones(features) if template.feature_weights is None else template.feature_weights
    shown = bits(words, features).astype(np.float64)
    # Σ w |x − y| = Σ w (x + y − 2 x y) for y in {0, 1}
    costs = (template.values @ weights)[:, None] + (shown @ weights)[None, :]
    costs -= 2.0 * (template.values * weights) @ shown.T
    path = align(np.maximum(costs / weights.sum(), 0.0), np.ones(len(template)), np.ones(len(words))).path
    counts = np.bincount(path[:, 0], minlength=len(template))
    totals = np.bincount(path[:, 0], weights=path[:, 1].astype(np.float64), minlength=len(template))
    return np.rint(totals / counts).astype(np.int64)
