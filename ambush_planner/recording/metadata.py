"""The metadata record ``ambush_planner`` of a recording: its keys, written and read.

Entries are single texts or JSON (with ``Infinity``, as Python writes it). ``sha256`` states the
hashes of messages, strategy and other entries; ``chain`` says which file this one is, and which
one it follows.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

# What the entries mean; another number where that changes.
FORMAT = '4'
ROLES = ('map', 'start', 'goal', 'path')
# Only in recordings of trips with stops.
VIA = 'via'
_HASHED = ('parameters', 'route_entropy_source', 'route', 'trip', 'ends')
_FILES = ('strategy', 'map_changes')
KEYS = frozenset({
    'format', 'planner_version', 'versions', 'service', 'departure', 'departure_id', 'frame',
    'inputs', 'parameters', 'route_entropy_source', 'route', 'trip', 'ends', 'sha256', 'chain',
})
# More than any node writes; reports and messages repeat what is below these.
_LONGEST_NAME, _LONGEST_VALUE, _LONGEST_ENTRY, _MOST_VALUES = 255, 4096, 2**22, 1000

Position = tuple[float, float]


class BadMetadata(ValueError):
    """The entries are none of a departure; the text says why."""


@dataclass(frozen=True)
class RecordedTrip:
    """Where a departure led, in the map's frame [m]; ``tolerance`` [m] as requested.

    ``stops`` are in the order in which they are visited.
    """

    start_xy: Position
    goal_xy: Position
    tolerance: float
    stops: tuple[Position, ...] = ()


@dataclass(frozen=True)
class Link:
    """A file's place in the chain: its name, and name and SHA-256 of the one before it.

    Names begin with that of the session; the very first recording follows nothing ('').
    """

    file: str = ''
    follows: str = ''
    sha256: str = ''


@dataclass(frozen=True, eq=False)
class Metadata:
    """What the metadata of one departure says.

    Attributes
    ----------
    id
        Unique to the departure.
    number
        Its number in its run of the node, from 1.
    service
        ``new_route`` or ``get_plan``.
    frame
        The map's frame.
    planner_version, versions
        Of the planner, and of what it was computed with.
    inputs
        The topics of map, start, goal and path, and of the stops if there are any.
    parameters
        All parameters of the node.
    trip
        From where to where was planned.
    ends
        Where the path begins and ends [m]: at the trip's ends, or somewhat beside them.
    route
        Node indices, at least 2.
    route_entropy_source
        The route is drawn from ``numpy.random.default_rng`` of this.
    sha256
        The stated hashes, by name.
    link
        Its place in the chain.
    texts
        All entries as they stand in the file.
    """

    id: str
    number: int
    service: str
    frame: str
    planner_version: str
    versions: Mapping[str, Any]
    inputs: Mapping[str, str]
    parameters: Mapping[str, Any]
    trip: RecordedTrip
    ends: tuple[Position, Position]
    route: list[int] = field(repr=False)
    route_entropy_source: list[int] = field(repr=False)
    sha256: Mapping[str, str] = field(repr=False)
    link: Link
    texts: Mapping[str, str] = field(repr=False)

    @property
    def roles(self) -> tuple[str, ...]:
        """The roles that messages have in it."""
        return _roles(self.trip)


def metadata_texts(
    *,
    inputs: Mapping[str, str],
    contents: Mapping[str, bytes],
    json_entries: Mapping[str, Any],
    texts: Mapping[str, str],
) -> dict[str, str]:
    """Return all entries but ``chain``, which the recorder adds.

    Parameters
    ----------
    inputs
        The topics of map, start, goal and path, and of the stops if there are any.
    contents
        The serialised messages by role, the strategy's file and the map's changes, b'' for none.
    json_entries
        ``parameters``, ``route_entropy_source``, ``route``, ``trip``, ``ends`` and ``versions``.
    texts
        The other entries.
    """
    encoded = {name: json.dumps(value) for name, value in json_entries.items()}
    hashed = {**contents, **{name: encoded[name].encode() for name in _HASHED}}
    hashes = {name: hashlib.sha256(data).hexdigest() for name, data in hashed.items()}
    return {
        'format': FORMAT, **texts, **encoded,
        'inputs': json.dumps(dict(inputs)), 'sha256': json.dumps(hashes),
    }


def chain_text(link: Link) -> str:
    """Return the entry ``chain``."""
    return json.dumps(vars(link))


def parse_metadata(texts: Mapping[str, str]) -> Metadata:
    """Read all entries.

    Raises
    ------
    BadMetadata
        One is missing, not known or malformed.
    """
    if texts.get('format') != FORMAT:
        raise BadMetadata(
            f"its metadata states the format {texts.get('format', '')[:20]!r}, this planner reads "
            f'{FORMAT!r}'
        )
    if unknown := sorted(set(texts) - KEYS):
        raise BadMetadata(f'metadata: an entry {unknown[0][:60]!r} is not known')
    if missing := sorted(KEYS - set(texts)):
        raise BadMetadata(f'the metadata has no entry {missing[0]!r}')
    trip = _trip(texts)
    roles = _roles(trip)
    return Metadata(
        id=_name(texts, 'departure_id'),
        number=_whole(texts, 'departure'),
        service=_name(texts, 'service'),
        frame=_name(texts, 'frame'),
        planner_version=_name(texts, 'planner_version'),
        versions=_scalars(texts, 'versions'),
        inputs=_names(texts, 'inputs', roles),
        parameters=_scalars(texts, 'parameters'),
        trip=trip,
        ends=_ends(texts),
        route=_wholes(texts, 'route', 2, 63),
        route_entropy_source=_wholes(texts, 'route_entropy_source', 1, 4096),
        sha256=_names(texts, 'sha256', (*roles, *_HASHED, *_FILES)),
        link=Link(**_names(texts, 'chain', ('file', 'follows', 'sha256'))),
        texts=dict(texts),
    )


def broken_hashes(metadata: Metadata, contents: Mapping[str, bytes]) -> list[str]:
    """Return the names of the stated hashes that do not hold; ``contents`` as for the writer."""
    hashed = {**contents, **{name: metadata.texts[name].encode() for name in _HASHED}}
    return [
        name for name, data in hashed.items()
        if metadata.sha256[name] != hashlib.sha256(data).hexdigest()
    ]


def _json(texts: Mapping[str, str], key: str) -> Any:
    text = texts[key]
    if len(text) > _LONGEST_ENTRY:
        raise BadMetadata(f'the recorded {key} has {len(text)} characters')
    try:
        return json.loads(text, object_pairs_hook=_mapping_of)
    except BadMetadata as error:
        raise BadMetadata(f'the recorded {key} has {error}') from None
    except (ValueError, RecursionError) as error:
        # Its own words are left out (and not chained): they may hold a route.
        raise BadMetadata(f'the recorded {key} is not JSON ({type(error).__name__})') from None


def _mapping_of(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Readers differ in which value they take of a key that comes twice."""
    mapping = dict(pairs)
    if len(mapping) < len(pairs):
        raise BadMetadata('a key that comes twice')
    return mapping


def _mapping(texts: Mapping[str, str], key: str) -> dict[str, Any]:
    content = _json(texts, key)
    if not isinstance(content, dict) or len(content) > _MOST_VALUES:
        raise BadMetadata(f'the recorded {key} is not a mapping of names')
    return content


def _scalars(texts: Mapping[str, str], key: str) -> dict[str, Any]:
    """A mapping of names to single texts and numbers, none over-long."""
    content = _mapping(texts, key)
    for name, value in content.items():
        if len(name) > _LONGEST_NAME or not _is_scalar(value):
            raise BadMetadata(f'the recorded {key}: {name[:60]!r} is not one text or number')
    return content


def _is_scalar(value: Any) -> bool:
    if isinstance(value, str):
        return len(value) <= _LONGEST_VALUE
    return isinstance(value, float) or isinstance(value, int) and abs(value) < 2**63


def _names(texts: Mapping[str, str], key: str, expected: Iterable[str]) -> dict[str, str]:
    content = _mapping(texts, key)
    good = all(isinstance(each, str) and len(each) <= _LONGEST_VALUE for each in content.values())
    if not good or set(content) != set(expected):
        raise BadMetadata(f'the recorded {key} does not name just {", ".join(expected)}')
    return content


def _name(texts: Mapping[str, str], key: str) -> str:
    if len(texts[key]) > _LONGEST_NAME:
        raise BadMetadata(f'the recorded {key} is longer than {_LONGEST_NAME}')
    return texts[key]


def _whole(texts: Mapping[str, str], key: str) -> int:
    text = texts[key]
    if not (text.isascii() and text.isdecimal() and len(text) < 19):
        raise BadMetadata(f'the recorded {key} is not a whole number')
    return int(text)


def _wholes(texts: Mapping[str, str], key: str, least: int, bits: int) -> list[int]:
    values = _json(texts, key)
    good = isinstance(values, list) and len(values) >= least and all(
        type(value) is int and value >= 0 and value.bit_length() <= bits for value in values
    )
    if not good:
        raise BadMetadata(f'the recorded {key} is not a list of whole numbers')
    return values


def _roles(trip: RecordedTrip) -> tuple[str, ...]:
    return (*ROLES, VIA) if trip.stops else ROLES


def _trip(texts: Mapping[str, str]) -> RecordedTrip:
    trip = _mapping(texts, 'trip')
    stops = trip.pop('stops', [])
    if set(trip) != {'start', 'goal', 'tolerance'}:
        raise BadMetadata('the recorded trip is not two places in metres')
    if not isinstance(stops, list):
        raise BadMetadata('the stops of the recorded trip are not a list of places')
    start, goal, *by = _places('trip', [trip['start'], trip['goal'], *stops])
    tolerance = trip['tolerance']
    if type(tolerance) not in (int, float) or not abs(tolerance) < math.inf:
        raise BadMetadata('the recorded trip has no tolerance in metres')
    return RecordedTrip(start, goal, float(tolerance), tuple(by))


def _ends(texts: Mapping[str, str]) -> tuple[Position, Position]:
    ends = _places('ends', _json(texts, 'ends'))
    if len(ends) != 2:
        raise BadMetadata('the recorded ends is not two places in metres')
    return ends[0], ends[1]


def _places(key: str, places: Any) -> list[Position]:
    try:
        read = [(float(x), float(y)) for x, y in places]
    except (TypeError, ValueError, OverflowError):
        read = [(math.nan, math.nan)]
    if not all(math.isfinite(number) for place in read for number in place):
        raise BadMetadata(f'the recorded {key} is not two places in metres')
    return read
