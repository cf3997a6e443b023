# SPDX-License-Identifier: Apache-2.0
"""Route sheets: a few routes with their shares in a small JSON file, from which one is drawn.

The format is in ``ambush draw --help``. Routes are secret: write it with mode 0600.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray, frozen_array
from ..errors import AmbushPlannerError, shown
from ..maps.coordinates import Coordinates

FORMAT = 'ambush routes 1'
# Digits after the decimal point: millimetres, and degrees of latitude as fine.
_METRES, _DEGREES = 3, 8
# Maximum rounding of a sum of shares.
MAX_ROUNDING = 1e-6

Position = tuple[float, float]


class InvalidRouteSheet(AmbushPlannerError, ValueError):
    """A file is no route sheet."""


@dataclass(frozen=True, eq=False)
class SheetRoute:
    """One route: its ``share``, ``length`` [m], and ``path`` (L, 2) in world coordinates [m].

    ``lat_lon`` (L, 2) is the path in degrees; None if the map has no coordinate system.
    """

    number: int
    share: float
    length: float
    path: FloatArray
    lat_lon: FloatArray | None


@dataclass(frozen=True, eq=False)
class RouteSheet:
    """A few routes between two places.

    ``map`` is the map's file. An ambusher who knows all of the sheet but the draws causes a mean
    loss of ``value``, and at least ``lower_bound`` with any mixture of the paths that these routes
    were chosen from. He hits a convoy within
    ``reach`` [m], but cannot wait within ``held_radius`` [m] of start, stops and goal. ``slots``
    are times of departure (HH:MM) with their shares, if one is drawn, too.
    """

    map: Path
    crs: str | None
    start: Position
    goal: Position
    stops: tuple[Position, ...]
    held_radius: float
    reach: float
    value: float
    lower_bound: float
    routes: tuple[SheetRoute, ...]
    slots: tuple[tuple[str, float], ...] = ()

    def draw(self, rng: np.random.Generator) -> tuple[SheetRoute, str | None]:
        """Draw one route and, if there are any, one slot by the shares."""
        route = self.routes[_drawn([route.share for route in self.routes], rng)]
        if not self.slots:
            return route, None
        return route, self.slots[_drawn([share for _, share in self.slots], rng)][0]


def _drawn(shares: Sequence[float], rng: np.random.Generator) -> int:
    """Draw an index by shares that add up to 1 but for rounding."""
    return int(rng.choice(len(shares), p=np.array(shares) / sum(shares)))


def sheet_route(number: int, share: float, path: FloatArray, crs: str | None) -> SheetRoute:
    """A route from its path (L, 2 or 3) [m]."""
    xy = frozen_array(path[:, :2], np.float64)
    length = float(np.hypot(*np.diff(xy, axis=0).T).sum())
    lat_lon = frozen_array(Coordinates(crs).to_lat_lon(xy), np.float64) if crs else None
    return SheetRoute(number, share, length, xy, lat_lon)


def sheet_bytes(sheet: RouteSheet, folder: Path) -> bytes:
    """The content of a file in ``folder``; write it with mode 0600."""
    routes = [{**vars(route), 'path': route.path.round(_METRES).tolist(),
               'lat_lon': None if route.lat_lon is None else route.lat_lon.round(_DEGREES).tolist()}
              for route in sheet.routes]
    content = {**vars(sheet), 'map': os.path.relpath(sheet.map, folder), 'routes': routes}
    return json.dumps({'format': FORMAT, **content}).encode()


def read_route_sheet(path: Path) -> RouteSheet:
    """Read a file; raises InvalidRouteSheet, and OSError if it cannot be read."""
    try:
        content = json.loads(path.read_bytes())
        if content.pop('format') != FORMAT:
            raise ValueError
        routes = tuple(_route(row) for row in content.pop('routes'))
        start, goal = _position(content.pop('start')), _position(content.pop('goal'))
        stops = tuple(map(_position, content.pop('stops')))
        slots = tuple((str(slot), float(share)) for slot, share in content.pop('slots'))
        sheet = RouteSheet(map=path.parent / content.pop('map'), start=start, goal=goal,
                           stops=stops, routes=routes, slots=slots, **content)
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InvalidRouteSheet(f'{shown(path)}: not a file of routes as ambush plan --routes '
                                'writes it (-o FILE.json)') from None
    shares = [route.share for route in routes], [share for _, share in slots]
    if not all(math.isclose(sum(each), 1.0, abs_tol=MAX_ROUNDING) for each in shares if each):
        raise InvalidRouteSheet(f'{shown(path)}: the shares must add up to 1; write the file again '
                                'with ambush plan --routes')
    return sheet


def _route(row: dict[str, Any]) -> SheetRoute:
    lat_lon = row.get('lat_lon')
    return SheetRoute(int(row['number']), float(row['share']), float(row['length']),
                      _line(row['path']), None if lat_lon is None else _line(lat_lon))


def _line(points: Any) -> FloatArray:
    line = np.array(points, dtype=np.float64)
    if line.ndim != 2 or line.shape[1] != 2:
        raise ValueError
    return frozen_array(line, np.float64)


def _position(point: Any) -> Position:
    x, y = map(float, point)
    return x, y
