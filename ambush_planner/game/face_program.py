"""The least value with a reach when a budget binds: a linear program in potentials of the faces.

On a planar two-way network every flow of size 1 is that of one reference route plus the differences
of a potential across the links. Lifted by the crossings of that route, the potential has one value
at each face that a disc touches. A random level line meets the disc with a probability of at most
the largest difference of these values. Newton's method finds the least z for which these
differences are at most z / alpha and the level lines' mean cost is within the budget.

For each z, the dual program is a flow between faces: a link carries at most its cost, and a disc,
at a cost of z / alpha, anything between the faces that it touches. A disc and its faces join the
program when the potential exceeds what the disc allows. The flow through the discs is the ambusher
(docs/theory.md, Proposition 8.9).

A budget that binds keeps the routes near the best one, so the program is first solved on the links
near it: faces that no such link separates have one potential. The discs found there are most of
those that a wider strip needs.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from ..arrays import FloatArray, IndexArray, sums
from ..errors import SolverFailed
from .budget import Budget
from .faces import Faces

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

# Most programs that are solved for one strip.
MAX_ROUNDS = 100
# A strip is left once at most this share of the pairs of a disc and a face has just joined, if the
# value is found or the strip has no routes of the value tried.
FEW_JOINED = 0.02


class LevelLines(NamedTuple):
    """A flow p (M,) along level lines, its value, an ambusher q (N,) or None, the budget's price.

    q is None if the value is the lower bound that the program began with.
    """

    p: FloatArray
    value: float
    q: FloatArray | None
    price: float


class FaceProgram:
    """The program of the least value within a budget, to a share ``closed``.

    The flow may exceed the value at the few discs that would have joined next. ``bound`` is a lower
    bound > 0 of the value. At the deadline, q still proves a bound, and p may be over the budget.
    """

    def __init__(self, faces: Faces, budget: Budget, bound: float, closed: float,
                 deadline: float) -> None:
        game = faces.game
        self.faces, self.budget, self.closed, self.deadline = faces, budget, closed, deadline
        self.least = self.value = bound * (1.0 + closed)
        self.loss, self.lift = game.loss[game.sites], faces.lifts[0]
        self.entries = faces.touched.indptr
        self.rows = np.flatnonzero(np.diff(self.entries))
        edge = np.flatnonzero(game.playable)
        self.most, self.excess = np.zeros(len(faces.left)), np.full(len(faces.left), np.inf)
        self.most[faces.link[edge]] = budget.cost[edge] / budget.limit
        np.minimum.at(self.excess, faces.link[edge], game.through(budget.excess)[edge])
        # Entries of ``touched`` whose face may send flow to its disc (higher) or receive it.
        self.entry, self.higher = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool)
        self._join(self.lift.astype(np.float64))
        self.found: LevelLines | None = None

    def solve(self, width: float) -> LevelLines:
        """The least value on the links whose best route has ``width`` margins more than the best.

        Raises SolverFailed if the first program fails.
        """
        faces = self.faces
        part = (self.excess <= width * self.budget.margin) | (faces.crossed != 0)
        links, joined = np.flatnonzero(part), np.flatnonzero(~part)
        ends = faces.left[joined], faces.right[joined]
        graph = csr_matrix((np.ones(len(joined)), ends), (faces.count, faces.count))
        count, merged = connected_components(graph, directed=False)
        least = self.least
        for _ in range(MAX_ROUNDS):
            result = self._program(links, merged, count)
            if result.status != 0:
                if self.found is None:
                    raise SolverFailed(f'the program in face potentials: {result.message}')
                break
            potential = np.concatenate(([0.0], result.eqlin.marginals[: count - 1]))[merged]
            flow = np.maximum(result.x[len(links) :], 0.0)
            ambush = flow / 2.0 / self.loss[faces.site[self.entry]]
            total, over = float(ambush.sum()), -float(result.fun) - 1.0
            newer = max(self.value + over / total if total > 0.0 else 0.0, least)
            closed = abs(newer - self.value) <= self.closed * self.value
            # Only the first step may go down: from the value on a narrower strip.
            self.value = least = newer
            self.found = self._level_lines(potential, ambush)
            new = self._join(potential[faces.touched.indices] + self.lift)
            full = bool((result.upper.residual[len(links) :] <= 0.0).any())
            few = new <= FEW_JOINED * len(self.entry)
            if few and (closed or full and width < np.inf):
                break
        assert self.found is not None  # else it raised
        return self.found

    def _program(self, links: IndexArray, merged: IndexArray, count: int) -> OptimizeResult:
        """The flow of greatest gain between faces and discs: through links, then faces and discs.

        Its rows are the faces, then the discs.
        """
        from scipy.optimize import linprog  # loading it is slow, see entropy_search

        faces, entry, up = self.faces, self.entry, self.higher
        sites, which = np.unique(faces.site[entry], return_inverse=True)
        face, disc = merged[faces.touched.indices[entry]], count + which.ravel()
        tail = np.concatenate((merged[faces.left[links]], np.where(up, face, disc)))
        head = np.concatenate((merged[faces.right[links]], np.where(up, disc, face)))
        each, rows = np.arange(len(tail)), count + len(sites)
        ends = np.concatenate((tail, head)), np.concatenate((each, each))
        conserved = csr_matrix((np.repeat([1.0, -1.0], len(each)), ends), (rows, len(each)))
        share = self.value / self.loss[faces.site[entry]]
        lifted = share / 2.0 - np.where(up, self.lift[entry], -self.lift[entry])
        bounds = np.zeros((len(each), 2))
        bounds[: len(links), 0], bounds[: len(links), 1] = -self.most[links], self.most[links]
        # A strip may have no routes of the value tried. This limit, at which a disc exceeds its
        # share by less than ``closed``, keeps the program bounded all the same, unless the value
        # is 0.
        with np.errstate(divide='ignore'):
            bounds[len(links) :, 1] = 1.0 / (share * self.closed)
        left = max(self.deadline - time.monotonic(), 1e-3)
        return linprog(np.concatenate((-faces.crossed[links], lifted)), A_eq=conserved[1:],
                       b_eq=np.zeros(rows - 1), bounds=bounds, method='highs-ds',
                       options={'time_limit': left,
                                'simplex_dual_edge_weight_strategy': 'devex'})

    def _join(self, height: FloatArray) -> int:
        """Join faces to the discs that exceed their shares of the value; return their number.

        They are the highest face, the lowest, and those that exceed the share by least.
        """
        allowed, first = self.value * (1.0 + self.closed / 2.0), self.entries[self.rows]
        spread = np.maximum.reduceat(height, first) - np.minimum.reduceat(height, first)
        sites = self.rows[spread * self.loss[self.rows] > allowed]
        higher, lower = [], []
        for site, a, b in zip(sites, self.entries[sites], self.entries[sites + 1], strict=True):
            order = a + height[a:b].argsort()
            ordered, most = height[order], allowed / self.loss[site]
            higher += [order[-1], order[ordered.searchsorted(ordered[0] + most, 'right')]]
            lower += [order[0], order[ordered.searchsorted(ordered[-1] - most) - 1]]
        self.entry = np.concatenate((self.entry, np.array(higher + lower, dtype=np.int64)))
        self.higher = np.concatenate((self.higher, np.repeat([True, False], len(higher))))
        return 2 * len(higher)

    def _level_lines(self, potential: FloatArray, ambush: FloatArray) -> LevelLines:
        """p of a potential (F,), with q and price from the dual ``ambush`` of each entry."""
        game, total = self.faces.game, float(ambush.sum())
        p = _flow(self.faces, potential)
        if self.value <= self.least or not total > 0.0:
            return LevelLines(p, self.value, None, 0.0)
        q = sums(game.sites[self.faces.site[self.entry]], ambush / total, game.node_count)
        return LevelLines(p, self.value, q, 1.0 / (total * self.budget.limit))


def _flow(faces: Faces, potential: FloatArray) -> FloatArray:
    """The flow (M,) of the reference route plus the differences of the potential (F,)."""
    game = faces.game
    flow = faces.crossed + potential[faces.left] - potential[faces.right]
    forward = np.where(game.network.tails < game.network.heads, 1.0, -1.0)
    return np.where(game.playable, np.maximum(forward * flow[faces.link], 0.0), 0.0)
