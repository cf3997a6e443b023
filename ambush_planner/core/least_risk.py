"""The least value where no cut tells it: with budgets, a reach, or several ambushers.

With f = p / z in units of a loss near the value, the program is to send as much as possible,

    maximise |f|   subject to   loss_j (hits of j by f) <= 1,   excess' f <= room |f|,   A f = 0,

because the budget's row is homogeneous in f. It is solved by HiGHS' interior point method on a
part of the network; its duals are the ambusher's q and the prices of the budgets. If the
certificate then finds better routes outside that part, their edges join it, and so on.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, hstack, vstack

from . import highs
from .acyclic import conserved
from .arrays import BoolArray, FloatArray, IndexArray
from .certificate import Budget, lower_bound, priced_edges, upper_bound
from .errors import BudgetInfeasible, SolverFailed, TimeLimit
from .game import Game
from .routes import always_shortest

# The most that the edges of the program may grow by in one round.
GROWTH, LEAST_GROWTH = 0.3, 1000
# After the first round, edges on routes that cost this many times the value or more are dropped.
KEPT = 1.1
# Prices of a budget that are tried beside the program's, over value and room.
PRICES = tuple(10.0**k for k in range(-9, 1))
# Flows below this are the interior point method's rounding.
NEGLIGIBLE = 1e-8
# Edges that only routes over budget by this many times its room use are left for later.
FAR_OVER_BUDGET = 2.0
# A unit of loss is this near to the value, or the program is built again.
UNIT_RANGE = 1e3
# Edges that are over a budget by this many times its room are as good as unused.
MOST_EXCESS = 1e7
MAX_ROUNDS = 30


@dataclass(frozen=True, eq=False)
class LeastRisk:
    """An optimal strategy p (M,), acyclic, with its value, and the ambusher's side.

    ``level`` (S,) is what each site's mean loss may be; ``prices`` of the budgets, in loss per
    unit of cost; ``bound`` is the certificate's.
    """

    value: float
    bound: float
    p: FloatArray
    q: FloatArray
    prices: tuple[float, ...]
    level: FloatArray


def least_risk(
    game: Game, part: Game, budgets: tuple[Budget, ...], closed: float, deadline: float
) -> LeastRisk:
    """Solve the value program, starting on the edges of ``part``.

    It is solved when value and bound are within ``closed`` of each other, relative.

    Raises
    ------
    BudgetInfeasible
        No strategy fits all budgets.
    TimeLimit
        The deadline passed before the first solution.
    """
    chosen = part.playable
    unit = first_unit(part)
    best: LeastRisk | None = None
    first, solver = True, "interior_point"
    for _ in range(MAX_ROUNDS):
        restricted = game.restricted_to(chosen)
        try:
            if restricted is None:
                raise SolverFailed("the chosen edges hold no route")
            found, unit = _solve(game, restricted, budgets, unit, solver, deadline)
        except (SolverFailed, BudgetInfeasible):
            if chosen.sum() == game.playable.sum():
                raise
            chosen = game.playable
            continue
        except TimeLimit:
            if best is None:
                raise
            return best
        best = _better(best, _priced(game, found, budgets, closed))
        if best.bound >= best.value * (1.0 - closed):
            return best
        through = _route_costs(game, found, budgets)
        added = _missing(chosen, through, found.value * (1.0 - closed / 2.0))
        if not added.any() and solver == "simplex":
            return best
        if not added.any():
            # Nothing is missing but digits.
            first, solver = True, "simplex"
        if first:
            chosen = chosen & ((through <= KEPT * found.value) | (found.p > 0.0))
        first = False
        chosen = chosen | added
        if time.monotonic() > deadline:
            return best
    return best  # type: ignore[return-value]


def _better(best: LeastRisk | None, found: LeastRisk) -> LeastRisk:
    """The better strategy with the better bound, each with what belongs to it."""
    if best is None:
        return found
    lower = found if found.bound >= best.bound else best
    upper = found if found.value <= best.value else best
    return replace(upper, q=lower.q, prices=lower.prices, bound=lower.bound)


def near_budgets(game: Game, budgets: tuple[Budget, ...]) -> BoolArray:
    """Edges (M,) that some route not too far over the budgets uses."""
    near = np.ones(len(game.network.edges), dtype=bool)
    for budget in budgets:
        if budget.binds:
            near &= game.through(budget.excess) <= FAR_OVER_BUDGET * budget.room
    return near


def _priced(
    game: Game, found: LeastRisk, budgets: tuple[Budget, ...], closed: float
) -> LeastRisk:
    """The program's bound with other prices, where they do better: its edges know few of them."""
    for k, budget in enumerate(budgets):
        for price in PRICES if budget.binds else ():
            if found.bound >= found.value * (1.0 - closed):
                return found
            prices = list(found.prices)
            prices[k] = price * found.value / budget.room
            if not np.isfinite(prices[k]):
                continue
            bound = lower_bound(game, found.q, budgets, tuple(prices))
            if bound > found.bound:
                found = replace(found, bound=bound, prices=tuple(prices))
    return found


def _route_costs(game: Game, found: LeastRisk, budgets: tuple[Budget, ...]) -> FloatArray:
    """What the best route through each edge (M,) costs by the program's duals; inf off routes."""
    weights, paid = priced_edges(game, found.q, budgets, found.prices)
    return game.through(weights) - paid


def _missing(chosen: BoolArray, through: FloatArray, limit: float) -> BoolArray:
    """Edges (M,) outside the program on routes that cost less than ``limit``, the best first."""
    outside = np.where(chosen, np.inf, through)
    most = max(int(GROWTH * chosen.sum()), LEAST_GROWTH)
    if len(outside) > most:
        limit = min(limit, float(np.partition(outside, most)[most]))
    missing: BoolArray = outside <= limit
    return missing


def first_unit(game: Game) -> float:
    """A loss not below the value, to begin with: what the shortest route risks."""
    return upper_bound(game, always_shortest(game)) or 1.0


def _solve(
    game: Game, part: Game, budgets: tuple[Budget, ...], unit: float, solver: str, deadline: float
) -> tuple[LeastRisk, float]:
    """Solve on the edges of ``part``, in a unit of loss that is brought near the value."""
    for _ in range(6):
        program = _FlowProgram(part, budgets, unit)
        size, f, duals = program.solve(solver, deadline)
        if 1.0 / UNIT_RANGE < size < UNIT_RANGE:
            break
        unit = unit / max(size, 1e-9)
    q, prices = program.ambusher(duals)
    p = conserved(part, f / size, NEGLIGIBLE)
    if p is None:
        raise SolverFailed("the program's flow holds no route")
    value = upper_bound(game, p)
    bound = lower_bound(game, q, budgets, prices)
    return LeastRisk(value, bound, p, q, prices, program.levels(p)), unit


class _FlowProgram:
    """The linear program on the edges of a game, and what its solution means."""

    def __init__(self, game: Game, budgets: tuple[Budget, ...], unit: float) -> None:
        self.game, self.unit = game, unit
        self.budgets = budgets
        self.edge = np.flatnonzero(game.playable)
        rows = game.hits[:, self.edge]
        self.row = np.flatnonzero(rows.getnnz(axis=1) > 0)
        loss = game.loss[game.sites][self.row] / unit
        scaled = csr_matrix(rows[self.row].multiply(loss[:, None]))
        out = (game.network.tails[self.edge] == game.network.source).astype(float)
        bound = [b for b in budgets if b.binds]
        over = [
            csr_matrix(np.minimum(b.excess[self.edge] / b.room, MOST_EXCESS) - out) for b in bound
        ]
        several = game.ambushers > 1
        sites = len(self.row)
        extra = 1 + sites if several else 0
        blocks = [hstack((scaled, _shared_loss(sites))) if several else scaled]
        blocks += [hstack((row, csr_matrix((1, extra)))) if several else row for row in over]
        limits = [np.zeros(sites) if several else np.ones(sites), np.zeros(len(over))]
        if several:
            total = np.concatenate((np.zeros(len(out)), [game.ambushers], np.ones(sites)))
            blocks.append(csr_matrix(total))
            limits.append(np.ones(1))
        self._over, self._several = len(over), several
        rows_of_a, node = conservation(game)
        inner = rows_of_a[node != game.network.source]
        self.program = highs.Program(
            np.concatenate((-out, np.zeros(extra))),
            csr_matrix(vstack(blocks)),
            np.concatenate(limits),
            csr_matrix(hstack((inner, csr_matrix((inner.shape[0], extra))))),
            np.zeros(inner.shape[0]),
        )

    def solve(self, solver: str, deadline: float) -> tuple[float, FloatArray, FloatArray]:
        """Return |f|, f (M,) and the duals of the inequalities."""
        try:
            result = highs.run(self.program, solver, deadline, presolve=False)
        except SolverFailed:
            result = highs.run(self.program, "simplex", deadline)
        size = -float(result.fun) if result.status == highs.OPTIMAL else 0.0
        if not size > 1e-12:
            names = " and ".join(b.option for b in self.budgets if b.binds)
            raise BudgetInfeasible(f"no strategy fits all budgets at once; raise {names}")
        f = np.zeros(len(self.game.network.edges))
        f[self.edge] = np.maximum(result.x[: len(self.edge)], 0.0)
        return size, f, np.maximum(-np.asarray(result.ineqlin.marginals), 0.0)

    def ambusher(self, duals: FloatArray) -> tuple[FloatArray, tuple[float, ...]]:
        """q (N,) and the budgets' prices; a site too costly ever to be passed stays barred."""
        sites, k = len(self.row), self.game.ambushers
        q = np.zeros(self.game.node_count)
        q[self.game.sites[self.row]] = duals[:sites]
        # With several, the dual of the sum's row: no q_j is over it, and all may sum to less.
        total = float(duals[-1]) if self._several else float(q.sum())
        if not total > 0.0:
            raise SolverFailed("the program has no ambusher")
        q = at_most_one(q / total, k)
        price = iter(duals[sites : sites + self._over] / total * self.unit)
        return q, tuple(
            float(next(price)) / budget.room if budget.binds else 0.0 for budget in self.budgets
        )

    def levels(self, p: FloatArray) -> FloatArray:
        """Mean loss (S,) that each site may cause: the k-th worst one's, or its own if worse."""
        losses = self.game.site_losses(p)
        kth = np.sort(losses)[-min(self.game.ambushers, len(losses))]
        return np.maximum(losses, kth)


def _shared_loss(sites: int) -> csr_matrix:
    """Columns for loss_j <= t + s_j: t first, then one s_j a site; k t + sum s <= 1 elsewhere."""
    entries = np.full(2 * sites, -1.0)
    row = np.tile(np.arange(sites), 2)
    column = np.concatenate((np.zeros(sites, dtype=int), 1 + np.arange(sites)))
    return csr_matrix((entries, (row, column)), shape=(sites, 1 + sites))


def conservation(game: Game) -> tuple[csr_matrix, IndexArray]:
    """Rows of ``A`` over the playable edges, and their nodes: all in use but the target.

    The target's row follows from the others.
    """
    network = game.network
    tail, head = network.edges[game.playable].T
    column = np.arange(len(tail))
    entries = np.concatenate((np.ones(len(tail)), -np.ones(len(tail))))
    full = csr_matrix(
        (entries, (np.concatenate((tail, head)), np.concatenate((column, column)))),
        shape=(game.node_count, len(tail)),
    )
    node = np.unique(tail)
    return full[node], node


def at_most_one(q: FloatArray, ambushers: int) -> FloatArray:
    """Bring q (N,), which sums to the number of ambushers, below 1 everywhere."""
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
