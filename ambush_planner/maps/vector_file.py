# SPDX-License-Identifier: Apache-2.0
"""Points, lines and polygons from GeoPackage, GeoJSON and other vector files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import FloatArray
from ..errors import AmbushPlannerError
from ..option_checks import check_at_least
from .coordinates import Coordinates, InvalidCoordinates, in_metres
from .risk_map import RiskMap, to_map_axes

if TYPE_CHECKING:
    from geopandas import GeoDataFrame


class InvalidFeatures(AmbushPlannerError, ValueError):
    """A vector file is unreadable, or lacks features or attributes."""


def read_features(source: str, kind: str) -> GeoDataFrame:
    """Read the features of a ``kind``, 'Point', 'LineString' or 'Polygon', as single parts.

    ``source`` is a file, or ``FILE|layername=NAME`` as in QGIS; without a name, the layer is the
    one that has such features. Features of other kinds are left out; parts of one feature have its
    index.

    Raises InvalidFeatures if there are none, or if several layers have some.
    """
    name, _, layer = str(source).partition('|layername=')
    path = Path(name).expanduser()
    if not path.exists():
        raise InvalidFeatures(f'{path}: no such file')
    try:
        import geopandas  # noqa: F401
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
        frame = pyogrio.read_dataframe(path, layer=layers[0]) if len(layers) == 1 else None
    except (RuntimeError, ValueError) as error:  # pyogrio's are RuntimeErrors
        raise InvalidFeatures(f'{path}: not a vector file ({str(error).split("; ")[0]})') from error
    if len(layers) > 1:
        raise InvalidFeatures(f'{path}: which layer? Write {path.name}|layername=NAME, with NAME '
                              f'one of {", ".join(layers)}')
    if frame is not None:
        frame = frame[~(frame.geometry.isna() | frame.geometry.is_empty)].explode()
        frame = frame[frame.geometry.geom_type == kind]
    if frame is None or frame.empty:
        raise InvalidFeatures(f'{path}: no {kind} in it')
    return frame


def from_system(points: FloatArray, crs: str, map_crs: str | None) -> FloatArray:
    """Convert positions (K, 2) in the coordinate system ``crs`` to world positions of a map [m].

    If the map's system is unknown, positions in metres are assumed to be in the map's. Raises
    InvalidCoordinates if they are in another unit.
    """
    from pyproj import CRS, Transformer

    own = CRS.from_user_input(crs)
    if not map_crs:
        if not in_metres(own):
            raise InvalidCoordinates(f'the positions are not in metres ({own.name}), and the map '
                                     'has no coordinate system; name it with map.crs')
        return points
    system = Coordinates(map_crs)
    to_map = Transformer.from_crs(own, system.crs, always_xy=True)
    return to_map_axes(system.origin, np.stack(to_map.transform(*points.T), axis=-1))


def features_on(risk_map: RiskMap, source: str, kind: str) -> GeoDataFrame:
    """Read features (``read_features``) in the coordinates of a map.

    Raises InvalidFeatures if none is on the map, or only one of the systems is known.
    """
    from shapely import box

    features = read_features(source, kind)
    if risk_map.crs and features.crs is None:
        raise InvalidFeatures(f'{source}: its coordinate system is unknown, that of the map is '
                              f'{risk_map.crs}; name it in the file')
    if risk_map.crs:
        features = features.to_crs(risk_map.crs)
    elif features.crs is not None and not in_metres(features.crs):
        raise InvalidFeatures(f'{source}: not in metres ({features.crs.name}), and the coordinate '
                              'system of the map is unknown; name it with crs')
    low, high = risk_map.bounds
    if not features.intersects(box(*low, *high)).any():
        raise InvalidFeatures(f'{source}: nothing in it lies on the map, which reaches from '
                              f'({low[0]:.0f}, {low[1]:.0f}) to ({high[0]:.0f}, {high[1]:.0f})')
    return features


def attribute_values(features: GeoDataFrame, key: str, value: Any) -> FloatArray:
    """A number >= 0 for each feature: the same for all, or the attribute named by a text."""
    from pandas import to_numeric

    if not isinstance(value, str):
        value = float(value) if isinstance(value, bool) else value
        check_at_least(key, value, 0.0)
        return np.full(len(features), float(value))
    words = attribute(features, key, value).astype(str).str.lower()
    words = words.replace({'true': '1', 'yes': '1', 'false': '0', 'no': '0'})
    numbers = np.asarray(to_numeric(words, errors='coerce'), dtype=np.float64)
    if bad := int((~(numbers >= 0.0)).sum()):
        raise InvalidFeatures(f'{key}: attribute {value!r} of {bad} of {len(features)} features is '
                              'no number of at least 0')
    return numbers


def attribute(features: GeoDataFrame, key: str, name: str) -> Any:
    """The column of an attribute; raises InvalidFeatures if there is none."""
    if name not in features.columns:
        others = ', '.join(str(each) for each in features.columns if each != 'geometry')
        raise InvalidFeatures(f'{key}: no attribute {name!r}; there is {others or "none"}')
    return features[name]
