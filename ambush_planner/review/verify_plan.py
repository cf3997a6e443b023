"""A recorded departure planned again: step by step, each as long as those before agree."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

from ..core.construction import expected_nodes
from ..core.network import Network
from ..core.planner import Plan, PlanRequest, node_spacing, read_request, with_cover
from ..core.trip import trip_network
from .verify_strategy import network_faults

# A network is built to be compared only if it is about as large as that which was recorded: a
# forged parameter must not fill the memory. Networks of so many nodes are built in any case.
_MOST_TIMES = 10
_ALWAYS_BUILT = 100_000


class PlannedAgain:
    """What map, trip and parameters lead to.

    Network and plan are worked out when they are asked for, and raise what ``plan`` raises.

    Parameters
    ----------
    request
        What the plan follows from.
    visited
        The stops [m], in the order in which the recorded plan visits them.
    solve
        Makes the plan, as the node's worker does.

    Attributes
    ----------
    goal_xy
        The goal, moved as far as it had to be [m].
    spacing
        As in ``Plan`` [m].

    Raises
    ------
    InvalidRiskMap
        The map is malformed.
    InvalidOption
        The spacing asks for more nodes than any network has.
    """

    def __init__(
        self, request: PlanRequest, visited: Sequence[tuple[float, float]],
        solve: Callable[[PlanRequest], Plan],
    ) -> None:
        self._request, self._visited, self._solve = request, visited, solve
        self._risk_map, self.goal_xy = read_request(request)
        self.spacing = node_spacing(self._risk_map, request.options.network)
        self._expected_nodes = (len(visited) + 1) * expected_nodes(
            self._risk_map, request.options.network
        )

    def network_faults(self, recorded: Network) -> list[str]:
        """Compare the recorded network with the one that follows, if that has such a size."""
        count = len(recorded.points)
        if self._expected_nodes > _MOST_TIMES * count + _ALWAYS_BUILT:
            return [
                'network: it does not follow from map, trip and parameters: it has '
                f'{count} points, they lead to some {self._expected_nodes:.2g}'
            ]
        return network_faults(recorded, self._network)

    @cached_property
    def plan(self) -> Plan:
        """The plan that follows."""
        return self._solve(self._request)

    @cached_property
    def _network(self) -> Network:
        request = self._request
        network = trip_network(
            self._risk_map, request.start_xy, self.goal_xy, request.options.network,
            self._visited, request.order,
        )
        return with_cover(network, self._risk_map, request.options)
