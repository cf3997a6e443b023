"""Recorded departures as plain records, those of one strategy or map sharing one."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.arrays import IndexArray, frozen_array
from ..core.risk_map import RiskMap
from ..core.strategy import Strategy
from ..recording import UnreadableRecording, read_departure
from ..recording.metadata import Metadata
from ..ros.node_parameters import NodeParameters
from .case import Case

# Of the operating system's 256 bits: fewer than these come once in 2^64 draws.
LEAST_BITS = 192


@dataclass(frozen=True, eq=False)
class Departure:
    """One departure with what it was drawn from; every checksum and stated hash held."""

    path: Path
    sha256: str
    stamp_ns: int
    metadata: Metadata
    parameters: NodeParameters
    strategy: Strategy
    risk_map: RiskMap
    route: IndexArray


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


def source_findings(departures: Iterable[tuple[str, Metadata]]) -> list[str]:
    """Say which departures were not drawn from fresh random numbers of full length.

    ``departures``: a name for each, and its metadata. Two sources nearer to each other than 192
    bits, a counter's say, come by chance once in 2^64.
    """
    found, values = [], []
    for name, metadata in departures:
        source = metadata.route_entropy_source
        if len(source) > 1:
            values.append((tuple(source), name, metadata.id))
        elif source[0].bit_length() < LEAST_BITS:
            found.append(f'{name}: its random source has fewer than {LEAST_BITS} bits')
        else:
            values.append((tuple(source), name, metadata.id))
    values.sort()
    for (one, first, id_), (other, name, other_id) in zip(values, values[1:], strict=False):
        near = one == other or (
            len(one) == len(other) == 1 and (other[0] - one[0]).bit_length() < LEAST_BITS
        )
        if near and id_ != other_id:
            same = 'the same' if one == other else 'nearly the same'
            found.append(f'{name}: its random source is {same} as that of {first}')
    return found


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
    route = frozen_array(metadata.route, np.int64)
    if route.max() >= len(strategy.network.points):
        raise case.unreadable('the recorded route leaves the recorded network')
    return Departure(
        case.path, case.recorded.sha256, case.recorded.stamp_ns, metadata, parameters, strategy,
        risk_map, route,
    )


def _content(risk_map: RiskMap) -> str:
    digest = hashlib.sha256(risk_map.alpha.tobytes() + risk_map.obstacles.tobytes())
    return f'{digest.hexdigest()} {risk_map.alpha.shape} {risk_map.resolution} {risk_map.origin}'
