# SPDX-License-Identifier: Apache-2.0
"""The convoy's mixed strategy with its certificate, of one leg or of a trip, and its options."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from .. import plan_methods
from ..arrays import FloatArray, IndexArray, frozen_array, sums
from ..errors import InvalidOption
from ..maps.risk_map import RiskMap
from ..network.network import Network
from ..notebook import Shown
from ..option_checks import allowed, check_options
from .ambusher import Ambusher
from .budget import Budget
from .certificate.certificate import Certificate, Certified, check_strategy
from .distribution.chain import RouteMixture
from .game import Game
from .hits import Law, joint_law, largest_product, law_of
from .legs import Legs
from .route_sampler import MixtureSampler, RouteSampler, entropy, route_entropy
from .tolerance import CERTIFICATE_TOLERANCE, Reason, within

SOLVERS = ('max_entropy', 'interior_point', 'simplex')


@dataclass(frozen=True, kw_only=True)
class StrategyOptions:
    """Options that select one of the optimal strategies, and limit the solver.

    Parameters
    ----------
    solver
        'max_entropy': least value, then the most unpredictable routes, on an acyclic network.
        'interior_point' and 'simplex': the paper's linear program, by HiGHS' interior point method
        without crossover or its dual simplex method; their solutions may have cycles.
    max_detour
        Limit of the expected length, as a multiple of ``shortest_length``; ``inf``: no limit.
        The most unpredictable strategy usually uses all of it.
    risk_slack
        Tolerance of the value: accept up to (1 + risk_slack) times the lower bound; 0: within 1e-5
        of it. The linear programs ignore it.
    length_weight
        w in [0, 1): minimise (1 - w) z + w sum p l, as the paper does with 0.01 (linear programs
        only).
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
    time_limit: float = allowed(60.0, unit='s', finite=False)

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
    def tolerance(self) -> float:
        """Tolerance of the value: the risk slack, or 0 for the linear programs."""
        return self.risk_slack if self.solver == 'max_entropy' else 0.0


@dataclass(frozen=True, eq=False, repr=False)
class Strategy(Certified, Shown):
    """Mixed strategy of one leg with its certificate.

    Attributes
    ----------
    game : Game
        The network with its playable edges, ambush sites and losses.
    edge_probability : (M,)
        p: expected uses of each edge; probabilities if the strategy is acyclic.
    ambusher : Ambusher
        The ambusher's strategy that certifies the lower bound. On a trip it is the same for all
        legs, so a single leg's bound can be far below its value.
    budget : Budget
        The limit of the mean length.
    mixture : RouteMixture or None
        Whole routes that are drawn instead of a Markov chain, if a chain with the same p would
        exceed the tolerance. This happens where ways part, share a pass and part again within the
        reach: a chain does not remember the first choice.
    iterations : int
        Evaluations of the Gibbs distribution, or iterations of HiGHS.
    entropy_bound : float
        Upper bound of the route entropy within the same limits [nats]; NaN if unknown.
    reason : str
        Why the search ended: 'complete', the value is within the tolerance of its bound; 'time',
        the time limit passed; 'solver', a numerical solver failed; 'stalled', no method found a
        better strategy or bound, and more time would not help.
    """

    game: Game
    edge_probability: FloatArray
    ambusher: Ambusher
    budget: Budget
    certificate: Certificate
    mixture: RouteMixture | None = None
    iterations: int = 0
    entropy_bound: float = math.nan
    reason: Reason = 'complete'

    @cached_property
    def law(self) -> Law:
        """Probability law of the drawn routes."""
        return self.mixture or law_of(self.game, self.edge_probability)

    @cached_property
    def visit_probability(self) -> FloatArray:
        """x (N,): expected visits of each node, 1 at the source and the target."""
        return frozen_array(self.game.visits(self.edge_probability), np.float64)

    @property
    def ambush_probability(self) -> FloatArray:
        """q (N,): the ambusher's equilibrium strategy; sums to 1."""
        return self.ambusher.q

    @cached_property
    def edge_entropy(self) -> float:
        """Entropy -sum p ln p of the paper [nats]."""
        return entropy(self.edge_probability, np.ones_like(self.edge_probability))

    @cached_property
    def route_entropy(self) -> float:
        """Entropy of the drawn route: -sum p_ij ln(p_ij / x_i), or that of the mixture [nats]."""
        if self.mixture:
            return self.mixture.entropy
        return route_entropy(self.network, self.edge_probability)

    @property
    def entropy_gap(self) -> float:
        """Upper bound of the route entropy still missing [nats]: ``entropy_bound`` minus its own.

        It compares strategies on the same acyclic subnetwork within the same limits. NaN if
        unknown, as with a reach or on trips.
        """
        return max(self.entropy_bound - self.route_entropy, 0.0)

    @cached_property
    def expected_length(self) -> float:
        """Mean length of the route [m], or mean time [s] if the network has driving times."""
        return self.budget.mean(self.edge_probability)

    @property
    def shortest_length(self) -> float:
        """Length of the shortest way over the ground if it is known, else on the network [m or s].

        The network knows it as ``Network.ground_length``.
        """
        return self.budget.shortest

    @property
    def length_budget(self) -> float:
        """Limit of the mean length [m or s]; inf: none; with ``length_weight``, the mean itself."""
        return self.budget.limit

    @property
    def length_price(self) -> float:
        """Decrease of the value per unit of increase of the length budget."""
        return self.ambusher.prices[0]

    @cached_property
    def expected_exposure(self) -> float:
        """Mean integral of alpha along the route [loss x m]."""
        return float(self.edge_probability @ self.network.edge_exposure)

    def _summary(self) -> dict[str, str]:
        return {
            'value': f'{self.value:.4g}', 'lower bound': f'{self.lower_bound:.4g}',
            'mean length': f'{self.expected_length:.0f} {self.network.travel_unit}',
            'shortest route': f'{self.shortest_length:.0f} {self.network.travel_unit}',
            'effective number of routes': f'{math.exp(min(self.route_entropy, 700.0)):.3g}',
            'network': f'{len(self.network.points)} nodes, {len(self.network.edges)} edges',
        }

    def plot(self, risk_map: RiskMap | None = None, axes: Any = None) -> Any:
        """Draw edges by probability and ambush sites on matplotlib axes; returns the axes."""
        return plan_methods.plot(self.as_trip, risk_map, axes)

    @cached_property
    def as_trip(self) -> TripStrategy:
        """The trip of this leg alone."""
        return TripStrategy((self,), self.certificate, self.entropy_bound, self.reason)

    @property
    def network(self) -> Network:
        """The network that the strategy is for."""
        return self.game.network

    @cached_property
    def sampler(self) -> RouteSampler | MixtureSampler:
        """Sampler of the routes."""
        if self.mixture:
            return MixtureSampler(self.network, self.mixture)
        return RouteSampler(self.network, self.edge_probability)

    def sample_route(self, rng: np.random.Generator | int | None = None) -> IndexArray:
        """Draw a route (K,): node indices, source first, target last, none twice.

        ``rng`` is a generator, or a seed for tests; None: the operating system's entropy.
        """
        return self.sampler.draw(np.random.default_rng(rng))

    def sample_routes(self, n: int,
                      rng: np.random.Generator | int | None = None) -> list[IndexArray]:
        """Draw ``n`` routes at once: much faster than one by one."""
        return self.sampler.draw_many(n, np.random.default_rng(rng))

    def mean_direction(self) -> FloatArray:
        """Mean direction (N, 2) in which the convoy leaves each node; 0 at unused nodes.

        It is the mean of the unit vectors along the edges out of the node, weighted by p (right
        column of the paper's figure 3). Its length is 1 if the next step is certain.
        """
        network, p = self.network, self.edge_probability
        step = network.points[network.heads] - network.points[network.tails]
        unit = step / np.maximum(network.lengths, np.finfo(float).tiny)[:, None]
        count = len(network.points)
        total = [sums(network.tails, p * u, count) for u in unit.T]
        leaving = sums(network.tails, p, count)
        mean: FloatArray = np.stack(total, axis=1) / np.where(leaving > 0.0, leaving, 1.0)[:, None]
        return mean


@dataclass(frozen=True, eq=False)
class TripStrategy(Certified):
    """Mixed strategies of a trip's ``legs``, drawn independently, with one certificate.

    The ``certificate`` is about sums over the legs: the largest mean loss that an ambush at one
    site causes, and its lower bound.
    """

    legs: tuple[Strategy, ...]
    certificate: Certificate
    entropy_bound: float = math.nan
    reason: Reason = 'complete'

    @property
    def game(self) -> Game:
        """The game of the first leg; all legs have the same sites."""
        return self.legs[0].game

    @property
    def ambusher(self) -> Ambusher:
        """The ambusher's strategy that certifies the bound, with the prices of all legs."""
        parts = [leg.ambusher for leg in self.legs]
        return Ambusher(parts[0].q, tuple(part.prices[0] for part in parts),
                        sum((part.circulations for part in parts), ()))

    @cached_property
    def joint(self) -> Legs:
        """The legs' games as one."""
        return Legs(tuple(leg.game for leg in self.legs), tuple(leg.budget for leg in self.legs))

    @cached_property
    def law(self) -> Law:
        """Probability law of the routes of all legs."""
        return joint_law(self.joint, [leg.law for leg in self.legs])

    @cached_property
    def ground_uses(self) -> tuple[IndexArray, FloatArray]:
        """Edges (K, 2) of all legs, each once, and their expected uses (K,) by all legs."""
        count = len(self.legs[0].network.points)
        keys = np.concatenate([leg.network.edges @ (count, 1) for leg in self.legs])
        ground, edge = np.unique(keys, return_inverse=True)
        p = np.concatenate([leg.edge_probability for leg in self.legs])
        return np.stack(np.divmod(ground, count), axis=1), sums(edge.ravel(), p, len(ground))

    @cached_property
    def hits(self) -> FloatArray:
        """Probability (legs, S) that each site hits each leg."""
        return np.stack([leg.law.meets(leg.game.entering) for leg in self.legs])

    @property
    def first_hit_value(self) -> float:
        """Largest mean loss that an ambush at one site causes if the first hit ends the trip.

        It is exact, because legs are drawn independently, and at most the value.
        """
        missed = np.prod(1.0 - np.minimum(self.hits, 1.0), axis=0)
        return float((self.joint.loss * (1.0 - missed)).max(initial=0.0))

    @property
    def expected_length(self) -> float:
        """Mean length of all legs together [m or s]."""
        return sum(leg.expected_length for leg in self.legs)

    @property
    def shortest_length(self) -> float:
        """Length of the shortest ways of all legs together [m or s]."""
        return sum(leg.shortest_length for leg in self.legs)

    @property
    def expected_exposure(self) -> float:
        """Mean integral of alpha along all legs [loss x m]."""
        return sum(leg.expected_exposure for leg in self.legs)

    @property
    def edge_entropy(self) -> float:
        """-sum p ln p over the edges of all legs [nats]."""
        return sum(leg.edge_entropy for leg in self.legs)

    @property
    def route_entropy(self) -> float:
        """Entropy of the drawn routes of all legs [nats]."""
        return sum(leg.route_entropy for leg in self.legs)

    @property
    def entropy_gap(self) -> float:
        """Upper bound of the route entropy still missing within the limits [nats]."""
        return max(self.entropy_bound - self.route_entropy, 0.0)


def make_strategies(legs: Legs, p: FloatArray, mixtures: Sequence[RouteMixture | None],
                    ambusher: Ambusher, bounds: FloatArray, **facts: Any) -> TripStrategy:
    """Certify strategies p (M,) of all legs, drawn by chains or from ``mixtures`` of whole routes.

    ``bounds`` (legs,) are the ambusher's ``lower_bounds``, ``facts`` the other fields of
    ``Strategy``. Raises SolverFailed if p is not valid or a bound exceeds its value.
    """
    strategies, total = [], 0.0
    for game, budget, leg_p, mixture, leg_ambusher, bound in zip(
            legs.games, legs.budgets, legs.split(p), mixtures, ambusher.by_leg(), bounds.tolist(),
            strict=True):
        check_strategy(game, budget, leg_p)
        # Rounding may put p over a budget; the bound then holds for strategies as far over it.
        if leg_ambusher.prices[0] > 0.0:
            bound -= leg_ambusher.prices[0] * budget.overrun(leg_p)
        total += bound
        found = Strategy(game, frozen_array(leg_p, np.float64), leg_ambusher, budget,
                         Certificate(math.inf, 0.0), mixture, **facts)
        value = largest_product(game.loss[game.sites], game.entering, found.law)[0]
        strategies.append(replace(found, certificate=Certificate(value, max(bound, 0.0))))
    if len(strategies) == 1:
        return TripStrategy(tuple(strategies), strategies[0].certificate)
    trip = TripStrategy(tuple(strategies), Certificate(math.inf, 0.0))
    value = largest_product(legs.loss, legs.entering, trip.law)[0]
    return replace(trip, certificate=Certificate(value, max(total, 0.0)))


def with_certificate(trip: TripStrategy, certificate: Certificate) -> TripStrategy:
    """Return the same strategies with another certificate, such as that on another map."""
    if len(trip.legs) > 1:
        return replace(trip, certificate=certificate)
    return replace(trip, certificate=certificate,
                   legs=(replace(trip.legs[0], certificate=certificate),))


def weighted_length(strategy: Strategy | TripStrategy, options: StrategyOptions) -> float:
    """Return the length in the objective of a linear program with ``length_weight`` [loss]; else 0.

    The sum of it and the value is minimal, and sets the scale of the gap.
    """
    return sum(price * strategy.expected_length for price in strategy.ambusher.prices
               ) * (options.length_weight > 0.0)


def within_tolerance(strategy: Strategy | TripStrategy, options: StrategyOptions) -> bool:
    """Return whether the value is within the options' tolerance of the lower bound."""
    length = weighted_length(strategy, options)
    return within(strategy.value + length, strategy.lower_bound + length,
                  options.tolerance + CERTIFICATE_TOLERANCE)
