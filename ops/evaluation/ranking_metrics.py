"""This module evaluates rankings by precision and recall at each rank, and by average precision."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import ParameterError

F64 = npt.NDArray[np.float64]


def precision_recall(relevant: Sequence[bool], total: int) -> tuple[F64, F64]:
    """Return precision and recall after each rank (thesis, Figure 3.13).

    Parameters
    ----------
    relevant : sequence of bool
        True where the entry at a rank, the best first, should be found; each entry occurs once.
    total : int
        The number of entries that should be found, those that the ranking misses included.

    Returns
    -------
    precision, recall : float64 array (R,)
        The values after each of the R ranks.

    Raises
    ------
    ParameterError
        If there are more relevant ranks than entries that should be found.
    """
    hits = np.cumsum(np.asarray(relevant, np.int64))
    if len(hits) and hits[-1] > total:
        raise ParameterError("total", f"at least {int(hits[-1])}, the relevant ranks", total)
    return hits / np.arange(1, len(hits) + 1), hits / total if total else np.full(len(hits), math.nan)


def average_precision(relevant: Sequence[bool], total: int) -> float:
    """Return the mean of the precision at every relevant rank, counting 0 for each entry that is not found.

    It is NaN where nothing should be found. Parameters and errors are those of `precision_recall`.
    """
    precision, _ = precision_recall(relevant, total)
    return float(precision[np.asarray(relevant, np.bool_)].sum() / total) if total else math.nan
