"""The convoy's optimal mixed strategy: the stages risk, slack, unpredictability, and the record."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

import numpy as np

from .arrays import frozen_array, sums
from .errors import InvalidOption, SolverFailed
from .game import Game, GameOptions, make_game
from .lexicographic import max_entropy_strategy
from .linear_program import linear_program_strategy
from .network import IndexArray, Network
from .outcome import Outcome
from .paths import distances_from
from .risk_map import FloatArray
from .routes import RouteSampler

SOLVERS = ("max_entropy", "interior_point", "simplex")
# A published strategy is this near to optimal, relative to its value.
CERTIFICATE_TOLERANCE = 1e-6
CONSERVATION_TOLERANCE = 1e-8


@dataclass(frozen=True)
class StrategyOptions:
    """Which optimal strategy is taken, and how it is found.

    Parameters
    ----------
    solver
        'max_entropy': least risk, then most unpredictable, on an acyclic network. 'interior_point'
        and 'simplex': the paper's linear program by HiGHS' interior point method without
        crossover or by its dual simplex method; their solutions may wander in circles.
    max_detour
        The expected length is at most this many times the shortest route's; ``inf``: any length.
    risk_slack
        Accept values up to (1 + risk_slack) times the least one ('max_entropy' only).
    length_weight
        w: minimise (1 - w) z + w sum p l, the paper's 0.99 / 0.01 variant (linear programs only).
    time_limit
        Give up after this time [s].

    Raises
    ------
    InvalidOption
        A value is out of range, or an option does not go with the solver.
    """

    solver: str = "max_entropy"
    max_detour: float = 1.5
    risk_slack: float = 0.0
    length_weight: float = 0.0
    time_limit: float = math.inf

    def __post_init__(self) -> None:
        if self.solver not in SOLVERS:
            raise InvalidOption(f"solver must be one of {', '.join(SOLVERS)}, got {self.solver!r}")
        if not self.max_detour >= 1.0:
            raise InvalidOption(f"max_detour must be >= 1, got {self.max_detour}")
        if not (math.isfinite(self.risk_slack) and self.risk_slack >= 0.0):
            raise InvalidOption(f"risk_slack must be finite and >= 0, got {self.risk_slack}")
        if not 0.0 <= self.length_weight < 1.0:
            raise InvalidOption(f"length_weight must be in [0, 1), got {self.length_weight}")
        if not self.time_limit > 0.0:
            raise InvalidOption(f"time_limit must be positive [s], got {self.time_limit}")
        if self.solver == "max_entropy" and self.length_weight > 0.0:
            raise InvalidOption(
                f"length_weight {self.length_weight} goes with the solvers interior_point and "
                "simplex; max_entropy bounds the length with max_detour"
            )
        if self.solver != "max_entropy" and self.risk_slack > 0.0:
            raise InvalidOption(f"risk_slack goes with the solver max_entropy, not {self.solver}")


@dataclass(frozen=True, eq=False)
class Strategy:
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
        q: the ambusher's equilibrium strategy, sums to 1.
    value : float
        z(p): what the best ambush costs on average.
    lower_bound : float
        No strategy within ``length_budget`` has a smaller value (one Dijkstra over q).
    gap : float
        value - lower_bound.
    edge_entropy, route_entropy : float
        -sum p ln p (the paper's), and the entropy of the drawn route, -sum p_ij ln(p_ij / x_i)
        [nats].
    expected_length, shortest_length, length_budget : float
        [m]; the shortest route is the whole network's. With ``length_weight`` the budget is the
        strategy's own expected length.
    length_price : float
        Fall of the value per metre that the budget grows.
    iterations : int
        Iterations of the interior point or simplex method.
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
    iterations: int
    _sampler: RouteSampler = field(repr=False)

    @property
    def network(self) -> Network:
        """The network that the strategy is for."""
        return self.game.network

    def sample_route(self, rng: np.random.Generator) -> IndexArray:
        """Draw a route (K,): node indices, source first, target last, none twice."""
        return self._sampler.draw(rng)

    def mean_direction(self) -> FloatArray:
        """Mean direction (N, 2) in which the convoy leaves each node; 0 where it never comes.

        The mean of the unit vectors along the edges out of the node, weighted by p (the right
        column of the paper's figure 3): its length is 1 where the next step is certain.
        """
        network, p = self.network, self.edge_probability
        step = network.points[network.heads] - network.points[network.tails]
        unit = step / np.maximum(network.lengths, np.finfo(float).tiny)[:, None]
        count = len(network.points)
        total = [sums(network.tails, p * u, count) for u in unit.T]
        out = sums(network.tails, p, count)
        mean: FloatArray = np.stack(total, axis=1) / np.where(out > 0.0, out, 1.0)[:, None]
        return mean


def solve(
    network: Network,
    game: GameOptions | None = None,
    options: StrategyOptions | None = None,
) -> Strategy:
    """Find the convoy's optimal mixed strategy.

    Raises
    ------
    NoRoute
        Nothing leads from the source to the target.
    BudgetInfeasible
        Every route left is longer than the budget.
    TimeLimit, SolverFailed
        No certified strategy was found in time, or at all.
    """
    options = options or StrategyOptions()
    deadline = time.monotonic() + options.time_limit
    prepared = make_game(network, game or GameOptions())
    shortest = float(
        distances_from(network.edges, network.lengths, len(network.points), network.source)[
            network.target
        ]
    )
    budget = options.max_detour * shortest if math.isfinite(options.max_detour) else math.inf
    if options.solver == "max_entropy":
        outcome = max_entropy_strategy(prepared, budget, options.risk_slack, deadline)
    else:
        outcome = linear_program_strategy(
            prepared, options.solver, budget, options.length_weight, deadline
        )
    # With a length weight it is the weighted sum that is minimal, and that the gap is held against.
    weighed = outcome.length_price * outcome.budget if options.length_weight > 0.0 else 0.0
    return _certified(prepared, outcome, shortest, options.risk_slack, weighed)


def _certified(
    game: Game, outcome: Outcome, shortest: float, risk_slack: float, weighed: float
) -> Strategy:
    """Compute what is published from p and q alone; refuse what is not near enough to optimal."""
    network, p = game.network, outcome.p
    value = game.upper_bound(p)
    bound = min(game.lower_bound(outcome.q, outcome.length_price, outcome.budget), value)
    length = float(p @ network.lengths)
    _check(game, outcome, value / (1.0 + risk_slack) - bound, value + weighed, length)
    visits = game.visits(p)
    leaving = sums(network.tails, p, game.node_count)
    return Strategy(
        game=game,
        edge_probability=frozen_array(p, np.float64),
        visit_probability=frozen_array(visits, np.float64),
        ambush_probability=frozen_array(outcome.q, np.float64),
        value=value,
        lower_bound=bound,
        gap=value - bound,
        edge_entropy=_entropy(p, np.ones_like(p)),
        route_entropy=_entropy(p, leaving[network.tails]),
        expected_length=length,
        shortest_length=shortest,
        length_budget=outcome.budget,
        length_price=outcome.length_price,
        iterations=outcome.iterations,
        _sampler=RouteSampler(network, p),
    )


def _check(game: Game, outcome: Outcome, gap: float, optimum: float, length: float) -> None:
    """Refuse to publish what is not a strategy, not near enough to optimal, or too long."""
    residual = game.conservation_residual(outcome.p)
    if not residual <= CONSERVATION_TOLERANCE:
        raise SolverFailed(f"the solver's strategy is no flow: residual {residual:.1e}")
    if not length <= outcome.budget * (1.0 + CERTIFICATE_TOLERANCE):
        raise SolverFailed(
            f"the solver's strategy is {length:.9g} m long, over the budget of "
            f"{outcome.budget:.9g} m"
        )
    scale = max(optimum, 1e-6 * float(game.loss.max(initial=0.0)))
    if not gap <= CERTIFICATE_TOLERANCE * scale:
        raise SolverFailed(
            f"the strategy's certificate does not close: optimum {optimum:.9g}, gap {gap:.3g}"
        )


def _entropy(p: FloatArray, whole: FloatArray) -> float:
    """-sum p ln(p / whole), with 0 ln 0 = 0 [nats]."""
    used = p > 0.0
    return float(-(p[used] * np.log(p[used] / whole[used])).sum())
