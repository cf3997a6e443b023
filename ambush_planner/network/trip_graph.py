# SPDX-License-Identifier: Apache-2.0
"""The drivable ground of a trip, and the network of each of its legs."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..arrays import FloatArray, IndexArray
from ..errors import (
    AmbushPlannerError,
    GoalBlocked,
    GoalOutsideMap,
    StartBlocked,
    StartOutsideMap,
    StopBlocked,
    StopOutsideMap,
)
from .network import Network
from .shortest_way import GroundLengths

Position = tuple[float, float]


@dataclass(frozen=True, eq=False)
class TripGraph:
    """Directed graph of the ground on which a trip can be driven, with its start, stops and goal.

    Parameters
    ----------
    points : (N, 2), alpha : (N,)
        The nodes [m] and their losses; 0 at start, stops and goal.
    edges : (E, 2)
        (tail, head) of each directed edge.
    visits : tuple of int
        The nodes of start, stops and goal in the given order; equal positions share a node.
    seconds : (E,), optional
        Driving time of each edge [s].
    refined : (K, 3), optional
        As in ``Network``.
    ground : optional
        Lengths over the ground between nodes, of which length budgets are multiples.
    """

    points: FloatArray
    alpha: FloatArray
    edges: IndexArray
    visits: tuple[int, ...]
    seconds: FloatArray | None = None
    refined: FloatArray | None = None
    ground: GroundLengths | None = None

    def networks(self) -> tuple[Network, ...]:
        """Make the network of each leg, without edges into its source or out of its target.

        All legs have the same nodes.
        """
        return tuple(self._leg(*ends) for ends in pairwise(self.visits))

    def _leg(self, source: int, target: int) -> Network:
        tails, heads = self.edges.T
        used = np.flatnonzero((heads != source) & (tails != target))
        used = used[np.lexsort((heads[used], tails[used]))]
        seconds = None if self.seconds is None else self.seconds[used]
        count = len(self.points)
        length = None if self.ground is None else self.ground.between(source - count,
                                                                      target - count)
        return Network(self.points, self.alpha, self.edges[used], source, target, seconds,
                       self.refined, length)


def position_text(name: str, position: Position) -> str:
    """Return a start, stop or goal with its position, for messages."""
    return f'{name} ({position[0]:.3f}, {position[1]:.3f})'


def position_errors(name: str) -> tuple[type[AmbushPlannerError], type[AmbushPlannerError]]:
    """Return the errors for a start, stop or goal off the map, and for one that is blocked."""
    return {'start': (StartOutsideMap, StartBlocked), 'goal': (GoalOutsideMap, GoalBlocked)}.get(
        name, (StopOutsideMap, StopBlocked))
