"""This module draws the clips of a large class from which a template is averaged, evenly over actors and lengths."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinedex.ops.arrays import I64
from kinedex.ops.errors import ParameterError


def evenly_drawn(lengths: Sequence[int], actors: Sequence[str], count: int) -> I64:
    """Draw clips evenly over actors, and over the lengths of each actor's clips.

    The clips are sorted by actor, then by length, and divided into `count` equal parts; the middle clip of each part is
    drawn. So each actor's share of the drawn clips is that of all clips, up to one clip.

    Parameters
    ----------
    lengths : sequence of int
        The frames of each clip.
    actors : sequence of str
        The actor of each clip.
    count : int
        The number of clips to draw; all are drawn where there are no more.

    Returns
    -------
    int64 array (min(count, n),)
        The indices of the drawn clips, ascending.

    Raises
    ------
    ParameterError
        There is not one actor for each clip, or no clip is wanted.

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
