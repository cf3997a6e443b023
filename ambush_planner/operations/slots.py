# SPDX-License-Identifier: Apache-2.0
"""Slots of departure: times of which one is drawn, so that an ambush must choose its time, too."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from ..errors import InvalidOption


@dataclass(frozen=True)
class Slots:
    """The times of departure (HH:MM) with their shares, and how many slots an ambush lasts.

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
        """The best shares (docs/theory.md, section 14).

        An ambush of ``window`` slots covers one of a set of slots that are as far apart: of the
        sets that cannot have more slots, one is drawn, then one of its slots.
        """
        size = math.ceil(len(times) / window)
        drawn = np.arange(len(times)) % window < len(times) - (size - 1) * window
        return cls(tuple(times), tuple((drawn / drawn.sum()).tolist()), window)

    @property
    def covered(self) -> float:
        """The largest share of departures that one ambush covers.

        A plan's value for an ambusher who knows the time, times this share, is that for one who
        must choose it, too.
        """
        return max(sum(self.shares[k:k + self.window]) for k in range(len(self.shares)))

    def drawn(self, rng: np.random.Generator) -> str:
        """Draw the time of a departure."""
        return self.times[int(rng.choice(len(self.shares), p=self.shares))]
