# SPDX-License-Identifier: Apache-2.0
"""A mixture of few routes that departures draw from, as ``operations.few_routes`` finds it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IndexArray
from ..game.strategy import TripStrategy
from ..routes.driven_path import joined


@dataclass(frozen=True, eq=False)
class FewRoutes:
    """Few routes of each leg of a trip, drawn leg by leg.

    Attributes
    ----------
    paths : K arrays (L, 3)
        The driven paths of the legs' routes, those of the first leg first.
    leg : (K,)
        The leg of each, from 0.
    shares : (K,)
        How likely each is driven on its leg; the leg's largest first.
    trip : TripStrategy
        The mixture, on networks of each leg's paths side by side. Its ambusher waits at the worst
        place anywhere on the map. Its lower bound is that of all mixtures of the ``candidates``:
        paths as they are driven, from which these were chosen. The plan's own bound is that of
        another game, in which convoys may stray from their routes by the tube.
    candidates : int
        Their number.
    costs : (K,)
        Lengths [m], or driving times [s] if the network has them.
    curve : ((K, value), ...)
        The value of the best mixture found with at most K routes a leg.
    """

    paths: tuple[FloatArray, ...]
    leg: IndexArray
    shares: FloatArray
    trip: TripStrategy
    candidates: int
    costs: FloatArray
    curve: tuple[tuple[int, float], ...]

    @property
    def value(self) -> float:
        """Mean loss by the worst ambusher who knows all of this."""
        return self.trip.value

    @property
    def lower_bound(self) -> float:
        """No mixture of the candidates has a smaller value."""
        return self.trip.lower_bound

    @property
    def worst_xy(self) -> FloatArray:
        """The worst place (2,) [m]."""
        network, q = self.trip.game.network, self.trip.ambusher.q
        return np.asarray(network.points[q.argmax()])

    def draw(self, n: int, rng: np.random.Generator) -> IndexArray:
        """Draw ``n`` departures, (n, legs): the number of a route for each leg."""
        own = [np.flatnonzero(self.leg == k) for k in range(len(self.trip.legs))]
        return np.stack([rng.choice(each, n, p=self.shares[each]) for each in own], axis=1)

    def path(self, numbers: IndexArray) -> FloatArray:
        """The path of a departure with some ``numbers`` (legs,) of routes."""
        return joined([self.paths[k] for k in numbers])
