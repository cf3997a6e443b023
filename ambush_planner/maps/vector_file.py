"""Points, lines and polygons from GeoPackage, GeoJSON and other vector files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from ..errors import AmbushPlannerError
from .coordinates import Coordinates, InvalidCoordinates
from .risk_map import to_map_axes

if TYPE_CHECKING:
    from geopandas import GeoDataFrame


class InvalidFeatures(AmbushPlannerError, ValueError):
    """A vector file is unreadable, or lacks features or attributes."""


def read_features(source: str, kind: str) -> GeoDataFrame:
    """Read the features of a ``kind``, 'Point', 'LineString' or 'Polygon', one part each.

    ``source`` is a file, or ``FILE|layername=NAME`` as in QGIS; without a name, the layer is the
    one that has such features. Others are left out.

    Raises InvalidFeatures if there are none, or if several layers have some.
    """
    name, _, layer = str(source).partition('|layername=')
    path = Path(name).expanduser()
    if not path.is_file():
        raise InvalidFeatures(f'{path}: no such file')
    try:
        import pyogrio
    except ModuleNotFoundError:
        raise InvalidFeatures(
            f"{path}: vector files need: pip install 'ambush_planner[gis]'"
        ) from None
    try:
        layers = [layer] if layer else [
            each for each, geometry in pyogrio.list_layers(path)
            if geometry and (kind in geometry or geometry in ('Unknown', 'GeometryCollection'))
        ]
        if len(layers) > 1:
            raise InvalidFeatures(f'{path}: which layer? Write {path.name}|layername=NAME, with '
                                  f'NAME one of {", ".join(layers)}')
        if not layers:
            raise InvalidFeatures(f'{path}: no {kind} in it')
        frame = pyogrio.read_dataframe(path, layer=layers[0])
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError, ValueError) as error:
        raise InvalidFeatures(f'{path}: {error}') from error
    frame = frame[~(frame.geometry.isna() | frame.geometry.is_empty)].explode(ignore_index=True)
    frame = frame[frame.geometry.geom_type == kind]
    if not len(frame):
        raise InvalidFeatures(f'{path}: no {kind} in it')
    return frame


def from_system(points: FloatArray, crs: str, map_crs: str | None) -> FloatArray:
    """Convert positions (K, 2) in the coordinate system ``crs`` to world positions of a map [m].

    If the map's system is unknown, positions in metres are taken to be in it. Raises
    InvalidCoordinates if they are in degrees.
    """
    from pyproj import CRS, Transformer

    own = CRS.from_user_input(crs)
    if not map_crs:
        if own.is_geographic:
            raise InvalidCoordinates(f'the positions are in degrees ({own.name}), and the map has '
                                     'no coordinate system; name it with map.crs')
        return points
    system = Coordinates(map_crs)
    to_map = Transformer.from_crs(own, system.crs, always_xy=True)
    return to_map_axes(system.origin, np.stack(to_map.transform(*points.T), axis=-1))
