# SPDX-License-Identifier: Apache-2.0
"""Which lines of a file are roads for vehicles, in which direction and how fast, by their tags.

The tags are OpenStreetMap's, read as OSRM and osmnx do, also as Geofabrik's shapefiles (``fclass``)
and GDAL's reader of OpenStreetMap files (``other_tags``) have them. Names count without regard to
case, ``_`` and ``-``. Without a kind of road anywhere, every line is a road.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import warn
from .vector_file import InvalidFeatures

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from pandas import DataFrame

_KINDS = ('highway', 'fclass')
DRIVABLE = frozenset((
    *(kind + link for kind in ('motorway', 'trunk', 'primary', 'secondary', 'tertiary')
      for link in ('', '_link')), *(f'track_grade{k}' for k in range(1, 6)),
    'unclassified', 'residential', 'living_street', 'service', 'road', 'track'))
ROUNDABOUT = 'roundabout'
# Ways that are no roads unless they have a kind of road, too; the last are words of other data.
_OTHER_WAYS = ('waterway', 'railway', 'power', 'aerialway', 'aeroway', 'barrier', 'man_made',
               'boundary', 'route')
_UNFINISHED = ('construction', 'proposed', 'planned', 'abandoned', 'disused', 'razed')
_UNUSABLE = {'area': 'yes', 'impassable': 'yes', 'status': 'impassable', 'smoothness': 'impassable'}
# Of these and of directions, the most particular one that is given counts.
_ACCESS = ('motorcar', 'motor_vehicle', 'vehicle', 'access')
_DENIED = ('no', 'private', 'agricultural', 'forestry', 'emergency', 'psv', 'bus')
_DIRECTION = ('oneway:motorcar', 'oneway:motor_vehicle', 'oneway:vehicle', 'oneway')
# Values of ``oneway`` in OpenStreetMap, osmnx, Geofabrik's extracts (F, T, B) and others (FT, TF).
ONE_WAY = {'yes': 1, 'true': 1, '1': 1, 'f': 1, 'ft': 1, '-1': -1, 'reverse': -1, 't': -1,
           'tf': -1, 'no': 0, 'false': 0, '0': 0, 'b': 0}
_NOT = ('', 'no', 'false', 'f', '0', 'minor', 'widening')
# Units of speed [m/s], by the attribute's name or at the end of a value.
_SPEEDS = {'speed_kph': 1 / 3.6, 'speed_kmh': 1 / 3.6, 'speed_mph': 0.44704, 'speed_mps': 1.0}
_UNITS = {'km/h': 1 / 3.6, 'kmh': 1 / 3.6, 'kph': 1 / 3.6, 'mph': 0.44704, 'm/s': 1.0}
_KEYS = {re.sub('[_ -]', '', key): key for key in (
    *_KINDS, *_OTHER_WAYS, *_UNFINISHED, *_UNUSABLE, *_ACCESS, *_DIRECTION, *_SPEEDS, 'junction',
    'bridge', 'tunnel', 'layer')}
# Names of attributes that may mean direction or speed.
_SIMILAR = re.compile(r'dir|direction|dir_?trav\w*|trav\w*_?dir\w*|sens|einbahn\w*|one_?way\w+|'
                      r'max_?sp\w*|speed\w*|spd\w*')


class Road(NamedTuple):
    """What the tags of a line say.

    ``problem``: why it is no road for vehicles; ``way``: 1 along the line only, -1 against it, 0
    both; ``level``: roads meet only on the same one; ``speed`` [m/s], NaN if it has none.
    """

    problem: str
    way: int = 0
    level: int = 0
    speed: float = math.nan


def roads_among(path: str, lines: GeoDataFrame) -> tuple[GeoDataFrame, list[Road]]:
    """Return the lines that are roads for vehicles, and what their tags say.

    Warns how many lines are left out and why; raises InvalidFeatures if all are, or if a speed is
    no number. Both name ``path``.
    """
    tags = _tags(path, lines)
    with_kinds = bool((tags[_KINDS[0]] + tags[_KINDS[1]] != '').any())
    # Thousands of lines share a few combinations.
    judged = [_judged(path, each, with_kinds) for each in tags.drop_duplicates().to_dict('records')]
    roads = [judged[k] for k in tags.groupby(list(tags), sort=False).ngroup()]
    if reasons := Counter(road.problem for road in roads if road.problem):
        why = ', '.join(f'{what} {count}' for what, count in reasons.most_common(8))
        text = (f'{path}: {sum(reasons.values())} of {len(roads)} lines are no roads for vehicles: '
                f'{why}{", ..." if len(reasons) > 8 else ""}')
        if 'oneway' in why:
            text += f'; known values of oneway are {", ".join(ONE_WAY)}'
        if sum(reasons.values()) == len(roads):
            raise InvalidFeatures(text)
        warn(f'{text}; they are left out')
    keep = np.array([not road.problem for road in roads])
    return lines[keep], [road for road in roads if not road.problem]


def road_names(lines: GeoDataFrame) -> list[str]:
    """Reference and name of each line, such as ``B 55 Main Street``, or ``ROUNDABOUT``."""
    ref, name, junction = (_texts(lines, key) for key in ('ref', 'name', 'junction'))
    return [ROUNDABOUT if kind in ('roundabout', 'circular') else ' '.join(filter(None, texts))
            for kind, *texts in zip(junction, ref, name, strict=True)]


def _texts(lines: GeoDataFrame, key: str) -> list[str]:
    """The texts of an attribute, '' if missing; osmnx has lists where it has merged ways."""
    columns = {str(each).lower(): each for each in lines.columns}
    if key in columns:
        values = [' / '.join(each) if isinstance(each, list) else each
                  for each in lines[columns[key]]]
    else:
        values = [(re.search(f'"{key}"=>"([^"]*)"', str(each)) or ('', ''))[1]
                  for each in lines.get('other_tags', [''] * len(lines))]
    return ['' if each is None or each != each else ' '.join(str(each).split())
            for each in values]


def _tags(path: str, lines: GeoDataFrame) -> DataFrame:
    """The known attributes of lines as lower-case texts, '' if missing."""
    from pandas import DataFrame, Series

    columns: dict[str, Any] = {}
    for name in lines.columns.drop(lines.geometry.name):
        key = _KEYS.get(re.sub('[_ -]', '', str(name).lower()))
        if key and key not in columns:
            columns[key] = lines[name]
            if key in (*_DIRECTION, *_SPEEDS) and str(name).lower() != key:
                warn(f'{path}: its attribute {name!r} is read as {key}')
        elif _SIMILAR.fullmatch(str(name).lower()):
            warn(f'{path}: its attribute {name!r} is not read; directions must be in oneway, '
                 'speeds in speed_kph')
    more = lines['other_tags'].fillna('').astype(str) if 'other_tags' in lines else Series(
        '', lines.index)
    texts = {key: columns[key] if key in columns else
             more.str.extract(f'"{key}"=>"([^"]*)"', expand=False) for key in _KEYS.values()}
    tags = DataFrame(texts).fillna('').astype(str).map(
        lambda text: text.strip().lower().removesuffix('.0'))
    return tags.replace(['none', 'nan', '<na>', 'nat'], '')


def _judged(path: str, tags: Mapping[str, str], with_kinds: bool) -> Road:
    """What the tags of a line say, in a file that has kinds of roads or has none."""
    kind = tags['highway'] or tags['fclass']
    for key in _OTHER_WAYS if with_kinds else _OTHER_WAYS[:5]:
        if not kind and tags[key] not in _NOT:
            return Road(f'{key}={tags[key]}')
    # osmnx has lists where it has merged ways.
    if with_kinds and DRIVABLE.isdisjoint(re.findall('[a-z_0-9]+', kind)):
        return Road(kind or 'without highway')
    for key in _UNFINISHED if with_kinds else ():
        if tags[key] not in _NOT:
            return Road(key)
    if (access := next((tags[key] for key in _ACCESS if tags[key]), '')) in _DENIED:
        return Road(f'access={access}')
    for key, value in _UNUSABLE.items():
        if tags[key] == value:
            return Road(f'{key}={value}')
    given = next((tags[key] for key in _DIRECTION if tags[key]), '')
    if given and given not in ONE_WAY:
        return Road(f'oneway={given}')
    implied = (kind in ('motorway', 'motorway_link')
               or tags['junction'] in ('roundabout', 'circular'))
    layer = re.fullmatch(r'-?\d+', tags['layer'])
    level = int(layer[0]) if layer else 0
    level = level or (tags['bridge'] not in _NOT) - (tags['tunnel'] not in _NOT)
    return Road('', ONE_WAY[given] if given else int(implied), level, _speed(path, tags))


def _speed(path: str, tags: Mapping[str, str]) -> float:
    for key, factor in _SPEEDS.items():
        if tags[key]:
            found = re.fullmatch(r'([\d.]+(?:e[-+]?\d+)?)\s*(\D*)', tags[key])
            if not found or found[2] not in ('', *_UNITS):
                raise InvalidFeatures(f'{path}: {key} must be numbers, got {tags[key]!r}')
            return float(found[1]) * _UNITS.get(found[2], factor)
    return math.nan
