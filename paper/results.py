# SPDX-License-Identifier: Apache-2.0
"""The paper's experiments: all strategies of its tables and figures, and their numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

import numpy as np

from ambush_planner.game.game import GameOptions
from ambush_planner.game.solver import solve
from ambush_planner.game.strategy import Strategy, StrategyOptions
from ambush_planner.maps.risk_map import RiskMap
from ambush_planner.network.network import Network
from ambush_planner.planning.evaluation import Measures, evaluate

from .environment import EXAMPLE, HIGH_ALPHA, SECURED_RADIUS, THRESHOLDS, make_networks

MEASURES = (
    'value', 'lower_bound', 'edge_entropy', 'route_entropy', 'expected_length', 'shortest_length',
)
SOLVERS = ('interior_point', 'simplex', 'max_entropy')
# The network of the paper's table III.
METHOD_3 = 'Method 3'
LENGTH_WEIGHT = 0.01
# Length budgets of our strategies: one that costs no value, and two close to the shortest route.
DETOURS = (1.5, 1.1, 1.06)
DRAWS = 2000
DRAWS_SEED = 1
# Edge probability below which a solution is numerical noise.
UNUSED = 1e-6

PAPER_ENTROPY = {
    (EXAMPLE, 'interior_point'): 4.10,
    (EXAMPLE, 'simplex'): 3.30,
    ('Method 1', 'interior_point'): 934.58,
    ('Method 1', 'simplex'): 117.05,
    ('Method 2', 'interior_point'): 331.54,
    ('Method 2', 'simplex'): 244.54,
    (METHOD_3, 'interior_point'): 404.21,
    (METHOD_3, 'simplex'): 239.96,
}
STOCHASTIC, SHORTEST, SAFEST = 'stochastic', 'energy efficient', 'risk avoidance'
WEIGHTED = 'stochastic, 0.99 / 0.01'
SECURED = f'ours, secured area within {SECURED_RADIUS:g} m'
# Expected length, P_1, P_inf, V_inf; for the weighted variant the text states only the length.
PAPER_MEASURES: dict[str, tuple[float | None, ...]] = {
    STOCHASTIC: (89.57, 0.33, 0.33, 1.09),
    SHORTEST: (31.24, 0.33, 1.0, 5.99),
    SAFEST: (40.87, 0.33, 1.0, 6.43),
    WEIGHTED: (33.14, None, None, None),
}

Say = Callable[[str], None]


@dataclass(frozen=True)
class Spread:
    """Spread of a strategy: a row of table II.

    Entropies are in nats; ``routes`` counts distinct routes among ``DRAWS`` drawn ones, and
    ``high_alpha_share`` is the share of node visits at alpha over ``HIGH_ALPHA``.
    """

    network: str
    solver: str
    nodes: int
    edges: int
    edges_used: int
    value: float
    lower_bound: float
    edge_entropy: float
    route_entropy: float
    expected_length: float
    shortest_length: float
    routes: int
    high_alpha_share: float
    paper_edge_entropy: float | None = None


@dataclass(frozen=True, eq=False)
class Results:
    """All strategies by name, and what is measured of them.

    ``strategies`` are by network and solver, ``variants`` of ours and of the paper's by name, and
    ``thresholds`` those without nodes whose alpha exceeds a threshold.
    """

    risk_map: RiskMap
    strategies: Mapping[tuple[str, str], Strategy]
    variants: Mapping[str, Strategy]
    thresholds: Mapping[float, Strategy]
    table_2: tuple[Spread, ...]
    table_3: Mapping[str, Measures]
    spread_3: tuple[Spread, ...]

    def spread(self, network: str, solver: str) -> Spread:
        """Row of table II."""
        rows = (*self.table_2, *self.spread_3)
        return next(row for row in rows if (row.network, row.solver) == (network, solver))

    def rows(self) -> dict[str, list[dict[str, object]]]:
        """All rows, ready for JSON."""
        return {
            'table_2': [asdict(row) for row in self.table_2],
            'table_3': [{**asdict(row), 'planner': name, 'paper': PAPER_MEASURES.get(name)}
                        for name, row in self.table_3.items()],
            'table_3_spread': [asdict(row) for row in self.spread_3],
            'alpha_thresholds': [{'alpha_threshold': threshold, 'value': strategy.value,
                                  'sites': site_count(strategy)}
                                 for threshold, strategy in self.thresholds.items()],
        }


def compute(risk_map: RiskMap, say: Say) -> Results:
    """Run all experiments; ``say`` is called with the progress.

    Raises
    ------
    AmbushPlannerError
        A strategy was not found.
    """
    say('building the networks')
    networks = make_networks(risk_map)
    strategies, table_2 = {}, []
    for name, network in networks.items():
        for solver in SOLVERS:
            say(f'{name}: {solver}, {DRAWS} routes')
            strategy = _solve(network, solver)
            strategies[name, solver] = strategy
            table_2.append(_spread(name, solver, strategy))
    network = networks[METHOD_3]
    say(f'{METHOD_3}: length weight {LENGTH_WEIGHT}, budgets, alpha thresholds')
    variants = {
        WEIGHTED: solve(network, options=_paper_options('interior_point', LENGTH_WEIGHT)),
        **{f'ours, max_detour {d:g}': solve(network, options=_our_options(d)) for d in DETOURS},
        SECURED: solve(network, GameOptions(secured_radius=SECURED_RADIUS), _our_options()),
    }
    thresholds = {
        threshold: solve(network, GameOptions(alpha_threshold=threshold),
                         _paper_options('interior_point'))
        for threshold in THRESHOLDS
    }
    planners = evaluate(strategies[METHOD_3, 'interior_point'])
    table_3 = {
        STOCHASTIC: planners['stochastic'],
        SHORTEST: planners['energy_efficient'],
        SAFEST: planners['risk_avoidance'],
        **{name: evaluate(strategy)['stochastic'] for name, strategy in variants.items()},
    }
    return Results(
        risk_map, strategies, variants, thresholds, tuple(table_2), table_3,
        tuple(_spread(METHOD_3, name, strategy) for name, strategy in variants.items()))


def _solve(network: Network, solver: str) -> Strategy:
    ours = solver == 'max_entropy'
    return solve(network, options=_our_options() if ours else _paper_options(solver))


def _our_options(max_detour: float = DETOURS[0]) -> StrategyOptions:
    """Without slack, so that values can be compared."""
    return StrategyOptions(max_detour=max_detour, risk_slack=0.0)


def _paper_options(solver: str, length_weight: float = 0.0) -> StrategyOptions:
    """The paper's linear programs, without a length budget."""
    return StrategyOptions(solver=solver, max_detour=np.inf, length_weight=length_weight)


def _spread(network: str, solver: str, strategy: Strategy) -> Spread:
    visits = strategy.visit_probability
    high = strategy.network.alpha > HIGH_ALPHA
    return Spread(
        network=network,
        solver=solver,
        nodes=len(strategy.network.points),
        edges=len(strategy.network.edges),
        edges_used=int((strategy.edge_probability > UNUSED).sum()),
        **{name: getattr(strategy, name) for name in MEASURES},
        routes=distinct_routes(strategy, DRAWS),
        high_alpha_share=float(visits[high].sum() / visits.sum()),
        paper_edge_entropy=PAPER_ENTROPY.get((network, solver)),
    )


def distinct_routes(strategy: Strategy, draws: int) -> int:
    """Number of different routes among ``draws`` routes drawn with a fixed seed."""
    rng = np.random.default_rng(DRAWS_SEED)
    return len({route.tobytes() for route in strategy.sample_routes(draws, rng)})


def site_count(strategy: Strategy) -> int:
    """Number of places where the ambusher waits."""
    q = strategy.ambush_probability
    return int((q > 1e-3 * q.max()).sum())
