"""The convoy's mixed strategy: its options, the record with its certificate, and ``solve``."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..arrays import FloatArray, IndexArray, frozen_array, sums
from ..errors import InvalidNetwork, InvalidOption, TimeLimit
from ..maps.risk_map import LEAST_LOSS, MOST_LOSS, RiskMap
from ..network.network import Network
from ..network.shortest_paths import distances_from
from ..notebook import Shown
from ..option_checks import check_at_least
from .budget import Budget
from .certificate import certify
from .entries import entry_bound, entry_value
from .entropy_stage import EntropyStage, Solution
from .game import Game, GameOptions, make_game
from .hits import hits_can_differ
from .limit_rows import Multipliers
from .linear_program import linear_program_strategy
from .route_sampler import RouteSampler, entropy, route_entropy
from .strategy_solver import max_entropy_strategy

SOLVERS = ('max_entropy', 'interior_point', 'simplex')
# A published value is at most (1 + risk_slack + this) times its bound.
CERTIFICATE_TOLERANCE = 1e-5


@dataclass(frozen=True)
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


@dataclass(frozen=True, eq=False, repr=False)
class Strategy(Shown):
    """A mixed strategy with its certificate.

    Attributes
    ----------
    game : Game
        The network with its options applied: sites, losses, playable edges.
    edge_probability : (M,)
        p: expected uses of each edge; probabilities where the strategy is acyclic.
    visit_probability : (N,)
        x: expected visits of each node, 1 at the source and the target.
    ambush_probability : (N,)
        q: the ambusher's equilibrium strategy, sums to the number of ambushers. On trips, a place
        can have a share at a node of each leg: the one for which the ambusher waits there.
    ambush_at_places : (K,)
        q by place, K = ``network.place_count``: the shares at all nodes of each added up.
    value : float
        z(p): mean loss of the best ambush. A route counts once per site, however often it comes
        back into the site's reach. If p has cycles, every entry counts: an upper bound.
    lower_bound : float
        No strategy within the budgets has a smaller value, counted in the same way.
    gap : float
        value - lower_bound.
    edge_entropy, route_entropy : float
        -sum p ln p (the paper's), and the entropy of the drawn route, -sum p_ij ln(p_ij / x_i)
        [nats].
    expected_length, shortest_length, length_budget : float
        [m], or [s] if the network has driving times (``travel_costs``); the shortest route is the
        whole network's. With ``length_weight`` the budget is the strategy's own expected length.
    expected_exposure, least_exposure, exposure_budget : float
        Integral of alpha along the route [loss x m]: its mean, the least of any route, the budget.
    length_price, exposure_price : float
        Decrease of the value per unit of increase of the budget.
    iterations : int
        Evaluations of the Gibbs law, or iterations of the interior point or simplex method.
    multipliers : Multipliers or None
        Those of the Gibbs law, for a warm start.
    entropy_gap : float
        How much more route entropy another strategy on the same acyclic part could have [nats];
        NaN if that is not known.
    counting_gap : bool
        Whether the value exceeds its bound by more than the slack because the methods here found
        no better strategy when each route counts once. More time would not change it.
    """

    game: Game
    edge_probability: FloatArray
    visit_probability: FloatArray
    ambush_probability: FloatArray
    value: float
    lower_bound: float
    gap: float
    edge_entropy: float
    route_entropy: float
    expected_length: float
    shortest_length: float
    length_budget: float
    length_price: float
    expected_exposure: float
    least_exposure: float
    exposure_budget: float
    exposure_price: float
    iterations: int
    multipliers: Multipliers | None
    counting_gap: bool = False
    entropy_gap: float = math.nan

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

    @property
    def ambush_at_places(self) -> FloatArray:
        """How likely an ambusher waits at each place (K,): q summed over the nodes of each."""
        return self.game.at_places(self.ambush_probability)

    @cached_property
    def _sampler(self) -> RouteSampler:
        return RouteSampler(self.network, self.edge_probability)

    def sample_route(self, rng: np.random.Generator) -> IndexArray:
        """Draw a route (K,): node indices, source first, target last, none twice."""
        return self._sampler.draw(rng)

    def sample_routes(self, n: int, rng: np.random.Generator) -> list[IndexArray]:
        """Draw ``n`` routes at once, much faster than one by one."""
        return self._sampler.draw_many(n, rng)

    def mean_direction(self) -> FloatArray:
        """Mean direction (N, 2) in which the convoy leaves each node; 0 at unused nodes.

        It is the mean of the unit vectors along the edges out of the node, weighted by p (the right
        column of the paper's figure 3); its length is 1 if the next step is certain.
        """
        network, p = self.network, self.edge_probability
        step = network.points[network.heads] - network.points[network.tails]
        unit = step / np.maximum(network.lengths, np.finfo(float).tiny)[:, None]
        count = len(network.points)
        total = [sums(network.tails, p * u, count) for u in unit.T]
        out = sums(network.tails, p, count)
        mean: FloatArray = np.stack(total, axis=1) / np.where(out > 0.0, out, 1.0)[:, None]
        return mean


def solve(network: Network, game: GameOptions | None = None, options: StrategyOptions | None = None,
          warm: Multipliers | None = None) -> Strategy:
    """Find the convoy's optimal mixed strategy.

    ``warm`` are the multipliers of a strategy for the same nodes with other losses, budgets or
    slack, to start the search from.

    Raises
    ------
    InvalidNetwork
        A loss is too large or too small to compute with.
    NoRoute
        No route leads from the source to the target.
    BudgetInfeasible
        Every playable route is longer, or more exposed, than the budget.
    TimeLimit
        The time limit passed, or rounding prevailed, before the value was within the slack of its
        bound; the error's ``strategy`` is the best so far.
    """
    options = options or StrategyOptions()
    deadline = time.monotonic() + options.time_limit
    _check_losses(network)
    prepared = make_game(network, game or GameOptions())
    budgets = make_budgets(prepared, options)
    bound = None
    if options.solver == 'max_entropy':
        stage = EntropyStage(prepared, budgets, options.risk_slack, deadline, warm)
        solution = max_entropy_strategy(stage)
        bound = stage.hit_bound(solution.q, solution.prices)
    else:
        solution, length = linear_program_strategy(
            prepared, options.solver, budgets[0], options.length_weight, deadline
        )
        budgets = (length, budgets[1])
    strategy = strategy_from_solution(prepared, solution, budgets, bound)
    return _with_gap_checked(strategy, solution, budgets, options, deadline)


def make_budgets(game: Game, options: StrategyOptions) -> tuple[Budget, Budget]:
    """The budgets of length and exposure, as multiples of the whole network's best routes.

    Raises BudgetInfeasible if the best playable route exceeds a budget.
    """
    network = game.network
    return (
        _budget(game, network.travel_costs, options.max_detour, 'length',
                network.travel_unit),
        _budget(game, network.edge_exposure, options.max_exposure, 'exposure', 'loss x m'),
    )


def _budget(game: Game, cost: FloatArray, factor: float, name: str, unit: str) -> Budget:
    least = least_cost(game.network, cost)
    limit = factor * least if math.isfinite(factor) else math.inf
    return Budget(game, cost, limit, least, name, unit)


def least_cost(network: Network, cost: FloatArray) -> float:
    """Cost of the network's best route, from the costs (M,) of edges."""
    found = distances_from(network.edges, cost, len(network.points), network.source)
    return float(found[network.target])


def _check_losses(network: Network) -> None:
    """Refuse losses whose products with probabilities leave the range of floating point."""
    odd = (network.alpha > MOST_LOSS) | ((network.alpha > 0.0) & (network.alpha < LEAST_LOSS))
    if odd.any():
        node = int(np.argmax(odd))
        raise InvalidNetwork(f'alpha must be 0 or in {LEAST_LOSS:g}..{MOST_LOSS:g}, got '
                             f'{network.alpha[node]:g} at node {node}; scale the losses')


def _with_gap_checked(strategy: Strategy, solution: Solution, budgets: tuple[Budget, Budget],
                      options: StrategyOptions, deadline: float) -> Strategy:
    """The strategy, which is that of the solution; raises TimeLimit if its gap is too wide."""
    entropic = options.solver == 'max_entropy'
    slack = CERTIFICATE_TOLERANCE + (options.risk_slack if entropic else 0.0)
    # With a length weight, the weighted sum is minimal and sets the scale of the gap.
    weighed = options.length_weight > 0.0
    extra = solution.prices[0] * strategy.expected_length if weighed else 0.0

    def closed(value: float, bound: float) -> bool:
        return value + extra <= (bound + extra) * (1.0 + slack)

    if closed(strategy.value, strategy.lower_bound):
        return strategy
    if hits_can_differ(strategy.game):
        complete = solution.complete and time.monotonic() < deadline if entropic else closed(
            entry_value(strategy.game, solution.p),
            entry_bound(strategy.game, solution.q, budgets, solution.prices),
        )
        if complete:
            return replace(strategy, counting_gap=True)
    raise TimeLimit(
        f'the value {strategy.value:.6g} is not within {slack:.3g} of its bound '
        f'{strategy.lower_bound:.6g} after {solution.iterations} steps; allow more time',
        strategy,
    )


def strategy_from_solution(game: Game, solution: Solution, budgets: tuple[Budget, Budget],
                           bound: float | None = None) -> Strategy:
    """The strategy with its certificate, which follows from p, q and prices; see ``certify``."""
    network, p = game.network, solution.p
    certificate = certify(game, p, solution.q, budgets, solution.prices, bound)
    length, exposure = budgets
    return Strategy(game=game, edge_probability=frozen_array(p, np.float64),
                    visit_probability=frozen_array(game.visits(p), np.float64),
                    ambush_probability=frozen_array(solution.q, np.float64),
                    value=certificate.value, lower_bound=certificate.bound,
                    gap=certificate.value - certificate.bound,
                    edge_entropy=entropy(p, np.ones_like(p)),
                    route_entropy=route_entropy(network, p), expected_length=length.mean(p),
                    shortest_length=length.least, length_budget=length.limit,
                    length_price=solution.prices[0], expected_exposure=exposure.mean(p),
                    least_exposure=exposure.least, exposure_budget=exposure.limit,
                    exposure_price=solution.prices[1], iterations=solution.iterations,
                    multipliers=solution.multipliers,
                    entropy_gap=max(solution.entropy_bound - route_entropy(network, p), 0.0))
