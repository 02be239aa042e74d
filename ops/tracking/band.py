"""This module assembles and solves the Gauss–Newton system of a whole take, a band matrix with blocks per frame.

Second differences of positions and rotations couple each parameter of a frame with the same parameter in the two frames
before and after. (H approximates the derivative of every logarithm by the identity; g can also use the exact
derivative.) Hence the matrix is a band whose half-width is twice the number of parameters.

Frames are eliminated one after the other, by the frontal method. The *front* is the matrix of a frame and the next two
frames, after the elimination of all earlier frames. A Cholesky factorisation of its first rows gives the front of the
next frame. Parameters that move no observed point are only coupled with themselves; each of them gives a separate band
of half-width 2, which is solved separately.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.kinematic_chain import PLACES, ChainArrays, log_gradients, log_of, take_step
from kinedex.ops.copies import copy_row
from kinedex.ops.tracking.blocks import TrackProblem, frame_buffers, frame_cost, frame_terms

MIN_DAMPING = 1e-6
"""The number added to the diagonal of every system."""

_PANEL = 8  # rows of a front that are subtracted from the others in one pass
# allow fused and reordered sums for speed; results are reproducible on the same machine
_FAST = {"contract", "reassoc", "nsz"}


class Band(NamedTuple):
    """The linear system of a take, with arrays for its solution.

    Attributes
    ----------
    smoothness : float64 array (N,)
        Weight of the second differences of each parameter.
    triples : float64 array (T,)
        1 if there is no cut between the previous frame, a frame and the next frame, else 0.
    coupled : int64 array (M,)
        The parameters that move observed points, ascending.
    single : int64 array (N − M,)
        The other parameters.
    blocks : float64 array (T, M, M)
        Upper half of H of each frame for the coupled parameters, without second differences.
    diagonals : float64 array (T, N)
        The diagonal of H of each frame, without second differences.
    gradient : float64 array (T, N)
        The vector g of each frame.
    velocities : float64 array (T, K, 3)
        The rotation vector log(R_tᵀR_{t+1}) of each node.
    """

    smoothness: F64
    triples: F64
    coupled: I64
    single: I64
    blocks: F64
    diagonals: F64
    gradient: F64
    velocities: F64


def make_band(chain: ChainArrays, moving: I64, smoothness: F64, triples: F64) -> Band:
    """Allocate an empty system.

    Parameters
    ----------
    chain : ChainArrays
        The body, of K nodes and N parameters.
    moving : int64 array
        The nodes on which observations or priors have points.
    smoothness : float64 array (N,)
        Weight of the second differences of each parameter.
    triples : float64 array (T,)
        1 if there is no cut between the previous frame, a frame and the next frame, else 0.
    """
    frames, size = len(triples), PLACES + len(chain.axis_nodes)
    moves = np.ones(size, np.bool_)
    moves[PLACES:] = chain.turned[moving].any(axis=0)
    moves[PLACES:] |= chain.axis_nodes == 0  # the tilt term couples the rotations of the first node
    coupled = np.flatnonzero(moves)
    return Band(
        smoothness,
        triples,
        coupled,
        np.flatnonzero(~moves),
        np.empty((frames, len(coupled), len(coupled))),
        np.empty((frames, size)),
        np.empty((frames, size)),
        np.empty((frames, len(chain.parents), 3)),
    )


@njit(cache=True, nogil=True)
def assemble(
    problem: TrackProblem, positions: F64, rotations: F64, width: float, units: F64, exact: bool, band: Band
) -> float:
    """Compute H and g of a take at given poses, and return the cost.

    Parameters
    ----------
    problem : TrackProblem
        The terms of the track.
    positions, rotations : float64 array (T, 3), (T, K, 3, 3)
        The poses.
    width : float
        The width c of the robust loss; infinite for least squares.
    units : float64 array (T, V, P)
        Output: the squares of the factors of residuals, see `rays.point_terms`.
    exact : bool
        True for the exact derivative of every logarithm in g; False for the identity, as in H.
    band : Band
        Output: the system.

    Returns
    -------
    float
        The cost.
    """
    buffers = frame_buffers(problem.chain, problem.evidence)
    cost = 0.0
    for t in range(len(positions)):
        cost += frame_terms(problem, t, positions[t], rotations[t], width, units[t], buffers, band.gradient[t])
        for a in range(len(band.coupled)):
            i = band.coupled[a]
            for b in range(a, len(band.coupled)):
                band.blocks[t, a, b] = buffers.hessian[band.coupled[b], i]
        for i in range(len(band.smoothness)):
            band.diagonals[t, i] = buffers.hessian[i, i]
    return cost + _add_differences(problem.chain, positions, rotations, exact, band)


@njit(cache=True, nogil=True)
def _log_between(first: F64, second: F64, between: F64) -> tuple[float, float, float]:
    """Return log(RᵀS), using a work array (3, 3) for the product."""
    for i in range(3):
        for j in range(3):
            between[i, j] = first[0, i] * second[0, j] + first[1, i] * second[1, j] + first[2, i] * second[2, j]
    return log_of(between)


@njit(cache=True, nogil=True)
def _differences(chain: ChainArrays, positions: F64, rotations: F64, band: Band) -> float:
    """Compute the velocities of all nodes, and return the cost of the second differences."""
    total, between, velocities = 0.0, np.empty((3, 3)), band.velocities
    for t in range(len(positions) - 1):
        for k in range(len(chain.parents)):
            copy_row(velocities[t, k], _log_between(rotations[t, k], rotations[t + 1, k], between))
        if t == 0 or band.triples[t] == 0.0:
            continue
        for i in range(PLACES):
            total += band.smoothness[i] * (positions[t + 1, i] - 2.0 * positions[t, i] + positions[t - 1, i]) ** 2
        for d in range(len(chain.axis_nodes)):
            k, i = chain.axis_nodes[d], chain.axis_directions[d]
            total += band.smoothness[PLACES + d] * (band.velocities[t, k, i] - band.velocities[t - 1, k, i]) ** 2
    return total


@njit(cache=True, nogil=True)
def _add_differences(chain: ChainArrays, positions: F64, rotations: F64, exact: bool, band: Band) -> float:
    """Add the second differences to g, and return their cost.

    The derivative of v = log(R_tᵀR_{t+1}) with respect to a rotation of R_{t+1} is the inverse right Jacobian J of v,
    and with respect to a rotation of R_t it is −Jᵀ.
    """
    cost = _differences(chain, positions, rotations, band)
    gradient, smoothness = band.gradient, band.smoothness
    pull = np.empty(3)
    for t in range(len(positions) - 1):
        here = band.triples[t] if t > 0 else 0.0
        after = band.triples[t + 1] if t + 2 < len(positions) else 0.0
        if here == 0.0 and after == 0.0:
            continue
        for i in range(PLACES):
            one = here * (positions[t + 1, i] - 2.0 * positions[t, i] + positions[t - 1, i]) if here > 0.0 else 0.0
            two = after * (positions[t + 2, i] - 2.0 * positions[t + 1, i] + positions[t, i]) if after > 0.0 else 0.0
            gradient[t + 1, i] += smoothness[i] * (one - two)
            gradient[t, i] -= smoothness[i] * (one - two)
        d = 0
        for k in range(len(chain.parents)):
            pull[:] = 0.0
            first = d
            while d < len(chain.axis_nodes) and chain.axis_nodes[d] == k:
                i, v = chain.axis_directions[d], band.velocities
                one = v[t, k, i] - v[t - 1, k, i] if here > 0.0 else 0.0
                two = v[t + 1, k, i] - v[t, k, i] if after > 0.0 else 0.0
                pull[i] = smoothness[PLACES + d] * (one - two)
                d += 1
            velocity = band.velocities[t, k]
            vector = (velocity[0], velocity[1], velocity[2]) if exact else (0.0, 0.0, 0.0)
            found = log_gradients(vector, (pull[0], pull[1], pull[2]))
            for b in range(first, d):
                i, sign = chain.axis_directions[b], chain.axis_signs[b]
                gradient[t + 1, PLACES + b] += sign * found[i]
                gradient[t, PLACES + b] -= sign * found[3 + i]
    return cost


@njit(cache=True, nogil=True)
def take_cost(problem: TrackProblem, positions: F64, rotations: F64, width: float, units: F64, band: Band) -> float:
    """Return the cost of a take at given poses, with fixed factors `units` of residuals; see `assemble`."""
    buffers = frame_buffers(problem.chain, problem.evidence)
    cost = 0.0
    for t in range(len(positions)):
        cost += frame_cost(problem, t, positions[t], rotations[t], width, units[t], buffers)
    return cost + _differences(problem.chain, positions, rotations, band)


@njit(cache=True, nogil=True)
def move(chain: ChainArrays, positions: F64, rotations: F64, steps: F64, new_places: F64, new_turns: F64) -> None:
    """Update the poses of a take by steps (T, N) of their parameters; write the result into the last two arrays."""
    for t in range(len(positions)):
        take_step(chain, positions[t], rotations[t], steps[t], new_places[t], new_turns[t])


@njit(cache=True, nogil=True)
def solve_band(band: Band, damping: float, factors: F64, steps: F64) -> None:
    """Solve H x = −g for the steps of all frames.

    The diagonal of H is multiplied by 1 + `damping`, and `MIN_DAMPING` is added.

    Parameters
    ----------
    band : Band
        The system.
    damping : float
        The damping λ of Levenberg's method.
    factors : float64 array (T, M, 2 M + 1)
        Work memory for the rows of the Cholesky factor.
    steps : float64 array (T, N)
        Output: the steps x.
    """
    frames = len(band.diagonals)
    own, near, far = np.empty(frames), np.empty(frames), np.empty(frames)
    for t in range(frames):
        before = band.triples[t - 1] if t >= 2 else 0.0
        here = band.triples[t] if 0 < t < frames - 1 else 0.0
        after = band.triples[t + 1] if t + 2 < frames else 0.0
        own[t], near[t], far[t] = before + 4.0 * here + after, -2.0 * (here + after), after
    _solve_single(band, damping, own, near, far, steps)
    _solve_coupled(band, damping, own, near, far, factors, steps)


@njit(cache=True, nogil=True)
def _solve_single(band: Band, damping: float, own: F64, near: F64, far: F64, steps: F64) -> None:
    """Solve the bands of half-width 2 of the uncoupled parameters."""
    frames = len(own)
    pivots, first, second = np.empty(frames), np.empty(frames), np.empty(frames)
    for i in band.single:
        w = band.smoothness[i]
        for t in range(frames):
            pivot = (band.diagonals[t, i] + w * own[t]) * (1.0 + damping) + MIN_DAMPING
            right, one = -band.gradient[t, i], w * near[t]
            if t >= 1:
                pivot -= first[t - 1] * first[t - 1] * pivots[t - 1]
                one -= first[t - 1] * second[t - 1] * pivots[t - 1]
                right -= first[t - 1] * steps[t - 1, i]
            if t >= 2:
                pivot -= second[t - 2] * second[t - 2] * pivots[t - 2]
                right -= second[t - 2] * steps[t - 2, i]
            pivots[t], first[t], second[t], steps[t, i] = pivot, one / pivot, w * far[t] / pivot, right
        for t in range(frames - 1, -1, -1):
            step = steps[t, i] / pivots[t]
            if t + 1 < frames:
                step -= first[t] * steps[t + 1, i]
            if t + 2 < frames:
                step -= second[t] * steps[t + 2, i]
            steps[t, i] = step


@njit(cache=True, nogil=True, fastmath=_FAST)
def _solve_coupled(band: Band, damping: float, own: F64, near: F64, far: F64, factors: F64, steps: F64) -> None:
    """Solve for the parameters that observations couple, by elimination frame by frame."""
    frames, m = len(own), len(band.coupled)
    weights = band.smoothness[band.coupled]
    width = _aligned(3 * m)
    front = np.zeros((3 * m, width))  # upper half; its rows belong to this frame, the next one and the one after
    right = np.zeros(3 * m)
    for t in range(frames):
        for a in range(m):
            row, block, i = front[a, a:m], band.blocks[t, a, a:], band.coupled[a]
            for b in range(len(row)):
                row[b] += block[b]
            diagonal = weights[a] * own[t]
            row[0] += diagonal + damping * (band.diagonals[t, i] + diagonal) + MIN_DAMPING
            front[a, m + a] += weights[a] * near[t]
            front[a, 2 * m + a] += weights[a] * far[t]
            right[a] -= band.gradient[t, i]
        _eliminate(front, right, m)
        for a in range(m):
            row = front[a, a : 2 * m + a + 1]
            for b in range(len(row)):
                factors[t, a, b] = row[b]
            steps[t, band.coupled[a]] = right[a]
        _shift(front, right, m)
    _substitute(band.coupled, factors, steps)


@njit(cache=True, nogil=True)
def _aligned(column: int) -> int:
    """Return the next column that is a multiple of eight, for aligned vector loads."""
    return (column + 7) // 8 * 8


@njit(cache=True, nogil=True, fastmath=_FAST)
def _eliminate(front: F64, right: F64, m: int) -> None:
    """Factorise the first m rows of a front and its right side, and subtract their products from the other rows.

    Row k ends at column 2 m + k, since the coupling with the frame after the next is 0 in later columns. Eight rows are
    subtracted from two other rows in one pass, and the remaining ones of the m rows in pairs. Rows are processed as
    slices from column 0, so that the compiler vectorises the loops; values left of the diagonal are not used.
    """
    for low in range(0, m, _PANEL):
        high = min(low + _PANEL, m)
        stop = 2 * m + high
        for k in range(low, high):
            row, pivot = front[k, k:stop], 1.0 / np.sqrt(max(front[k, k], 1e-300))
            for j in range(len(row)):
                row[j] *= pivot
            right[k] *= pivot
            for i in range(k + 1, high):
                _subtract(front[i, i:stop], front[k, i], front[k, i:stop])
            _subtract(right[k + 1 : stop], right[k], front[k, k + 1 : stop])
        for i in range(high, stop, 2):  # 2 m rows
            if high - low == _PANEL:
                _subtract_panel(front, low, i, _aligned(stop))
                continue
            for k in range(low, high - 1, 2):
                _subtract_pair(front, k, i, _aligned(stop))
            if (high - low) % 2 == 1:
                _subtract(front[i, i:stop], front[high - 1, i], front[high - 1, i:stop])
                _subtract(front[i + 1, i + 1 : stop], front[high - 1, i + 1], front[high - 1, i + 1 : stop])


@njit(cache=True, nogil=True, fastmath=_FAST)
def _subtract(row: F64, factor: float, other: F64) -> None:
    for j in range(len(row)):
        row[j] -= factor * other[j]


@njit(cache=True, nogil=True, fastmath=_FAST)
def _subtract_panel(front: F64, k: int, i: int, stop: int) -> None:
    """Subtract eight rows of the front, from k on, from its rows i and i + 1."""
    first = i // 8 * 8
    row, next_row = front[i, first:stop], front[i + 1, first:stop]
    p, q, r, s = front[k, first:stop], front[k + 1, first:stop], front[k + 2, first:stop], front[k + 3, first:stop]
    t, u, v, w = front[k + 4, first:stop], front[k + 5, first:stop], front[k + 6, first:stop], front[k + 7, first:stop]
    n, o = i - first, i + 1 - first
    a, b, c, d, e, f, g, h = p[n], q[n], r[n], s[n], t[n], u[n], v[n], w[n]
    aa, bb, cc, dd, ee, ff, gg, hh = p[o], q[o], r[o], s[o], t[o], u[o], v[o], w[o]
    for j in range(len(row)):
        row[j] -= a * p[j] + b * q[j] + c * r[j] + d * s[j] + e * t[j] + f * u[j] + g * v[j] + h * w[j]
        next_row[j] -= aa * p[j] + bb * q[j] + cc * r[j] + dd * s[j] + ee * t[j] + ff * u[j] + gg * v[j] + hh * w[j]


@njit(cache=True, nogil=True, fastmath=_FAST)
def _subtract_pair(front: F64, k: int, i: int, stop: int) -> None:
    """Subtract two rows of the front, from k on, from its rows i and i + 1."""
    first = i // 8 * 8
    row, next_row = front[i, first:stop], front[i + 1, first:stop]
    p, q = front[k, first:stop], front[k + 1, first:stop]
    n, o = i - first, i + 1 - first
    a, b, aa, bb = p[n], q[n], p[o], q[o]
    for j in range(len(row)):
        row[j] -= a * p[j] + b * q[j]
        next_row[j] -= aa * p[j] + bb * q[j]


@njit(cache=True, nogil=True)
def _shift(front: F64, right: F64, m: int) -> None:
    """Move the rows of the next two frames to the beginning of the front, and clear the last m rows."""
    for i in range(2 * m):
        row, source = front[i, i : 2 * m], front[m + i, m + i : 3 * m]
        for j in range(len(row)):
            row[j] = source[j]
        front[i, 2 * m :] = 0.0
        right[i] = right[m + i]
    front[2 * m :] = 0.0
    right[2 * m :] = 0.0


@njit(cache=True, nogil=True, fastmath=_FAST)
def _substitute(coupled: I64, factors: F64, steps: F64) -> None:
    """Solve the factorised system by back substitution, overwriting the right side."""
    frames, m = len(steps), len(coupled)
    x = np.zeros(3 * m)
    for t in range(frames - 1, -1, -1):
        for a in range(m - 1, -1, -1):
            row, later = factors[t, a, 1:], x[a + 1 : 2 * m + a + 1]
            total = 0.0
            for b in range(len(row)):
                total += row[b] * later[b]
            x[a] = (steps[t, coupled[a]] - total) / factors[t, a, 0]
        for a in range(m):
            steps[t, coupled[a]] = x[a]
        for a in range(2 * m - 1, -1, -1):
            x[m + a] = x[a]
