# SPDX-License-Identifier: Apache-2.0
"""The sentences and tables of the report as plain text."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..arrays import NEGLIGIBLE
from ..game.strategy import TripStrategy
from ..planning.plan import path_lengths
from ..recordings.recorded_departure import RecordedDeparture
from ..recordings.report_data import Section
from ..words import (
    best_ambush,
    count,
    distance,
    ends,
    of_departures,
    over_legs,
    percent,
    rounded,
    travel,
)
from .console import when
from .positions import written

PLANNERS = {
    'stochastic': 'these random routes',
    'energy_efficient': 'always the shortest route',
    'risk_avoidance': 'always the route of least risk',
}
# Relative gap below which a strategy counts as optimal.
OPTIMAL = 1e-5


def certificate(section: Section) -> list[str]:
    """Say what the value and its lower bound guarantee, and what that assumes."""
    return [
        _guarantee(section), _optimality(section),
        ' '.join(filter(None, (_assumptions(section.trip), secured(section)))),
        'Losses are in the units of the risk map: they compare how bad an ambush is at different '
        'places.',
    ]


def _guarantee(section: Section) -> str:
    trip, (value, _) = section.trip, section.bounds
    anywhere = trip.game.options.widened > 0.0
    where = 'Wherever' if anywhere else 'At whichever node of the network'
    outside = (f', except on the secured area around {ends(len(trip.legs) - 1)}'
               if secured(section) else '')
    timed = section.slots is not None
    when_known = (' He can wait at one time of departure only; if he knows the time, it is at most '
                  f'{rounded(trip.value)}.') * timed
    several = len(trip.legs) > 1
    covered = section.departures[-1].covered
    summed = f', {over_legs(len(trip.legs), trip.first_hit_value * covered)},' * several
    best = section.best
    meant = 'No ambush causes a loss.' if best is None else (
        f'In other words, {best_ambush(best.hit, written(best.xy, section.risk_map), covered)}.')
    return (f'{where} an ambusher waits{outside}, he causes a mean loss of at most '
            f'{rounded(value)} per departure{summed}, even if he knows the map, the probabilities '
            f'and all earlier routes.{when_known} This assumes that he does not know the next '
            f'route{" and time" * timed}; an informant who tells him whether the convoy passes '
            f'raises the mean loss at most twofold. {meant}')


def _optimality(section: Section) -> str:
    trip, (value, bound) = section.trip, section.bounds
    unit = trip.game.network.travel_unit
    budgets = [leg.length_budget for leg in trip.legs]
    length = ('' if max(budgets) == math.inf else
              f' with a mean length of at most {_limits(budgets, unit)}')
    gap = (value - bound) / value if value > 0.0 else 0.0
    near = f'within {percent(gap)} of ' if gap > OPTIMAL else ''
    return (f'No other probabilities on this network{length} can promise less than '
            f'{rounded(bound)}: the ambusher on the map causes at least that much against every '
            f'planner. So these are {near}the best possible. Both numbers were computed again for '
            'this page.')


def _assumptions(trip: TripStrategy) -> str:
    game, radius = trip.game, trip.game.options.ambush_radius
    hits = (f'every route that passes within {distance(game.reach)} (his reach of '
            f'{distance(radius)}, and {distance(game.reach - radius)} by which the path and his '
            'place may be off)' if radius > 0.0 else
            'only routes through his node, since no reach is set (game.ambush_radius)')
    return (f'This assumes that he waits at one place per departure, chosen before the route is '
            f'drawn, hits {hits}, and causes the loss of the risk map there.')


def secured(section: Section) -> str:
    """The assumption about the secured area; '' if there is none."""
    radius = section.trip.game.options.secured_distance
    game = section.departures[-1].parameters.planning.game
    asked, places = game.secured_radius, len(game.secured_places)
    if not radius > 0.0:
        return ''
    margin = ''
    if asked is not None and round(asked - radius) > 0:
        margin = f' ({distance(asked)}, less how far start and goal may move)'
    more = f', nor at {count(places, "secured place")}' if places else ''
    return (f'A secured area is assumed: nobody can wait within {distance(radius)} of '
            f'{ends(len(section.trip.legs) - 1)}{margin}{more}.')


def tiles(section: Section) -> list[tuple[str, str]]:
    """The most important numbers, each with its meaning."""
    trip, fixed = section.trip, section.measures['energy_efficient']
    different = len({each.path_poses.round(1).tobytes() for each in section.departures})
    driven = path_lengths([each.path_poses for each in section.departures])
    ratio = rounded(trip.expected_length / trip.shortest_length)
    unit = 'time' if trip.game.network.travel_unit == 's' else 'length'
    timed = section.slots is not None
    return [
        (rounded(section.bounds[0]), 'mean loss per departure from the best ambush'
         f'{" (at one time)" * timed}, instead of {rounded(fixed.v_repeated)} if you always take '
         'the shortest route'),
        _hits_tile(section),
        (f'{different} of {len(section.departures)}', 'departures took different routes'),
        (distance(float(driven.mean())), 'driven per departure, on average; the mean '
         f'{unit} along the network is {ratio} times the shortest'),
    ]


def _hits_tile(section: Section) -> tuple[str, str]:
    if section.best is None:
        return 'no departure', 'meets an ambush that causes a loss'
    return (of_departures(section.best.hit * section.departures[-1].covered),
            f'hit by the best ambush, at {written(section.best.xy, section.risk_map)}, instead of '
            'every one once he has learnt a habit')


def measures(section: Section) -> list[tuple[str, ...]]:
    """Head and rows of the comparison of planners (the paper's table III: E, P_1, P_inf, V_inf)."""
    head = ('the convoy drives', 'mean along the network', 'hit by the ambusher on the map',
            'hit once the habit is known', 'mean loss once it is known')
    timed = section.slots is not None
    return [head, *(
        (PLANNERS[name] + ' and times' * (timed and name == 'stochastic'),
         travel(row.expected_length, section.trip.game.network.travel_unit),
         percent(row.p_first), percent(row.p_repeated), rounded(row.v_repeated))
        for name, row in section.measures.items()
    )]


def quantities(section: Section) -> list[tuple[str, str]]:
    """Further measures of the strategy by name."""
    trip, (value, bound) = section.trip, section.bounds
    network, unit, waits = trip.game.network, trip.game.network.travel_unit, trip.ambusher.q
    budgets = [leg.length_budget for leg in trip.legs]
    sites = int((waits > NEGLIGIBLE * waits.max()).sum()) if trip.value > 0.0 else 0
    return [
        ('mean loss, at most (value)', rounded(value, 4)),
        ('no planner can promise less than', rounded(bound, 4)),
        ('mean along the network', travel(trip.expected_length, unit)),
        ('shortest route along it', travel(trip.shortest_length, unit)),
        ('limit of that mean', _limits(budgets, unit) if math.isfinite(max(budgets)) else 'none'),
        ('as hard to guess as one of', f'{_routes(trip)} equally likely routes'),
        ('network', f'{len(network.points):,} nodes, {len(trip.ground_uses[0]):,} edges'),
        ('sites of the best ambusher', f'{sites:,}' if sites else 'none: no ambush causes a loss'),
    ]


def departures(section: Section) -> list[tuple[str, ...]]:
    """Head and rows of the list of departures, in order of time; the loss only if it varies."""
    varies = len({id(each.departed_on) for each in section.departures}) > 1
    rows = []
    for number, each in enumerate(section.departures, start=1):
        (length,) = path_lengths([each.path_poses])
        rows.append((str(number), leaving(each)[:len('2000-01-01 00:00')],
                     distance(float(length)), *([rounded(each.value)] * varies)))
    time = 'day' if section.departures[-1].metadata.day else 'time (UTC)'
    return [('route', time, 'length', *(['mean loss'] * varies)), *rows]


def leaving(departure: RecordedDeparture) -> str:
    """Return the day and slot that a plan's departure is for, or the time it leaves."""
    day = departure.metadata.day
    return f'{day.date} {day.slot}'.strip() if day else when(departure.stamp_ns)


def _limits(budgets: Sequence[float], unit: str) -> str:
    """The length budgets of the legs."""
    return ', '.join(travel(each, unit) for each in budgets) + ' on its leg' * (len(budgets) > 1)


def _routes(trip: TripStrategy) -> str:
    """The effective number of routes."""
    power = trip.route_entropy / math.log(10.0)
    return f'{math.exp(trip.route_entropy):,.0f}' if power < 6.0 else f'about 10^{power:.0f}'
