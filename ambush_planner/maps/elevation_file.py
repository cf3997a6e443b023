"""Elevation models and masks from files: GeoTIFF (and what else GDAL reads), and npz.

An npz file holds ``elevation`` (or ``roads``), an array (H, W) with the northernmost row first, as
in a GeoTIFF, [m]; and ``resolution`` [m], or ``dx`` and ``dy`` [m] from west to east and from north
to south. NaN is unknown.
"""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .elevation import MAX_CELLS, InvalidTerrain, Raster

# Of the sphere with the Earth's mean radius.
METRES_PER_DEGREE = 111_195.0


def read_raster(path: Path, name: str = 'elevation') -> Raster:
    """Read the array ``name`` of an npz file, or the first band of a GeoTIFF.

    Rasters in degrees are taken as rectangles with the scale at their middle: north of 60 degrees
    and over more than a degree better reproject them first (gdalwarp).

    Raises
    ------
    InvalidTerrain
        The file is not as above, or rasterio, which reads GeoTIFF, is not installed.
    OSError
        It cannot be opened.
    """
    with path.open('rb') as file:
        is_zip = file.read(4) == b'PK\x03\x04'
    return _read_npz(path, name) if is_zip else _read_geotiff(path)


def raster_in_degrees(
    north_up: npt.ArrayLike, row_step: float, column_step: float, latitude: float, place: str = ''
) -> Raster:
    """A raster whose steps are in degrees, at ``latitude`` [degrees] in its middle."""
    scale = METRES_PER_DEGREE * math.cos(math.radians(latitude))
    values = np.asarray(north_up, dtype=np.float64)[::-1]
    return Raster(values, METRES_PER_DEGREE * row_step, scale * column_step, place)


def _read_npz(path: Path, name: str) -> Raster:
    try:
        with np.load(path, allow_pickle=False) as file:
            content = {key: file[key] for key in (name, 'resolution', 'dx', 'dy') if key in file}
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InvalidTerrain(f'{path}: not an npz file that can be read: {error}') from error
    if name not in content:
        raise InvalidTerrain(f'{path}: no array {name!r}; see ambush_terrain --help for the layout')
    try:
        column_step = float(content['dx' if 'dx' in content else 'resolution'])
        row_step = float(content['dy' if 'dy' in content else 'resolution'])
        values = content[name].astype(np.float64)
    except KeyError:
        raise InvalidTerrain(f'{path}: neither resolution nor dx and dy [m]') from None
    except (TypeError, ValueError) as error:
        raise InvalidTerrain(f'{path}: not numeric: {error}') from error
    return _checked(path, Raster(values[::-1], row_step, column_step))


def _checked(path: Path, raster: Raster) -> Raster:
    if raster.values.ndim != 2 or raster.values.size == 0:
        raise InvalidTerrain(f'{path}: must be (H, W), got shape {raster.values.shape}')
    for step in (raster.row_step, raster.column_step):
        if not (math.isfinite(step) and step > 0.0):
            raise InvalidTerrain(f"{path}: the cells' size must be positive [m], got {step}")
    return raster


def _read_geotiff(path: Path) -> Raster:
    try:
        import rasterio
    except ModuleNotFoundError:
        raise InvalidTerrain(
            f'{path}: no npz file; what else there is takes rasterio: '
            "pip install 'ambush_planner[terrain]'"
        ) from None
    try:
        with rasterio.open(path) as dataset:
            return _checked(path, _raster_of(path, dataset))
    except rasterio.errors.RasterioError as error:
        raise InvalidTerrain(f'{path}: {error}') from error


def _raster_of(path: Path, dataset: Any) -> Raster:
    """The first band of an open rasterio dataset."""
    grid = dataset.transform
    if grid.b or grid.d or grid.a <= 0.0 or grid.e >= 0.0:
        raise InvalidTerrain(f'{path}: rows must lead from north to south and columns from west to '
                             'east; gdalwarp brings a raster into that form')
    if dataset.width * dataset.height > MAX_CELLS:
        raise InvalidTerrain(f'{path}: {dataset.width} x {dataset.height} cells, at most '
                             f'{MAX_CELLS} are read; cut out what you need')
    north_up = dataset.read(1, masked=True).astype(np.float64).filled(np.nan)
    crs, bounds = dataset.crs, dataset.bounds
    place = f'{bounds.left:.9g} {bounds.bottom:.9g} {crs.to_string() if crs else ""}'.strip()
    if crs and crs.is_geographic:
        latitude = (bounds.bottom + bounds.top) / 2.0
        return raster_in_degrees(north_up, -grid.e, grid.a, latitude, place)
    metres = crs.linear_units_factor[1] if crs else 1.0
    return Raster(north_up[::-1], -grid.e * metres, grid.a * metres, place)
