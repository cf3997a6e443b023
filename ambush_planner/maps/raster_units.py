# SPDX-License-Identifier: Apache-2.0
"""Units of rasters: heights must be in metres, and grow upwards, wherever a file says otherwise."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

from .elevation import InvalidTerrain

_METRE = re.compile(r'(?i)m|met(re|er)s?')
# Tags that name a unit of heights, the line of a .prj file in the old form of ESRI that does, and
# units in a description, such as "Elevation (US ft)" but not "DEM 10 m".
_UNIT_TAG = re.compile(r'(band|data|value|(z|alt|elev|height|vert)[a-z]*)?[_ ]?unit(s|_?type)?')
_Z_UNITS = re.compile(r'(?im)^\s*zunits\s+(?!no\b)(\w+)')
_DESCRIBED = re.compile(r'(?i)(?<![a-z0-9])(?<!\d )((us )?(survey )?(ft|feet|foot)|m|met(re|er)s?|'
                        r'[cdk]m|yards?|fathoms?)(?![a-z0-9])')
DEPTH = re.compile(r'(?i)depth|bathymetr|sounding')


def check_axes(path: Path, tags: dict[str, str], system: Any) -> None:
    """Raise InvalidTerrain if the unit of a NetCDF file's coordinates is not its system's."""
    factor = system.axis_info[0].unit_conversion_factor if system else 1.0
    for name, unit in ((key[:-6], each) for key, each in tags.items() if key.endswith('#units')):
        if system is None and 'degree' in unit:
            raise InvalidTerrain(f'{path}: its cells are in degrees, but its coordinate system is '
                                 'unknown; add --crs EPSG:4326, if it is that')
        if tags.get(f'{name}#standard_name', '').startswith('projection_') and math.isclose(
                factor, 1.0) != bool(_METRE.fullmatch(unit.strip())):
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
    described = _DESCRIBED.search((dataset.descriptions[0] or '').replace('_', ' '))
    return str(found or (described[0] if described else '')).strip()


def tags_of(dataset: Any) -> dict[str, str]:
    """The tags of the file and its band, and those of ENVI's header, in small letters."""
    tags = dataset.tags(ns='ENVI') | dataset.tags() | dataset.tags(1)
    return {key.lower(): value for key, value in tags.items()}


def vertical_axis(dataset: Any) -> Any:
    """The third axis of the coordinate system (pyproj), or None."""
    from pyproj import CRS

    axes = CRS.from_wkt(dataset.crs.to_wkt()).axis_info if dataset.crs else ()
    return axes[2] if len(axes) > 2 else None


def check_heights(path: Path, dataset: Any) -> None:
    """Raise InvalidTerrain if a file says that its values are no heights in metres, or may not be.

    By vertical system, unit, tag ``positive`` or name.
    """
    unit, axis, tags = unit_of(dataset), vertical_axis(dataset), tags_of(dataset)
    units = [*filter(None, (unit, axis and axis.unit_name))]
    if other := next((each for each in units if not _METRE.fullmatch(each)), ''):
        raise InvalidTerrain(
            f'{path}: its heights are in {other!r}: convert them to metres with gdal_calc.py '
            "(feet: --calc='A*0.3048'), and name the unit with gdal_edit.py -units m")
    if not units and dataset.crs and dataset.crs.is_projected and (
            factor := dataset.crs.linear_units_factor[1]) != 1.0:
        raise InvalidTerrain(f'{path}: are its heights in metres, or in the unit of its coordinate '
                             f'system, {factor:.4g} m? If in metres, say so with gdal_edit.py '
                             '-units m; else convert them with gdal_calc.py')
    names = (tags.get('standard_name'), tags.get('long_name'), dataset.descriptions[0],
             tags.get('netcdf_varname'))
    up = tags.get('positive', axis.direction if axis else '').lower()
    if up == 'down' or (up != 'up' and any(DEPTH.search(each or '') for each in names)):
        raise InvalidTerrain(
            f"{path}: are its values depths? Turn them into heights with gdal_calc.py --calc='-A'; "
            'if they are heights, say so with gdal_edit.py -mo positive=up')
