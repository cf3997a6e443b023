# SPDX-License-Identifier: Apache-2.0
"""A mixture of few routes that departures draw from, as ``operations.few_routes`` finds it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IndexArray
from ..game.strategy import TripStrategy


@dataclass(frozen=True, eq=False)
class FewRoutes:
    """A mixture of few routes.

    Attributes
    ----------
    paths : K arrays (L, 3)
        The driven paths, as ``Plan.paths`` has them.
    shares : (K,)
        How likely each is driven; the largest first.
    trip : TripStrategy
        The mixture, on a network of the paths side by side. Its ambusher waits at the worst place
        anywhere on the map. Its lower bound is that of all mixtures of the ``candidates``: paths as
        they are driven, from which these were chosen. The plan's own bound is that of another game,
        in which convoys may stray from their routes by the tube.
    candidates : int
        Their number.
    costs : (K,)
        Lengths [m], or driving times [s] if the network has them.
    curve : ((K, value), ...)
        The value of the best mixture found with at most K routes.
    routes : K arrays
        The nodes of each leg of each route in the plan's network.
    """

    paths: tuple[FloatArray, ...]
    shares: FloatArray
    trip: TripStrategy
    candidates: int
    costs: FloatArray
    curve: tuple[tuple[int, float], ...]
    routes: tuple[tuple[IndexArray, ...], ...]

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

    def nodes(self, k: int) -> tuple[IndexArray, ...]:
        """The nodes of a route in the network of ``trip``."""
        network = self.trip.game.network
        first = np.flatnonzero(network.tails == network.source)
        return (np.append(network.source, np.split(network.heads, first[1:])[k]),)

    def draw(self, rng: np.random.Generator) -> int:
        """Draw the index of a departure's route."""
        return int(rng.choice(len(self.paths), p=self.shares))

    def drawn(self, n: int, rng: np.random.Generator) -> list[FloatArray]:
        """Draw the paths of ``n`` departures."""
        return [self.paths[k] for k in rng.choice(len(self.paths), n, p=self.shares)]
