# SPDX-License-Identifier: Apache-2.0
"""Road data that are known: the columns that say what is a road for vehicles, and their values.

Values are in small letters; the names of columns count as ``tables.plain`` reads them.
"""

from __future__ import annotations

import re

# Kinds of OpenStreetMap that vehicles drive on.
_CLASSES = ('motorway', 'trunk', 'primary', 'secondary', 'tertiary')
_SMALL = ('unclassified', 'residential', 'living_street', 'service', 'track')
_HIGHWAYS = frozenset((*_CLASSES, *(f'{each}_link' for each in _CLASSES), *_SMALL, 'road'))
# The columns of each kind of data, with the values of each that roads have.
OPENSTREETMAP = {'highway': _HIGHWAYS}
GEOFABRIK = {'fclass': _HIGHWAYS | {f'track_grade{k}' for k in range(1, 6)}}
# Primary, secondary, local, four-wheel drive; ramp, service drive, alley, car park.
TIGER = {'mtfcc': frozenset('s1100 s1200 s1400 s1500 s1630 s1640 s1730 s1780'.split())}
NATURAL_EARTH = {'featurecla': frozenset({'road'}), 'type': frozenset({
    'major highway', 'secondary highway', 'beltway', 'bypass', 'road', 'track', 'unknown'})}
SCHEMAS = (OPENSTREETMAP, GEOFABRIK, TIGER, NATURAL_EARTH)

# Ways of OpenStreetMap that are no roads unless they have a kind of road, too.
OTHER_WAYS = ('waterway', 'railway', 'power', 'aerialway', 'aeroway', 'barrier', 'man_made',
              'boundary', 'route')
UNFINISHED = ('construction', 'proposed', 'planned', 'abandoned', 'disused', 'razed')
UNUSABLE = {'area': 'yes', 'impassable': 'yes', 'status': 'impassable', 'smoothness': 'impassable',
            'ice_road': 'yes', 'winter_road': 'yes'}
# Of these and of directions, the most particular one that is given counts.
ACCESS = ('motorcar', 'motor_vehicle', 'vehicle', 'access')
DENIED = frozenset({'no', 'private', 'agricultural', 'forestry', 'emergency', 'psv', 'bus', 'taxi',
                    'military', 'official', 'permit', 'foot', 'bicycle'})
DIRECTIONS = ('oneway:motorcar', 'oneway:motor_vehicle', 'oneway:vehicle', 'oneway')
# Values of ``oneway`` in OpenStreetMap, osmnx, Geofabrik's extracts (F, T, B) and others (FT, TF).
ONE_WAY = {'yes': 1, 'true': 1, '1': 1, 'f': 1, 'ft': 1, '-1': -1, 'reverse': -1, 't': -1,
           'tf': -1, 'no': 0, 'false': 0, '0': 0, 'b': 0}
# The column of Overture with rules of access for some vehicles, which are not read.
RULES = 'access_restrictions'
# Units of speed [m/s], by the attribute's name or at the end of a value.
SPEEDS = {'speed_kph': 1 / 3.6, 'speed_kmh': 1 / 3.6, 'speed_mph': 0.44704, 'speed_mps': 1.0}
UNITS = {'km/h': 1 / 3.6, 'kmh': 1 / 3.6, 'kph': 1 / 3.6, 'mph': 0.44704, 'm/s': 1.0}
LEVELS = ('bridge', 'tunnel', 'layer')
NAMES = ('ref', 'name')
# Limits of OpenStreetMap that are counted, and not read.
LIMITS = (*(f'{key}:conditional' for key in (*ACCESS, 'oneway')), 'maxweight', 'maxheight',
          'maxwidth', 'ford')
KEYS = tuple(dict.fromkeys((
    *(key for each in SCHEMAS for key in each), *OTHER_WAYS, *UNFINISHED, *UNUSABLE, *ACCESS,
    *DIRECTIONS, RULES, *SPEEDS, *LEVELS, *LIMITS, 'junction')))

# Plain names, and values, of columns that may say a direction or a speed.
DIRECTION_NAMES = re.compile(
    r'(?<!pre)(?<!suf)(?<!post)(?<!fe)dir(?!t)|sens(?!i|ors?$)|richt|rikt|retn|(one|two|both)ways?|'
    r'einbahn|ensret|enkelr|sentid|doble|kierun|jednok|smer|suunt|travel(?!time)|flow|revers|'
    r'heading|forward|backward|circul|accessres|arah|^(tek|cift)?yon|напр|односторон|اتجاه|طرفه|方向|单行|方通|방|'
    r'ir[aá]ny|suund|virzien|krypt|smjer|chieu|chiều|sentit|maounica|enve[ig]|einstefn|rigting|κατε[υύ]θ|μον[οό]δρ|כיוון')
DIRECTION_VALUES = re.compile(
    r'.*(one.?way|two.?way|(bi|uni)-?direc|forward|backward|digiti[sz]|einbahn|double sens|'
    r'opposite|sens (direct|inverse|unique)|senso unico|sentido|both direc|heading).*|ft|tf')
# Codes that say directions if a column has those on the left, and no others than on the right.
DIRECTION_CODES = (('bf', 'bftn'), ('bt', 'bfthn'), ('+-', '+-='))
SPEED_NAMES = re.compile(r'maxsp\w*|speed\w*|spd\w*')
# Plain names of columns that may say which roads are on bridges, in tunnels or on other levels.
LEVEL_NAMES = re.compile(
    r'.*(br(i|u)nnel|bridge|tunnel|br[uü]e?c?ke|kunstbau|viadu[ck]t|puente|ponte?s?$|structur|possol|gradesep|'
    r'(?<!fr)(?<!sea)level|niv(eau|el|å)|hoejde|relative|zlev|elev|medium).*')
# Plain names of columns that may say a kind, and of those that say nothing.
KIND_NAMES = re.compile('class|klass|type|typ$|kind|categ|nature|func|feat|layer|road|surface')
NUMBER_NAMES = ('id', 'fid', 'gid', 'objectid', 'ogcfid', 'length', 'shapelength', 'shapeleng')
