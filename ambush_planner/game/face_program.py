"""The least value with a reach when a budget binds: a linear program in potentials of the faces.

On a planar two-way network every flow of size 1 is that of one reference route plus the differences
of a potential across the links. Lifted by the crossings of that route, the potential has one value
at each face that a disc touches. A random level line meets the disc with a probability of at most
the largest difference of these values. Newton's method finds the least z for which these
differences are at most z / alpha and the level lines' mean cost is within the budget.

For each z, the dual program is a flow between faces: a link carries at most its cost, and a disc,
at a cost of z / alpha, anything between the faces that it touches. Pairs of faces join the program
when the potential exceeds what their disc allows. The flow through the discs is the ambusher
(docs/theory.md, Proposition 8.9).
"""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import FloatArray, IndexArray, sums
from ..errors import SolverFailed
from .budget import Budget
from .faces import Faces

# Most programs that are solved for one game.
MAX_ROUNDS = 100


class LevelLines(NamedTuple):
    """A flow p (M,) along level lines, an ambusher q (N,) or None, and the budget's price."""

    p: FloatArray
    q: FloatArray | None
    price: float


def solve_on_faces(faces: Faces, budget: Budget, value: float, closed: float,
                   deadline: float) -> LevelLines:
    """Find the least value within the budget, to a share ``closed``, from a lower bound > 0.

    q is None if the budget does not raise the value. At the deadline, q still proves a bound, and p
    may be over the budget. Raises SolverFailed if the first program fails.
    """
    from scipy.optimize import linprog  # loading it is slow, see entropy_search

    game, links = faces.game, len(faces.left)
    loss, lift = game.loss[game.sites], faces.lifts[0]
    edge = np.flatnonzero(game.playable)
    most = np.zeros(links)
    most[faces.link[edge]] = budget.cost[edge] / budget.limit
    entries = faces.touched.indptr
    rows = np.flatnonzero(np.diff(entries))
    # Columns: the links, then pairs of faces that a site joins, with the lift between them.
    tail, head, site = faces.left, faces.right, np.zeros(0, dtype=np.int64)
    gain = faces.crossed.astype(np.float64)
    value *= 1.0 + closed
    for k in range(MAX_ROUNDS):
        each = np.arange(len(tail))
        ends = np.concatenate((tail, head)), np.concatenate((each, each))
        conserved = csr_matrix((np.repeat([1.0, -1.0], len(each)), ends), (faces.count, len(each)))
        cost = np.concatenate((np.zeros(links), value / loss[site])) - gain
        bounds = np.zeros((len(each), 2))
        bounds[:links, 0], bounds[:links, 1], bounds[links:, 1] = -most, most, np.inf
        left = max(deadline - time.monotonic(), 1e-3)
        newest = linprog(cost, A_eq=conserved[1:], b_eq=np.zeros(faces.count - 1), bounds=bounds,
                         method='highs-ds', options={'time_limit': left})
        if newest.status != 0:
            if k > 0:
                break
            raise SolverFailed(f'the program in face potentials: {newest.message}')
        found = newest
        potential = np.concatenate(([0.0], found.eqlin.marginals))
        height = potential[faces.touched.indices] + lift
        ambush = found.x[links:] / loss[site]
        spread = np.maximum.reduceat(height, entries[rows])
        spread -= np.minimum.reduceat(height, entries[rows])
        over = rows[spread * loss[rows] > value * (1.0 + closed / 2.0)]
        newer = value + (-found.fun - 1.0) / ambush.sum() if ambush.any() else value
        if not len(over) and newer <= value * (1.0 + closed):
            break
        value = max(value, newer)
        high, low = _extremes(height, entries[over], entries[over + 1])
        tail = np.concatenate((tail, faces.touched.indices[high]))
        head = np.concatenate((head, faces.touched.indices[low]))
        gain = np.concatenate((gain, lift[high] - lift[low]))
        site = np.concatenate((site, over))
    p = _flow(faces, potential)
    if not -found.fun > 1.0 - closed or not ambush.any():
        return LevelLines(p, None, 0.0)
    q = sums(game.sites[site[: len(ambush)]], ambush / ambush.sum(), game.node_count)
    return LevelLines(p, q, float(1.0 / (ambush.sum() * budget.limit)))


def _extremes(height: FloatArray, first: IndexArray, last: IndexArray) -> tuple[IndexArray, ...]:
    """The entries (K,) of the highest and the lowest face of sites with entries first..last - 1."""
    ranges = [(a, height[a:b]) for a, b in zip(first.tolist(), last.tolist(), strict=True)]
    return (np.array([a + heights.argmax() for a, heights in ranges], dtype=np.int64),
            np.array([a + heights.argmin() for a, heights in ranges], dtype=np.int64))


def _flow(faces: Faces, potential: FloatArray) -> FloatArray:
    """The flow (M,) of the reference route plus the differences of the potential (F,)."""
    game = faces.game
    flow = faces.crossed + potential[faces.left] - potential[faces.right]
    forward = np.where(game.network.tails < game.network.heads, 1.0, -1.0)
    return np.where(game.playable, np.maximum(forward * flow[faces.link], 0.0), 0.0)
