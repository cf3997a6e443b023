"""A recorded strategy: its certificate, the one planned again, and the route drawn from it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from io import BytesIO

import numpy as np

from ..core.acyclic import is_acyclic
from ..core.network import Network
from ..core.planner import PlanningOptions
from ..core.strategy import CERTIFICATE_TOLERANCE, Strategy
from ..recording.strategy_file import NUMBERS
from .case import Case
from .departures import LEAST_BITS

# Of numbers that have to be the same but for rounding, relative.
VALUE_TOLERANCE = 1e-9
# Of probabilities and of what follows from them: another release of numpy or scipy, another
# processor or number of threads rounds otherwise on the way to the optimum.
PROBABILITY_TOLERANCE = 1e-6
_TOLERANCES = {
    'value': VALUE_TOLERANCE,
    'lower_bound': VALUE_TOLERANCE,
    'length_budget': VALUE_TOLERANCE,
    'shortest_length': VALUE_TOLERANCE,
    'exposure_budget': VALUE_TOLERANCE,
    'least_exposure': VALUE_TOLERANCE,
    'expected_exposure': PROBABILITY_TOLERANCE,
    'expected_length': PROBABILITY_TOLERANCE,
    'edge_entropy': PROBABILITY_TOLERANCE,
    'route_entropy': PROBABILITY_TOLERANCE,
}
# What the time that a solve had leaves as it is.
_TIMELESS = ('length_budget', 'shortest_length', 'exposure_budget', 'least_exposure')
# From this share of its time limit on, a solve may have been cut short.
_HURRIED = 0.2
_ENTROPY_BITS = 256


def certificate_faults(strategy: Strategy, planning: PlanningOptions) -> list[str]:
    """Check what ``plan`` promises of every strategy, from this one alone."""
    faults, options = [], planning.strategy
    if options.solver == 'max_entropy' and not is_acyclic(
        strategy.network, strategy.edge_probability
    ):
        faults.append('strategy: it goes round in cycles')
    length, budget = strategy.expected_length, strategy.length_budget
    if not length <= budget * (1.0 + CERTIFICATE_TOLERANCE):
        faults.append(f'strategy: it is {length:.9g} m long, over its budget of {budget:.9g} m')
    exposure, budget = strategy.expected_exposure, strategy.exposure_budget
    if not exposure <= budget * (1.0 + CERTIFICATE_TOLERANCE):
        faults.append(f'strategy: its exposure {exposure:.9g} is over its budget of {budget:.9g}')
    gap = _open_gap(strategy, planning)
    if gap > planning.max_gap * strategy.value:
        faults.append(f'strategy: its certificate does not close: gap {gap:.3g}')
    return faults


def was_hurried(strategy: Strategy, planning: PlanningOptions, seconds: float) -> bool:
    """Whether the solve, which took so many seconds, may have been cut short by its time limit.

    What it would have found with more time nobody knows; its certificate is checked all the same.
    """
    limit = planning.strategy.time_limit
    return _open_gap(strategy, planning) > 0.0 or seconds >= _HURRIED * limit


def _open_gap(strategy: Strategy, planning: PlanningOptions) -> float:
    """What the certificate leaves open beyond the slack and rounding; 0 where it closes."""
    options = planning.strategy
    # With a length weight it is the weighted sum that is minimal.
    weighed = strategy.length_price * strategy.expected_length * (options.length_weight > 0.0)
    slack = options.risk_slack if options.solver == 'max_entropy' else 0.0
    gap = strategy.value / (1.0 + slack) - strategy.lower_bound
    scale = max(strategy.value + weighed, 1e-6 * float(strategy.game.loss.max(initial=0.0)))
    return gap if gap > 2.0 * CERTIFICATE_TOLERANCE * scale else 0.0


def network_faults(recorded: Network, planned: Network) -> list[str]:
    """Compare the recorded network with that planned again, bit for bit."""
    for name in ('points', 'edges', 'alpha'):
        one, other = getattr(recorded, name), getattr(planned, name)
        if len(one) != len(other):
            found = f'it has {len(one)} {name}, planned again {len(other)}'
        elif not np.array_equal(one, other):
            rows = (one != other).reshape(len(one), -1).any(axis=1)
            found = f'{np.count_nonzero(rows)} of {len(one)} {name} are others'
        else:
            continue
        return [f'network: it does not follow from map, trip and parameters: {found}']
    if (recorded.source, recorded.target) != (planned.source, planned.target):
        return ['network: its source or its target is another node']
    if recorded.legs != planned.legs:
        return [f'network: it has {recorded.legs} legs, planned again {planned.legs}']
    return []


def strategy_faults(
    data: bytes, recorded: Strategy, planned: Strategy, hurried: bool
) -> tuple[list[str], list[str]]:
    """Compare a strategy with that planned again on the same network.

    ``data`` is the recorded file, for the numbers that it states; ``recorded`` is what its
    probabilities give, ``planned`` what the solver finds now; one that was ``hurried`` may have
    found another strategy. Returns (faults, notes).
    """
    faults = _stated_faults(data, recorded)
    if recorded.game.ambush_radius != planned.game.ambush_radius:
        faults.append('strategy: it is for another reach than the parameters give')
    faults += _number_faults(recorded, planned, _TIMELESS if hurried else _TOLERANCES)
    apart = max(
        float(np.abs(getattr(recorded, name) - getattr(planned, name)).max(initial=0.0))
        for name in ('edge_probability', 'ambush_probability')
    )
    if apart > PROBABILITY_TOLERANCE and hurried:
        return faults, [
            'not checked: whether another strategy follows, as its solve took long for its '
            'max_planning_time'
        ]
    if apart > PROBABILITY_TOLERANCE:
        faults.append(
            f'strategy: its probabilities differ by up to {apart:.1e} from those planned again'
        )
        return faults, []
    return faults, [f'the strategy is the same to within {apart:.0e}'] if apart else []


def _stated_faults(data: bytes, recorded: Strategy) -> list[str]:
    """Compare what the file states with what follows from its probabilities."""
    with np.load(BytesIO(data), allow_pickle=False) as archive:
        stated = {name: float(archive[name]) for name in NUMBERS}
    # The route entropy is a difference of two numbers of the edge entropy's size.
    rounding = VALUE_TOLERANCE * abs(recorded.edge_entropy)
    return [
        f'strategy: {name} is stated as {stated[name]:.12g}, its probabilities give {again:.12g}'
        for name in NUMBERS
        if not math.isclose(
            stated[name], again := getattr(recorded, name), rel_tol=VALUE_TOLERANCE,
            abs_tol=rounding if name == 'route_entropy' else 1e-12,
        )
    ]


def _number_faults(recorded: Strategy, planned: Strategy, names: Iterable[str]) -> list[str]:
    faults = []
    for name in names:
        tolerance = _TOLERANCES[name]
        one, other = getattr(recorded, name), getattr(planned, name)
        if not math.isclose(one, other, rel_tol=tolerance, abs_tol=1e-12):
            faults.append(f'strategy: {name} is {one:.12g}, planned again {other:.12g}')
    return faults


def source_faults(case: Case) -> list[str]:
    """Check that the generator was made from the seed as the node makes it."""
    seed, source = case.parameters.seed, case.metadata.route_entropy_source
    if seed < 0:
        if len(source) != 1 or source[0] >= 2**_ENTROPY_BITS:
            return [f'route_entropy_source: it is not one number of {_ENTROPY_BITS} bits']
        if source[0].bit_length() < LEAST_BITS:
            return [f'route_entropy_source: it has fewer than {LEAST_BITS} bits']
    elif source != [seed, case.metadata.number]:
        return [
            'route_entropy_source: it is not what the parameter seed and the number of the '
            'departure give'
        ]
    return []


def route_faults(case: Case, strategy: Strategy) -> list[str]:
    """Draw the route again from the recorded strategy, and compare it node for node."""
    drawn = strategy.sample_route(np.random.default_rng(case.metadata.route_entropy_source))
    if np.array_equal(drawn, case.metadata.route):
        return []
    return ['route: it is not what route_entropy_source draws from the strategy']
