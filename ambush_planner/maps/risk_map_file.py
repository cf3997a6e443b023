# SPDX-License-Identifier: Apache-2.0
"""Risk maps from and to files: map_server's YAML, rasters, and npz with the fields of RiskMap."""

from __future__ import annotations

import math
from dataclasses import fields
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, BadZipFile, ZipFile

import numpy as np
import numpy.typing as npt

from ..arrays import arrays_in
from ..errors import InvalidOption, InvalidRiskMap, warn
from .coordinates import Coordinates
from .elevation_file import read_raster
from .map_file import read_map
from .occupancy import NO_RISK, OBSTACLE, UNKNOWN, OccupancyMap, OccupancyOptions, agreed_crs
from .risk_map import GradedLosses, RiskMap

_UNKNOWN = 255  # in a GeoTIFF
# Graded losses in an npz file, instead of ``alpha``.
_GRADED = ('levels', 'grades')


def read_risk_map(path: Path | str, options: OccupancyOptions | None = None) -> RiskMap:
    """Read a map of map_server, a GeoTIFF of its values (nodata: unknown), or an npz file.

    The npz file has the fields of ``RiskMap``, as ``npz_bytes`` writes it. A file without a
    coordinate system gets ``options.crs``. The losses that a file of ``ambush risk`` names for the
    values 0 and 100 hold, unless the options have others than the default ones. Warns of what was
    converted, and if a map carries no risk.

    Raises
    ------
    InvalidTerrain, InvalidRiskMap, OSError
        The file is not such a map.

    Examples
    --------
    >>> from ambush_planner import read_risk_map
    >>> read_risk_map('docs/yard.yaml')  # doctest: +SKIP
    RiskMap(cells 120 x 80 of 0.5 m, loss 1 to 7.3, obstacles 10.3%, crs unknown)
    """
    path, options = Path(path), options or OccupancyOptions()
    risk_map = (_read_npz(path, options.crs) if path.suffix.lower() == '.npz'
                else _read_grid(path, options))
    losses = risk_map.loss_range
    if losses and losses[0] == losses[1] and options.alpha_min < options.alpha_max:
        warn(NO_RISK)
    return risk_map


def _read_grid(path: Path, options: OccupancyOptions) -> RiskMap:
    is_yaml = path.suffix.lower() in ('.yaml', '.yml')
    grid = read_map(path) if is_yaml else _read_raster(path)
    try:
        return grid.risk_map(options)
    except (InvalidOption, InvalidRiskMap) as error:  # of the file's losses, or its values
        hint = ('; is it an elevation model? Make a risk map of it with ambush risk'
                if 'cell values' in str(error) else '')
        raise InvalidRiskMap(f'{path}: {error}{hint}') from error


def _read_raster(path: Path) -> OccupancyMap:
    raster = read_raster(path, is_risk=True)
    if not math.isclose(raster.row_step, raster.column_step, rel_tol=1e-5):
        step = min(raster.row_step, raster.column_step)
        raise InvalidRiskMap(
            f'{path}: its cells of {raster.column_step:.7g} m x {raster.row_step:.7g} m are not '
            f'square; resample it with gdalwarp -tr {step:.7g} {step:.7g}')
    origin = (*(raster.corner or (0.0, 0.0)), 0.0)
    return OccupancyMap(_cell_values(raster.values), raster.column_step, origin, raster.crs,
                        raster.losses)


def _cell_values(values: npt.NDArray[np.float32]) -> Any:
    """Values (H, W) of an occupancy grid, -1 where unknown: whole numbers if all of them are."""
    cells = np.empty(values.shape, np.int8)
    for part, given in zip(cells, values, strict=True):  # row by row, as the map may be large
        given = np.nan_to_num(given, nan=UNKNOWN)
        if not ((given == np.rint(given)) & (given >= UNKNOWN) & (given <= OBSTACLE)).all():
            return np.nan_to_num(values.astype(np.float64), nan=UNKNOWN)
        part[:] = given
    return cells


def _read_npz(path: Path | BytesIO, crs: str | None) -> RiskMap:
    try:
        content = arrays_in(path, (*_GRADED, *(field.name for field in fields(RiskMap))))
        alpha: Any = (GradedLosses(*(content[name] for name in _GRADED)) if _GRADED[0] in content
                      else content.pop('alpha'))
        x, y, yaw = map(float, content.get('origin', (0.0, 0.0, 0.0)))
        return RiskMap(alpha, content['obstacles'], float(content['resolution']),
                       (x, y, yaw), agreed_crs(str(content.get('crs', '')), crs),
                       content.get('unknown'))
    except KeyError as error:
        raise InvalidRiskMap(f'{path}: no {error}; it has {", ".join(content)}') from error
    except (BadZipFile, EOFError, TypeError, ValueError) as error:
        raise InvalidRiskMap(f'{path}: {error}') from error


def map_from_bytes(data: bytes) -> RiskMap:
    """Return the map in the content of an npz file that ``npz_bytes`` has made."""
    return _read_npz(BytesIO(data), None)


def npz_bytes(risk_map: RiskMap) -> bytes:
    """Return the content of an npz file of a map; graded losses are ``levels`` and ``grades``."""
    stream, graded = BytesIO(), risk_map.graded
    content = {each.name: value for each in fields(RiskMap)
               if (value := getattr(risk_map, each.name)) is not None}
    if graded:
        del content['alpha']
        content |= {name: getattr(graded, name) for name in _GRADED}
    with ZipFile(stream, 'w', ZIP_DEFLATED, compresslevel=1) as archive:
        for name, value in content.items():
            with archive.open(f'{name}.npy', 'w', force_zip64=True) as entry:
                np.lib.format.write_array(entry, np.asanyarray(value), allow_pickle=False)
    return stream.getvalue()


def write_geotiff(path: Path, grid: OccupancyMap) -> None:
    """Write the values of a map as a GeoTIFF (nodata: unknown) in its coordinate system.

    The losses of the values 0 and 100 are tags.

    Raises InvalidCoordinates if the map has no such system.
    """
    import rasterio

    system = Coordinates(grid.crs or '')
    rows, columns = grid.values.shape
    values = np.where(grid.values < 0, _UNKNOWN, grid.values).astype(np.uint8)[::-1]
    with rasterio.open(path, 'w', driver='GTiff', height=rows, width=columns, dtype=np.uint8,
                       count=1, crs=system.crs.to_wkt(), transform=cell_transform(grid),
                       nodata=_UNKNOWN, compress='deflate') as file:
        file.write(values, 1)
        file.update_tags(alpha_min=grid.losses[0], alpha_max=grid.losses[1])


def cell_transform(grid: OccupancyMap | RiskMap) -> Any:
    """Return the affine transform of rasterio from (column, row from the top) to positions."""
    from rasterio import Affine

    left, bottom, turn = grid.origin
    rows = len(grid.values if isinstance(grid, OccupancyMap) else grid.alpha)
    c, s = grid.resolution * math.cos(turn), grid.resolution * math.sin(turn)
    return Affine(c, s, left - s * rows, s, -c, bottom + c * rows)
