# SPDX-License-Identifier: Apache-2.0
"""When to depart: an ambusher who waits in one slot of the day cannot wait in another.

Slot t has the value z_t of its own plan. An ambush lasts ``window`` consecutive slots, in each of
which the ambusher may wait elsewhere. Against a slot drawn with probabilities pi, independently of
the route, the worst window costs the largest sum of pi_t z_t within it: a linear program. With a
window of one slot, pi_t is proportional to 1 / z_t, and the joint value is 1 / sum(1 / z_t); with m
slots of the same value z and a window of w, it is z / ceil(m / w) (docs/theory.md, section 14).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

from ..arrays import ROUNDING, FloatArray, frozen_array
from ..errors import InvalidOption
from ..option_checks import check_whole
from .best_shares import vertex


@dataclass(frozen=True, eq=False)
class SlotMixture:
    """How likely each slot (T,) is drawn, and the joint ``value`` and ``lower_bound``."""

    shares: FloatArray
    value: float
    lower_bound: float


def mix_slots(values: npt.ArrayLike, lower_bounds: npt.ArrayLike, window: int = 1) -> SlotMixture:
    """Draw the departure's slot and route so that no window costs more than necessary.

    Parameters
    ----------
    values, lower_bounds : (T,)
        Those of the plan of each slot.
    window
        Number of consecutive slots that one ambush lasts.

    Raises
    ------
    InvalidOption
        There is no slot, a lower bound is over its value, or the window is not a whole number of 1
        or more.

    Examples
    --------
    >>> mix_slots([1.0, 2.0], [1.0, 2.0]).shares.round(3).tolist()
    [0.667, 0.333]
    """
    check_whole('window', window, 1)
    values, lower_bounds = (np.asarray(each, dtype=np.float64) for each in (values, lower_bounds))
    if not values.size:
        raise InvalidOption('slots must name at least one time')
    if not (lower_bounds <= values * (1.0 + ROUNDING)).all():
        raise InvalidOption('each lower bound must be at most the value of its slot')
    shares, value = _least(values, window)
    _, bound = _least(lower_bounds, window)
    return SlotMixture(frozen_array(shares, np.float64), value, min(bound, value))


def _least(values: FloatArray, window: int) -> tuple[FloatArray, float]:
    """The shares (T,) that minimise the largest sum of share times value in a window, and it."""
    slots = len(values)
    if window >= slots or values.min() == 0.0:  # one ambush covers all, or some slots are safe
        least = values == values.min()
        return least / least.sum(), float(values.min())
    first = np.arange(slots - window + 1)[:, None]
    covered = (np.arange(slots) >= first) & (np.arange(slots) < first + window)
    _, shares, *_ = vertex(csr_matrix(covered * values), np.zeros((0, slots)))
    return shares, float((covered @ (shares * values)).max())
