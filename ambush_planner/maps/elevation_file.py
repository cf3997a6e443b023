# SPDX-License-Identifier: Apache-2.0
"""Rasters from files: heights, or values of a risk map. GeoTIFF and other GDAL formats.

What a file declares is applied or refused: scale, offset, unit, vertical system, nodata, masks,
colours, coordinate system. Heights that cannot be heights are unknown; a warning counts them.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InvalidCoordinates, InvalidRiskMap, import_extra, warn
from . import raster_units as units
from .coordinates import agree, horizontal, is_robot_frame, metric_system, resolve_system
from .elevation import MAX_CELLS, HeightArray, InvalidTerrain, Raster
from .file_kinds import refuse_other_kinds
from .risk_map import LOSSES

# GDAL's drivers of rasters that can be heights or risk.
_DRIVERS = ('GTiff', 'VRT', 'AAIGrid', 'SRTMHGT', 'DTED', 'USGSDEM', 'HFA', 'EHdr', 'ENVI', 'ERS',
            'GPKG', 'netCDF', 'XYZ', 'GSAG', 'GSBG', 'GS7BG', 'SAGA', 'JP2OpenJPEG')
_HEIGHTS_BY_NAME = re.compile(
    rf'(?i)elevation|height|altitude|\b(d[est]m|alti)\b|{units.DEPTH.pattern[4:]}')
# Range of heights on Earth outside the sea [m].
LOWEST, HIGHEST = -430.0, 9000.0
# Rows that are read at a time, so that a large file takes no more memory than its values.
_ROWS = 512
_CACHE = 64  # of GDAL [MB]


def read_raster(path: Path, is_risk: bool = False, crs: str | None = None) -> Raster:
    """Read heights, or the values of a risk map, from a GeoTIFF or another raster.

    Those of a risk map are whole numbers, -1..100, NaN if unknown. A file without a coordinate
    system gets ``crs``. Heights whose cells are not in metres on the ground (degrees, feet, Web
    Mercator) are reprojected to the UTM zone, and to ``crs`` if that is the frame of a robot, by
    bilinear interpolation.

    Raises InvalidTerrain if the file is malformed or too large, or if rasterio is not installed;
    InvalidRiskMap if heights are read as risk, or a risk map is not in metres; OSError if the file
    cannot be opened.
    """
    refuse_other_kinds(path, InvalidTerrain)
    rasterio = import_extra('rasterio', f'{path}: rasters', 'gis', InvalidTerrain)
    with warnings.catch_warnings(), rasterio.Env(GDAL_CACHEMAX=_CACHE):
        warnings.simplefilter('ignore', rasterio.errors.NotGeoreferencedWarning)  # refused
        try:
            dataset = rasterio.io.DatasetReader(path, driver=list(_DRIVERS))
        except rasterio.errors.RasterioError as error:
            other = ('; a risk map is a .yaml for map_server, an .npz, or such a raster' if is_risk
                     else '; a .yaml has layers, or is a map for map_server')
            raise InvalidTerrain(
                f'{path}: no raster that is read, such as GeoTIFF, .asc, .hgt and NetCDF; convert '
                'it with gdal_translate, shapes with gdal_rasterize' + other
            ) from error
        try:
            with dataset:
                return _of_dataset(path, dataset, is_risk, crs)
        except rasterio.errors.RasterioIOError as error:
            raise InvalidTerrain(f'{path}: it is damaged, or ends early') from error
        except (rasterio.errors.RasterioError, InvalidCoordinates) as error:
            raise InvalidTerrain(f'{path}: {str(error).rstrip(".")}') from error


def _of_dataset(path: Path, dataset: Any, is_risk: bool, crs: str | None) -> Raster:
    """The raster in an open rasterio dataset."""
    _check(path, dataset)
    frame = crs if is_robot_frame(crs) else None
    system = resolve_system(dataset.crs and dataset.crs.to_wkt(), None if frame else crs)
    units.check_axes(path, units.tags_of(dataset), system)
    values = _values(dataset)
    if is_risk:
        _refuse_heights(path, dataset, values)
    else:
        units.check_heights(path, dataset)
        _fill_holes(path, values)
    raster = _in_metres(path, values, dataset.transform, system, is_risk, frame)
    if crs and system and not any(agree(crs, each) for each in (system.to_wkt(), str(raster.crs))):
        raise InvalidTerrain(f'{path}: the file is in {system.name}, not in {crs}; leave out '
                             '--crs (crs), or correct the file')
    least, most = (float(dataset.tags().get(tag, loss))
                   for tag, loss in zip(('alpha_min', 'alpha_max'), LOSSES, strict=True))
    return replace(raster, losses=(least, most))


def _check(path: Path, dataset: Any) -> None:
    """Raise InvalidTerrain if an open rasterio dataset is not a raster of one kind of value."""
    from rasterio.enums import ColorInterp

    _check_size(path, dataset.height, dataset.width)
    if dataset.subdatasets:
        names = ', '.join(each.rpartition(':')[2] for each in dataset.subdatasets)
        raise InvalidTerrain(f'{path}: has several variables, {names}; choose one with '
                             f'gdal_translate {dataset.subdatasets[0]} FILE.tif')
    if missing := [each for each in dataset.files if not Path(each).exists()]:
        raise InvalidTerrain(f'{path}: names {missing[0]}, which is not here')
    has_alpha = dataset.count == 2 and dataset.colorinterp[1] == ColorInterp.alpha
    if dataset.count != 1 and not has_alpha:
        raise InvalidTerrain(f'{path}: has {dataset.count} bands, must have one; choose it with '
                             'gdal_translate -b')
    if dataset.colorinterp[0] == ColorInterp.palette:
        raise InvalidTerrain(f'{path}: its band has a table of colours: a picture, not values; if '
                             'its numbers are values, use gdal_translate -colorinterp gray')
    grid = dataset.transform
    if grid.is_identity:
        raise InvalidTerrain(f'{path}: has no georeference: neither a position nor a cell size; '
                             'give it one with gdal_translate -a_ullr and -a_srs')
    if grid.b or grid.d or grid.a <= 0.0 or grid.e >= 0.0:
        raise InvalidTerrain(f'{path}: rows must run from north to south and columns from west to '
                             'east; convert the raster with gdalwarp')


def _values(dataset: Any) -> HeightArray:
    """The values (H, W), the north first; NaN if masked or nodata."""
    from rasterio.windows import Window

    (scale, *_), (offset, *_) = dataset.scales, dataset.offsets
    values = np.empty(dataset.shape, np.float32)
    for row in range(0, len(values), _ROWS):
        part = values[row: row + _ROWS]
        stored = dataset.read(1, masked=True, window=Window(0, row, part.shape[1], len(part)))
        part[:] = stored.astype(np.float64).filled(np.nan) * scale + offset
    return values


def _check_size(path: Path, rows: int, columns: int) -> None:
    if rows * columns > MAX_CELLS:
        raise InvalidTerrain(f'{path}: {columns} x {rows} cells exceed the limit of {MAX_CELLS}; '
                             'crop the raster')


def _fill_holes(path: Path, heights: HeightArray) -> None:
    """Set heights [m] to NaN where they can be none."""
    odd = np.isinf(heights) | (heights < LOWEST) | (heights > HIGHEST)
    if odd.any():
        heights[odd] = np.nan
        warn(f'{path}: {odd.sum()} of {odd.size} heights are unknown: outside {LOWEST:g} to '
             f'{HIGHEST:g} m; declare the number for no data with gdal_edit.py -a_nodata')


def _refuse_heights(path: Path, dataset: Any, values: HeightArray) -> None:
    """Raise InvalidRiskMap if the values of a risk map are rather heights, or shares."""
    unit, about = units.unit_of(dataset), dataset.descriptions[0] or ''
    known = values[np.isfinite(values)]
    reason = ''
    if unit:
        reason = f'its unit is {unit!r}'
    elif units.vertical_axis(dataset):
        reason = 'its coordinate system has heights'
    elif _HEIGHTS_BY_NAME.search(about):
        reason = f'its band is called {about!r}'
    elif any((np.abs(part - np.rint(part)) > 1e-6).any() for part in np.array_split(known, _ROWS)):
        if known.min() >= 0.0 and known.max() <= 1.0:
            raise InvalidRiskMap(
                f'{path}: risks from 0 to 1? A risk map has whole numbers from 0 to 100: multiply '
                "by 100 and round, with gdal_calc.py --calc='rint(100*A)' --type=Byte")
        reason = 'its values are no whole numbers'
    if reason:
        raise InvalidRiskMap(f'{path}: {reason}; is it an elevation model? Make a risk map of it '
                             'with ambush risk (risk_from_terrain); that has whole numbers from 0 '
                             'to 100')
    if known.size and 0.0 < known.max() <= 1.0:
        warn(f'{path}: no value is over 1, of 100: if 1 stands for the most risk, multiply by 100')


def _in_metres(path: Path, values: HeightArray, grid: Any, own: Any, is_risk: bool,
               frame: str | None) -> Raster:
    """Values (H, W), the northernmost row first, reprojected if the system is not in metres."""
    from rasterio import Affine
    from rasterio.transform import array_bounds

    if own is not None:
        west, south, east, north = array_bounds(*values.shape, grid)
        turns = round((west + east) / 720.0) if own.is_geographic else 0  # longitudes from 0 to 360
        grid = Affine(grid.a, 0.0, grid.c - 360.0 * turns, 0.0, grid.e, grid.f)
        target = horizontal(frame) if frame else metric_system(
            own, (west + east) / 2.0 - 360.0 * turns, (south + north) / 2.0)
        if target is not own and is_risk:
            raise InvalidRiskMap(f'{path}: its cells are not in metres on the ground, but in '
                                 f'{own.name}; reproject it with gdalwarp -r near -t_srs '
                                 f'{target.to_string()} -tr METRES METRES')
        if target is not own:
            values, grid = _reprojected(path, values, grid, own, target)
            warn(f'{path}: reprojected from {own.name} to '
                 f'{frame or f"{target.name} ({target.to_string()})"}, cells of {grid.a:.4g} m')
        own = frame or target.to_string()
    return Raster(values[::-1], -grid.e, grid.a, (grid.c, grid.f + grid.e * len(values)),
                  own or frame)


def _reprojected(path: Path, values: HeightArray, grid: Any, crs: Any,
                 target: Any) -> tuple[HeightArray, Any]:
    from rasterio.enums import Resampling
    from rasterio.io import MemoryFile
    from rasterio.vrt import WarpedVRT

    rows, columns = values.shape
    # Plain interpolation: a transform that is exact to 1e-6 cells, and no smoothing across cells.
    options = {'crs': target.to_wkt(), 'tolerance': 1e-6, 'XSCALE': 1, 'YSCALE': 1,
               'resampling': Resampling.bilinear}
    with MemoryFile() as file:
        with file.open(driver='GTiff', height=rows, width=columns, count=1, dtype='float32',
                       crs=crs.to_wkt(), transform=grid, nodata=np.nan) as stored:
            stored.write(values, 1)
        with file.open() as stored, WarpedVRT(stored, **options) as warped:
            _check_size(path, warped.height, warped.width)
            return warped.read(1), warped.transform
