# SPDX-License-Identifier: Apache-2.0
"""Numbers as people say them."""

from __future__ import annotations


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


def ends(stops: int) -> str:
    """Return the names of the places around which the area is secured."""
    return 'start, stops and goal' if stops else 'start and goal'


def travel(value: float, unit: str) -> str:
    """Return a length, or a time if the unit of budgets is 's'."""
    return distance(value) if unit == 'm' else duration(value)
