"""The sentences and tables of the report as plain text."""

from __future__ import annotations

import math

import numpy as np

from ..game.bottleneck import DECISIVE_SHARE
from ..game.strategy import Strategy
from ..planning.evaluation import evaluate
from ..recordings.report_data import Section
from .audit import when

PLANNERS = {
    'stochastic': 'these random routes',
    'energy_efficient': 'always the shortest route',
    'risk_avoidance': 'always the route of least risk',
}
# Relative gap below which a strategy counts as optimal.
OPTIMAL = 1e-5


def distance(metres: float) -> str:
    """Return a length in km if it is at least 2 km, else in m."""
    return f'{metres / 1000.0:.1f} km' if metres >= 2000.0 else f'{metres:.0f} m'


def percent(share: float) -> str:
    """Return a share, 0..1, with three significant digits."""
    return f'{100.0 * share:.3g} %'


def certificate(section: Section) -> list[str]:
    """What the value and its lower bound guarantee."""
    strategy = section.strategy
    held = strategy.game.options.held_radius
    ends = 'start, stops and goal' if len(strategy.network.stops) else 'start and goal'
    outside = f' more than {distance(held)} from {ends}' if held > 0.0 else ''
    length = ('' if strategy.length_budget == math.inf else
              f' with an expected length of at most {travel(strategy, strategy.length_budget)}')
    gap = strategy.gap / strategy.value if strategy.value > 0.0 else 0.0
    verdict = 'optimal' if gap <= OPTIMAL else f'within {percent(gap)} of the optimum'
    reach = strategy.game.reach
    passing = f'that passes within {distance(reach)}' if reach > 0.0 else 'through its place'
    assumed = (
        f' Nobody can wait within {distance(held)} of {ends}: if that ground is not held, '
        'the guarantee does not hold.' if held > 0.0 else ''
    )
    return [
        f'No ambusher{outside} causes a mean loss of more than {strategy.value:.4f} per departure, '
        'even if he knows the map, the strategy and all earlier routes. He must not know the next '
        'route.',
        f'No planner can guarantee less than {strategy.lower_bound:.4f} on this network{length}: '
        'the ambusher in the picture causes at least this mean loss against every planner.',
        f'The two numbers differ by {strategy.gap:.1e}, so this strategy is {verdict}. Both were '
        'computed again for this page from the recorded probabilities.',
        'The assumptions: at each departure one ambush waits at one place, which is chosen before '
        f'the route is drawn, and hits every route {passing}. It causes the loss of the risk map '
        f'at its place.{assumed} If the map is wrong, or there are more ambushes, the numbers are '
        'wrong, too.',
    ]


def tiles(strategy: Strategy) -> list[tuple[str, str]]:
    """The most important numbers, each with its meaning."""
    shortest = evaluate(strategy)['energy_efficient'].v_repeated
    return [
        (f'{strategy.value:.2f}', 'mean loss per departure from the best possible ambush'),
        (f'{shortest:.2f}', 'the same if the convoy always took the shortest route'),
        (_routes(strategy), 'equally likely routes would be as hard to guess'),
        (f'{strategy.expected_length / strategy.shortest_length:.2f} x',
         f'mean length, relative to the shortest route '
         f'({travel(strategy, strategy.shortest_length)})'),
    ]


def measures(strategy: Strategy) -> list[tuple[str, ...]]:
    """Head and rows of the comparison of planners (the paper's table III)."""
    head = ('planner', 'mean length E', 'probability of a hit, planner unknown: P_1',
            'probability of a hit, planner known: P_inf', 'mean loss, planner known: V_inf')
    return [head, *(
        (PLANNERS[name], travel(strategy, row.expected_length), percent(row.p_first),
         percent(row.p_repeated), f'{row.v_repeated:.3f}')
        for name, row in evaluate(strategy).items()
    )]


def quantities(strategy: Strategy) -> list[tuple[str, str]]:
    """Further measures of the strategy by name."""
    network, budget = strategy.network, strategy.length_budget
    waits = strategy.ambush_at_places
    sites = int((waits > DECISIVE_SHARE * waits.max()).sum()) if strategy.value > 0.0 else 0
    return [
        ('value z', f'{strategy.value:.9g}'),
        ('lower bound', f'{strategy.lower_bound:.9g}'),
        ('gap', f'{strategy.gap:.3g}'),
        ('expected length', travel(strategy, strategy.expected_length)),
        ('shortest route', travel(strategy, strategy.shortest_length)),
        ('length budget', travel(strategy, budget) if math.isfinite(budget) else 'none'),
        ('edge entropy', f'{strategy.edge_entropy:.4g} nats'),
        ('route entropy', f'{strategy.route_entropy:.4g} nats'),
        ('effective number of routes', _routes(strategy)),
        ('network', f'{len(network.points):,} nodes, {len(network.edges):,} edges'),
        ('sites of the best ambusher', f'{sites:,}' if sites else 'none: no ambush causes a loss'),
    ]


def departures(section: Section) -> list[tuple[str, ...]]:
    """Head and rows of the list of departures, in order of time."""
    rows = []
    for number, each in enumerate(section.departures, start=1):
        steps = np.diff(each.path_poses[:, :2], axis=0)
        rows.append((
            str(number), when(each.stamp_ns), str(each.number), f'{each.strategy.value:.4f}',
            distance(float(np.hypot(*steps.T).sum())), each.id,
        ))
    return [('#', 'time', 'number in its run', 'mean loss z', 'length', 'departure id'), *rows]


def settings(section: Section) -> list[tuple[str, str]]:
    """The frame and all parameters but the seed; values that differ are not listed."""
    found: dict[str, set[str]] = {}
    for each in section.departures:
        values = {'frame of the map': each.frame, **each.parameters.values}
        for name, value in values.items():
            found.setdefault(name, set()).add(str(value))
    return [(name, values.pop() if len(values) == 1 else 'differs between departures')
            for name, values in sorted(found.items()) if name != 'seed']


def travel(strategy: Strategy, value: float) -> str:
    """A length, or a time where budgets are of time."""
    return distance(value) if strategy.network.travel_unit == 'm' else f'{value:.4g} s'


def _routes(strategy: Strategy) -> str:
    """The effective number of routes."""
    number = math.exp(min(strategy.route_entropy, 700.0))
    return f'{number:.3g}' if number < 100.0 or number >= 1e9 else f'{number:,.0f}'
