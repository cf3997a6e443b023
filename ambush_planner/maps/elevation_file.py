"""Elevation models and masks from files: GeoTIFF (and other GDAL formats) and .npz.

An .npz file holds the array ``elevation`` (or ``roads``) (H, W) [m], northernmost row first as in a
GeoTIFF, NaN if unknown; and the cell size, either ``resolution`` [m] or ``dx`` (west to east) and
``dy`` (north to south) [m].
"""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .elevation import MAX_CELLS, InvalidTerrain, Raster

# Length of one degree of latitude on a sphere with the Earth's mean radius [m].
METRES_PER_DEGREE = 111_195.0


def read_raster(path: Path, name: str = 'elevation') -> Raster:
    """Read the array ``name`` of an .npz file, or the first band of a GeoTIFF.

    Rasters in degrees are treated as rectangles with the scale at their centre. Beyond 60 degrees
    of latitude, or if they span more than a degree, reproject them first (gdalwarp).

    Raises InvalidTerrain if the file is malformed, or is a GeoTIFF and rasterio is not installed;
    OSError if it cannot be opened.
    """
    with path.open('rb') as file:
        is_zip = file.read(4) == b'PK\x03\x04'
    return _read_npz(path, name) if is_zip else _read_geotiff(path)


def raster_in_degrees(north_up: npt.ArrayLike, row_step: float, column_step: float, latitude: float,
                      place: str = '') -> Raster:
    """Convert a raster with steps in degrees, centred at ``latitude`` [degrees]."""
    scale = METRES_PER_DEGREE * math.cos(math.radians(latitude))
    values = np.asarray(north_up, dtype=np.float64)[::-1]
    return Raster(values, METRES_PER_DEGREE * row_step, scale * column_step, place)


def _read_npz(path: Path, name: str) -> Raster:
    try:
        with np.load(path, allow_pickle=False) as file:
            content = {key: file[key] for key in (name, 'resolution', 'dx', 'dy') if key in file}
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InvalidTerrain(f'{path}: not a readable .npz file: {error}') from error
    if name not in content:
        raise InvalidTerrain(f'{path}: no array {name!r}; see ambush_terrain --help for the layout')
    try:
        column_step = float(content['dx' if 'dx' in content else 'resolution'])
        row_step = float(content['dy' if 'dy' in content else 'resolution'])
        values = content[name].astype(np.float64)
    except KeyError:
        raise InvalidTerrain(f'{path}: needs resolution, or dx and dy [m]') from None
    except (TypeError, ValueError) as error:
        raise InvalidTerrain(f'{path}: not numeric: {error}') from error
    return _checked(path, Raster(values[::-1], row_step, column_step))


def _checked(path: Path, raster: Raster) -> Raster:
    if raster.values.ndim != 2 or raster.values.size == 0:
        raise InvalidTerrain(f'{path}: must be (H, W), got shape {raster.values.shape}')
    for step in (raster.row_step, raster.column_step):
        if not (math.isfinite(step) and step > 0.0):
            raise InvalidTerrain(f'{path}: cell size must be positive [m], got {step}')
    return raster


def _read_geotiff(path: Path) -> Raster:
    try:
        import rasterio
    except ModuleNotFoundError:
        raise InvalidTerrain(f'{path}: not an .npz file; other formats need rasterio: '
                             "pip install 'ambush_planner[terrain]'") from None
    try:
        with rasterio.open(path) as dataset:
            return _checked(path, _raster_of(path, dataset))
    except rasterio.errors.RasterioError as error:
        raise InvalidTerrain(f'{path}: {error}') from error


def _raster_of(path: Path, dataset: Any) -> Raster:
    """The first band of an open rasterio dataset."""
    grid = dataset.transform
    if grid.b or grid.d or grid.a <= 0.0 or grid.e >= 0.0:
        raise InvalidTerrain(f'{path}: rows must run from north to south and columns from west to '
                             'east; convert the raster with gdalwarp')
    if dataset.width * dataset.height > MAX_CELLS:
        raise InvalidTerrain(f'{path}: {dataset.width} x {dataset.height} cells exceed the limit '
                             f'of {MAX_CELLS}; crop the raster')
    north_up = dataset.read(1, masked=True).astype(np.float64).filled(np.nan)
    crs, bounds = dataset.crs, dataset.bounds
    place = f'{bounds.left:.9g} {bounds.bottom:.9g} {crs.to_string() if crs else ""}'.strip()
    if crs and crs.is_geographic:
        latitude = (bounds.bottom + bounds.top) / 2.0
        return raster_in_degrees(north_up, -grid.e, grid.a, latitude, place)
    metres = crs.linear_units_factor[1] if crs else 1.0
    return Raster(north_up[::-1], -grid.e * metres, grid.a * metres, place)
