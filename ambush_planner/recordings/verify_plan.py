"""A recorded strategy and route: proved by the certificate, planned again, drawn again."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from ..game.acyclic import is_acyclic
from ..game.revaluation import open_gap
from ..game.strategy import CERTIFICATE_TOLERANCE, Strategy
from ..maps.occupancy import OccupancyMap
from ..maps.ros_messages import occupancy_from_ros
from ..network.construction import expected_nodes
from ..network.network import Network
from ..planning.changed_ground import ChangedGround
from ..planning.plan import (
    Plan,
    PlanningOptions,
    PlanRequest,
    add_hiding_places,
    node_spacing,
    risk_map_and_goal,
)
from ..planning.trip import trip_network
from .map_changes import changed_map
from .metadata import LEAST_BITS
from .npz import BadAttachment
from .recorded_case import Case
from .strategy_file import VALUE_TOLERANCE

# Of probabilities and of what follows from them, relative: another release of numpy or scipy,
# another processor or number of threads rounds otherwise on the way to the optimum.
PROBABILITY_TOLERANCE = 1e-6
# What the time that a solve had leaves as it is, and what it does not.
_TIMELESS = dict.fromkeys(
    ('length_budget', 'shortest_length', 'exposure_budget', 'least_exposure'), VALUE_TOLERANCE
)
_TOLERANCES = {
    **_TIMELESS,
    **dict.fromkeys(('value', 'lower_bound'), VALUE_TOLERANCE),
    **dict.fromkeys(
        ('expected_exposure', 'expected_length', 'edge_entropy', 'route_entropy'),
        PROBABILITY_TOLERANCE,
    ),
}
# From this share of its time limit on, a solve may have been cut short.
_HURRIED = 0.2
_ENTROPY_BITS = 256
# A network is built to be compared only if it is about as large as that which was recorded: a
# forged parameter must not fill the memory. Networks of so many nodes are built in any case.
_MOST_TIMES = 10
_ALWAYS_BUILT = 100_000


def certificate_faults(strategy: Strategy, planning: PlanningOptions) -> list[str]:
    """Check what ``plan`` promises of every strategy, from this one alone, whatever time it had."""
    faults = []
    if planning.strategy.solver == 'max_entropy' and not is_acyclic(
        strategy.network, strategy.edge_probability
    ):
        faults.append('strategy: it goes round in cycles')
    for what, unit in (('length', ' m'), ('exposure', '')):
        mean, budget = getattr(strategy, f'expected_{what}'), getattr(strategy, f'{what}_budget')
        if not mean <= budget * (1.0 + CERTIFICATE_TOLERANCE):
            faults.append(
                f'strategy: its {what}, {mean:.9g}{unit}, is over its budget of {budget:.9g}{unit}'
            )
    gap = open_gap(strategy, planning.strategy)
    if gap > planning.max_gap * strategy.value:
        faults.append(f'strategy: its certificate does not close: gap {gap:.3g}')
    return faults


def was_hurried(strategy: Strategy, planning: PlanningOptions, seconds: float) -> bool:
    """Whether the solve, which took so many seconds, may have been cut short by its time limit.

    What it would have found with more time nobody knows; its certificate is checked all the same.
    """
    limit = planning.strategy.time_limit
    return open_gap(strategy, planning.strategy) > 0.0 or seconds >= _HURRIED * limit


class PlannedAgain:
    """What map, trip and parameters lead to; network and plan when they are asked for.

    ``visited`` are the stops [m] as the recorded plan visits them. ``solve`` makes the plan, as the
    node's worker does; ``goal_xy`` [m] is the goal, moved as far as it had to be, ``spacing`` as in
    ``Plan`` [m]. Raises what ``plan_trip`` raises.
    """

    def __init__(
        self, request: PlanRequest, visited: Sequence[tuple[float, float]],
        solve: Callable[[PlanRequest], Plan],
    ) -> None:
        self._request, self._visited, self._solve = request, visited, solve
        self._risk_map, self.goal_xy = risk_map_and_goal(request)
        self.spacing = node_spacing(self._risk_map, request.options.network)

    def network_faults(self, recorded: Network) -> list[str]:
        """Compare the recorded network with the one that follows, if that has such a size."""
        does_not = 'network: it does not follow from map, trip and parameters: '
        count = len(recorded.points)
        likely = expected_nodes(self._risk_map, self._request.options.network)
        likely *= len(self._visited) + 1
        if likely > _MOST_TIMES * count + _ALWAYS_BUILT:
            return [f'{does_not}it has {count} points, they lead to some {likely:.2g}']
        for name in ('points', 'edges', 'alpha'):
            one, other = getattr(recorded, name), getattr(self._network, name)
            if len(one) != len(other):
                return [f'{does_not}it has {len(one)} {name}, planned again {len(other)}']
            if differing := np.count_nonzero((one != other).reshape(len(one), -1).any(axis=1)):
                return [f'{does_not}{differing} of {len(one)} {name} are others']
        if (recorded.source, recorded.target) != (self._network.source, self._network.target):
            return ['network: its source or its target is another node']
        if recorded.legs != self._network.legs:
            return [f'network: it has {recorded.legs} legs, planned again {self._network.legs}']
        return []

    @cached_property
    def plan(self) -> Plan:
        """The plan that follows."""
        return self._solve(self._request)

    @cached_property
    def _network(self) -> Network:
        options = self._request.options
        network = trip_network(
            self._risk_map, self._request.start_xy, self.goal_xy, options.network,
            self._visited, self._request.order,
        )
        return add_hiding_places(network, self._risk_map, options)


def strategy_faults(
    recorded: Strategy, planned: Strategy, hurried: bool
) -> tuple[list[str], list[str]]:
    """Compare a strategy with that planned again on the same network: (faults, notes).

    One that was ``hurried`` may have found another strategy; how far from the best it is at most
    its certificate says.
    """
    faults = []
    if recorded.game.ambush_radius != planned.game.ambush_radius:
        faults.append('strategy: it is for another reach than the parameters give')
    for name, tolerance in (_TIMELESS if hurried else _TOLERANCES).items():
        one, other = getattr(recorded, name), getattr(planned, name)
        if not math.isclose(one, other, rel_tol=tolerance, abs_tol=1e-12):
            faults.append(f'strategy: {name} is {one:.12g}, planned again {other:.12g}')
    apart = max(
        float(np.abs(getattr(recorded, name) - getattr(planned, name)).max(initial=0.0))
        for name in ('edge_probability', 'ambush_probability')
    )
    if apart <= PROBABILITY_TOLERANCE:
        return faults, [f'the strategy is the same to within {apart:.0e}'] if apart else []
    if hurried:
        return faults, [
            'not checked: whether another strategy follows, as its solve took long for its '
            f'max_planning_time; proved: its value {recorded.value:.6g}, and that none has less '
            f'than {recorded.lower_bound:.6g}; its route entropy is {recorded.route_entropy:.2f}, '
            f'{planned.route_entropy:.2f} with more time'
        ]
    said = f'strategy: its probabilities differ by up to {apart:.1e} from those planned again'
    return [*faults, said], []


def source_faults(case: Case) -> list[str]:
    """Check that the generator was made from the seed as the node makes it."""
    seed, source = case.parameters.seed, case.metadata.route_entropy_source
    if seed >= 0:
        said = 'it is not what the parameter seed and the number of the departure give'
        return [] if source == [seed, case.metadata.number] else [f'route_entropy_source: {said}']
    if len(source) != 1 or source[0] >= 2**_ENTROPY_BITS:
        return [f'route_entropy_source: it is not one number of {_ENTROPY_BITS} bits']
    if source[0].bit_length() < LEAST_BITS:
        return [f'route_entropy_source: it has fewer than {LEAST_BITS} bits']
    return []


def route_faults(case: Case, strategy: Strategy) -> list[str]:
    """Draw the route again from the recorded strategy, and compare it node for node."""
    drawn = strategy.sample_route(np.random.default_rng(case.metadata.route_entropy_source))
    if np.array_equal(drawn, case.metadata.route):
        return []
    return ['route: it is not what route_entropy_source draws from the strategy']


def ground_then(case: Case, plan: Plan) -> tuple[ChangedGround, OccupancyMap]:
    """The ground as it was planned on, with the recorded strategy, and the newest map.

    Raises
    ------
    UnreadableRecording
        The changes of the map are none.
    """
    values, resolution, origin = occupancy_from_ros(case.message('map'))
    # What came, and where from, is not looked at.
    planned = newest = OccupancyMap(values, resolution, origin)
    if case.recorded.map_changes:
        try:
            after = changed_map(values, case.recorded.map_changes)
        except BadAttachment as error:
            raise case.unreadable(f'map_changes: {error}') from error
        newest = OccupancyMap(after, resolution, origin)
    return ChangedGround(plan, planned, case.parameters.occupancy), newest


def changed_route_faults(case: Case, ground: ChangedGround, newest: OccupancyMap) -> list[str]:
    """Draw the route again as the node does on ground that has changed: until it is clear."""
    drawn = ground.draw(np.random.default_rng(case.metadata.route_entropy_source), newest)
    if drawn is None or not np.array_equal(drawn.nodes, case.metadata.route):
        return ['route: it is not what route_entropy_source draws on the map as it had changed']
    return []
