"""How good a ranking is: precision and recall along it, and average precision."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import ParameterError

F64 = npt.NDArray[np.float64]


def precision_recall(relevant: Sequence[bool], total: int) -> tuple[F64, F64]:
    """Return precision and recall after each rank (thesis, Figure 3.13), float64 (R,) each.

    Parameters
    ----------
    relevant: whether what stands at each rank, the best first, should be found; each thing to find counts once.
    total: how many things there are to find, those that the ranking misses included.

    Raises
    ------
    ParameterError: more relevant ranks than there is to find.
    """
    hits = np.cumsum(np.asarray(relevant, np.int64))
    if len(hits) and hits[-1] > total:
        raise ParameterError("total", f"at least {int(hits[-1])}, the relevant ranks", total)
    return hits / np.arange(1, len(hits) + 1), hits / total if total else np.full(len(hits), math.nan)


def average_precision(relevant: Sequence[bool], total: int) -> float:
    """Return the mean of the precision at every relevant rank, what is not found counting 0; NaN with nothing to find.

    Parameters and errors as in `precision_recall`.
    """
    precision, _ = precision_recall(relevant, total)
    return float(precision[np.asarray(relevant, np.bool_)].sum() / total) if total else math.nan
