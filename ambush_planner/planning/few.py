# SPDX-License-Identifier: Apache-2.0
"""Record of a mixture of few routes that departures are drawn from (``operations.few_routes``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IndexArray
from ..game.strategy import TripStrategy
from ..routes.driven_path import join_legs


@dataclass(frozen=True, eq=False)
class FewRoutes:
    """A mixture of few routes of each leg of a trip, drawn leg by leg.

    Attributes
    ----------
    paths : K arrays (L, 3)
        The driven paths of the routes, leg by leg.
    leg : (K,)
        The leg of each, from 0.
    shares : (K,)
        Probability of each on its leg, in falling order.
    trip : TripStrategy
        The mixture as strategies, on networks that have each leg's paths as separate lines. Its
        ambusher waits at the worst place of the map. Its lower bound is that of all mixtures of the
        candidates, the driven paths from which these were chosen. The plan's own bound is about
        another game, in which convoys may stray from their routes by the tube.
    candidates : int
        Number of candidates.
    costs : (K,)
        Length of each [m], or its driving time [s] if the network has times.
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
        """Largest mean loss that an ambush at one place causes."""
        return self.trip.value

    @property
    def lower_bound(self) -> float:
        """Lower bound of the value of every mixture of the candidates."""
        return self.trip.lower_bound

    @property
    def worst_xy(self) -> FloatArray:
        """The worst place (2,) [m]."""
        network, q = self.trip.game.network, self.trip.ambusher.q
        return np.asarray(network.points[q.argmax()])

    def draw(self, n: int, rng: np.random.Generator) -> IndexArray:
        """Draw ``n`` departures: the numbers (n, legs) of their routes."""
        by_leg = [np.flatnonzero(self.leg == k) for k in range(len(self.trip.legs))]
        return np.stack([rng.choice(each, n, p=self.shares[each]) for each in by_leg], axis=1)

    def path(self, numbers: IndexArray) -> FloatArray:
        """Return the path (L, 3) of a departure with the routes ``numbers`` (legs,)."""
        return join_legs([self.paths[k] for k in numbers])
