"""The certificate: what a strategy costs at worst, and what no strategy can do better.

For any strategy p within the budgets, any q >= 0 that sums to the number of ambushers k with
q_j <= 1, and prices >= 0,

    z(p) >= q' D p >= min over routes of sum over edges (D' q + price * excess) - price * room,

where excess is how much longer (or more exposed) an edge makes the route than the best one, and
room is what the budget leaves over the best route. The left side is read off p, the right side is
one Dijkstra; neither knows where p, q and the prices come from.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import FloatArray, sums
from ..errors import BudgetInfeasible, SolverFailed
from .game import Game

# Rooms below this share of the best route's cost count as this: ties of best routes are rounding.
LEAST_ROOM = 1e-12
CONSERVATION_TOLERANCE = 1e-8
# Rounding that a bound may exceed a value by, relative.
ROUNDING = 1e-9
# A solver's strategy keeps its budgets within this, relative.
FITS = 5e-7


@dataclass(frozen=True, eq=False)
class Budget:
    """A limit on the mean of a cost that adds up along the route: length, or exposure.

    Parameters
    ----------
    game
        Where the convoy may drive.
    cost : (M,)
        Cost of each edge, >= 0.
    limit
        Largest mean cost; ``inf``: none.
    least
        Cost of the best route of the whole network, the measure of the limit.
    name, unit
        For messages.

    Raises
    ------
    BudgetInfeasible
        The best playable route costs more than the limit.
    """

    game: Game
    cost: FloatArray
    limit: float
    least: float
    name: str
    unit: str

    def __post_init__(self) -> None:
        if not self.binds:
            return
        best = self._behind[self.game.network.source]
        if best > self.limit * (1.0 + ROUNDING):
            raise BudgetInfeasible(
                f'the best playable route has {self.name} {best:.6g} {self.unit}, more than the '
                f'budget of {self.limit:.6g} {self.unit}; raise {self.option}, or '
                'alpha_threshold'
            )

    @cached_property
    def _behind(self) -> FloatArray:
        return self.game.distances_behind(self.cost)

    @property
    def option(self) -> str:
        """The option that sets the limit."""
        return 'max_detour' if self.name == 'length' else 'max_exposure'

    @property
    def binds(self) -> bool:
        """Whether there is a limit at all."""
        return bool(np.isfinite(self.limit))

    @cached_property
    def room(self) -> float:
        """What the limit leaves over the best playable route's cost, > 0."""
        best = float(self._behind[self.game.network.source])
        # Where the best route costs nothing the others' costs are the measure.
        scale = best or float(self.cost.max(initial=0.0))
        return max(self.limit - best, LEAST_ROOM * scale, np.finfo(float).tiny)

    @cached_property
    def excess(self) -> FloatArray:
        """Cost (M,) that each edge adds over the best way on from its tail; >= 0, inf off routes.

        Along a route they add up to its cost less the best one's, without cancellation.
        """
        network, behind = self.game.network, self._behind
        with np.errstate(invalid='ignore'):
            added = self.cost + behind[network.heads] - behind[network.tails]
        return np.where(self.game.playable, np.maximum(added, 0.0), np.inf)

    def mean(self, p: FloatArray) -> float:
        """Mean cost of strategy p (M,)."""
        return float(p @ self.cost)

    def keeps(self, p: FloatArray) -> bool:
        """Whether p (M,) is within the limit but for a solver's rounding."""
        return self.mean(p) <= self.limit * (1.0 + FITS)

    def overrun(self, p: FloatArray) -> float:
        """By how much the mean cost of p (M,) is over the limit, without cancellation."""
        used = p > 0.0
        return max(float(p[used] @ self.excess[used]) - self.room, 0.0)


@dataclass(frozen=True, eq=False)
class Certificate:
    """``value`` z(p) of a strategy and the ``bound`` that no strategy within the budgets beats."""

    value: float
    bound: float


def certify(
    game: Game, p: FloatArray, q: FloatArray, budgets: tuple[Budget, ...],
    prices: tuple[float, ...],
) -> Certificate:
    """Judge a strategy p (M,) by an ambusher's q (N,) and the prices of the budgets.

    Raises
    ------
    SolverFailed
        p is no flow from source to target or over a budget, q is no strategy, a price is
        negative, or the bound exceeds the value: something is wrong with the solver or the game.
    """
    _check_flow(game, p)
    for budget in budgets:
        if budget.binds and not budget.mean(p) <= budget.limit * (1.0 + 1e-6):
            raise SolverFailed(
                f"the strategy's {budget.name} is {budget.mean(p):.9g} {budget.unit}, over the "
                f"budget of {budget.limit:.9g}"
            )
    value = upper_bound(game, p)
    bound = lower_bound(game, q, budgets, prices)
    # What rounding lets p be over a budget, others may be, too: the bound is for all of them.
    over = sum(price * budget.overrun(p) for budget, price in zip(budgets, prices, strict=True))
    bound = max(bound - over, 0.0)
    if bound > value * (1.0 + ROUNDING):
        raise SolverFailed(f'the lower bound {bound:.12g} is above the value {value:.12g}')
    return Certificate(value, bound)


def upper_bound(game: Game, p: FloatArray) -> float:
    """z(p): what the best ambush against p costs on average, the sum of the k worst sites."""
    losses = game.site_losses(p)
    if game.ambushers == 1:
        return float(losses.max(initial=0.0))
    return float(np.sort(losses)[-game.ambushers :].sum())


def lower_bound(
    game: Game, q: FloatArray, budgets: tuple[Budget, ...] = (), prices: tuple[float, ...] = ()
) -> float:
    """Value that no strategy within the budgets can beat, given q (N,): one Dijkstra.

    Raises
    ------
    SolverFailed
        q is no strategy of the ambusher, or a price is negative.
    """
    _check_ambusher(game, q)
    for budget, price in zip(budgets, prices, strict=True):
        if not price >= 0.0:
            raise SolverFailed(f'the price of the {budget.name} budget is {price}, not >= 0')
    weights, paid = priced_edges(game, q, budgets, prices)
    return max(float(game.distances_ahead(weights)[game.network.target]) - paid, 0.0)


def priced_edges(
    game: Game, q: FloatArray, budgets: tuple[Budget, ...], prices: tuple[float, ...]
) -> tuple[FloatArray, float]:
    """What each edge (M,) costs by q (N,) and the budgets' prices, and what their room is worth."""
    weights, paid = game.mean_loss_on_edges(q), 0.0
    for budget, price in zip(budgets, prices, strict=True):
        if price > 0.0:
            weights = weights + price * budget.excess
            paid += price * budget.room
    return weights, paid


def _check_flow(game: Game, p: FloatArray) -> None:
    if not (p >= 0.0).all():
        raise SolverFailed(f'p must be >= 0, the least is {p.min()}')
    network = game.network
    balance = sums(network.tails, p, game.node_count)
    balance -= sums(network.heads, p, game.node_count)
    balance[network.source] -= 1.0
    balance[network.target] += 1.0
    residual = float(np.abs(balance).max())
    if not residual <= CONSERVATION_TOLERANCE:
        raise SolverFailed(f'p is no flow from source to target: residual {residual:.1e}')
    if p[~game.playable].any():
        raise SolverFailed('p uses edges that are not playable')


def _check_ambusher(game: Game, q: FloatArray) -> None:
    most = 1.0 + ROUNDING
    if not (q >= 0.0).all() or not (q <= most).all():
        raise SolverFailed(f'q must be in [0, 1], got {q.min()} to {q.max()}')
    if not abs(q.sum() - game.ambushers) <= ROUNDING * game.ambushers:
        raise SolverFailed(f'q must sum to {game.ambushers}, got {q.sum()}')
