# SPDX-License-Identifier: Apache-2.0
"""Elevation models and masks from files: GeoTIFF (and other GDAL formats) and .npz.

An .npz file holds the array ``elevation`` (or ``roads``) (H, W) [m], northernmost row first as in a
GeoTIFF, NaN if unknown; and the cell size, either ``resolution`` [m] or ``dx`` (west to east) and
``dy`` (north to south) [m].
"""

from __future__ import annotations

import math
import warnings
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray
from .coordinates import InvalidCoordinates, metric_system
from .elevation import MAX_CELLS, InvalidTerrain, Raster

HEIGHTS = 'elevation'  # name of the second band of a risk map that has the heights [m]


def read_raster(path: Path, name: str = 'elevation', nearest: bool = False) -> Raster:
    """Read the array ``name`` of an .npz file, or the band of a GeoTIFF.

    A risk map has its heights in a second band, if it has them.

    A GeoTIFF whose units are not metres on the ground (degrees, feet, Web Mercator) is reprojected
    to its UTM zone, by bilinear interpolation or, if ``nearest``, with the values of nearest cells.

    Raises InvalidTerrain if the file is malformed or too large, or if a GeoTIFF needs rasterio and
    it is not installed; OSError if the file cannot be opened.
    """
    with path.open('rb') as file:
        is_zip = file.read(4) == b'PK\x03\x04'
    return _read_npz(path, name) if is_zip else _read_geotiff(path, nearest)


def _read_npz(path: Path, name: str) -> Raster:
    try:
        with np.load(path, allow_pickle=False) as file:
            if name in file and file.zip.getinfo(f'{name}.npy').file_size > 9 * MAX_CELLS:
                raise ValueError(f'{name} exceeds the limit of {MAX_CELLS} cells; crop it')
            content = {key: file[key] for key in (name, 'resolution', 'dx', 'dy') if key in file}
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InvalidTerrain(f'{path}: not a readable .npz file: {error}') from error
    if name not in content:
        raise InvalidTerrain(f'{path}: no array {name!r}; see ambush terrain --help for the layout')
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


def _read_geotiff(path: Path, nearest: bool) -> Raster:
    try:
        import rasterio
    except ModuleNotFoundError:
        raise InvalidTerrain(f'{path}: not an .npz file; other formats need rasterio: '
                             "pip install 'ambush_planner[gis]'") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', rasterio.errors.NotGeoreferencedWarning)
            with rasterio.open(path) as dataset:
                return _checked(path, _raster_of(path, dataset, nearest))
    except (rasterio.errors.RasterioError, InvalidCoordinates) as error:
        hint = ('; it looks like a map for map_server, not like an elevation model'
                if path.suffix in ('.yaml', '.yml') else '')
        raise InvalidTerrain(f'{path}: {str(error).rstrip(".")}{hint}') from error


def _raster_of(path: Path, dataset: Any, nearest: bool) -> Raster:
    """The band of an open rasterio dataset, in metres."""
    _check_size(path, dataset)
    if dataset.count != 1 and not _has_heights(dataset):
        raise InvalidTerrain(f'{path}: has {dataset.count} bands, must have one; choose it with '
                             'gdal_translate -b')
    if dataset.transform.is_identity:
        raise InvalidTerrain(f'{path}: has no georeference: neither a position nor a cell size; '
                             'give it one with gdal_translate -a_ullr and -a_srs')
    if not (dataset.crs and (dataset.crs.is_projected or dataset.crs.is_geographic)):
        return _band(path, dataset, None)
    left, bottom, right, top = dataset.bounds
    x, y = (left + right) / 2.0, (bottom + top) / 2.0
    crs, is_other = metric_system(dataset.crs.to_wkt(), x, y)
    if not is_other:
        return _band(path, dataset, crs.to_string())
    from rasterio.vrt import WarpedVRT
    from rasterio.warp import Resampling

    # Plain interpolation: an exact transform, and no smoothing across cells.
    with WarpedVRT(dataset, crs=crs.to_wkt(), nodata=np.nan, dtype='float64',
                   resampling=Resampling.nearest if nearest else Resampling.bilinear,
                   tolerance=0.0, XSCALE=1, YSCALE=1) as warped:
        _check_size(path, warped)
        note = (f'{path}: reprojected from {dataset.crs.to_string()} to {crs.to_string()} '
                f'({crs.name}), cells of {warped.transform.a:.4g} m')
        return replace(_band(path, warped, crs.to_string()), note=note)


def _band(path: Path, dataset: Any, crs: str | None) -> Raster:
    grid = dataset.transform
    if grid.b or grid.d or grid.a <= 0.0 or grid.e >= 0.0:
        raise InvalidTerrain(f'{path}: rows must run from north to south and columns from west to '
                             'east; convert the raster with gdalwarp')
    def read(band: int) -> FloatArray:
        north_up = dataset.read(band, masked=True).astype(np.float64).filled(np.nan)
        return np.asarray(north_up[::-1])

    corner = dataset.bounds.left, dataset.bounds.bottom
    heights = read(2).astype(np.float32) if _has_heights(dataset) else None
    return Raster(read(1), -grid.e, grid.a, corner, crs, heights=heights)


def _has_heights(dataset: Any) -> bool:
    return bool(dataset.descriptions[1:] == (HEIGHTS,))


def _check_size(path: Path, dataset: Any) -> None:
    if dataset.width * dataset.height > MAX_CELLS:
        raise InvalidTerrain(f'{path}: {dataset.width} x {dataset.height} cells exceed the limit '
                             f'of {MAX_CELLS}; crop the raster')
