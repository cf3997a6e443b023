"""What the report says, in sentences and rows of plain text; nothing here is HTML."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from ..game.strategy import Strategy
from ..planning.evaluation import evaluate
from ..recordings import RecordedDeparture
from ..recordings.verify import Verdict
from .audit_text import plain, when
from .report_sections import Section

PLANNERS = {
    'stochastic': 'these random routes',
    'energy_efficient': 'always the shortest route',
    'risk_avoidance': 'always the route of least risk',
}
# Values this near to their bound, relative, are as good as equal to it.
SAME = 1e-5
RAISED = str.maketrans('0123456789', '⁰¹²³⁴⁵⁶⁷⁸⁹')


def distance(metres: float) -> str:
    """Return a length in km from 2 km on, else in m."""
    return f'{metres / 1000.0:.1f} km' if metres >= 2000.0 else f'{metres:.0f} m'


def percent(share: float) -> str:
    """Return a share, 0..1, with as many digits as say something."""
    return f'{100.0 * share:.3g} %'


def certificate(section: Section) -> list[str]:
    """Say what the value and its lower bound promise, with their numbers."""
    strategy, game = section.strategy, section.departures[0].parameters.planning.game
    # An ambush whose reach holds the start or the goal is no site either.
    held = max(game.secured_radius, strategy.game.ambush_radius)
    outside = f' that waits over {distance(held)} from start and goal' if held > 0.0 else ''
    value, bound = strategy.value, strategy.lower_bound
    bounded = math.isfinite(strategy.length_budget)
    length = (
        f' with an expected length of at most {distance(strategy.length_budget)}' if bounded else ''
    )
    apart = strategy.gap / value if value > 0.0 else 0.0
    verdict = 'as good as any can be' if apart <= SAME else f'within {percent(apart)} of the best'
    return [
        f'No ambusher{outside}, however clever, costs this convoy more than '
        f'{value:.4f} a departure on average. This holds even if he knows the map, the strategy '
        'and every route that was ever driven, as long as he does not know the next draw.',
        f'No planner could promise less than {bound:.4f} on this network{length}: the ambusher in '
        'the picture costs every one of them at least that much on average.',
        f'The two numbers are {strategy.gap:.1e} apart, so this strategy is {verdict}. Both were '
        'computed again for this page from the recorded odds alone.',
        _rules(game.ambush_radius, held),
    ]


def _rules(reach: float, held: float) -> str:
    hits = f'hits every route that passes within {distance(reach)} of it' if reach > 0.0 else (
        'hits the routes through its place'
    )
    ends = (
        f' Nobody waits within {distance(held)} of start or goal: where that ground is not held, '
        'nothing here is promised.' if held > 0.0 else ''
    )
    return (
        'The rules behind these numbers: at each departure one ambush waits at one place, '
        f'chosen before the route is drawn, and {hits}. What it costs is what the risk map says '
        f'for that place.{ends} If the map is wrong, or there are more ambushes, the numbers are '
        'too.'
    )


def tiles(section: Section) -> list[tuple[str, str]]:
    """The few numbers that matter most, each with what it is."""
    strategy = section.strategy
    shortest = evaluate(strategy)['energy_efficient']
    return [
        (f'{strategy.value:.2f}', 'mean loss a departure by the best possible ambush'),
        (f'{shortest.v_repeated:.2f}', 'the same if always the shortest route were driven'),
        (_routes(strategy), 'equally likely routes would be as hard to guess'),
        (f'{strategy.expected_length / strategy.shortest_length:.2f} x',
         f'the shortest way ({distance(strategy.shortest_length)}) is driven on average'),
    ]


def measures(strategy: Strategy) -> list[tuple[str, ...]]:
    """Head and rows of the table that compares planners (the paper's table III)."""
    head = ('planner', 'expected length E', 'chance of an ambush P_1',
            'the same once it is known P_inf', 'mean loss then V_inf')
    rows = [
        (PLANNERS[name], distance(row.expected_length), percent(row.p_first),
         percent(row.p_repeated), f'{row.v_repeated:.3f}')
        for name, row in evaluate(strategy).items()
    ]
    return [head, *rows]


def quantities(strategy: Strategy) -> list[tuple[str, str]]:
    """Further measures of the strategy by name."""
    network = strategy.network
    return [
        ('value z', f'{strategy.value:.9g}'),
        ('lower bound', f'{strategy.lower_bound:.9g}'),
        ('gap', f'{strategy.gap:.3g}'),
        ('expected length', distance(strategy.expected_length)),
        ('shortest route', distance(strategy.shortest_length)),
        ('length allowed', distance(strategy.length_budget)
         if math.isfinite(strategy.length_budget) else 'any'),
        ('edge entropy', f'{strategy.edge_entropy:.4g} nats'),
        ('route entropy', f'{strategy.route_entropy:.4g} nats'),
        ('effective number of routes', _routes(strategy)),
        ('network', f'{len(network.points):,} places, {len(network.edges):,} connections'),
        ('places where the best ambusher waits',
         f'{int((strategy.ambush_probability > 1e-6).sum()):,}' if strategy.value > 0.0
         else 'none: no ambush costs anything'),
    ]


def _routes(strategy: Strategy) -> str:
    """The effective number of routes, with raised digits where it is a power of ten."""
    number, _, digits = plain(math.exp(min(strategy.route_entropy, 700.0))).partition('^')
    return number + digits.translate(RAISED)


def departures(section: Section) -> list[tuple[str, ...]]:
    """Head and rows of the list of departures, in the order of time."""
    def length(each: RecordedDeparture) -> str:
        steps = np.diff(each.strategy.network.points[each.route], axis=0)
        return distance(float(np.hypot(*steps.T).sum()))

    rows = [
        (str(number), when(each.stamp_ns), str(each.number), each.service,
         f'{each.strategy.value:.4f}', length(each), each.id)
        for number, each in enumerate(section.departures, start=1)
    ]
    head = ('#', 'time', 'number in its run', 'asked for by', 'mean loss z', 'length',
            'departure id')
    return [head, *rows]


def settings(section: Section) -> list[tuple[str, str]]:
    """Parameters that all departures share; what differs is said to. Never the seed."""
    found: dict[str, set[str]] = {}
    for record in section.departures:
        for name, value in record.parameters.values.items():
            found.setdefault(name, set()).add(str(value))
    return [
        (name, values.pop() if len(values) == 1 else 'differs between departures')
        for name, values in sorted(found.items())
        if name != 'seed'
    ]


def origins(section: Section) -> list[tuple[str, str]]:
    """Which programs and which strategy the departures come from."""
    def joined(values: Iterable[str]) -> str:
        return ', '.join(sorted(set(values)))

    records = section.departures
    names = sorted({name for record in records for name in record.versions})
    return [
        ('strategies', str(section.strategies)),
        ('frame of the map', joined(record.frame for record in records)),
        *((name, joined(str(record.versions.get(name, '?')) for record in records))
          for name in names),
    ]


def verification(verdicts: list[Verdict], faults: list[str]) -> list[str]:
    """Say what ambush_verify found, or that it was not asked."""
    if not verdicts:
        return [
            'Not verified: this page believes what the recordings say. Run ambush_verify on them, '
            'or make this page with --verify.'
        ]
    failing = [verdict for verdict in verdicts if not verdict.holds]
    if not failing and not faults:
        return [
            f'Verified: all {len(verdicts)} recordings were checked by ambush_verify: their '
            'certificates hold, and their routes, drawn again, are the same.'
        ]
    told = [
        f"{verdict.path.name}: {'; '.join(verdict.problems)}" for verdict in failing
    ] + faults
    return [
        f'VERIFICATION FAILED for {len(failing)} of {len(verdicts)} recordings. Do not rely on '
        'this page.', *told,
    ]
