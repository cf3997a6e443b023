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

import numpy as np

from .arrays import FloatArray
from .errors import InvalidOption
from .game.strategy import TripStrategy
from .maps.coordinates import WGS84, InvalidCoordinates
from .maps.risk_map import RiskMap
from .planning.plan import Plan
from .planning.route_layers import line_table, lines_in_system, route_columns, strategy_tables
from .recordings.durable_files import write_all_durably

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .recordings.plan_file import SavedPlan

# The libraries that each format needs.
NEEDS: dict[str, tuple[str, ...]] = {
    '.gpkg': ('geopandas', 'rasterio'), '.geojson': ('geopandas', 'rasterio'),
    '.gpx': ('geopandas', 'gpxpy'), '.csv': (), '.png': ('matplotlib',)}
SUFFIXES = tuple(NEEDS)
PLAN = '.plan'
NEEDS[PLAN] = ('mcap', 'mcap_ros2', 'zstandard')
# Points of a GPX route that are nearer to the line through the others are left out [m].
_STRAIGHT = 0.5


@dataclass(frozen=True, eq=False)
class Drawn:
    """Paths (L, 2 or 3) [m] drawn from a trip's strategies at ``times``, perhaps for slots.

    Without ``labels``, they are named by their numbers and slots. ``covered`` is the share of
    departures that an ambush at one of the times covers, if these are drawn.
    """

    trip: TripStrategy
    risk_map: RiskMap
    paths: Sequence[FloatArray]
    times: Sequence[datetime]
    slots: Sequence[str] = field(default=(), kw_only=True)
    labels: Sequence[str] = field(default=(), kw_only=True)
    covered: float = field(default=1.0, kw_only=True)

    @property
    def columns(self) -> dict[str, Any]:
        """What files say of each route, by column."""
        slots = {'slot': self.slots} if self.slots else {}
        return {**route_columns(self.paths, self.times), **slots}

    @cached_property
    def routes(self) -> Any:
        """The table of routes."""
        return line_table(self.columns, self.paths, self.risk_map.crs)

    @property
    def names(self) -> Sequence[str]:
        """The name of each path."""
        slots = [f', {slot}' for slot in self.slots] or [''] * len(self.paths)
        return self.labels or [f'Departure {k}{slot}' for k, slot in enumerate(slots, start=1)]

    @cached_property
    def tables(self) -> Mapping[str, Any]:
        """All tables by name, routes first."""
        return {'routes': self.routes, **strategy_tables(self.trip, self.risk_map)}

    def picture(self) -> Figure:
        """Draw map, strategy and routes."""
        from matplotlib.figure import Figure

        from .figures import draw_strategy
        from .map_figures import WIDTH

        figure = Figure(figsize=(WIDTH, 6.2), layout='compressed')
        draw_strategy(figure.subplots(), self.trip, self.risk_map,
                      [path[:, :2] for path in self.paths], self.covered)
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
            "of the map is unknown; plan or export with --crs SYSTEM, or a robot's frame (--datum)")
    if suffix == '.png':
        from .map_figures import as_png

        return as_png(drawn.picture())
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
    for line, *row in zip(lines_in_system(drawn.paths, drawn.risk_map.crs), *columns.values(),
                          strict=True):
        corners = ','.join(f'{x:.4f} {y:.4f}' for x, y in line)
        writer.writerow([f'LINESTRING ({corners})', *row])
    return text.getvalue().encode()


def _geojson(tables: Mapping[str, Any]) -> bytes:
    features = []
    for name, table in tables.items():
        shown = table.assign(layer=name)
        if shown.crs:
            shown = shown.to_crs(WGS84)
            shown.geometry = [_cut_at_180(shape) for shape in shown.geometry]
        features += json.loads(shown.to_json(drop_id=True, show_bbox=False))['features']
    return json.dumps({'type': 'FeatureCollection', 'features': features}).encode()


def _cut_at_180(shape: Any) -> Any:
    """A shape in degrees; one that crosses 180 degrees as its parts on both sides (RFC 7946)."""
    import shapely

    first = shapely.get_coordinates(shape)[0, 0]
    whole = shapely.transform(shape, lambda at: np.column_stack((
        (at[:, 0] - first + 180.0) % 360.0 + first - 180.0, at[:, 1])))
    west, _, east, _ = whole.bounds
    if -180.0 <= west and east <= 180.0:
        return shape
    parts = []
    for turn in (-360.0, 0.0, 360.0):
        side = whole.intersection(shapely.box(turn - 180.0, -90.0, turn + 180.0, 90.0))
        moved = shapely.transform(side, lambda at, turn=turn: at - (turn, 0.0))
        parts += [each for each in shapely.get_parts(moved)
                  if each.geom_type in shape.geom_type and not each.is_empty]
    kind = {'L': shapely.multilinestrings, 'P': shapely.multipolygons}[parts[0].geom_type[0]]
    return kind(parts)


def _gpx(drawn: Drawn) -> bytes:
    from gpxpy import gpx

    file = gpx.GPX()
    file.creator = 'ambush_planner'
    lines, corners = (each.to_crs(WGS84) for each in (drawn.routes.geometry,
                                                      drawn.routes.simplify(_STRAIGHT)))
    for name, line, corner in zip(drawn.names, lines, corners, strict=True):
        route, track, segment = gpx.GPXRoute(name), gpx.GPXTrack(name), gpx.GPXTrackSegment()
        route.points = [gpx.GPXRoutePoint(latitude, longitude)
                        for longitude, latitude in corner.coords]
        segment.points = [gpx.GPXTrackPoint(latitude, longitude)
                          for longitude, latitude in line.coords]
        track.segments.append(segment)
        file.routes.append(route)
        file.tracks.append(track)
    text: str = file.to_xml(version='1.1')
    return text.encode()
