# SPDX-License-Identifier: Apache-2.0
"""Draws of few routes by hand: which faces of dice, or which cards, stand for which route."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IndexArray, frozen_array
from ..planning.plan import Plan
from .path_mixtures import PathMixtures

_FACES = '123456'
# What can be drawn, all alike: a die; a first and a second die; a deck, suit after suit.
OUTCOMES = {
    'die': tuple(_FACES),
    'two dice': tuple(first + second for first in _FACES for second in _FACES),
    'cards': tuple(rank + suit for suit in '♠♥♦♣' for rank in (*'A23456789', '10', *'JQK')),
}


@dataclass(frozen=True, eq=False)
class RandomDraw:
    """A way to draw, once for each leg: ``counts`` (K,) of its outcomes stand for each route.

    ``value`` is the mean loss by the worst ambusher who knows all of this but the draws.
    """

    name: str
    counts: IndexArray
    value: float

    @property
    def ranges(self) -> list[str]:
        """The outcomes of each route, such as ``11-23``; '-' if it has none."""
        outcomes = OUTCOMES[self.name]
        last = (np.cumsum(self.counts) - 1) % len(outcomes)  # of each leg, from the first one
        return ['-' if not count else outcomes[end] if count == 1 else
                f'{outcomes[end - count + 1]}-{outcomes[end]}'
                for count, end in zip(self.counts.tolist(), last.tolist(), strict=True)]


def random_draws(plan: Plan) -> list[RandomDraw]:
    """All ways with at least as many outcomes as a leg has routes, by the nearest shares."""
    few = plan.few
    assert few is not None
    mixtures, own = PathMixtures(plan.own_map, plan, few.paths, few.leg), np.bincount(few.leg)
    made = []
    for name, outcomes in OUTCOMES.items():
        if len(outcomes) >= own.max():
            counts = np.concatenate([nearest_counts(shares, len(outcomes)) for shares in np.split(
                few.shares, own.cumsum()[:-1])])
            value = mixtures.judged(counts / len(outcomes)).value
            made.append(RandomDraw(name, counts, value))
    return made


def nearest_counts(shares: FloatArray, total: int) -> IndexArray:
    """Whole numbers (K,) that add up to ``total``, nearest to ``total`` times the shares (K,)."""
    counts = np.floor(total * shares + 1e-9).astype(np.int64)
    largest = np.argsort(counts - total * shares, kind='stable')[: total - int(counts.sum())]
    counts[largest] += 1
    return frozen_array(counts, np.int64)
