"""Recorded departures as plain records, those of one strategy or map sharing one."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import IndexArray, frozen_array
from ..game.acyclic import is_acyclic
from ..game.certificate import upper_bound
from ..game.strategy import Strategy
from ..maps.risk_map import RiskMap
from ..planning.conditioning import ConditionedStrategy
from ..planning.node_parameters import NodeParameters
from ..planning.plan import Plan
from . import UnreadableRecording, read_departure
from .metadata import LEAST_BITS, Metadata
from .recorded_case import Case
from .verify_plan import ground_then


@dataclass(frozen=True, eq=False)
class Departure:
    """One departure with what it was drawn from; every checksum and stated hash held.

    ``strategy`` is the recorded one. ``law`` is what the route was drawn from: the same, or, where
    the map had changed, the strategy on condition that its routes are clear on the newest map.
    """

    path: Path
    sha256: str
    stamp_ns: int
    metadata: Metadata
    parameters: NodeParameters
    strategy: Strategy
    law: Strategy
    risk_map: RiskMap
    route: IndexArray

    drawn_from = property(lambda self: self.law)
    id = property(lambda self: self.metadata.id)
    number = property(lambda self: self.metadata.number)
    frame = property(lambda self: self.metadata.frame)
    trip = property(lambda self: self.metadata.trip)
    route_entropy_source = property(lambda self: self.metadata.route_entropy_source)


RecordedDeparture = Departure


def read_departures(
    paths: Iterable[Path], unreadable: Callable[[UnreadableRecording], None]
) -> list[Departure]:
    """Read recordings, the earliest departure first; one that was copied counts once.

    ``unreadable`` is called with the error of each file that cannot be read; others are used.
    """
    known: dict[str, Departure] = {}
    shared: dict[Hashable, Any] = {}
    for path in paths:
        try:
            departure = _departure(Case(read_departure(path)), shared)
            other = known.setdefault(departure.metadata.id, departure)
            if other.metadata.sha256 != departure.metadata.sha256:
                raise UnreadableRecording(
                    path, f'it has the departure_id of {other.path.name}, but another content'
                )
        except UnreadableRecording as error:
            unreadable(error)
    return sorted(known.values(), key=lambda each: (each.stamp_ns, each.metadata.number))


def source_findings(departures: Iterable[RecordedDeparture]) -> list[str]:
    """Report departures that were not drawn from fresh random numbers of full length.

    Sources that differ only in their last 192 bits, like those of a counter, come by chance with
    probability 2^-64.
    """
    findings, sources = [], []
    for each in departures:
        source, name = each.route_entropy_source, each.path.name
        if len(source) == 1 and source[0].bit_length() < LEAST_BITS:
            findings.append(f'{name}: its random source has fewer than {LEAST_BITS} bits')
        else:
            sources.append((tuple(source), name, each.id))
    sources.sort()
    for (one, first, id_), (other, name, other_id) in zip(sources, sources[1:], strict=False):
        near = one == other or (
            len(one) == len(other) == 1 and (other[0] - one[0]).bit_length() < LEAST_BITS
        )
        if near and id_ != other_id:
            same = 'the same' if one == other else 'nearly the same'
            findings.append(f'{name}: its random source is {same} as that of {first}')
    return findings


def _departure(case: Case, shared: dict[Hashable, Any]) -> Departure:
    metadata, parameters = case.metadata, case.parameters

    def once(make: Callable[[], Any], *key: Hashable) -> Any:
        if key not in shared:
            shared[key] = make()
        return shared[key]

    strategy = once(case.strategy, 'strategy', metadata.sha256['strategy'],
                    parameters.planning.game)
    risk_map = once(case.risk_map, 'map', metadata.sha256['map'], parameters.occupancy)
    # Published anew, a map may be serialised to other bytes.
    risk_map = once(lambda: risk_map, 'content', _content(risk_map))
    law = once(
        lambda: _law(case, strategy), 'law', id(strategy), id(risk_map),
        metadata.sha256['map_changes'], parameters.occupancy, parameters.planning,
    ) if case.recorded.map_changes else strategy
    route = frozen_array(metadata.route, np.int64)
    if route.max() >= len(strategy.network.points):
        raise case.unreadable('the recorded route leaves the recorded network')
    return Departure(
        case.path, case.recorded.sha256, case.recorded.stamp_ns, metadata, parameters, strategy,
        law, risk_map, route,
    )


def _law(case: Case, strategy: Strategy) -> Strategy:
    """The strategy on condition that its routes are clear on the map as it had changed.

    One with cycles has no such law, and comes back as it is.
    """
    # Bottleneck and corridors do not decide which edges are lost.
    options = case.parameters.planning
    plan = Plan(strategy.network, strategy, None, None, options, 0.0, None, 0.0)
    ground, newest = ground_then(case, plan)
    lost = ground.lost(newest)
    if not lost[strategy.edge_probability > 0.0].any() or not is_acyclic(
        strategy.network, strategy.edge_probability
    ):
        return strategy
    share, p = ConditionedStrategy(strategy).avoiding(lost)
    if share <= 0.0:
        raise case.unreadable('map_changes: no route of the recorded strategy is left')
    return replace(
        strategy, edge_probability=frozen_array(p, np.float64),
        visit_probability=frozen_array(strategy.game.visits(p), np.float64),
        value=upper_bound(strategy.game, p),
    )


def _content(risk_map: RiskMap) -> str:
    digest = hashlib.sha256(risk_map.alpha.tobytes() + risk_map.obstacles.tobytes())
    return f'{digest.hexdigest()} {risk_map.alpha.shape} {risk_map.resolution} {risk_map.origin}'
