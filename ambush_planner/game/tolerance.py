# SPDX-License-Identifier: Apache-2.0
"""The tolerance within which a value counts as equal to its lower bound."""

from __future__ import annotations

from typing import Literal

from ..arrays import ROUNDING

# Why a search ended: its value is within the tolerance of the bound, the time limit passed, a
# numerical solver failed, or no method finds a better strategy or bound.
Reason = Literal['complete', 'time', 'solver', 'stalled']

# Maximum number of rounds of each kind: of constraint generation, of a route distribution, of an LP
# over routes that hardly gains, and of refining a solution to double precision.
ROUNDS = 25
# A published value is at most (1 + risk_slack + CERTIFICATE_TOLERANCE) times its bound.
CERTIFICATE_TOLERANCE = 1e-5
# Least tolerance of a search: with a risk slack of 0, its result still passes the certificate.
MIN_TOLERANCE = 0.5 * CERTIFICATE_TOLERANCE


def ceiling(bound: float, tolerance: float) -> float:
    """The largest value within the relative ``tolerance`` of a bound."""
    return bound * (1.0 + tolerance)


def within(value: float, bound: float, tolerance: float) -> bool:
    """Return whether a value is within the relative ``tolerance`` of a bound, up to rounding."""
    return value <= ceiling(bound, tolerance + ROUNDING)
