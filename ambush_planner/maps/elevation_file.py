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

from .elevation import MAX_CELLS, InvalidTerrain, Raster


def read_raster(path: Path, name: str = 'elevation') -> Raster:
    """Read the array ``name`` of an .npz file, or the first band of a GeoTIFF.

    Raises InvalidTerrain if the file is malformed, too large, in degrees (reproject it to metres
    first, for example with gdalwarp), or a GeoTIFF and rasterio is not installed; OSError if it
    cannot be opened.
    """
    with path.open('rb') as file:
        is_zip = file.read(4) == b'PK\x03\x04'
    return _read_npz(path, name) if is_zip else _read_geotiff(path)


def _read_npz(path: Path, name: str) -> Raster:
    try:
        with np.load(path, allow_pickle=False) as file:
            if name in file and file.zip.getinfo(f'{name}.npy').file_size > 9 * MAX_CELLS:
                raise ValueError(f'{name} exceeds the limit of {MAX_CELLS} cells; crop it')
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
    crs, bounds = dataset.crs, dataset.bounds
    if crs and crs.is_geographic:
        raise InvalidTerrain(
            f'{path}: the cells are in degrees ({crs.to_string()}); reproject the raster to '
            f'metres, for instance: {_reprojection(path, bounds)}'
        )
    north_up = dataset.read(1, masked=True).astype(np.float64).filled(np.nan)
    place = f'{bounds.left:.9g} {bounds.bottom:.9g} {crs.to_string() if crs else ""}'.strip()
    metres = crs.linear_units_factor[1] if crs else 1.0
    return Raster(north_up[::-1], -grid.e * metres, grid.a * metres, place)


def _reprojection(path: Path, bounds: Any) -> str:
    """The command that reprojects a raster with ``bounds`` in degrees to its UTM zone."""
    longitude = (bounds.left + bounds.right) / 2.0
    zone = math.floor((longitude + 180.0) / 6.0) % 60 + 1
    code = (32600 if bounds.bottom + bounds.top >= 0.0 else 32700) + zone
    return f'gdalwarp -t_srs EPSG:{code} -r bilinear {path.name} {path.stem}_utm.tif'
