# SPDX-License-Identifier: Apache-2.0
"""The metadata record of a recording: its entries with their types, as JSON."""

from __future__ import annotations

import math
import platform
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, fields
from datetime import datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import chain
from types import MappingProxyType, NoneType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import scipy

from ..arrays import Position
from ..errors import AmbushPlannerError
from ..gone import RENAMED, check_none_gone
from ..operations.slots import Slots
from ..parameters.table import PARAMETERS
from ..planning.plan import Route
from .sources import Source

# Options that the node has no parameter for.
BEYOND: Mapping[str, Any] = {
    'game.secured_places': tuple[tuple[float, float, float], ...],
    'network.seed': int}
_INTEGERS, _SOURCE = 2**63, 'route_entropy_source'
# Parameters that went and say nothing of a departure of one leg.
_UNRELATED = ('trip.order', 'queue.size', 'diagnostics.error_hold')


class InvalidEntry(AmbushPlannerError):
    """An entry of the metadata record is missing or has the wrong type."""


@dataclass(frozen=True)
class RecordedTrip:
    """The planned trip in the map's frame [m], its stops as in ``Plan.stops_xy``.

    ``names`` are those of start and goal, '' if they have none.
    """

    start: Position
    goal: Position
    stops: tuple[Position, ...] = ()
    names: tuple[str, str] = ('', '')


@dataclass(frozen=True)
class RecordedCall:
    """The call that made a departure: the service's full name and type, times, and the request.

    ``remarks`` are those of the response. An action's goal is recorded as a call of ``get_plan``.
    """

    service: str
    type: str
    request_ns: int
    response_ns: int
    request: Mapping[str, Any]
    remarks: str = ''


@dataclass(frozen=True)
class Diversion:
    """Diversion of a departure, its ``number``-th.

    ``left`` are the nodes of the whole route that the convoy was on, leg by leg; ``ahead`` those
    from which its rest could change, in the first leg of the departure's ``route``, the first one
    to be tried first.
    """

    number: int
    left: tuple[tuple[int, ...], ...]
    ahead: tuple[int, ...]


@dataclass(frozen=True)
class RecordedPlan:
    """The entry about the plan of a file; times as ``Plan`` has them, ``made_ns`` when it was made.

    ``sources`` are the files that it was made from.
    """

    id: str
    made_ns: int
    seconds: float
    slots: Slots | None
    sources: tuple[Source, ...] = ()


@dataclass(frozen=True)
class RecordedDay:
    """The day of a departure that was drawn from a plan file.

    ``date`` (YYYY-MM-DD) and ``slot`` (HH:MM; '': not said) in a time ``zone``, which was drawn
    after the route if ``slot_drawn``; the id of an earlier departure for the same day that it
    ``replaces``, because that one was not driven, and ``why``.
    """

    date: str
    slot: str
    slot_drawn: bool
    replaces: str = ''
    why: str = ''
    zone: str = ''

    def __post_init__(self) -> None:
        _check_form('%Y-%m-%d', self.date)
        _check_form('%H:%M', *filter(None, [self.slot]))


@dataclass(frozen=True)
class PlanMetadata:
    """The metadata record of a plan file; ``kind`` is 'plan', the rest as in ``Metadata``."""

    kind: str
    frame: str
    parameters: Mapping[str, Any]
    versions: Mapping[str, str]
    topics: Mapping[str, str]
    trip: RecordedTrip
    plan: RecordedPlan


@dataclass(frozen=True)
class Metadata:
    """The record of a departure, with all that it takes to draw it again.

    Attributes
    ----------
    departure_id, departure
        Unique to the departure; its number in the node's run, from 1.
    frame, parameters, versions
        The map's frame, all parameters of the node by name, and the versions of the software.
    topics
        The topics of the messages by role: map, start, goal, via, path.
    trip, ends
        The planned trip, and the ends of the driven path, which may lie near the trip's [m].
    joined
        Whether the path joins the plan from where the convoy was.
    value
        Of the departure, on the map of that moment, against an ambusher who must choose a time,
        too, if that was drawn. A diversion has that of its departure. None in files of before.
    route, route_entropy_source
        Node indices of each leg, and what seeded ``numpy.random.default_rng`` for their draw.
    diversion
        None for a departure; else the route is the rest of its departure's, from where it was
        diverted, with the source of that leg in place of the convoy.
    plan, day
        The plan file that the departure was drawn from, and the day that it is for; None if a node
        made it.

    Raises InvalidEntry if a position is not finite.
    """

    departure_id: str
    departure: int
    frame: str
    parameters: Mapping[str, Any]
    versions: Mapping[str, str]
    topics: Mapping[str, str]
    trip: RecordedTrip
    ends: tuple[Position, Position]
    joined: bool
    route: tuple[tuple[int, ...], ...]
    route_entropy_source: tuple[int, ...]
    call: RecordedCall
    value: float | None = None
    diversion: Diversion | None = None
    plan: RecordedPlan | None = None
    day: RecordedDay | None = None

    def __post_init__(self) -> None:
        places = (self.trip.start, self.trip.goal, *self.trip.stops, *self.ends)
        if not all(map(math.isfinite, chain.from_iterable(places))):
            raise InvalidEntry('a position of trip or ends is not finite')

    @property
    def recording_id(self) -> str:
        """Unique to the recording: a departure and each of its diversions have one each."""
        return self.departure_id + (f'/{self.diversion.number}' if self.diversion else '')

    def entries(self) -> dict[str, Any]:
        """Return the entries of the metadata record, as JSON values."""
        return asdict(self)


@cache
def software_versions() -> Mapping[str, str]:
    """The versions of the planner and of the software that it computes with."""
    return MappingProxyType({'ambush_planner': _version_of('ambush_planner'),
                             'python': platform.python_version(), 'numpy': np.__version__,
                             'scipy': scipy.__version__, 'rclpy': _version_of('rclpy')})


def _version_of(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return 'not installed'


def numbers_of(route: Route) -> tuple[tuple[int, ...], ...]:
    """Return the nodes of a route, leg by leg."""
    return tuple(tuple(nodes.tolist()) for nodes in route)


def _check_form(form: str, *texts: str) -> None:
    """Raise InvalidEntry if one of the texts is no date or time of this form."""
    try:
        for text in texts:
            datetime.strptime(text, form)
    except ValueError as error:
        raise InvalidEntry(f'a date or time is not of the form {form}') from error


def typed(value: Any, wanted: Any, name: str) -> Any:
    """Return a value read from JSON as the type that is ``wanted``.

    That may be bool, int, float (no NaN), str, a tuple, list or mapping of these, a dataclass of
    these, or one of them or None. Integers have 64 bits, random sources any number. InvalidEntry
    names what is missing or has another type.
    """
    kind: Any = get_origin(wanted) or wanted
    inner = get_args(wanted)
    if wanted is Any:
        return value
    if NoneType in inner:
        return None if value is None else typed(value, inner[0], name)
    if hasattr(kind, '__dataclass_fields__') and isinstance(value, dict):
        hints = get_type_hints(kind)
        for each in fields(kind):
            if each.name not in value and each.default is MISSING:
                raise InvalidEntry(f'{each.name} is missing')
        return kind(**{each: typed(value[each], hint, each)
                       for each, hint in hints.items() if each in value})
    if kind is Mapping and isinstance(value, dict):
        return {key: typed(each, inner[1], key) for key, each in value.items()}
    if kind in (tuple, list) and isinstance(value, (tuple, list)):
        types = inner if kind is tuple and ... not in inner else inner[:1] * len(value)
        if len(types) == len(value):
            return kind(typed(*each, name) for each in zip(value, types, strict=True))
    if kind is float and type(value) in (int, float) and not math.isnan(value):
        return float(value)
    if kind in (bool, int, str) and type(value) is kind:
        if kind is int and not -_INTEGERS <= value < _INTEGERS and name != _SOURCE:
            raise InvalidEntry(f'{name} is out of range')
        return value
    raise InvalidEntry(f'{name} is not of the type {getattr(kind, "__name__", kind)}')


def typed_values(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of all parameters, and of others, each of the type that it should have.

    Raises InvalidEntry if one is missing or has another type, and InvalidOption if one went.
    """
    values = {RENAMED.get(name, name): value for name, value in values.items()}
    check_none_gone({name: value for name, value in values.items() if name not in _UNRELATED})
    kinds: dict[str, Any] = {
        name: list[str] if isinstance(each.default, list) else type(each.default)
        for name, each in PARAMETERS.items()}
    if missing := next((name for name in kinds if name not in values), ''):
        raise InvalidEntry(f'{missing} is missing: the file is of another version of '
                           'ambush_planner, or was edited')
    kinds |= {name: kind for name, kind in BEYOND.items() if name in values}
    return {name: typed(values[name], kind, name) for name, kind in kinds.items()}
