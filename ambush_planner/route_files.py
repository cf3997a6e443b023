# SPDX-License-Identifier: Apache-2.0
"""Files of routes for GIS programs, phones and GPS receivers; the suffix chooses the format."""

from __future__ import annotations

import csv
import io
import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from .errors import InvalidCoordinates, InvalidOption

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure

    from .arrays import FloatArray
    from .game.strategy import TripStrategy
    from .maps.risk_map import RiskMap
    from .planning.plan import Plan
    from .recordings.plan_file import SavedPlan
    from .routes.way_points import WayPoint

# The libraries that each format needs.
NEEDS: dict[str, tuple[str, ...]] = {
    '.gpkg': ('geopandas', 'rasterio'), '.geojson': ('geopandas', 'rasterio'),
    '.gpx': ('gpxpy', 'pyproj'), '.csv': (), '.png': ('matplotlib',)}
SUFFIXES = tuple(NEEDS)
PLAN = '.plan'
NEEDS[PLAN] = ('mcap', 'mcap_ros2', 'zstandard')
# Points of a GPX route that are nearer to the line through the others are left out [m], and corners
# nearer to a way point.
_STRAIGHT, _APART = 0.5, 2.0


@dataclass(frozen=True, eq=False)
class Drawn:
    """Paths (L, 2 or 3) [m] drawn from a trip's strategies at ``times``, perhaps for slots.

    With ``routes_only``, files tell nothing of other routes. Without ``labels``, routes are named
    by their numbers and slots. ``covered`` is the share of departures that an ambush at one of the
    times covers, if these are drawn. ``way_points`` are those of their drivers' cards, for each
    path, or none. ``sources`` are the names of the files of map and roads.
    """

    trip: TripStrategy
    risk_map: RiskMap
    paths: Sequence[FloatArray]
    times: Sequence[datetime]
    slots: Sequence[str] = field(default=(), kw_only=True)
    labels: Sequence[str] = field(default=(), kw_only=True)
    covered: float = field(default=1.0, kw_only=True)
    routes_only: bool = field(default=False, kw_only=True)
    way_points: Sequence[Sequence[WayPoint]] = field(default=(), kw_only=True)
    sources: Sequence[str] = field(default=(), kw_only=True)

    @property
    def columns(self) -> dict[str, Any]:
        """The columns that files have about each route."""
        from .planning.route_layers import route_columns

        slots = {'slot': self.slots} if self.slots else {}
        return {**route_columns(self.paths, self.times), **slots}

    @cached_property
    def routes(self) -> Any:
        """The table of routes."""
        from .planning.route_layers import line_table

        return line_table(self.columns, self.paths, self.risk_map.crs)

    @property
    def names(self) -> Sequence[str]:
        """The name of each path."""
        slots = [f', {slot}' for slot in self.slots] or [''] * len(self.paths)
        return self.labels or [f'Departure {k}{slot}' for k, slot in enumerate(slots, start=1)]

    @cached_property
    def tables(self) -> Mapping[str, Any]:
        """All tables by name, routes first."""
        from .planning.route_layers import strategy_tables

        others = {} if self.routes_only else strategy_tables(self.trip, self.risk_map)
        return {'routes': self.routes, **others}

    def picture(self) -> Figure:
        """Draw map, strategy and routes."""
        from matplotlib.figure import Figure

        from .figures import draw_routes, draw_strategy
        from .map_figures import WIDTH, draw_map

        figure = Figure(figsize=(WIDTH, 6.2), layout='compressed')
        axes, lines = figure.subplots(), [path[:, :2] for path in self.paths]
        if self.routes_only:
            draw_map(axes, self.risk_map, ', '.join(self.names))
            draw_routes(axes, lines)
        else:
            draw_strategy(axes, self.trip, self.risk_map, lines, self.covered)
        return figure


def draw(plan: Plan, n: int, rng: np.random.Generator | int | None = None) -> Drawn:
    """Draw ``n`` departures; without ``rng``, the operating system's entropy makes them fresh.

    Raises InvalidOption if the plan was made in another process, so that its map is missing.
    """
    times = [datetime.now(timezone.utc)] * n
    return Drawn(plan.drawn_from, plan.own_map, plan.paths(n, rng), times)


def write_routes(paths: Sequence[Path], drawn: Drawn, plan: Plan | SavedPlan | None = None) -> None:
    """Write files with mode 0600; the suffix of each, one of ``SUFFIXES``, is its format.

    With a ``plan``, the suffix can also be ``PLAN``. Raises InvalidOption if a suffix is none of
    these, InvalidCoordinates if a format needs a coordinate system and the map has none, and
    OSError; nothing is written then.
    """
    from .recordings.durable_files import write_all_durably

    write_all_durably({path: plan_content(plan) if plan and path.suffix.lower() == PLAN
                       else content_of(path, drawn) for path in paths})


def plan_content(plan: Plan | SavedPlan) -> bytes:
    """The content of a plan file."""
    from .recordings.plan_file import SavedPlan, plan_bytes, saved_plan

    return plan_bytes(plan if isinstance(plan, SavedPlan) else saved_plan(plan))


def content_of(path: Path, drawn: Drawn) -> bytes:
    """The content of a file of routes; raises as ``write_routes`` does."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InvalidOption(f'{path}: its suffix must be one of {", ".join(SUFFIXES)}')
    if suffix == '.gpx' and not drawn.risk_map.crs:
        raise InvalidCoordinates(
            f'{path}: GPX holds latitude and longitude, but the coordinate system '
            'of the map is unknown; plan or export with --crs SYSTEM')
    if suffix == '.png':
        from .map_figures import as_png

        return as_png(drawn.picture(), path.name, drawn.sources)
    if suffix == '.csv':
        return _csv(drawn)
    if suffix == '.geojson':
        return _geojson(drawn.tables)
    if suffix == '.gpx':
        return _gpx(drawn)
    # The folder has mode 0700; GDAL makes files that all can read.
    with TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.filterwarnings('ignore', "'crs' was not provided")  # it is unknown
        file = Path(folder) / path.name
        for name, table in drawn.tables.items():
            table.to_file(file, layer=name, driver='GPKG')
        return file.read_bytes()


def _csv(drawn: Drawn) -> bytes:
    columns, text = drawn.columns, io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow(['WKT', *columns])
    for path, *row in zip(drawn.paths, *columns.values(), strict=True):
        corners = ','.join(f'{x:.4f} {y:.4f}' for x, y in path[:, :2])
        writer.writerow([f'LINESTRING ({corners})', *row])
    return text.getvalue().encode()


def _geojson(tables: Mapping[str, Any]) -> bytes:
    from .maps.coordinates import WGS84, longest_edge

    features = []
    for name, table in tables.items():
        shown = table.assign(layer=name)
        if shown.crs:
            shown.geometry = shown.segmentize(longest_edge(shown.crs))
            shown = shown.to_crs(WGS84)
            if (shown.bounds['maxx'] - shown.bounds['minx']).max() > 180.0:
                raise InvalidCoordinates('GeoJSON would cut what crosses 180 degrees; write .gpkg')
        features += json.loads(shown.to_json(drop_id=True, show_bbox=False))['features']
    return json.dumps({'type': 'FeatureCollection', 'features': features}).encode()


def _gpx(drawn: Drawn) -> bytes:
    """Each path as a track, and as a route of its corners and named way points.

    The way points of a single path are also points of their own.
    """
    from gpxpy import gpx

    from .maps.coordinates import Coordinates

    system, file = Coordinates(drawn.risk_map.crs or ''), gpx.GPX()
    file.creator = 'ambush_planner'
    for k, (name, path) in enumerate(zip(drawn.names, drawn.paths, strict=True)):
        texts, corners = _corners(path[:, :2], drawn.way_points[k] if drawn.way_points else ())
        route, track, segment = gpx.GPXRoute(name), gpx.GPXTrack(name), gpx.GPXTrackSegment()
        route.points = [gpx.GPXRoutePoint(latitude, longitude, name=text)
                        for text, (latitude, longitude) in
                        zip(texts, system.to_lat_lon(corners).tolist(), strict=True)]
        segment.points = [gpx.GPXTrackPoint(*place)
                          for place in system.to_lat_lon(path[:, :2]).tolist()]
        track.segments.append(segment)
        file.routes.append(route)
        file.tracks.append(track)
    if len(file.routes) == 1:
        file.waypoints = [gpx.GPXWaypoint(each.latitude, each.longitude, name=each.name)
                          for each in file.routes[0].points if each.name]
    text: str = file.to_xml(version='1.1')
    return text.encode()


def _corners(path: FloatArray,
             way_points: Sequence[WayPoint]) -> tuple[Sequence[str | None], FloatArray]:
    """The corners of a path (L, 2), and its way points (C, 2) with their numbers and names."""
    import numpy as np

    from .routes.legs import distances_along, main_corners

    at, named = main_corners(path, _STRAIGHT), np.array([each.distance for each in way_points])
    along = distances_along(path)[at]
    bare = np.abs(named[:, None] - along).min(axis=0, initial=np.inf) > _APART
    texts = [f'{number:02} {each.label}'.strip()
             for number, each in enumerate(way_points, start=1)]
    places = np.concatenate((path[at[bare]], np.reshape([each.xy for each in way_points], (-1, 2))))
    order = np.argsort(np.concatenate((along[bare], named)), kind='stable')
    names = [*[None] * int(bare.sum()), *texts]
    return [names[k] for k in order], places[order]
