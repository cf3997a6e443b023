# SPDX-License-Identifier: Apache-2.0
"""Tolerance within which a value counts as equal to its lower bound."""

from __future__ import annotations

from typing import Literal

from ..arrays import ROUNDING

# Why a search ended: its value is within the tolerance of the bound, the time was up, a numerical
# solver failed, or no method finds a better strategy or bound.
Reason = Literal['complete', 'time', 'solver', 'stalled']

# Maximum number of rounds of one kind: in which sites join a search, of a route distribution, in
# which an LP over routes hardly gains, or which refine a solution to double precision.
ROUNDS = 25
# A published value is at most (1 + risk_slack + this) times its bound.
CERTIFICATE_TOLERANCE = 1e-5
# Least tolerance of a search, so that it ends within the certificate's if none is asked for.
MIN_TOLERANCE = 0.5 * CERTIFICATE_TOLERANCE


def ceiling(bound: float, tolerance: float) -> float:
    """The largest value within the relative ``tolerance`` of a bound."""
    return bound * (1.0 + tolerance)


def within(value: float, bound: float, tolerance: float) -> bool:
    """Return whether a value is within the relative ``tolerance`` of a bound, up to rounding."""
    return value <= ceiling(bound, tolerance + ROUNDING)
