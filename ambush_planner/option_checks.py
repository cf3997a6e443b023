# SPDX-License-Identifier: Apache-2.0
"""Checks of options' types and ranges; each raises InvalidOption with a message of one line."""

from __future__ import annotations

import math

import numpy as np

from .errors import InvalidOption


def check_at_least(name: str, value: object, least: float, unit: str = '',
                   finite: bool = True) -> None:
    """Check that ``value`` is a number >= ``least``, finite unless ``finite`` is false."""
    number = isinstance(value, int | float | np.integer | np.floating)
    if not number or isinstance(value, bool):
        raise InvalidOption(f'{name} must be a number, got {value!r}')
    try:
        value = float(value)  # type: ignore[arg-type]
    except OverflowError as error:
        raise InvalidOption(f'{name} is too large') from error
    if not value >= least or (finite and math.isinf(value)):
        kind = 'finite and ' if finite else ''
        range_ = f'{kind}>= {least:g}' + (f' [{unit}]' if unit else '')
        raise InvalidOption(f'{name} must be {range_}, got {value}')


def none_for(options: object, **automatic: float | str) -> None:
    """Set options to None that have the node's value for it: ROS parameters cannot be None."""
    for name, value in automatic.items():
        if isinstance(given := getattr(options, name), int | float | str) and given == value:
            object.__setattr__(options, name, None)


def check_whole(name: str, value: object, least: int) -> None:
    """Check that ``value`` is a whole number >= ``least``."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool | np.bool_)
    if not whole or value < least:  # type: ignore[operator]
        raise InvalidOption(f'{name} must be a whole number >= {least}, got {value!r}')


def check_flag(name: str, value: object) -> None:
    """Check that ``value`` is true or false."""
    if not isinstance(value, bool | np.bool_):
        raise InvalidOption(f'{name} must be true or false, got {value!r}')
