# SPDX-License-Identifier: Apache-2.0
"""Routes, strategy and ground as tables of geometries (GeoDataFrames), for GIS programs.

Positions are world positions, in the map's coordinate system if it has one. Needs geopandas,
shapely and rasterio.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..game.strategy import TripStrategy
from ..maps.coordinates import Coordinates
from ..maps.risk_map import RiskMap
from ..maps.risk_map_file import cell_transform
from .plan import path_lengths

# Minimum probability of edges and sites in files.
MIN_PROBABILITY = 1e-6


def route_columns(paths: Sequence[FloatArray], times: Sequence[datetime]) -> dict[str, Any]:
    """``departure`` (from 1), ``length`` [m] and the ``time`` of drawing (ISO 8601) of paths."""
    return {'departure': range(1, len(paths) + 1), 'length': path_lengths(paths),
            'time': [time.isoformat(timespec='seconds') for time in times]}


def line_table(columns: Mapping[str, Any], paths: Sequence[FloatArray], crs: str | None) -> Any:
    """Return paths (L, 2 or 3) [m] as lines with other columns."""
    import geopandas
    import shapely

    return geopandas.GeoDataFrame(
        columns, geometry=[shapely.LineString(path[:, :2]) for path in paths],
        crs=Coordinates(crs).crs if crs else None)


def strategy_tables(trip: TripStrategy, risk_map: RiskMap) -> Mapping[str, Any]:
    """Return the tables ``edges``, ``sites``, ``places``, ``secured_area`` and ``forbidden``.

    Edges have a ``probability``, on a trip with stops the expected uses by all legs; sites have the
    ``probability`` q that the best ambusher waits there and the ``loss``; places are start, stops
    and goal. Forbidden ground is the map's obstacles.
    """
    import geopandas
    import shapely

    game = trip.game
    secured, network, q = game.secured.shrunk(0.0), game.network, trip.ambusher.q
    edges, p = trip.ground_uses
    points, centres = network.points, secured.centres
    crs = Coordinates(risk_map.crs).crs if risk_map.crs else None
    used = np.flatnonzero(p > MIN_PROBABILITY)
    waits = np.flatnonzero(q > MIN_PROBABILITY) if trip.value > 0.0 else np.zeros(0, int)
    stops = [f'stop {k}' for k in range(1, len(trip.legs))]
    ends = points[[network.source, *(leg.network.target for leg in trip.legs)]]
    tables = {
        'edges': ({'probability': p[used]}, shapely.linestrings(points[edges[used]])),
        'sites': ({'probability': q[waits], 'loss': game.loss[waits]},
                  shapely.points(points[waits])),
        'places': ({'name': ['start', *stops, 'goal']}, shapely.points(ends)),
        'secured_area': ({'radius': secured.radii},
                        shapely.buffer(shapely.points(centres), secured.radii, quad_segs=32)),
        'forbidden': ({}, _obstacles(risk_map)),
    }
    return {name: geopandas.GeoDataFrame(columns, geometry=list(shapes), crs=crs)
            for name, (columns, shapes) in tables.items() if len(shapes)}


def _obstacles(risk_map: RiskMap) -> list[Any]:
    """Polygons of the map's obstacle cells."""
    from rasterio.features import shapes
    from shapely.geometry import shape

    cells = risk_map.obstacles[::-1].astype(np.uint8)
    place = cell_transform(risk_map)
    return [shape(outline) for outline, _ in shapes(cells, cells == 1, transform=place)]
