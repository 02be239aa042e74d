"""This module lays out the states of all classes as columns of one matrix, so that evidence is a product of matrices.

The classes follow each other. Each has its states from the last to the first, followed by two columns without evidence:
a path comes to a column from this column or one of the next two, and so never from another class.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F32, F64, I64

PIECE = 256
"""Evidence is computed for so many frames at a time, counted from the first of a take."""

LANES = 8
"""Kernels handle so many columns at once; there are as many behind the last class as make its columns a multiple."""

NO_EVIDENCE = np.float32(-1e30)
"""The evidence of columns that are no state."""


@dataclass(frozen=True)
class StateColumns:
    """The states of P classes, and the usual frames that are their background.

    Attributes
    ----------
    usual : float32 array (d + 1, B)
        The matrix by which a projected frame, with a 1 appended, is multiplied to get the evidence of each usual frame.
    states : float32 array (d + 1, W)
        The same for the states and the columns between classes.
    lasts, firsts : int64 array (P,)
        The columns of the last and the first state of each class, which has the columns from the former to the latter.
    """

    usual: F32
    states: F32
    lasts: I64
    firsts: I64

    @classmethod
    def of_means(cls, usual: F64, means: F64, firsts: I64, weight: float) -> StateColumns:
        """Lay out the means of states.

        Half a squared distance is half the squared lengths of frame and mean minus their scalar product. The length of
        the frame is the same for all means, and is left out.

        Parameters
        ----------
        usual : float64 array (B, d)
            The projected usual frames.
        means : float64 array (S, d)
            The projected means of the states, class by class.
        firsts : int64 array (P + 1,)
            The first state of each class, and S.
        weight : float
            The factor by which half a squared distance is multiplied and subtracted from the evidence of a state.
        """
        sizes = np.diff(firsts)
        begins = np.cumsum([0, *(sizes + 2)])
        columns = np.zeros((usual.shape[1] + 1, int(begins[-1]) + LANES), np.float32)
        columns[-1] = NO_EVIDENCE
        for begin, first, last in zip(begins[:-1].tolist(), firsts[:-1].tolist(), firsts[1:].tolist(), strict=True):
            columns[:, begin : begin + last - first] = _terms(means[first:last][::-1], weight)
        return cls(_terms(usual, weight), columns, begins[:-1], begins[:-1] + sizes - 1)

    def background(self, projected: F32) -> F32:
        """Return the evidence of the nearest usual frame to each of some projected frames (L, d + 1), float32 (L,)."""
        found: F32 = np.max(projected @ self.usual, axis=1)
        return found

    def pieces(self, projected: F32) -> Iterator[tuple[int, F32, F32]]:
        """Yield pieces of a take: the first frame, and the evidence of all columns and of the background.

        The evidence is float32 (n, W) and (n,). The array of the columns is overwritten by the next piece; the evidence
        of the background has not been subtracted from it.

        Parameters
        ----------
        projected : float32 array (L, d + 1)
            The projected frames of a take, with a 1 appended to each.
        """
        columns = np.empty((PIECE, self.states.shape[1]), np.float32)
        for first in range(0, len(projected), PIECE):
            own = projected[first : first + PIECE]
            yield first, np.matmul(own, self.states, out=columns[: len(own)]), self.background(own)


def _terms(means: F64, weight: float) -> F32:
    """Return the matrix (d + 1, M) by which a frame, with a 1 appended, is multiplied to get the evidence of means."""
    squares = (means**2).sum(axis=1)
    return np.concatenate([weight * means.T, [-0.5 * weight * squares]]).astype(np.float32)
