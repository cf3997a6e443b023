"""The game on a set of routes: a linear program over mixtures of them, each hit once by each site.

The optimal mixture keeps the budgets, so its value is at least the game's. Its duals are an
ambusher and prices, which ``best_response`` turns into a lower bound and another route. Adding that
route and solving again closes the gap (column generation).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_matrix, diags, hstack, identity, vstack

from ..arrays import FloatArray, IndexArray
from ..errors import SolverFailed
from .best_response import best_response
from .budget import Budget
from .flow_program import capped_at_places
from .game import Game

# Most programs that are solved for one game, and in a row without a better bound.
MAX_ROUNDS, MAX_STALLED = 60, 8
# Weights of the best ambusher so far against the program's own in the ambushers that are tried.
BLENDS = (0.0, 0.5)


@dataclass(frozen=True, eq=False)
class RouteProgram:
    """The best bound with its ambusher, and the best mixture of routes.

    ``bound`` is certified by ``q`` (N,) and ``prices``; ``value`` >= bound is the mean loss of the
    mixture with the edge probabilities ``p`` (M,), if its routes are drawn as such.
    """

    bound: float
    q: FloatArray
    prices: tuple[float, ...]
    value: float
    p: FloatArray


def solve_on_routes(game: Game, routes: Sequence[IndexArray], budgets: tuple[Budget, ...],
                    q: FloatArray, prices: tuple[float, ...], closed: float,
                    deadline: float) -> RouteProgram:
    """Generate routes until value and bound are within ``closed`` of each other, relative.

    ``routes`` (edge indices each) include one within all budgets; ``q`` (N,) and ``prices`` are the
    ambusher to start from.
    """
    known: dict[tuple[int, ...], IndexArray] = {tuple(r.tolist()): r for r in routes}
    bound, stalled = -np.inf, 0
    best = q, prices

    def respond(q: FloatArray, prices: tuple[float, ...]) -> bool:
        """Try an ambusher; tell whether he gave a better bound or a new route."""
        nonlocal bound, best
        found, before = best_response(game, q, budgets, prices), len(known)
        if found.edges is not None:
            known.setdefault(tuple(found.edges.tolist()), found.edges)
        better = found.bound > bound
        if better:
            bound, best = found.bound, (q, prices)
        return better or len(known) > before

    respond(q, prices)
    for _ in range(MAX_ROUNDS):
        tried = list(known.values())
        value, share, q, prices = _solve_program(game, tried, budgets)
        if bound >= value * (1.0 - closed) or time.monotonic() > deadline:
            break
        centre = best
        ambushers = [
            (w * centre[0] + (1.0 - w) * q,
             tuple(w * a + (1.0 - w) * b for a, b in zip(centre[1], prices, strict=True)))
            for w in BLENDS
        ]
        before = bound
        progress = [respond(*ambusher) for ambusher in ambushers]
        stalled = 0 if bound > before else stalled + 1
        if not any(progress) or stalled == MAX_STALLED:
            break
    p = np.zeros(len(game.network.edges))
    for edges, probability in zip(tried, share, strict=True):
        p[edges] += probability
    return RouteProgram(bound, *best, value, p)


def _solve_program(
    game: Game, routes: list[IndexArray], budgets: tuple[Budget, ...]
) -> tuple[float, FloatArray, FloatArray, tuple[float, ...]]:
    """Value, shares (R,), q (N,) and prices of the game on ``routes``.

    Variables: the shares, then t and, with several ambushers, s_j >= 0 for each site, so that
    k t + sum s is the sum of the k largest losses.
    """
    which = np.repeat(np.arange(len(routes)), [len(route) for route in routes])
    shape = len(game.network.edges), len(routes)
    drives = csr_matrix((np.ones(len(which)), (np.concatenate(routes), which)), shape=shape)
    met = csr_matrix((game.hits @ drives > 0).astype(float))
    loss, k = game.loss[game.sites], game.ambushers
    rows = _needed_rows(met, loss) if k == 1 else np.flatnonzero(met.getnnz(axis=1))
    if not len(rows):
        q = np.zeros(game.node_count)
        q[game.sites[:k]] = 1.0
        return 0.0, np.eye(1, len(routes))[0], q, (0.0,) * len(budgets)
    unit, count, extra = float(loss[rows].max()), len(routes), len(rows) if k > 1 else 0
    losses = diags(loss[rows] / unit) @ met[rows]
    parts = [losses, csr_matrix(-np.ones((len(rows), 1))), -identity(len(rows), format='csr')]
    binding = [budget for budget in budgets if budget.binds]
    over = np.zeros((len(binding), count + 1 + extra))
    for row, budget in zip(over, binding, strict=True):
        row[:count] = [budget.excess[route].sum() / budget.margin for route in routes]
    limits = np.concatenate((np.zeros(len(rows)), np.ones(len(binding))))
    total = np.zeros((1, count + 1 + extra))
    total[0, :count] = 1.0
    found = linprog(np.concatenate((np.zeros(count), [float(k)], np.ones(extra))),
                    vstack([hstack(parts[: 3 if extra else 2]), csr_matrix(over)]).tocsr(), limits,
                    csr_matrix(total), [1.0], method='highs-ds')
    if found.status != 0:
        raise SolverFailed(f'the linear program over routes failed: {found.message}')
    duals = np.maximum(-found.ineqlin.marginals, 0.0)
    q = np.zeros(game.node_count)
    q[game.sites[rows]] = np.minimum(duals[: len(rows)], 1.0)
    q = capped_at_places(game, q * (k / q.sum()))
    price = iter(duals[len(rows) :])
    prices = tuple(float(next(price)) * unit / b.margin if b.binds else 0.0 for b in budgets)
    return float(found.fun) * unit, found.x[:count], q, prices


def _needed_rows(met: csr_matrix, loss: FloatArray) -> IndexArray:
    """Of the sites that meet the same routes, the costliest."""
    needed: dict[bytes, int] = {}
    order = np.argsort(-loss, kind='stable')
    for j in order[np.diff(met.indptr)[order] > 0].tolist():
        needed.setdefault(met.indices[met.indptr[j] : met.indptr[j + 1]].tobytes(), j)
    return np.array(sorted(needed.values()), dtype=np.int64)
