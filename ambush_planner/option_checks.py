"""Checks that the option records share: type and range, told in one line."""

from __future__ import annotations

import math

import numpy as np

from .errors import InvalidOption


def check_at_least(
    name: str, value: object, least: float, unit: str = '', finite: bool = True
) -> None:
    """Refuse what is not a number >= ``least``.

    Raises
    ------
    InvalidOption
        The message names the option, its range and the value.
    """
    number = isinstance(value, int | float | np.integer | np.floating)
    if not number or isinstance(value, bool):
        raise InvalidOption(f'{name} must be a number, got {value!r}')
    try:
        value = float(value)  # type: ignore[arg-type]
    except OverflowError as error:
        raise InvalidOption(f'{name} is too large a whole number') from error
    if not value >= least or (finite and math.isinf(value)):
        kind = 'finite and ' if finite else ''
        range_ = f'{kind}>= {least:g}' + (f' [{unit}]' if unit else '')
        raise InvalidOption(f'{name} must be {range_}, got {value}')


def check_whole(name: str, value: object, least: int) -> None:
    """Refuse what is not a whole number >= ``least``; raises InvalidOption."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool | np.bool_)
    if not whole or value < least:  # type: ignore[operator]
        raise InvalidOption(f'{name} must be a whole number >= {least}, got {value!r}')


def check_flag(name: str, value: object) -> None:
    """Refuse what is neither true nor false; raises InvalidOption."""
    if not isinstance(value, bool | np.bool_):
        raise InvalidOption(f'{name} must be true or false, got {value!r}')
