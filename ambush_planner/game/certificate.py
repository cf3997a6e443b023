"""The certificate: the worst mean loss of a strategy, and a bound that no strategy can beat.

For any strategy p within the budgets, any q >= 0 that sums to the number of ambushers k with
q_j <= 1, and prices >= 0,

    z(p) >= q' D p >= min over routes of sum over edges (D' q + price * excess) - price * margin,

where an edge's excess is how much it lengthens (or exposes) the route beyond the best one, and the
margin is the budget minus the best route's cost. The left side follows from p, the right side from
one Dijkstra; neither depends on the solver that found p, q and the prices.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import FloatArray, sums
from ..errors import BudgetInfeasible, SolverFailed
from .game import Game

# Least margin of a budget, as a share of the best route's cost: smaller ones are rounding.
LEAST_MARGIN = 1e-12
# Largest imbalance of the flow at a node.
CONSERVATION_TOLERANCE = 1e-8
# Relative rounding by which a bound may exceed a value.
ROUNDING = 1e-9
# Relative overrun of a budget that a solver's strategy may have.
BUDGET_TOLERANCE = 5e-7


@dataclass(frozen=True, eq=False)
class Budget:
    """A limit on the mean cost of the route: its length, or its exposure.

    Parameters
    ----------
    game
        Where the convoy may drive.
    cost : (M,)
        Cost of each edge, >= 0.
    limit
        Largest mean cost; ``inf``: no limit.
    least
        Cost of the best route of the whole network.
    name, unit
        For messages, as in BudgetInfeasible if the best playable route exceeds the limit.
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
    def margin(self) -> float:
        """The limit minus the best playable route's cost, > 0."""
        best = float(self._behind[self.game.network.source])
        scale = best or float(self.cost.max(initial=0.0))
        return max(self.limit - best, LEAST_MARGIN * scale, np.finfo(float).tiny)

    @cached_property
    def excess(self) -> FloatArray:
        """Cost (M,) that each edge adds to the best way on from its tail; inf if not playable.

        The sum along a route is its cost minus the best route's, without cancellation.
        """
        network, behind = self.game.network, self._behind
        with np.errstate(invalid='ignore'):
            added = self.cost + behind[network.heads] - behind[network.tails]
        return np.where(self.game.playable, np.maximum(added, 0.0), np.inf)

    def mean(self, p: FloatArray) -> float:
        """Mean cost of strategy p (M,)."""
        return float(p @ self.cost)

    def keeps(self, p: FloatArray) -> bool:
        """Whether p (M,) is within the limit, up to a solver's rounding."""
        return self.mean(p) <= self.limit * (1.0 + BUDGET_TOLERANCE)

    def overrun(self, p: FloatArray) -> float:
        """Mean cost of p (M,) beyond the limit, >= 0, without cancellation."""
        used = p > 0.0
        return max(float(p[used] @ self.excess[used]) - self.margin, 0.0)


@dataclass(frozen=True, eq=False)
class Certificate:
    """``value`` z(p) of a strategy, and the ``bound`` that no strategy within the budgets beats."""

    value: float
    bound: float


def certify(
    game: Game, p: FloatArray, q: FloatArray, budgets: tuple[Budget, ...],
    prices: tuple[float, ...],
) -> Certificate:
    """Certify a strategy p (M,) with an ambusher's q (N,) and the prices of the budgets.

    Raises SolverFailed if p is not a unit flow from source to target or exceeds a budget, q is not
    a strategy, a price is negative, or the bound exceeds the value.
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
    # Rounding may put p over a budget; the bound then holds for strategies as far over it.
    over = sum(price * budget.overrun(p) for budget, price in zip(budgets, prices, strict=True))
    bound = max(bound - over, 0.0)
    if bound > value * (1.0 + ROUNDING):
        raise SolverFailed(f'the lower bound {bound:.12g} is above the value {value:.12g}')
    return Certificate(value, bound)


def upper_bound(game: Game, p: FloatArray) -> float:
    """z(p): mean loss of the best ambush against p (M,), the sum over the k worst sites."""
    losses = game.site_losses(p)
    if game.ambushers == 1:
        return float(losses.max(initial=0.0))
    return float(np.sort(losses)[-game.ambushers :].sum())


def lower_bound(
    game: Game, q: FloatArray, budgets: tuple[Budget, ...] = (), prices: tuple[float, ...] = ()
) -> float:
    """Value that no strategy within the budgets can beat, given q (N,): one Dijkstra.

    Raises SolverFailed if q is not a strategy of the ambusher, or a price is negative.
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
    """Cost of each edge (M,) under q (N,) and the prices, and the priced margins to subtract."""
    weights, paid = game.mean_loss_on_edges(q), 0.0
    for budget, price in zip(budgets, prices, strict=True):
        if price > 0.0:
            weights = weights + price * budget.excess
            paid += price * budget.margin
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
        raise SolverFailed(f'p is not a flow from source to target: residual {residual:.1e}')
    if p[~game.playable].any():
        raise SolverFailed('p uses edges that are not playable')


def _check_ambusher(game: Game, q: FloatArray) -> None:
    most = 1.0 + ROUNDING
    if not (q >= 0.0).all() or not (q <= most).all():
        raise SolverFailed(f'q must be in [0, 1], got {q.min()} to {q.max()}')
    if not abs(q.sum() - game.ambushers) <= ROUNDING * game.ambushers:
        raise SolverFailed(f'q must sum to {game.ambushers}, got {q.sum()}')
