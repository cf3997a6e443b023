# SPDX-License-Identifier: Apache-2.0
"""Routes, strategy and ground as tables of geometries (GeoDataFrames), for GIS programs.

Positions are world positions, in the map's coordinate system if it has one; those of a robot's
frame are converted to the UTM zone of its datum. Needs geopandas, shapely and rasterio.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..game.strategy import Strategy
from ..maps.coordinates import Coordinates
from ..maps.risk_map import RiskMap
from ..maps.risk_map_file import cell_transform
from .few_routes import FewRoutes

# Minimum probability of edges and sites in files.
MIN_PROBABILITY = 1e-6


def route_table(paths: Sequence[FloatArray], times: Sequence[datetime], crs: str | None) -> Any:
    """Return paths (L, 2 or 3) [m] as lines with ``departure`` (from 1), ``length`` [m], ``time``.

    ``time`` is when a route was drawn, as text (ISO 8601).
    """
    return _lines({'departure': np.arange(1, len(paths) + 1)}, paths, crs,
                  {'time': [time.isoformat(timespec='seconds') for time in times]})


def few_table(few: FewRoutes, crs: str | None) -> Any:
    """Return few routes as lines with ``route`` (from 1), ``share`` and ``length`` [m]."""
    return _lines({'route': np.arange(1, len(few.paths) + 1), 'share': few.shares}, few.paths, crs)


def _lines(columns: Mapping[str, Any], paths: Sequence[FloatArray], crs: str | None,
           more: Mapping[str, Any] | None = None) -> Any:
    """A table of paths with their lengths, between the other columns."""
    import geopandas
    import shapely

    system = Coordinates(crs) if crs else None
    length = [float(np.hypot(*np.diff(path[:, :2], axis=0).T).sum()) for path in paths]
    columns = {**columns, 'length': length, **(more or {})}
    lines = [shapely.LineString(system.to_crs(path[:, :2]) if system else path[:, :2])
             for path in paths]
    return geopandas.GeoDataFrame(columns, geometry=lines, crs=system and system.crs)


def strategy_tables(strategy: Strategy, risk_map: RiskMap) -> Mapping[str, Any]:
    """Return the tables ``edges``, ``sites``, ``held_ground`` and ``forbidden``.

    Edges have a ``probability``; sites have the ``probability`` q that the best ambusher waits
    there and the ``loss``. Forbidden ground is the map's obstacles.
    """
    import geopandas
    import shapely

    held = strategy.game.held.shrunk(0.0)
    network, p = strategy.network, strategy.shown_probability
    q, first = strategy.ambush_at_places, network.representatives
    system = Coordinates(risk_map.crs) if risk_map.crs else None
    points = system.to_crs(network.points) if system else network.points
    used = np.flatnonzero(p > MIN_PROBABILITY)
    waits = np.flatnonzero(q > MIN_PROBABILITY) if strategy.value > 0.0 else np.zeros(0, int)
    at = first[waits]
    centres = system.to_crs(held.centres) if system else held.centres
    tables = {
        'edges': ({'probability': p[used]}, shapely.linestrings(points[network.edges[used]])),
        'sites': ({'probability': q[waits], 'loss': strategy.game.loss[at]},
                  shapely.points(points[at])),
        'held_ground': ({'radius': held.radii},
                        shapely.buffer(shapely.points(centres), held.radii, quad_segs=32)),
        'forbidden': ({}, _obstacles(risk_map)),
    }
    return {name: geopandas.GeoDataFrame(columns, geometry=list(shapes),
                                         crs=system and system.crs)
            for name, (columns, shapes) in tables.items() if len(shapes)}


def _obstacles(risk_map: RiskMap) -> list[Any]:
    """Polygons of the map's obstacle cells."""
    from rasterio.features import shapes
    from shapely.geometry import shape

    cells = risk_map.obstacles[::-1].astype(np.uint8)
    place = cell_transform(risk_map)
    return [shape(outline) for outline, _ in shapes(cells, cells == 1, transform=place)]
