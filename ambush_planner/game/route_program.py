"""The game on a few routes: a linear program over mixtures of them, each hit once by each site.

Its optimal mixture is within the budgets, so its value is above the least one; its duals are an
ambusher's q and prices of the budgets, which ``best_response`` turns into a bound below it. The
best response joins the routes, and so on (column generation).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_matrix, hstack, vstack

from ..arrays import FloatArray, IndexArray
from ..errors import SolverFailed
from .best_response import best_response
from .certificate import Budget
from .game import Game


@dataclass(frozen=True, eq=False)
class RouteProgram:
    """Bound with its q (N,) and prices, and the mixture: value, routes as edges, their shares."""

    bound: float
    q: FloatArray
    prices: tuple[float, ...]
    value: float
    routes: tuple[IndexArray, ...]
    share: FloatArray
    rounds: int


def solve_on_routes(
    game: Game, routes: Sequence[IndexArray], budgets: tuple[Budget, ...], q: FloatArray,
    prices: tuple[float, ...], closed: float, deadline: float, max_rounds: int = 60,
) -> RouteProgram:
    known = {tuple(r.tolist()): r for r in routes}
    first = best_response(game, q, budgets, prices, 20_000)
    best = (first.bound, q, prices)
    if first.edges is not None:
        known.setdefault(tuple(first.edges.tolist()), first.edges)
    rounds, value, share = 0, np.inf, np.zeros(0)
    weight = 1.0
    while True:
        rounds += 1
        value, share, q_lp, prices_lp = _program(game, list(known.values()), budgets)
        if best[0] >= value * (1.0 - closed) or rounds > max_rounds or time.monotonic() > deadline:
            break
        before, improved = len(known), False
        # At the program's own duals, and between these and the best known ones.
        for mix in (0.0, 0.5):
            q_try = mix * best[1] + (1.0 - mix) * q_lp
            prices_try = tuple(mix * a + (1.0 - mix) * b for a, b in zip(best[2], prices_lp, strict=True))
            found = best_response(game, q_try, budgets, prices_try, 30_000)
            if found.bound > best[0]:
                best = (found.bound, q_try, prices_try)
                improved = True
            if found.edges is not None:
                known.setdefault(tuple(found.edges.tolist()), found.edges)
        if len(known) == before and not improved:
            break
    return RouteProgram(best[0], best[1], best[2], value, tuple(known.values()), share, rounds)


def _program(
    game: Game, routes: list[IndexArray], budgets: tuple[Budget, ...]
) -> tuple[float, FloatArray, FloatArray, tuple[float, ...]]:
    """Value, shares (R,), q (N,) and prices of the game on ``routes``."""
    which = np.repeat(np.arange(len(routes)), [len(r) for r in routes])
    drives = csr_matrix(
        (np.ones(len(which)), (np.concatenate(routes), which)),
        shape=(len(game.network.edges), len(routes)),
    )
    hit = ((game.hits @ drives) > 0).astype(float)
    loss = game.loss[game.sites]
    met = np.flatnonzero(hit.getnnz(axis=1) > 0)
    # Sites that hit the same routes: only the costliest matters to one ambusher.
    if game.ambushers == 1:
        keys: dict[bytes, int] = {}
        for j in met[np.argsort(-loss[met], kind='stable')].tolist():
            keys.setdefault(hit.indices[hit.indptr[j]:hit.indptr[j + 1]].tobytes(), j)
        met = np.array(sorted(keys.values()), dtype=np.int64)
    rows = csr_matrix(hit[met].multiply(loss[met][:, None]))
    unit = float(loss[met].max(initial=0.0)) or 1.0
    count, k = len(routes), game.ambushers
    extra = len(met) if k > 1 else 0
    parts = [rows / unit, csr_matrix(-np.ones((len(met), 1)))]
    if extra:
        parts.append(csr_matrix((-np.ones(extra), (np.arange(extra), np.arange(extra)))))
    upper = [hstack(parts)]
    limits = [np.zeros(len(met))]
    binding = [b for b in budgets if b.binds]
    for budget in binding:
        cost = np.array([budget.excess[r].sum() for r in routes]) / budget.room
        upper.append(csr_matrix((cost, (np.zeros(count, int), np.arange(count))), shape=(1, count + 1 + extra)))
        limits.append(np.ones(1))
    objective = np.concatenate((np.zeros(count), [float(k)], np.ones(extra)))
    total = csr_matrix((np.ones(count), (np.zeros(count, int), np.arange(count))), shape=(1, count + 1 + extra))
    found = linprog(objective, vstack(upper).tocsr(), np.concatenate(limits), total, [1.0], method='highs-ds')
    if found.status != 0:
        raise SolverFailed(f'the program over routes: {found.message}')
    duals = np.maximum(-found.ineqlin.marginals, 0.0)
    q = np.zeros(game.node_count)
    q[game.sites[met]] = np.minimum(duals[: len(met)], 1.0)
    if q.sum() > 0.0:
        q *= k / q.sum()
    else:
        q[game.sites[:k]] = 1.0
    price = iter(duals[len(met):])
    prices = tuple(float(next(price)) * unit / b.room if b.binds else 0.0 for b in budgets)
    return float(found.fun) * unit, found.x[:count], q, prices
