# SPDX-License-Identifier: Apache-2.0
"""When a value counts as near enough to its lower bound."""

from __future__ import annotations

from ..arrays import ROUNDING

# A published value is at most (1 + risk_slack + this) times its bound.
CERTIFICATE_TOLERANCE = 1e-5


def ceiling(bound: float, slack: float) -> float:
    """The largest value within the relative ``slack`` of a bound."""
    return bound * (1.0 + slack)


def within(value: float, bound: float, slack: float) -> bool:
    """Whether a value is within the relative ``slack`` of a bound, up to rounding."""
    return value <= ceiling(bound, slack + ROUNDING)
