"""The evidence by which a body is recognised: the nodes of a file, their tree, and their positions in a few frames."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from kinedex.ops.arrays import F64

SAMPLED_FRAMES = 32
"""About how many frames, spread evenly over the take, a reader samples for the positions of nodes."""


@dataclass(frozen=True)
class Evidence:
    """The nodes of one body in a file, without any statement on which joint each of them is.

    Attributes
    ----------
    names : tuple of str
        The names of N nodes as the file has them; an end without a name is called by its parent, as `LeftToe_end`.
    positions : float64 array (N, 3, K)
        Positions of the nodes in K sampled frames, in the file's axes and unit; NaN where a point is not seen.
    parents : tuple of int, optional
        Index of each node's parent, −1 for a root; None for points and markers, which hang from nothing.
    offsets : float64 array (N, 3), optional
        Each node's offset from its parent in the rest pose; None for points and markers.
    up : str, optional
        The axis that the file calls vertical: "x", "y" or "z"; None if the file does not state it.
    unit_m : float, optional
        Metres of the file's unit; None if the file does not state it.
    """

    names: tuple[str, ...]
    positions: F64
    parents: tuple[int, ...] | None = None
    offsets: F64 | None = None
    up: str | None = None
    unit_m: float | None = None

    def without(self, nodes: Collection[int]) -> Evidence:
        """Return the evidence without some nodes of the tree, whose children hang from their parents instead.

        Parameters
        ----------
        nodes : collection of int
            Indices of nodes, no roots; a node is unrotated in the rest pose, so that offsets add up.
        """
        if not nodes or self.parents is None:
            return self
        kept = [i for i in range(len(self.names)) if i not in nodes]
        place = {node: i for i, node in enumerate(kept)}
        offsets = None if self.offsets is None else np.array(self.offsets)
        parents = []
        for node in kept:
            above = self.parents[node]
            while above in nodes:
                if offsets is not None and self.offsets is not None:
                    offsets[node] += self.offsets[above]
                above = self.parents[above]
            parents.append(place.get(above, -1))
        return replace(
            self,
            names=tuple(self.names[node] for node in kept),
            positions=self.positions[kept],
            parents=tuple(parents),
            offsets=None if offsets is None else offsets[kept],
        )
