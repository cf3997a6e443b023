# SPDX-License-Identifier: Apache-2.0
"""Slots of departure: the time is drawn as well, so that an ambush must choose its time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from ..errors import InvalidOption


@dataclass(frozen=True)
class Slots:
    """Times of departure (HH:MM) with their shares; an ambush lasts ``window`` slots.

    Raises InvalidOption if they do not fit together.
    """

    times: tuple[str, ...]
    shares: tuple[float, ...]
    window: int

    def __post_init__(self) -> None:
        try:
            for time in self.times:
                datetime.strptime(time, '%H:%M')
        except ValueError as error:
            raise InvalidOption('a slot is not of the form HH:MM') from error
        if not (len(self.times) == len(self.shares) and min(self.shares, default=-1.0) >= 0.0
                and math.isclose(sum(self.shares), 1.0) and self.window > 0):
            raise InvalidOption('times and shares of slots do not fit together')

    @classmethod
    def of(cls, times: Sequence[str], window: int) -> Slots:
        """Make slots with optimal shares (docs/theory.md, Proposition 14.2).

        An ambush covers at most one of a set of slots that are ``window`` apart. Shares are uniform
        over all slots in sets of the largest size.
        """
        size = math.ceil(len(times) / window)
        used = np.arange(len(times)) % window < len(times) - (size - 1) * window
        return cls(tuple(times), tuple((used / used.sum()).tolist()), window)

    @property
    def covered(self) -> float:
        """Largest share of departures that one ambush covers.

        The value of a plan times this share is the value if the ambusher does not know the time.
        """
        return max(sum(self.shares[k:k + self.window]) for k in range(len(self.shares)))

    def draw(self, rng: np.random.Generator) -> str:
        """Draw the time of a departure."""
        return self.times[int(rng.choice(len(self.shares), p=self.shares))]
