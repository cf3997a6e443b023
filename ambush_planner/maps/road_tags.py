# SPDX-License-Identifier: Apache-2.0
"""Roads for vehicles among the lines of a file, their directions and speeds, by their columns.

``road_schemas`` has the data that are known; tags of OpenStreetMap are read as OSRM and osmnx do.
Columns of other data are refused unless the caller says what they mean.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter, defaultdict
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import warn
from . import road_schemas as schemas
from .tables import InvalidFeatures, find_column, plain, prefixed_errors

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from pandas import DataFrame

ROUNDABOUT = 'roundabout'
_NOT = ('', 'no', 'false', 'f', '0', 'minor', 'widening')
_MISSING = ('none', 'nan', '<na>', 'nat')
_WHOLE = re.compile(r'[-+]?\d+')
# A pair of hstore, and a text of pairs; the longest text of a shapefile [bytes], less a character.
_PAIR = r'"((?:[^"\\]|\\.)*)"\s*=>\s*(?:"((?:[^"\\]|\\.)*)"|NULL)'
_HSTORE = re.compile(rf'{_PAIR}(\s*,\s*{_PAIR})*')
_CUT = 251
_NESTED = re.compile('(?=[{"]).*["\'](highway|' + '|'.join((*schemas.ACCESS, *schemas.DIRECTIONS))
                     + ')["\']\\s*(:|=>)', re.DOTALL)
_Schema = Mapping[str, frozenset[str]]


class Road(NamedTuple):
    """The meaning of a line's tags.

    ``problem``: why it is no road for vehicles; ``way``: 1 along the line only, -1 against it, 0
    both; ``level``: roads cross only on the same one; ``speed`` [m/s], NaN if it has none.
    """

    problem: str
    way: int = 0
    level: int = 0
    speed: float = math.nan


def select_roads(path: str, lines: GeoDataFrame, road_column: str = '',
                all_lines_are_roads: bool = False,
                two_way: bool = False) -> tuple[GeoDataFrame, list[Road], list[str]]:
    """Return the lines that are roads for vehicles, what their tags say, and their names.

    Columns of no known schema need ``road_column``, COLUMN=VALUE,... of roads, or
    ``all_lines_are_roads``; columns that may say directions and are not known need ``two_way``.

    Warns how many lines are left out and why; raises InvalidFeatures if all are, if a column is not
    known for certain, or if a speed is no number. Both name ``path``.
    """
    with prefixed_errors(path):
        texts = _texts(lines, path.lower().endswith('.shp'))
        columns = {key: name for key in schemas.KEYS if (name := _column(texts, key))}
        schema = _schema(texts, columns, road_column, all_lines_are_roads)
        if schemas.RULES in columns:
            raise InvalidFeatures('subtype, class and access_restrictions are columns of Overture, '
                                  'whose rules of access are not read; take the same roads from '
                                  'OpenStreetMap')
        others = texts.drop(columns=[*columns.values()])
        problems = [] if schema is not None else [
            f'{len(lines)} lines, and no column says which are roads: '
            f'{_kinds(texts)}; use --road-column COLUMN=VALUE,... or --all-lines-are-roads '
            '(road_column, all_lines_are_roads)']
        directed = two_way or not columns.keys().isdisjoint(schemas.DIRECTIONS)
        names = [name for name in others if _says_directions(others, name, schema)]
        if names and not directed:
            problems.append(
                f'a column that is not known may say directions: {_kinds(others[names])}; name it '
                'oneway, with yes, no and -1, or use --two-way (two_way)')
        if schema is None or problems:
            raise InvalidFeatures('; '.join(problems))
        if texts.empty and not all_lines_are_roads:
            warn(f'{path}: its lines have no attributes, so that all are read as roads')
        _warn_of_columns(path, others, columns, schema, directed)
        columns = {**columns, **{key: key for key in schema if key in texts}}
        tags = texts[[*dict.fromkeys(columns.values())]].apply(lambda each: each.str.lower())
        tags[''] = ''  # if there is no column
        # Thousands of lines share a few combinations.
        kinds = [_judge(defaultdict(str, {key: each[name] for key, name in columns.items()}),
                        schema) for each in tags.drop_duplicates().to_dict('records')]
        roads = [kinds[k] for k in tags.groupby([*tags], sort=False).ngroup()]
        _warn_of_others(path, roads)
        keep = np.array([not road.problem for road in roads])
        counts = {key: int(((texts[columns[key]] != '') & keep).sum())
                  for key in schemas.LIMITS if key in columns}
        if limits := [f'{key} {count}' for key, count in counts.items() if count]:
            warn(f'{path}: limits of its roads are not read: {", ".join(limits)}')
    return (lines[keep], [road for road in roads if not road.problem],
            [name for name, kept in zip(_names(texts), keep, strict=True) if kept])


def _texts(lines: GeoDataFrame, of_shapefile: bool) -> DataFrame:
    """The columns that say something as texts, '' if missing, and tags in one column as columns."""
    texts = lines.drop(columns=lines.geometry.name).map(_text).reset_index(drop=True)
    texts.columns = texts.columns.astype(str)
    texts = texts[[name for name in texts if plain(name) not in schemas.NUMBER_NAMES
                   and (texts[name] != '').any()]].copy()
    for name in [*texts]:
        words = texts[name].unique()
        if any(_NESTED.match(word) or plain(name).endswith('tags') and re.search('[=:[{]', word)
               for word in words):
            pairs = texts.pop(name).map({each: _pairs(name, each, of_shapefile) for each in words})
            for key in {*schemas.KEYS, *schemas.NAMES}.intersection(*[set().union(*pairs)]):
                found = pairs.map(lambda each, key=key: str(each.get(key) or ''))
                texts[key] = texts[key].where(texts[key] != '', found) if key in texts else found
    return texts


def _names(texts: DataFrame) -> list[str]:
    """Reference and name of each line, such as ``B 55 Main Street``, or ``ROUNDABOUT``."""
    columns = {name.lower(): texts[name] for name in texts}
    # osmnx has lists where it has merged ways.
    kind, *parts = ([' / '.join(_parts(each)) if each.startswith('["') else each
                     for each in columns.get(key, [''] * len(texts))]
                    for key in ('junction', *schemas.NAMES))
    return [ROUNDABOUT if kind in ('roundabout', 'circular') else ' '.join(' '.join(words).split())
            for kind, *words in zip(kind, *parts, strict=True)]


def _text(value: Any) -> str:
    if isinstance(value, list | dict | np.ndarray):
        return json.dumps(value, default=list)
    text = str(value).strip().removesuffix('.0')
    return '' if text.lower() in _MISSING else text


def _pairs(name: str, text: str, of_shapefile: bool) -> dict[str, Any]:
    """The tags in a text, of JSON or hstore."""
    try:
        found = json.loads(text) if text.startswith('{') else None
    except ValueError:
        found = None
    if _HSTORE.fullmatch(text) or not text:
        found = dict(re.findall(_PAIR, text))
    if found is None or of_shapefile and len(text.encode()) >= _CUT:
        raise InvalidFeatures(f'its column {name!r} is cut, or neither JSON nor hstore: '
                              f'{text[:60]!r}; export it as GeoPackage')
    return dict(found)


def _column(texts: DataFrame, key: str) -> Any:
    """The column of a key, which shapefiles cut to ten characters."""
    cut = (each for each in texts if len(each) == 10 and plain(key).startswith(plain(each)))
    return find_column(texts, key) or next(cut, None)


def _schema(texts: DataFrame, columns: Mapping[str, str], road_column: str,
            all_lines_are_roads: bool) -> _Schema | None:
    """The schema that the caller names, or that the columns have."""
    if road_column:
        name, _, values = road_column.partition('=')
        column = find_column(texts, name.strip())
        roads = frozenset(each.strip().lower() for each in values.split(','))
        if column is None or not roads <= {*texts[column].str.lower()}:
            raise InvalidFeatures(f'road_column must be COLUMN=VALUE,... of {_kinds(texts)}; got '
                                  f'{road_column!r}')
        return {column: roads}
    found = next((each for each in schemas.SCHEMAS if columns.keys() >= each.keys()), None)
    if found and all_lines_are_roads:
        raise InvalidFeatures(f'{", ".join(found)} says which lines are roads; leave out '
                              '--all-lines-are-roads (all_lines_are_roads)')
    return found or ({} if all_lines_are_roads or texts.empty else None)


def _kinds(texts: DataFrame) -> str:
    """Columns that may say kinds, with their most frequent values."""
    names = sorted(texts, key=lambda name: (not schemas.KIND_NAMES.search(plain(name)),
                                            texts[name].nunique()))
    return ', '.join(f'{name} has ' + ', '.join(
        f'{value[:40] or "nothing"} {count}' for value, count in
        Counter(texts[name]).most_common(4)) for name in names[:3])


def _says_directions(texts: DataFrame, name: str, schema: _Schema | None) -> bool:
    """Return whether a column may say directions, by its name or values (all in OpenStreetMap)."""
    words = {*texts[name].str.lower()} - {''}
    enough = all if schema is schemas.OPENSTREETMAP else any
    return ':' not in name and bool(
        schemas.DIRECTION_NAMES.search(plain(name))
        or enough(map(schemas.DIRECTION_VALUES.fullmatch, words))
        or any(words.issuperset(some) and words <= {*every}
               for some, every in schemas.DIRECTION_CODES))


def _warn_of_columns(path: str, others: DataFrame, columns: Mapping[str, str], schema: _Schema,
                     directed: bool) -> None:
    for key, name in columns.items():
        if len(plain(name)) < len(plain(key)) or (
                key in (*schemas.DIRECTIONS, *schemas.SPEEDS) and name.lower() != key):
            warn(f'{path}: its attribute {name!r} is read as {key}')
    for name in others:
        if schemas.SPEED_NAMES.fullmatch(plain(name)):
            warn(f'{path}: its attribute {name!r} is not read; speeds must be in speed_kph')
        if schemas.LEVEL_NAMES.fullmatch(plain(name)) and others[name].nunique() > 1 and (
                columns.keys().isdisjoint(schemas.LEVELS)):
            warn(f'{path}: its attribute {name!r} is not read; bridges, tunnels and levels must be '
                 'in bridge, tunnel and layer')
    if not directed and schema not in (schemas.OPENSTREETMAP, schemas.GEOFABRIK):
        warn(f'{path}: no column says directions, so that all roads are two-way')


def _warn_of_others(path: str, roads: list[Road]) -> None:
    """Warn how many lines are no roads, and why; raises InvalidFeatures if all are."""
    reasons = Counter(road.problem for road in roads if road.problem)
    if not reasons:
        return
    why = ', '.join(f'{what} {count}' for what, count in reasons.most_common(8))
    text = (f'{sum(reasons.values())} of {len(roads)} lines are no roads for vehicles: {why}'
            f'{", ..." if len(reasons) > 8 else ""}')
    if 'oneway' in why:
        text += f'; known values of oneway are {", ".join(schemas.ONE_WAY)}'
    if sum(reasons.values()) == len(roads):
        raise InvalidFeatures(text)
    warn(f'{path}: {text}; they are left out')


def _judge(tags: Mapping[str, str], schema: _Schema) -> Road:
    """Read the tags of a line."""
    if of_osm := 'highway' in schema:
        for key in schemas.OTHER_WAYS:
            if not tags['highway'] and tags[key] not in _NOT:
                return Road(f'{key}={tags[key]}')
    for key, roads in schema.items():
        if roads.isdisjoint(_parts(tags[key])):
            return Road(tags[key] or f'without {key}')
    for key in schemas.UNFINISHED:
        if of_osm and tags[key] not in _NOT:
            return Road(key)
    access = next((tags[key] for key in schemas.ACCESS if tags[key]), '')
    if access and schemas.DENIED.issuperset(_parts(access)):
        return Road(f'access={access}')
    for key, value in schemas.UNUSABLE.items():
        if tags[key] == value:
            return Road(f'{key}={value}')
    given = next((tags[key] for key in schemas.DIRECTIONS if tags[key]), '')
    if given and given not in schemas.ONE_WAY:
        return Road(f'oneway={given}')
    implied = (tags['highway'] in ('motorway', 'motorway_link')
               or tags['junction'] in ('roundabout', 'circular'))
    way = schemas.ONE_WAY[given] if given else int(implied)
    level = int(tags['layer']) if _WHOLE.fullmatch(tags['layer']) else 0
    level = level or (tags['bridge'] not in _NOT) - (tags['tunnel'] not in _NOT)
    return Road('', way, level, _speed(tags))


def _parts(text: str) -> list[str]:
    """The values of a list, such as those of osmnx where it has merged ways."""
    return [each.strip(' \'"') for each in re.split(r'[;|,]', text.strip('[]'))]


def _speed(tags: Mapping[str, str]) -> float:
    for key, factor in schemas.SPEEDS.items():
        if tags[key]:
            found = re.fullmatch(r'([\d.]+(?:e[-+]?\d+)?)\s*(\D*)', tags[key])
            if not found or found[2] not in ('', *schemas.UNITS):
                raise InvalidFeatures(f'{key} must be numbers, got {tags[key]!r}')
            return float(found[1]) * schemas.UNITS.get(found[2], factor)
    return math.nan
