# SPDX-License-Identifier: Apache-2.0
"""The convoy's mixed strategy: its options, and the record with its certificate."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..arrays import FloatArray, IndexArray, frozen_array, sums
from ..errors import InvalidOption
from ..maps.risk_map import RiskMap
from ..network.network import Network
from ..notebook import Shown
from ..option_checks import allowed, check_options
from .ambusher import Ambusher
from .budget import Budget, least_cost
from .certificate.certificate import Certificate, certify
from .game import Game
from .route_sampler import RouteSampler, entropy, route_entropy
from .slack import CERTIFICATE_TOLERANCE, Reason, within

SOLVERS = ('max_entropy', 'interior_point', 'simplex')


@dataclass(frozen=True, kw_only=True)
class StrategyOptions:
    """Options of the solver, and the strategy to choose among the optimal ones.

    Parameters
    ----------
    solver
        'max_entropy': least risk, then the most unpredictable routes, on an acyclic network.
        'interior_point' and 'simplex': the paper's linear program by HiGHS' interior point method
        without crossover or by its dual simplex method; their solutions may have cycles.
    max_detour
        Limit of the expected length, as a multiple of ``shortest_length``; ``inf``: no limit.
        The most unpredictable strategy usually uses all of it.
    risk_slack
        Accept values up to (1 + risk_slack) times the least; 0: within 1e-5 of the bound. The
        linear programs ignore it.
    length_weight
        w: minimise (1 - w) z + w sum p l, the paper's 0.99 / 0.01 variant (linear programs only).
    time_limit
        Time limit of the solve [s].

    Raises
    ------
    InvalidOption
        A value is out of range or of the wrong type, or the solver does not support an option.
    """

    solver: str = allowed('max_entropy', choices=SOLVERS)
    max_detour: float = allowed(1.2, low=1.0, finite=False)
    risk_slack: float = allowed(0.01)
    length_weight: float = allowed(0.0, high=1.0)
    time_limit: float = allowed(math.inf, unit='s', finite=False)

    def __post_init__(self) -> None:
        check_options(self)
        if self.length_weight >= 1.0:
            raise InvalidOption(f'length_weight must be in [0, 1), got {self.length_weight}')
        if self.time_limit == 0.0:
            raise InvalidOption(f'time_limit must be positive [s], got {self.time_limit}')
        if self.solver == 'max_entropy' and self.length_weight > 0.0:
            raise InvalidOption(
                f'length_weight {self.length_weight} needs the solver interior_point or simplex; '
                'max_entropy limits the length with max_detour'
            )

    @property
    def slack(self) -> float:
        """The risk slack of the solver: 0 for linear programs."""
        return self.risk_slack if self.solver == 'max_entropy' else 0.0


@dataclass(frozen=True, eq=False, repr=False)
class Strategy(Shown):
    """A mixed strategy with its certificate.

    Attributes
    ----------
    game : Game
        The network with its options applied: sites, losses, playable edges.
    edge_probability : (M,)
        p: expected uses of each edge; probabilities where the strategy is acyclic.
    ambusher : Ambusher
        The best one: where he waits, and what the budget is worth to him.
    budget : Budget
        The limit of the mean length.
    iterations : int
        Evaluations of the Gibbs distribution, or iterations of interior point or simplex method.
    reason : str
        Why the search ended: 'complete', the value is within the slack of its bound; 'time', the
        time limit passed; 'solver', a numerical solver failed; 'stalled', no method found a better
        strategy or bound, and more time would not help.
    """

    game: Game
    edge_probability: FloatArray
    ambusher: Ambusher
    budget: Budget
    certificate: Certificate
    iterations: int = 0
    entropy_bound: float = math.nan
    reason: Reason = 'complete'

    @property
    def value(self) -> float:
        """z(p): mean loss of the best ambush.

        A route counts once per site, however often it comes back into the site's reach. If p has
        cycles, every entry counts: an upper bound.
        """
        return self.certificate.value

    @property
    def lower_bound(self) -> float:
        """No strategy within the budget has a smaller value, counted in the same way."""
        return self.certificate.bound

    @property
    def gap(self) -> float:
        """Value minus lower bound."""
        return self.value - self.lower_bound

    @cached_property
    def visit_probability(self) -> FloatArray:
        """x (N,): expected visits of each node, 1 at the source and the target."""
        return frozen_array(self.game.visits(self.edge_probability), np.float64)

    @cached_property
    def shown_probability(self) -> FloatArray:
        """p (M,) with all edges for one stretch, as in layers, added up at the first."""
        p, first = self.edge_probability, self.network.first_edge
        return frozen_array(sums(first, p, len(p)), np.float64)

    @property
    def ambush_probability(self) -> FloatArray:
        """q (N,): the ambusher's equilibrium strategy at the first node of each place.

        It sums to 1. On trips, ``ambusher.by_leg`` says for which leg he
        waits there.
        """
        return self.ambusher.q

    @property
    def ambush_at_places(self) -> FloatArray:
        """q by place (K,), K = ``network.place_count``: summed over the nodes of each."""
        return self.game.at_places(self.ambush_probability)

    @cached_property
    def edge_entropy(self) -> float:
        """-sum p ln p, the paper's [nats]."""
        return entropy(self.edge_probability, np.ones_like(self.edge_probability))

    @cached_property
    def route_entropy(self) -> float:
        """Entropy of a drawn route, -sum p_ij ln(p_ij / x_i) [nats]."""
        return route_entropy(self.network, self.edge_probability)

    @property
    def entropy_gap(self) -> float:
        """How much more route entropy another strategy on the same acyclic part could have [nats].

        Within the same limits. NaN if that is not known, as with a reach or on trips.
        """
        return max(self.entropy_bound - self.route_entropy, 0.0)

    @cached_property
    def expected_length(self) -> float:
        """Mean length [m], or [s] if the network has driving times (``travel_costs``)."""
        return self.budget.mean(self.edge_probability)

    @property
    def shortest_length(self) -> float:
        """Length of the shortest way over the ground, or on the network [m or s].

        The latter if that over the ground is not known (``Network.ground_length``).
        """
        return self.budget.least

    @property
    def length_budget(self) -> float:
        """Largest mean length [m or s]; with ``length_weight`` the strategy's own; inf: any."""
        return self.budget.limit

    @property
    def length_price(self) -> float:
        """Decrease of the value per unit of increase of the length budget."""
        return self.ambusher.price

    @cached_property
    def expected_exposure(self) -> float:
        """Mean integral of alpha along the route [loss x m]."""
        return float(self.edge_probability @ self.network.edge_exposure)

    @cached_property
    def least_exposure(self) -> float:
        """Least exposure of any route [loss x m]."""
        return least_cost(self.network, self.network.edge_exposure)

    def _summary(self) -> dict[str, str]:
        return {
            'value': f'{self.value:.4g}', 'lower bound': f'{self.lower_bound:.4g}',
            'mean length': f'{self.expected_length:.0f} {self.network.travel_unit}',
            'shortest route': f'{self.shortest_length:.0f} {self.network.travel_unit}',
            'effective number of routes': f'{math.exp(min(self.route_entropy, 700.0)):.3g}',
            'network': f'{self.network.place_count} nodes, {self.network.stretches} edges',
        }

    def plot(self, risk_map: RiskMap | None = None, axes: Any = None) -> Any:
        """Draw edges by probability and ambush sites on matplotlib axes; returns the axes."""
        from ..figures import draw_strategy

        return draw_strategy(axes, self, risk_map)

    @property
    def network(self) -> Network:
        """The network that the strategy is for; layers come after its own nodes and edges.

        A strategy that has to remember its route has layers: on most trips, and if an ambush
        reaches two passes of a route.
        """
        return self.game.network

    @cached_property
    def _sampler(self) -> RouteSampler:
        return RouteSampler(self.network, self.edge_probability)

    def sample_route(self, rng: np.random.Generator | int | None = None) -> IndexArray:
        """Draw a route (K,): node indices, source first, target last, none twice.

        ``rng`` is a generator, or a seed for tests; None: the operating system's entropy.
        """
        return self._sampler.draw(np.random.default_rng(rng))

    def sample_routes(self, n: int,
                      rng: np.random.Generator | int | None = None) -> list[IndexArray]:
        """Draw ``n`` routes at once, as ``sample_route`` does but much faster."""
        return self._sampler.draw_many(n, np.random.default_rng(rng))

    def mean_direction(self) -> FloatArray:
        """Mean direction (N, 2) in which the convoy leaves each node; 0 at unused nodes.

        It is the mean of the unit vectors along the edges out of the node, weighted by p (the right
        column of the paper's figure 3); its length is 1 if the next step is certain. The nodes
        of all layers for a place count at the first of them.
        """
        network, p = self.network, self.shown_probability
        step = network.points[network.heads] - network.points[network.tails]
        unit = step / np.maximum(network.lengths, np.finfo(float).tiny)[:, None]
        count = len(network.points)
        total = [sums(network.tails, p * u, count) for u in unit.T]
        out = sums(network.tails, p, count)
        mean: FloatArray = np.stack(total, axis=1) / np.where(out > 0.0, out, 1.0)[:, None]
        return mean


def strategy_of(game: Game, p: FloatArray, ambusher: Ambusher, budget: Budget,
                bound: float | None = None) -> Strategy:
    """The strategy p (M,) with its certificate; ``bound`` is the ambusher's, if it is known.

    Raises SolverFailed if p or the ambusher is not valid; see ``certify``.
    """
    return Strategy(game, frozen_array(p, np.float64), ambusher, budget,
                    certify(game, p, ambusher, budget, bound))


def within_slack(strategy: Strategy, options: StrategyOptions) -> bool:
    """Whether value and lower bound are as near to each other as the options ask for."""
    # With a length weight, the weighted sum is minimal and sets the scale of the gap.
    weighed = strategy.length_price * strategy.expected_length * (options.length_weight > 0.0)
    return within(strategy.value + weighed, strategy.lower_bound + weighed,
                  options.slack + CERTIFICATE_TOLERANCE)
