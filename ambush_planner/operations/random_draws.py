# SPDX-License-Identifier: Apache-2.0
"""Draws of few routes by hand: faces of dice, or cards, stand for routes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IndexArray, frozen_array
from ..planning.plan import Plan
from .path_mixtures import PathMixtures

_FACES = '123456'
# Equally likely outcomes of a die, of a first and a second die, and of a deck, suit by suit.
OUTCOMES = {
    'die': tuple(_FACES),
    'two dice': tuple(first + second for first in _FACES for second in _FACES),
    'cards': tuple(rank + suit for suit in '♠♥♦♣' for rank in (*'A23456789', '10', *'JQK')),
}


@dataclass(frozen=True, eq=False)
class RandomDraw:
    """A way to draw by hand, once for each leg: each route has ``counts`` (K,) of the outcomes.

    ``value`` is the value of the mixture with the shares that follow.
    """

    name: str
    counts: IndexArray
    value: float

    @property
    def ranges(self) -> list[str]:
        """Outcomes of each route, such as ``11-23``; '-' if it has none."""
        outcomes = OUTCOMES[self.name]
        last = (np.cumsum(self.counts) - 1) % len(outcomes)  # each leg uses all outcomes
        return ['-' if not count else outcomes[end] if count == 1 else
                f'{outcomes[end - count + 1]}-{outcomes[end]}'
                for count, end in zip(self.counts.tolist(), last.tolist(), strict=True)]


def random_draws(plan: Plan) -> list[RandomDraw]:
    """Make all draws with at least as many outcomes as a leg has routes, by the nearest shares."""
    few = plan.few
    assert few is not None
    mixtures, sizes = PathMixtures(plan.own_map, plan, few.paths, few.leg), np.bincount(few.leg)
    draws = []
    for name, outcomes in OUTCOMES.items():
        if len(outcomes) >= sizes.max():
            counts = np.concatenate([nearest_counts(shares, len(outcomes)) for shares in np.split(
                few.shares, sizes.cumsum()[:-1])])
            value = mixtures.judge(counts / len(outcomes)).value
            draws.append(RandomDraw(name, counts, value))
    return draws


def nearest_counts(shares: FloatArray, total: int) -> IndexArray:
    """Return whole numbers (K,) with sum ``total``, nearest to ``total`` times the shares (K,)."""
    counts = np.floor(total * shares + 1e-9).astype(np.int64)
    largest = np.argsort(counts - total * shares, kind='stable')[: total - int(counts.sum())]
    counts[largest] += 1
    return frozen_array(counts, np.int64)
