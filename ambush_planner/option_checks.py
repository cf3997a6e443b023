# SPDX-License-Identifier: Apache-2.0
"""Fields of options with their ranges, and checks, which raise InvalidOption with one line."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from .errors import InvalidOption

# Largest length that makes sense on a map [m].
MAX_LENGTH = 1e6


@dataclass(frozen=True)
class Allowed:
    """Values an option allows: a number in a range, true or false, one of ``choices``, or a text.

    A number may be 0 or at least ``least``. ``automatic`` stands for None: ROS has no None.
    """

    kind: type
    low: float = 0.0
    high: float = math.inf
    unit: str = ''
    finite: bool = True
    least: float = 0.0
    choices: tuple[str, ...] = ()
    automatic: Any = None

    def check(self, name: str, value: Any) -> None:
        """Raise InvalidOption unless a value is allowed."""
        if self.choices:
            if not isinstance(value, str) or value not in self.choices:
                choices = ', '.join(self.choices)
                raise InvalidOption(f'{name} must be one of {choices}, got {value!r}')
        elif self.kind is bool:
            check_flag(name, value)
        elif self.kind is int:
            check_whole(name, value, int(self.low))
        elif self.kind is float:
            check_at_least(name, value, self.low, self.unit, self.finite)
        if self.kind in (int, float) and not (value <= self.high and (
                value >= self.least or value == 0.0)):
            zero = '0 or ' if self.least else ''
            unit = f' [{self.unit}]' if self.unit else ''
            raise InvalidOption(f'{name} must be {zero}in {self.least or self.low:g}..'
                                f'{self.high:g}{unit}, got {value}')


def allowed(default: Any, kind: type | None = None, **limits: Any) -> Any:
    """Return a field of an options' record; ``limits`` are those of ``Allowed``."""
    return field(default=default,
                 metadata={'allowed': Allowed(kind or type(default), **limits)})


def length(default: float | None = 0.0, high: float = MAX_LENGTH, **limits: Any) -> Any:
    """Return a field for a length [m]."""
    return allowed(default, float, high=high, unit='m', **limits)


def check_options(options: Any) -> None:
    """Check all fields of a record that have ``Allowed``, and set automatic ones to None."""
    for each in fields(options):
        if (limits := each.metadata.get('allowed')) is None:
            continue
        value, automatic = getattr(options, each.name), limits.automatic
        if isinstance(value, int | float | str) and value == automatic:
            value = None
            object.__setattr__(options, each.name, None)
        if value is not None or each.default is not None:
            limits.check(each.name, value)


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


def check_whole(name: str, value: object, least: int) -> None:
    """Check that ``value`` is a whole number >= ``least``."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool | np.bool_)
    if not whole or value < least:  # type: ignore[operator]
        raise InvalidOption(f'{name} must be a whole number >= {least}, got {value!r}')


def check_flag(name: str, value: object) -> None:
    """Check that ``value`` is true or false."""
    if not isinstance(value, bool | np.bool_):
        raise InvalidOption(f'{name} must be true or false, got {value!r}')
