# SPDX-License-Identifier: Apache-2.0
"""Options that were removed, and what to do instead, for parameters, commands and recordings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from .errors import InvalidOption


class _Gone(NamedTuple):
    """The remedy for an option that was removed, and its value ``without`` effect."""

    remedy: str
    without: object = None


_LOADS = 'leave it out: the value counts the whole loss on every leg'
_BAG = 'leave it out, or play the file with ros2 bag play, which has --rate and --topics'
_MOVED = 'if the files of a plan were only moved, add --ground-unchanged'
_ORDER = 'give the stops in the order in which they are to be visited'
# By the names that are typed: flags of ambush plan, parameters and options of --set.
_GONE = {
    '--datum': _Gone("write --crs 'datum LAT LON YAW'"),
    '--equal': _Gone('leave it out: --routes K says for each route which faces of dice to throw'),
    '--load': _Gone(_LOADS),
    '--order': _Gone(_ORDER),
    'audit -o': _Gone('the console says what it finds, and ambush report --verify shows it with '
                      'the routes'),
    'replay --inputs-only': _Gone(_BAG),
    'replay --rate': _Gone(_BAG),
    'replay --topics': _Gone(_BAG),
    'card --route': _Gone('leave it out: few routes (ambush plan --routes) are briefed by their '
                          'map and their GPX file'),
    'draw --map': _Gone(_MOVED),
    'draw --roads': _Gone(_MOVED),
    'risk --roads': _Gone('the roads of a risk map are a layer: {roads: roads.gpkg, width: 8, '
                          'factor: 0.5, passable: true} (docs/risk_layers.md)'),
    '--terrain': _Gone('make a risk map of the elevation model with ambush risk, and plan on it'),
    'diagnostics.error_hold': _Gone('leave it out: a failed request is shown for 30 s', 30.0),
    'game.ambushers': _Gone(
        'leave it out: k ambushers at different places cause at most k times the value '
        '(docs/theory.md, 2.3)', 1),
    'game.loads': _Gone(_LOADS, ()),
    'queue.size': _Gone('leave it out: 8 solves may wait', 8),
    'strategy.max_exposure': _Gone(
        'leave it out: the plan minimises the risk, and its mean exposure is reported', math.inf),
    'trip.order': _Gone(_ORDER, 'given'),
}


def remedy_for(name: str) -> str:
    """Say that an option was removed, and what to do instead; '' if none had this name."""
    return f'{name} was removed: {_GONE[name].remedy}' if name in _GONE else ''


def check_none_gone(values: Mapping[str, Any]) -> None:
    """Raise InvalidOption if one of the values sets a removed option to some effect."""
    for name, gone in _GONE.items():
        if values.get(name, gone.without) != gone.without:
            raise InvalidOption(remedy_for(name))
