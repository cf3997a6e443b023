# SPDX-License-Identifier: Apache-2.0
"""Units of rasters: of heights, wherever a file names them, and of coordinates; depths."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

from ..errors import warn
from .elevation import InvalidTerrain

# Units of heights, without spaces and other signs, in metres.
_METRES = {name: metres for names, metres in (
    ('m metre metres meter meters', 1.0), ('dm decimetre decimetres decimeter decimeters', 0.1),
    ('cm centimetre centimetres centimeter centimeters', 0.01), ('mm millimetre millimeter', 1e-3),
    ('km kilometre kilometres kilometer kilometers', 1e3), ('yd yard yards', 0.9144),
    ('ft foot feet internationalfoot internationalfeet', 0.3048), ('fathom fathoms', 1.8288),
    ('usft ftus footus ussurveyfoot ussurveyfeet usfoot usfeet surveyfoot', 1200.0 / 3937.0),
) for name in names.split()}
# Tags that name a unit of heights, and the line of a .prj file in the old form of ESRI that does.
_UNIT_TAG = re.compile(r'(band|data|value|(z|alt|elev|height|vert)[a-z]*)?[_ ]?unit(s|_?type)?')
_Z_UNITS = re.compile(r'(?im)^\s*zunits\s+(?!no\b)(\w+)')
DEPTH = re.compile(r'(?i)depth|bathymetr|sounding')


def check_axes(path: Path, tags: dict[str, str], system: Any) -> None:
    """Raise InvalidTerrain if the unit of a NetCDF file's coordinates is not its system's."""
    factor = system.axis_info[0].unit_conversion_factor if system else 1.0
    for name, unit in ((key[:-6], each) for key, each in tags.items() if key.endswith('#units')):
        if system is None and 'degree' in unit:
            raise InvalidTerrain(f'{path}: its cells are in degrees, but its coordinate system is '
                                 'unknown; add --crs EPSG:4326, if it is that')
        if tags.get(f'{name}#standard_name', '').startswith('projection_') and not math.isclose(
                metres_in(unit) or 0.0, factor, rel_tol=1e-4):
            raise InvalidTerrain(f'{path}: its coordinates are in {unit!r}, but the unit of its '
                                 f'coordinate system is {factor:.4g} m; correct one of them')


def unit_of(dataset: Any) -> str:
    """The unit of the values by the band, a tag, the old form of a .prj file, or the description.

    A tag names it as ``units``, or as those of heights, such as ``z_units``.
    """
    found = dataset.units[0] or next((value for key, value in tags_of(dataset).items()
                                      if _UNIT_TAG.fullmatch(key)), '')
    for file in map(Path, dataset.files):
        if file.suffix.lower() == '.prj' and (named := _Z_UNITS.search(file.read_text('latin-1'))):
            found = found or named[1]
    return str(found or _unit_among(dataset.descriptions[0] or '')).strip()


def _unit_among(text: str) -> str:
    """The first unit of length in a text, such as "Elevation (US ft)" but not "DEM 10 m"."""
    words = re.findall('[a-z]+|[0-9]+', text.lower())
    for begin in range(len(words)):
        for end in range(begin + 3, begin, -1):
            unit = ' '.join(words[begin: end])
            if metres_in(unit) and not (begin and words[begin - 1].isdigit()):
                return unit
    return ''


def tags_of(dataset: Any) -> dict[str, str]:
    """The tags of the file and its band, and those of ENVI's header, in small letters."""
    tags = dataset.tags(ns='ENVI') | dataset.tags() | dataset.tags(1)
    return {key.lower(): value for key, value in tags.items()}


def metres_in(unit: str) -> float | None:
    """Return the length of a unit [m], None if it is not known."""
    return _METRES.get(re.sub('[^a-z]', '', unit.lower()))


def vertical_axis(dataset: Any) -> Any:
    """The third axis of the coordinate system (pyproj), or None."""
    from pyproj import CRS

    axes = CRS.from_wkt(dataset.crs.to_wkt()).axis_info if dataset.crs else ()
    return axes[2] if len(axes) > 2 else None


def metres_per_unit(path: Path, dataset: Any) -> float:
    """Metres per unit of the heights, negative for depths; raises InvalidTerrain if unknown."""
    unit, axis = unit_of(dataset), vertical_axis(dataset)
    metres = metres_in(unit) if unit else axis.unit_conversion_factor if axis else 1.0
    if metres is None:
        raise InvalidTerrain(f'{path}: the unit of the heights, {unit!r}, is not known; convert '
                             'them to metres, or name it with gdal_edit.py -units')
    if axis and not math.isclose(axis.unit_conversion_factor, metres, rel_tol=1e-4):
        raise InvalidTerrain(f'{path}: its heights are in {unit!r} by the band, in '
                             f'{axis.unit_name!r} by the vertical system; correct one of them')
    if not (unit or axis) and dataset.crs and dataset.crs.is_projected and (
            factor := dataset.crs.linear_units_factor[1]) != 1.0:
        warn(f'{path}: heights are taken as metres, though {factor:.4g} m are the unit of its '
             'coordinate system; if they have it, too, say so with gdal_edit.py -units')
    sign = -1.0 if _is_depth(path, dataset, axis) else 1.0
    if (sign, metres) != (1.0, 1.0):
        kind = 'depths' if sign < 0.0 else 'heights'
        warn(f'{path}: {kind} in {unit or (axis.unit_name if axis else "metres")} are read as '
             'heights in metres')
    return sign * metres


def _is_depth(path: Path, dataset: Any, axis: Any) -> bool:
    """Return whether values grow downwards, by vertical system, tag ``positive`` or name.

    Raises InvalidTerrain if these differ, or if only a name that can mean both says so.
    """
    tags = tags_of(dataset)
    standard = tags.get('standard_name', '').lower()
    said = {axis.direction} if axis else set()
    if 'positive' in tags:
        said.add(tags['positive'].lower())
    if standard:
        said.add('down' if DEPTH.search(standard) else 'up')
    name = next((each for each in (tags.get('long_name'), dataset.descriptions[0],
                                   tags.get('netcdf_varname')) if DEPTH.search(each or '')), '')
    if len(said) > 1 or not said <= {'up', 'down'} or name and not said:
        what = ' and '.join(sorted(said)) or f'called {name!r}'
        raise InvalidTerrain(f'{path}: its values are {what}: do they grow upwards or downwards? '
                             'Say so with gdal_translate -mo positive=up, or positive=down')
    return said == {'down'}
