# SPDX-License-Identifier: Apache-2.0
"""The numbers of a plan, and warnings about them as sentences."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial, wraps
from typing import TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from ..arrays import FloatArray
from ..game.strategy import within_tolerance
from ..game.tolerance import Reason
from ..words import distance, ends
from .one_place import OnePlace, find_one_place
from .options import holds_anywhere, start_tolerance
from .plan import Plan
from .refinement import LEAST_FALL

_Said = TypeVar('_Said')
Where = Callable[[FloatArray], str]
# Endings of the sentence about a gap over the slack, by the reason for which the search ended.
_WHY: dict[Reason, str] = {
    'complete': 'the search ended',
    'time': 'the time limit ended the search: to come closer, allow more time '
            '(strategy.time_limit, or max_planning_time of the node)',
    'solver': 'a numerical solver failed, so the value may be far from the best: another '
              'max_detour may help',
    'stalled': 'no closer strategy or bound was found, and more time would not help',
}
# Spacing of nodes from which on it is mentioned, as a share of the reach.
MAX_SPACING = 0.25
# Share of the way in the secured area from which on it is mentioned.
MAX_SECURED = 0.5
# Length budget from which on it is mentioned, as a multiple of the shortest route.
MAX_DETOUR = 5.0


def _once_a_plan(say: Callable[[Plan], _Said]) -> Callable[[Plan], _Said]:
    """Cache the result for each plan as long as that lives: a node asks at each departure."""
    known: WeakKeyDictionary[Plan, _Said] = WeakKeyDictionary()
    return wraps(say)(lambda plan: known[plan] if plan in known else (
        known.setdefault(plan, say(plan))))


def in_world(xy: FloatArray) -> str:
    """Write a world position (2,) [m]."""
    return '({:.1f}, {:.1f})'.format(*xy)


def concerns(plan: Plan, where: Where = in_world) -> list[str]:
    """Return warnings about a plan's value, one sentence each.

    ``where`` writes a world position (2,) [m].
    """
    return _concerns_in_world(plan) if where is in_world else _concerns(plan, where)


@_once_a_plan
def _concerns_in_world(plan: Plan) -> list[str]:
    return _concerns(plan, in_world)


def _concerns(plan: Plan, where: Where) -> list[str]:
    found = wide_gap(plan), _secured_area(plan, where), _long_routes(plan)
    return [text for text in found if text]


def _ends(plan: Plan) -> str:
    return ends(len(plan.stops_xy))


def assumptions(plan: Plan) -> list[str]:
    """Return the assumptions behind a plan's value, one sentence each, the main two first."""
    game = plan.trip.game.options
    straight = np.hypot(*np.diff(np.array(plan.ends_xy), axis=0).T)
    radius = game.secured_distance
    share = float(np.minimum(straight, 2.0 * radius).sum() / straight.sum())
    much = f', which is {share:.0%} of the straight way' if share > MAX_SECURED else ''
    if not game.reach:
        where = ("an ambusher waits at one of the network's nodes and hits only routes through "
                 'it: say how far he reaches (game.ambush_radius)')
    else:
        places = 'anywhere else' if holds_anywhere(plan.options) else 'at a node of the network'
        where = f'an ambush {places} hits whatever passes within {distance(game.ambush_radius)}'
    more = [f'nobody can wait within {distance(radius)} of ({x:.1f}, {y:.1f})'
            for x, y, radius in game.secured_places]
    if game.tube:
        more.append(f'paths stray at most {distance(game.tube)} from their drawn routes')
    around = f'within {distance(radius)} of' if radius else 'at'
    return [f'nobody can wait {around} {_ends(plan)}{much}', where, *more, *_coarse(plan)]


def _coarse(plan: Plan) -> list[str]:
    """Say that a finer network could have a lower value, if it was refined too little or not."""
    reach, spacing, rounds = plan.options.game.ambush_radius, plan.spacing, plan.refinement
    if plan.few:
        return []
    if len(rounds) > 1 and rounds[-1].value < (1.0 - LEAST_FALL) * rounds[-2].value:
        return [f'the last round of refinement brought {rounds[-2].value:.4g} to '
                f'{rounds[-1].value:.4g}; with more rounds or time the value can be lower still']
    if rounds or plan.options.network.roads or not reach or spacing <= MAX_SPACING * reach:
        return []
    return [f'the convoy drives between nodes {distance(spacing)} apart, {spacing / reach:.2f} '
            'times the reach; on a finer network (network.refine=-1) the value can be lower']


def is_sound(plan: Plan) -> bool:
    """Return whether the gap is within the tolerance, and the value is positive."""
    return within_tolerance(plan.trip, plan.options.strategy) and plan.value > 0.0


def wide_gap(plan: Plan) -> str:
    """Say why the gap exceeds the tolerance, and how to close it; '' if it does not."""
    strategy, options = plan.trip, plan.options.strategy
    if within_tolerance(strategy, options):
        return ''
    wide = f'the value is {strategy.value:.4g}, and no lower bound of it was found'
    if strategy.lower_bound > 0.0:
        usable = (f'more than {plan.options.max_gap:.0%} (strategy.max_gap)' if plan.gap_is_wide
                  else 'so the plan can be used')
        wide = (f'the value, {strategy.value:.4g}, is at most '
                f'{strategy.gap / strategy.lower_bound:.1%} above the best on this network (lower '
                f'bound {strategy.lower_bound:.4g}), {usable}')
    whole = 'of the plan that the routes were chosen from, ' if plan.few else ''
    may_help = '; fewer stops may help' if len(plan.stops_xy) else ''
    return f'{whole}{wide}; {_WHY[strategy.reason]}{may_help}'


def _long_routes(plan: Plan) -> str:
    """Say that the length budget seems to be a percentage; '' if it does not."""
    detour = plan.options.strategy.max_detour
    if not MAX_DETOUR < detour < math.inf:
        return ''
    return (f'routes may be {detour:g} times as long as the shortest: strategy.max_detour is a '
            'ratio, so 1.2 is 20 % more, and inf no limit')


def _secured_area(plan: Plan, where: Where) -> str:
    """Say that the secured area, or one place just outside it, decides the value; else ''."""
    bottleneck, game = plan.bottleneck, plan.drawn_from.game
    secured = game.options.secured_distance
    if not len(game.sites):
        return (f'the value is 0: nobody can wait within {distance(secured)} of {_ends(plan)}, '
                'and no ambush elsewhere causes a loss; check the map and game.secured_radius')
    if not plan.drawn_from.value > 0.0:
        return 'the value is 0: some routes pass no ambush that causes a loss; check the map'
    enough = game.options.ambush_radius + game.options.tube + start_tolerance(
        plan.options, plan.spacing)
    asked = plan.options.game.secured_radius
    too_small = asked is not None and asked < enough
    if place := find_one_place(plan):
        return _one_place_text(plan, place, enough if too_small else 0.0, where)
    if too_small and asked is not None and game.reach > 0.0:
        return (f'an ambush reaches {distance(game.reach)}, tube included, but only '
                f'{distance(asked)} around start and goal are secured: an ambush just outside may '
                f'hit every route; secure {distance(enough)} (game.secured_radius -1)')
    if not bottleneck.near_ends:
        return ''
    count, near = len(bottleneck.sites), bottleneck.near_ends
    return (
        f'the value {plan.drawn_from.value:.4g} is decided at {count} nodes, '
        f'{"all" if near == count else f"{near} of them"} within {distance(bottleneck.distance)} '
        'of start, stops or goal; a larger secured area there (game.secured_radius) may lower it'
    )


def _one_place_text(plan: Plan, place: OnePlace, enough: float, where: Where) -> str:
    """Say where the place that hits every route is, and list the remedies, the best first."""
    leg = f' of leg {place.leg + 1}' if len(plan.legs) > 1 else ''
    what = f'one place covers every way {"into" if place.arriving else "out of"} {place.end}' if (
        place.covers_end) else f'one place hits every route{leg}'
    radius = None if place.secured_radius is None else max(place.secured_radius, enough)
    helps = [f'secure {distance(radius)} around {_ends(plan)} (game.secured_radius={radius:.4g})'
             ] if radius else []
    helps += ['hold places on the way (ambush hold finds them)',
              f'choose another start{", stop" * (len(plan.legs) > 1)} or goal']
    if place.detour and place.detour > plan.options.strategy.max_detour:
        helps.append('or drive around it (strategy.max_detour='
                     f'{math.ceil(10.0 * place.detour) / 10.0:g})')
    return (f'{what}, at {where(place.xy)}, {distance(place.distance)} from {place.end}: an ambush '
            f'there always succeeds and costs {plan.drawn_from.value:.4g}. What helps: '
            f'{", ".join(helps)}')


def _strategy_number(name: str, plan: Plan) -> str:
    return f'{getattr(plan.drawn_from, name):.9g}'


_NUMBERS: dict[str, Callable[[Plan], str]] = {
    **{name: partial(_strategy_number, name) for name in (
        'value', 'lower_bound', 'gap', 'edge_entropy', 'route_entropy', 'entropy_gap',
        'expected_length', 'shortest_length')},
    'value_is': lambda plan: (
        'probability of being hit' if np.isin(plan.drawn_from.game.loss, (0.0, 1.0)).all()
        else 'mean loss'),
    'value_holds_at': lambda plan: ('anywhere in free ground' if holds_anywhere(plan.options)
                                    else "the network's nodes"),
    'secured_radius': lambda plan: f'{plan.drawn_from.game.options.secured_distance:.9g}',
    'nodes': lambda plan: str(len(plan.network.points)),
    'edges': lambda plan: str(len(plan.drawn_from.ground_uses[0])),
    'refined': lambda plan: ' '.join(f'{each.value:.4g}' for each in plan.refinement),
    'deciding_sites': lambda plan: str(len(plan.bottleneck.sites)),
    'deciding_sites_near_ends': lambda plan: str(plan.bottleneck.near_ends),
    'search_ended': lambda plan: plan.drawn_from.reason,
    'stops': lambda plan: str(len(plan.stops_xy)),
    'solve_seconds': lambda plan: f'{plan.seconds:.3f}',
}


def plan_numbers(plan: Plan | None) -> dict[str, str]:
    """Return the numbers of a plan by stable keys, as text; empty ones without a plan."""
    return _numbers(plan) if plan else dict.fromkeys(_NUMBERS, '')


@_once_a_plan
def _numbers(plan: Plan) -> dict[str, str]:
    return {name: number(plan) for name, number in _NUMBERS.items()}
