"""The linear program of the least value: the largest flow that the sites and budgets allow.

With f = p / z, in units of a loss near the value, it is

    maximise |f|   subject to   loss_j (hits of j by f) <= 1,   excess' f <= margin |f|,   A f = 0.

With k ambushers, the losses of any k sites must add up to at most 1: loss_j (hits of j) <= t + s_j
with k t + sum s <= 1. The duals are the ambusher's q and the prices of the budgets.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, hstack, vstack

from ..arrays import FloatArray, IndexArray
from ..errors import SolverFailed
from . import highs
from .budget import Budget
from .game import Game

# Cap on an edge's excess in units of the budget's margin; no strategy notices it.
MOST_EXCESS = 1e7
# Precision of the interior point method, as a share of the gap. A finer one costs more than its
# iterations: at a price of 0, all edges on routes that avoid the ambusher tie to join the program.
PRECISION = 0.05
# The interior point method leaves some probability at all sites, and best responses take longer
# with more sites. The costliest are kept: the others cost a route that meets each of them once at
# most this share of the gap.
NEGLIGIBLE = 0.1


class FlowProgram:
    """The linear program on the edges of a game; its solution as a flow and an ambusher."""

    def __init__(self, game: Game, budgets: tuple[Budget, ...], unit: float) -> None:
        self.game, self.budgets, self.unit = game, budgets, unit
        self.edge = np.flatnonzero(game.playable)
        hits = game.hits[:, self.edge]
        self.row = np.flatnonzero(hits.getnnz(axis=1) > 0)
        loss = game.loss[game.sites][self.row] / unit
        out = (game.network.tails[self.edge] == game.network.source).astype(float)
        over = [csr_matrix(np.minimum(b.excess[self.edge] / b.margin, MOST_EXCESS) - out)
                for b in budgets if b.binds]
        rows = csr_matrix(vstack([csr_matrix(hits[self.row].multiply(loss[:, None])), *over]))
        limits = np.repeat([1.0, 0.0], [len(loss), len(over)])
        rows_of_a, node = conservation(game)
        inner = rows_of_a[node != game.network.source]
        if game.ambushers > 1:
            rows, limits, inner = _with_several_ambushers(rows, len(loss), inner, game.ambushers)
        cost = np.zeros(rows.shape[1])
        cost[: len(out)] = -out
        self.program = highs.Program(cost, rows, limits, inner, np.zeros(inner.shape[0]))

    def solve(self, solver: str, closed: float,
              deadline: float) -> tuple[float, FloatArray, FloatArray]:
        """Return |f|, f (M,) and the duals of the inequalities, to a relative gap ``closed``."""
        try:
            result = highs.run(self.program, solver, deadline, False, PRECISION * closed)
        except SolverFailed:
            result = highs.run(self.program, 'simplex', deadline)
        size = -float(result.fun) if result.status == highs.OPTIMAL else 0.0
        if not size > 1e-12:
            raise SolverFailed('the program has no flow')
        f = np.zeros(len(self.game.network.edges))
        f[self.edge] = np.maximum(result.x[: len(self.edge)], 0.0)
        return size, f, np.maximum(-np.asarray(result.ineqlin.marginals), 0.0)

    def ambusher(self, duals: FloatArray, closed: float) -> tuple[FloatArray, tuple[float, ...]]:
        """q (N,) and the budgets' prices from the duals, for a relative gap of ``closed``."""
        sites, k = len(self.row), self.game.ambushers
        node, q = self.game.sites[self.row], np.zeros(self.game.node_count)
        # In these units every route, with the prices of its excess, costs at least 1.
        charge = duals[:sites] * self.game.loss[node] / self.unit
        order = np.argsort(charge)
        held = order[charge[order].cumsum() > NEGLIGIBLE * min(closed, 1.0)]
        q[node[held]] = duals[held]
        # With several ambushers, the dual of the sum's row bounds every q_j.
        total = float(duals[-1]) if k > 1 else float(q.sum())
        if not total > 0.0:
            raise SolverFailed('the program has no ambusher')
        price = iter(duals[sites:] / total * self.unit)
        return capped_at_places(self.game, q / total), tuple(
            float(next(price)) / budget.margin if budget.binds else 0.0 for budget in self.budgets
        )


def _with_several_ambushers(rows: csr_matrix, sites: int, inner: csr_matrix,
                            ambushers: int) -> tuple[csr_matrix, FloatArray, csr_matrix]:
    """Rows, limits and conservation with columns for t and each s_j appended to the flow's."""
    column = np.concatenate((np.zeros(sites, dtype=int), 1 + np.arange(sites)))
    places = np.tile(np.arange(sites), 2), column
    less = csr_matrix((np.full(2 * sites, -1.0), places), (rows.shape[0], 1 + sites))
    total = np.concatenate((np.zeros(rows.shape[1]), [ambushers], np.ones(sites)))
    limits = np.append(np.zeros(rows.shape[0]), 1.0)
    nothing = csr_matrix((inner.shape[0], 1 + sites))
    rows = vstack((hstack((rows, less)), csr_matrix(total)))
    return csr_matrix(rows), limits, csr_matrix(hstack((inner, nothing)))


def conservation(game: Game) -> tuple[csr_matrix, IndexArray]:
    """Rows of ``A`` over the playable edges, and their nodes.

    The target's row follows from the others and is omitted.
    """
    network = game.network
    tail, head = network.edges[game.playable].T
    column = np.arange(len(tail))
    entries = np.concatenate((np.ones(len(tail)), -np.ones(len(tail))))
    full = csr_matrix((entries, (np.concatenate((tail, head)), np.concatenate((column, column)))),
                      shape=(game.node_count, len(tail)))
    node = np.unique(tail)
    return full[node], node


def capped_at_places(game: Game, q: FloatArray) -> FloatArray:
    """Cap q (N,), which is 0 but at the sites, at 1; it sums to the number of ambushers.

    If there are fewer sites than ambushers, the others are spread over all places.
    """
    few = len(game.sites) < game.ambushers
    among = game.network.representatives if few else game.sites
    capped = np.zeros(game.node_count)
    capped[among] = capped_at_one(q[among], game.ambushers)
    return capped


def capped_at_one(q: FloatArray, ambushers: int) -> FloatArray:
    """Cap q (N,) at 1 everywhere and keep its sum, the number of ambushers."""
    for _ in range(100):
        over = q >= 1.0
        missing = ambushers - float(np.minimum(q, 1.0).sum())
        q = np.minimum(q, 1.0)
        if missing <= 0.0:
            break
        rest = float(q[~over].sum())
        if rest <= 0.0:
            q[~over] += missing / max(int((~over).sum()), 1)
            break
        q[~over] *= 1.0 + missing / rest
    return q
