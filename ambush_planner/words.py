# SPDX-License-Identifier: Apache-2.0
"""Numbers as people say them."""

from __future__ import annotations

import math


def rounded(number: float, digits: int = 3) -> str:
    """Return a number with the given significant digits and no exponent."""
    return f'{float(f"{number:.{digits}g}"):.12g}'


def distance(metres: float) -> str:
    """Return a length in m, from 1000 m in km."""
    return f'{rounded(metres / 1000.0)} km' if metres >= 1000.0 else f'{rounded(metres)} m'


def duration(seconds: float) -> str:
    """Return a time in s, min, or h and min."""
    minutes = round(seconds / 60.0)
    if seconds < 120.0:
        return f'{rounded(seconds)} s'
    return f'{minutes} min' if minutes < 90 else f'{minutes // 60} h {minutes % 60} min'


def percent(share: float) -> str:
    """Return a share, 0..1, with two significant digits."""
    return f'{rounded(100.0 * share, 2)} %'


def count(number: int, what: str) -> str:
    """Return a number and its noun, such as ``3 recordings``."""
    return f'{number} {what}{"s" * (number != 1)}'


def of_departures(share: float) -> str:
    """Return how many departures a share of them is, rounded up, such as ``1 of 7 departures``."""
    if share > 0.9:
        return 'every departure' if share > 0.99 else 'nearly every departure'
    if share > 0.25:
        return f'{math.ceil(10.0 * share - 1e-9)} of 10 departures'
    if share < 1e-3:
        return 'fewer than 1 of 1000 departures'
    return f'1 of {math.floor(1.0 / share + 1e-9)} departures'


def best_ambush(share: float, place: str, covered: float = 1.0) -> str:
    """Return a sentence on the best ambush, which hits a share of the departures at its place.

    ``covered`` is the share that an ambush covers at one of the times of departure.
    """
    known = f' ({of_departures(share)} if he knows the time)' if covered < 1.0 else ''
    return f'the best ambush hits {of_departures(share * covered)}, at {place}{known}'


def over_legs(legs: int, first_hit_value: float) -> str:
    """Return what the value of a trip with stops adds up, and the loss if the first hit ends it."""
    return (f'added up over its {legs} legs, each drawn on its own ({first_hit_value:.4g} if the '
            'first hit ends the trip)')


def ends(stops: int) -> str:
    """Return the names of the places around which the area is secured."""
    return 'start, stops and goal' if stops else 'start and goal'


def travel(value: float, unit: str) -> str:
    """Return a length, or a time if the unit of budgets is 's'."""
    return distance(value) if unit == 'm' else duration(value)
