# SPDX-License-Identifier: Apache-2.0
"""The convoy's mixed strategy: its options, the record with its certificate, and ``solve``."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..arrays import FloatArray, IndexArray, frozen_array, sums
from ..errors import InvalidNetwork, InvalidOption, TimeLimit, warn
from ..maps.risk_map import MAX_LOSS, MIN_LOSS, RiskMap
from ..network.network import Network
from ..notebook import Shown
from ..option_checks import check_at_least
from .ambusher import Ambusher
from .budget import Budget
from .certificate.certificate import Certificate, certify
from .game import Game, GameOptions, make_game
from .hits import hits_can_differ
from .route_sampler import RouteSampler, entropy, route_entropy
from .search import Multipliers, Search, SearchProblem, SiteSearch, Solution
from .slack import CERTIFICATE_TOLERANCE, Reason, within
from .solver import find_distribution, most_unpredictable
from .value.linear_program import linear_program_strategy
from .value.routes import Progress, no_progress

# A search ends before its time limit by a share of it or by a time [s], whichever is less; its
# judge ends at most half of the greater after it. On a trip the judge takes seconds.
RESERVE, RESERVE_ON_TRIPS = (0.05, 1.0), (0.15, 30.0)
# Share of the routes that a single ambush hits from which they count as all.
ALL_ROUTES = 0.99
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
        Limit of the expected length, as a multiple of the shortest route's; ``inf``: no limit.
        The most unpredictable strategy usually uses all of it.
    max_exposure
        Limit of the expected exposure (the integral of alpha along the route), as a multiple of
        the least; ``inf``: no limit ('max_entropy' only).
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

    solver: str = 'max_entropy'
    max_detour: float = 1.2
    max_exposure: float = math.inf
    risk_slack: float = 0.01
    length_weight: float = 0.0
    time_limit: float = math.inf

    def __post_init__(self) -> None:
        if not isinstance(self.solver, str) or self.solver not in SOLVERS:
            raise InvalidOption(f"solver must be one of {', '.join(SOLVERS)}, got {self.solver!r}")
        check_at_least('max_detour', self.max_detour, 1.0, finite=False)
        check_at_least('max_exposure', self.max_exposure, 1.0, finite=False)
        check_at_least('risk_slack', self.risk_slack, 0.0)
        check_at_least('length_weight', self.length_weight, 0.0)
        check_at_least('time_limit', self.time_limit, 0.0, 's', finite=False)
        if self.length_weight >= 1.0:
            raise InvalidOption(f'length_weight must be in [0, 1), got {self.length_weight}')
        if self.time_limit == 0.0:
            raise InvalidOption(f'time_limit must be positive [s], got {self.time_limit}')
        if self.solver == 'max_entropy' and self.length_weight > 0.0:
            raise InvalidOption(
                f'length_weight {self.length_weight} needs the solver interior_point or simplex; '
                'max_entropy limits the length with max_detour'
            )
        if self.solver != 'max_entropy' and math.isfinite(self.max_exposure):
            raise InvalidOption(
                f'max_exposure {self.max_exposure} needs the solver max_entropy, got {self.solver}'
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
        The best one: where he waits, and what the budgets are worth to him.
    iterations : int
        Evaluations of the Gibbs distribution, or iterations of interior point or simplex method.
    multipliers : Multipliers or None
        Those of the Gibbs distribution, for a warm start.
    reason : str
        Why the search ended: 'complete', the value is within the slack of its bound; 'time', the
        time limit passed; 'solver', a numerical solver failed; 'stalled', no method found a better
        strategy or bound, and more time would not help.
    """

    game: Game
    edge_probability: FloatArray
    ambusher: Ambusher
    budgets: tuple[Budget, Budget]
    certificate: Certificate
    iterations: int = 0
    multipliers: Multipliers | None = None
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
        """No strategy within the budgets has a smaller value, counted in the same way."""
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
        """p (M,) with all edges for one stretch, as in layers of a trip, added up at the first."""
        p, first = self.edge_probability, self.network.first_edge
        return frozen_array(sums(first, p, len(p)), np.float64)

    @property
    def ambush_probability(self) -> FloatArray:
        """q (N,): the ambusher's equilibrium strategy at the first node of each place.

        It sums to the number of ambushers. On trips, ``ambusher.by_leg`` says for which leg he
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
        return self.budgets[0].mean(self.edge_probability)

    @property
    def shortest_length(self) -> float:
        """Length of the whole network's shortest route [m or s]."""
        return self.budgets[0].least

    @property
    def length_budget(self) -> float:
        """Largest mean length [m or s]; with ``length_weight`` the strategy's own; inf: any."""
        return self.budgets[0].limit

    @property
    def length_price(self) -> float:
        """Decrease of the value per unit of increase of the length budget."""
        return self.ambusher.prices[0]

    @cached_property
    def expected_exposure(self) -> float:
        """Mean integral of alpha along the route [loss x m]."""
        return self.budgets[1].mean(self.edge_probability)

    @property
    def least_exposure(self) -> float:
        """Least exposure of any route [loss x m]."""
        return self.budgets[1].least

    @property
    def exposure_budget(self) -> float:
        """Largest mean exposure [loss x m]; inf: unlimited."""
        return self.budgets[1].limit

    @property
    def exposure_price(self) -> float:
        """Decrease of the value per unit of increase of the exposure budget."""
        return self.ambusher.prices[1]

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
        from ..figures import draw_strategy

        return draw_strategy(axes, self, risk_map)

    @property
    def network(self) -> Network:
        """The network that the strategy is for."""
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


def solve(network: Network, game: GameOptions | None = None, options: StrategyOptions | None = None,
          warm: Multipliers | None = None) -> Strategy:
    """Find the convoy's optimal mixed strategy on a network; its value is at the network's nodes.

    ``plan_trip`` also considers ambushers between the nodes, the driven paths and the secured area.

    Parameters
    ----------
    network
        As ``build_network`` makes it, or any other.
    game
        What the ambusher can do.
    options
        The budgets, the solver, the time limit.
    warm
        Multipliers of a strategy for the same nodes with other losses, budgets or slack, to start
        the search from.

    Returns
    -------
    Strategy
        With its value, its lower bound and the ambusher who proves it.

    Raises
    ------
    InvalidNetwork
        A loss is too large or too small to compute with.
    NoRoute
        No route leads from the source to the target.
    BudgetInfeasible
        Every playable route is longer, or more exposed, than the budget.
    TimeLimit
        The time limit passed before the value was within the slack of its bound; the error's
        ``strategy`` is the best so far.

    Examples
    --------
    Two ways, past losses of 1 and 3: the ambusher gains most if both cost the same.

    >>> from ambush_planner import Network, StrategyOptions, solve
    >>> network = Network(points=[(0, 0), (1, 1), (1, -1), (2, 0)], alpha=[0, 1, 3, 0],
    ...                   edges=[(0, 1), (0, 2), (1, 3), (2, 3)], source=0, target=3)
    >>> strategy = solve(network, options=StrategyOptions(risk_slack=0.0))
    >>> round(strategy.value, 3), strategy.edge_probability.round(2).tolist()
    (0.75, [0.75, 0.25, 0.75, 0.25])
    """
    if not isinstance(network, Network):
        raise InvalidNetwork(f'solve needs a Network, got a {type(network).__name__}; '
                             'build_network makes one of a RiskMap, and plan_trip does it all')
    found = solve_game(make_game(network, game or GameOptions()), options or StrategyOptions(),
                       warm=warm)
    loss = found.game.loss
    certain = (found.ambush_probability > 0.0) & (ALL_ROUTES * loss <= found.value) & (loss > 0.0)
    if not found.value > 0.0:
        warn('the value is 0: some routes pass no ambush that causes a loss; check alpha and the '
             'secured area (secured_radius)')
    elif found.reason == 'complete' and found.game.options.ambushers == 1 and certain.any():
        warn(f'an ambush at node {int(certain.argmax())} hits every route: it always succeeds and '
             f'costs {found.value:.4g}')
    return found


def solve_game(game: Game, options: StrategyOptions, site_search: SiteSearch | None = None,
               warm: Multipliers | None = None, progress: Progress = no_progress) -> Strategy:
    """Find the optimal strategy against an ambusher at a game's sites and those of ``site_search``.

    Raises the errors of ``solve``.
    """
    if options.solver != 'max_entropy':
        _check_losses(game.network)
        deadline = time.monotonic() + options.time_limit
        return _by_linear_program(game, make_budgets(game, options), options, deadline)
    problem = make_problem(game, options, site_search, warm, progress)
    return _strategy_within(most_unpredictable(problem), options)


def make_problem(game: Game, options: StrategyOptions, site_search: SiteSearch | None = None,
                 warm: Multipliers | None = None,
                 progress: Progress = no_progress) -> SearchProblem:
    """What 'max_entropy' searches, from now to its time limit; raises the errors of ``solve``."""
    _check_losses(game.network)
    deadline, judged = _search_ends(time.monotonic() + options.time_limit, options,
                                    game.network)
    return SearchProblem(game, make_budgets(game, options), options.risk_slack, deadline,
                         site_search, warm, progress, judged)


def finish(search: Search, options: StrategyOptions, end: float) -> Strategy:
    """The strategy of a search whose value has been found, by ``end``; raises TimeLimit."""
    search.go_on_until(*_search_ends(end, options, search.problem.game.network))
    return _strategy_within(find_distribution(search), options)


def _search_ends(end: float, options: StrategyOptions, network: Network) -> tuple[float, float]:
    """When a search and its judge end if the time limit passes at ``end``."""
    share, most = RESERVE_ON_TRIPS if network.legs > 1 else RESERVE
    later = max(RESERVE[0] * options.time_limit, RESERVE[1]) / 2.0
    return end - min(share * options.time_limit, most), end + later


def _strategy_within(found: Solution, options: StrategyOptions) -> Strategy:
    """The strategy; raises TimeLimit if the time passed before it was within the slack."""
    strategy = strategy_of(found.game, found.p, found.ambusher, found.budgets, found.bound)
    strategy = replace(strategy, iterations=found.evaluations, multipliers=found.multipliers,
                       entropy_bound=found.entropy_bound)
    if within_slack(strategy, options):
        return strategy
    strategy = replace(strategy, reason=found.reason)
    if found.reason != 'time':
        return strategy
    raise TimeLimit(
        f'after {options.time_limit:g} s the value {strategy.value:.6g} is not within '
        f'{options.risk_slack:g} of its bound {strategy.lower_bound:.6g}; allow more time', strategy
    )


def strategy_of(game: Game, p: FloatArray, ambusher: Ambusher, budgets: tuple[Budget, Budget],
                bound: float | None = None) -> Strategy:
    """The strategy p (M,) with its certificate; ``bound`` is the ambusher's, if it is known.

    Raises SolverFailed if p or the ambusher is not valid; see ``certify``.
    """
    return Strategy(game, frozen_array(p, np.float64), ambusher, budgets,
                    certify(game, p, ambusher, budgets, bound))


def make_budgets(game: Game, options: StrategyOptions) -> tuple[Budget, Budget]:
    """The budgets of length and exposure, as multiples of the whole network's best routes.

    Raises BudgetInfeasible if the best playable route exceeds a budget.
    """
    return Budget.length(game, options.max_detour), Budget.exposure(game, options.max_exposure)


def within_slack(strategy: Strategy, options: StrategyOptions) -> bool:
    """Whether value and lower bound are as near to each other as the options ask for."""
    # With a length weight, the weighted sum is minimal and sets the scale of the gap.
    weighed = strategy.length_price * strategy.expected_length * (options.length_weight > 0.0)
    return within(strategy.value + weighed, strategy.lower_bound + weighed,
                  options.slack + CERTIFICATE_TOLERANCE)


def _by_linear_program(game: Game, budgets: tuple[Budget, Budget], options: StrategyOptions,
                       deadline: float) -> Strategy:
    """The strategy of one of the paper's linear programs."""
    found = linear_program_strategy(game, options.solver, budgets[0], options.length_weight,
                                    deadline)
    own = found.budget, budgets[1]
    strategy = replace(strategy_of(game, found.p, found.ambusher, own), iterations=found.iterations)
    if within_slack(strategy, options):
        return strategy
    return replace(strategy, reason='stalled' if hits_can_differ(game) else 'solver')


def _check_losses(network: Network) -> None:
    """Raise InvalidNetwork if a loss is out of range."""
    odd = (network.alpha > MAX_LOSS) | ((network.alpha > 0.0) & (network.alpha < MIN_LOSS))
    if odd.any():
        node = int(np.argmax(odd))
        raise InvalidNetwork(f'alpha must be 0 or in {MIN_LOSS:g}..{MAX_LOSS:g}, got '
                             f'{network.alpha[node]:g} at node {node}; scale the losses, or '
                             'set the smallest to 0')
