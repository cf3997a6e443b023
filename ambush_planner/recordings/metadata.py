"""The metadata record ``ambush_planner`` of a recording: its keys, written and read.

Entries are single texts or JSON (with ``Infinity``, as Python writes it). ``sha256`` states the
hashes of messages, strategy and other entries; ``chain`` says which file this one is, and which
one it follows.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

# What the entries mean; another number where that changes.
FORMAT = '5'
ROLES = ('map', 'start', 'goal', 'path')
# Only in recordings of trips with stops.
VIA = 'via'
# Of a random source, which has 256 from the operating system: fewer come once in 2^64 draws.
LEAST_BITS = 192
_HASHED = ('parameters', 'route_entropy_source', 'route', 'trip', 'ends')
_FILES = ('strategy', 'map_changes')
_NAMES = ('departure_id', 'service', 'frame', 'planner_version')
# More than any node writes; reports and messages repeat what is below these.
_LONGEST_NAME, _LONGEST_VALUE, _LONGEST_ENTRY, _MOST_VALUES = 255, 4096, 2**22, 1000

Position = tuple[float, float]


class BadMetadata(ValueError):
    """The entries are not those of a departure; the text says why."""


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
class RecordedCall:
    """A request and its answer: the service, its type, the times [ns], and the messages' fields.

    A path that was answered is left out: it is the one that is recorded.
    """

    service: str
    type: str
    request_ns: int
    response_ns: int
    request: Mapping[str, Any]
    response: Mapping[str, Any] = field(repr=False)


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
    call
        What was asked for and answered.
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
    call: RecordedCall
    route: list[int] = field(repr=False)
    route_entropy_source: list[int] = field(repr=False)
    sha256: Mapping[str, str] = field(repr=False)
    link: Link
    texts: Mapping[str, str] = field(repr=False)


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
        ``parameters``, ``route_entropy_source``, ``route``, ``trip``, ``ends``, ``versions`` and
        ``call``, the fields of a ``RecordedCall``.
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
    for key in _NAMES:
        if len(texts[key]) > _LONGEST_NAME:
            raise BadMetadata(f'the recorded {key} is longer than {_LONGEST_NAME}')
    read = {key: _read(texts, key) for key in _JSON}
    trip, ends = read['trip'], read['ends']
    if set(read['sha256']) != {*read['inputs'], *_HASHED, *_FILES}:
        raise BadMetadata('the recorded sha256 is not that of the recorded inputs')
    if (VIA in read['inputs']) != bool(trip['stops']):
        raise BadMetadata('the recorded trip has stops without their message, or the other way')
    return Metadata(
        **{key: texts[key] for key in _NAMES if key != 'departure_id'},
        **{key: read[key] for key in
           ('versions', 'inputs', 'parameters', 'route', 'route_entropy_source', 'sha256')},
        id=texts['departure_id'],
        number=read['departure'],
        trip=RecordedTrip(
            _position(trip['start']), _position(trip['goal']), float(trip['tolerance']),
            tuple(map(_position, trip['stops'])),
        ),
        ends=(_position(ends[0]), _position(ends[1])),
        call=RecordedCall(**read['call']),
        link=Link(**read['chain']),
        texts=dict(texts),
    )


def broken_hashes(metadata: Metadata, contents: Mapping[str, bytes]) -> list[str]:
    """Return the names of the stated hashes that do not hold; ``contents`` as for the writer."""
    hashed = {**contents, **{name: metadata.texts[name].encode() for name in _HASHED}}
    return [
        name for name, data in hashed.items()
        if metadata.sha256[name] != hashlib.sha256(data).hexdigest()
    ]


def _read(texts: Mapping[str, str], key: str) -> Any:
    """What an entry of JSON says; it has to be written as the recorder writes it.

    So nothing hides in it: no key twice, of which readers take this or that value.
    """
    text, (what, is_good) = texts[key], _JSON[key]
    if len(text) > _LONGEST_ENTRY:
        raise BadMetadata(f'the recorded {key} has {len(text)} characters')
    try:
        content = json.loads(text)
        good, plain = is_good(content), json.dumps(content) == text
    except (ValueError, ArithmeticError, RecursionError) as error:
        # Its own words are left out (and not chained): they may hold a route.
        raise BadMetadata(f'the recorded {key} is not JSON ({type(error).__name__})') from None
    if not good:
        raise BadMetadata(f'the recorded {key} is not {what}')
    if not plain:
        raise BadMetadata(f'the recorded {key} is not written as the recorder does it')
    return content


def _position(numbers: list[float]) -> Position:
    return float(numbers[0]), float(numbers[1])


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(float(value))


def _is_place(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(map(_is_number, value))


def _is_trip(value: Any) -> bool:
    return isinstance(value, dict) and set(value) == {'start', 'goal', 'stops', 'tolerance'} and (
        _is_place(value['start']) and _is_place(value['goal']) and _is_number(value['tolerance'])
        and isinstance(value['stops'], list) and all(map(_is_place, value['stops']))
    )


def _is_scalar(value: Any) -> bool:
    if isinstance(value, str):
        return len(value) <= _LONGEST_VALUE
    return isinstance(value, float) or isinstance(value, int) and abs(value) < 2**63


def _are_scalars(value: Any) -> bool:
    return isinstance(value, dict) and len(value) <= _MOST_VALUES and all(
        len(name) <= _LONGEST_NAME and _is_scalar(each) for name, each in value.items()
    )


def _texts_of(*names: str, also: tuple[str, ...] = ()) -> tuple[str, Callable[[Any], bool]]:
    """An entry that is a mapping of just these names to texts, and of others that may be there."""
    return f'a text for each of {", ".join(names)}', lambda value: (
        _are_scalars(value) and set(names) <= set(value) <= {*names, *also}
        and all(isinstance(each, str) for each in value.values())
    )


def _whole_numbers(least: int, bits: int) -> tuple[str, Callable[[Any], bool]]:
    """An entry that is a list of at least so many numbers of so many bits."""
    return 'a list of whole numbers', lambda value: (
        isinstance(value, list) and len(value) >= least and all(
            type(each) is int and each >= 0 and each.bit_length() <= bits for each in value
        )
    )


_CALL = {
    'service': str, 'type': str, 'request_ns': int, 'response_ns': int, 'request': dict,
    'response': dict,
}
# The entries that are JSON: what each is, and whether a value is that.
_SCALARS = 'a text or a number for each name', _are_scalars
_JSON: dict[str, tuple[str, Callable[[Any], bool]]] = {
    'departure': ('a whole number', lambda value: type(value) is int and 0 <= value < 2**63),
    'versions': _SCALARS,
    'parameters': _SCALARS,
    'inputs': _texts_of(*ROLES, also=(VIA,)),
    'sha256': _texts_of(*ROLES, *_HASHED, *_FILES, also=(VIA,)),
    'chain': _texts_of('file', 'follows', 'sha256'),
    'call': (f'just {", ".join(_CALL)}', lambda value: (
        isinstance(value, dict) and {name: type(each) for name, each in value.items()} == _CALL
    )),
    'trip': ('two places, stops and a tolerance in metres', _is_trip),
    'ends': ('two places in metres', lambda value: (
        isinstance(value, list) and len(value) == 2 and all(map(_is_place, value))
    )),
    'route': _whole_numbers(2, 63),
    'route_entropy_source': _whole_numbers(1, 4096),
}
KEYS = frozenset({'format', *_NAMES, *_JSON})
