# SPDX-License-Identifier: Apache-2.0
"""The data of a report: departures by trip, and what its maps show."""

from __future__ import annotations

import math
import zlib
from base64 import b64encode
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..colours import ROUTES
from ..game.strategy import TripStrategy
from ..maps.coordinates import degrees_polynomial
from ..maps.risk_map import RiskMap
from ..operations.slots import Slots
from ..planning.ambush_costs import BestAmbush, best_ambush, cost_raster
from ..planning.evaluation import Measures, compare_with_fixed
from ..routes.legs import main_corners
from ..routes.shared_roads import stripes
from .recorded_departure import RecordedDeparture

# Starts or goals are the same up to this share of the distance between start and goal.
SAME_TRIP = 0.05
# Maximum number of cells of a map in each direction, or blocks of cells.
MAX_CELLS = 2000
# Number of obstacle cells; smaller numbers are indices into the losses.
OBSTACLE = 255
# Maximum number of blocks of cells in each direction whose cost is shown at the pointer.
MAX_COSTS = 160
# Its codes: shares of the largest cost up to 1, then secured area, then obstacle.
FULL, SECURED, NOBODY = 250, 254, 255
# Minimum probability of edges that are drawn.
MIN_PROBABILITY = 1e-3
# Accuracy of driven paths in the picture [cells of the map].
PATH_ACCURACY = 0.1
# Minimum probability of sites, as a share of the likeliest site's.
MIN_SITE = 1e-3


@dataclass(frozen=True, eq=False)
class Section:
    """The departures of one trip in order of time; start and goal may move a little."""

    departures: list[RecordedDeparture]

    @property
    def trip(self) -> TripStrategy:
        """The latest strategies."""
        return self.departures[-1].departed_on

    @property
    def slots(self) -> Slots | None:
        """The times that the latest departure's was drawn from, if any."""
        return (self.departures[-1].drawn_slot or ('', None))[1]

    @property
    def bounds(self) -> tuple[float, float]:
        """Value and lower bound for an ambusher who also has to choose a time, if it is drawn."""
        return self.departures[-1].value, self.departures[-1].lower_bound

    @property
    def risk_map(self) -> RiskMap:
        """The map of the latest departure; the others were planned on the same one."""
        return self.departures[-1].newest_risk_map

    @cached_property
    def measures(self) -> dict[str, Measures]:
        """The departures' strategy, at the times that are drawn, and planners of a fixed route."""
        last = self.departures[-1]
        rows = compare_with_fixed(self.trip, last.trip if last.few else self.trip)
        drawn = rows['stochastic']
        return rows | {'stochastic': replace(
            drawn, p_first=drawn.p_first * last.covered, p_repeated=drawn.p_repeated * last.covered,
            v_repeated=drawn.v_repeated * last.covered)}

    @cached_property
    def best(self) -> BestAmbush | None:
        """The best ambush, for one who knows the time."""
        return best_ambush(self.trip, self.risk_map)

    def includes(self, other: RecordedDeparture) -> bool:
        """Return whether a departure is on this trip."""
        first = self.departures[0]
        one, two = first.metadata.trip, other.metadata.trip
        far = math.dist(one.start, one.goal) * SAME_TRIP
        return (other.risk_map is first.risk_map
                and math.dist(one.start, two.start) <= far
                and math.dist(one.goal, two.goal) <= far)


def sections_of(departures: Iterable[RecordedDeparture]) -> list[Section]:
    """Group departures by trip, the earliest trip first."""
    sections: list[Section] = []
    for each in departures:
        section = next((section for section in sections if section.includes(each)), None)
        if section is None:
            sections.append(section := Section([]))
        section.departures.append(each)
    return sections


def map_data(section: Section, with_degrees: bool = True) -> dict[str, Any]:
    """Return what the script of the map draws; positions are relative to the map's corner [m].

    Arrays are deflated, little-endian and base64. ``cells`` are indices into the losses ``levels``,
    ``costs`` what an ambush costs, in blocks of ``block`` [m], as shares of ``most_cost``.
    ``pieces`` of ``routes`` have the index of their departure, their number of points, and how many
    of the later coloured routes follow them.
    Raises InvalidCoordinates if the map's coordinate system cannot be used.
    """
    risk_map, trip, game = section.risk_map, section.trip, section.trip.game
    cells, levels, cell = map_cells(risk_map)
    edges, p = trip.ground_uses
    used = np.flatnonzero(p >= MIN_PROBABILITY)
    costs = cost_raster(trip, risk_map, MAX_COSTS)
    covered = section.departures[-1].covered
    most_cost = max(trip.value, float(np.nanmax(costs.cost, initial=0.0))) or 1.0
    codes = np.where(np.isnan(costs.cost), np.where(costs.secured, SECURED, NOBODY),
                     np.rint(FULL * np.nan_to_num(costs.cost) / most_cost))
    corner = np.array(risk_map.origin[:2])
    low, high = risk_map.bounds
    degrees = degrees_polynomial(risk_map.crs, low, high) if risk_map.crs and with_degrees else None
    paths = [each.path_poses[:, :2] for each in section.departures]
    lines = [*([(path, 0)] for path in paths[: -len(ROUTES)]), *stripes(paths[-len(ROUTES) :])]
    pieces = [(k, piece[main_corners(piece, PATH_ACCURACY * cell)] - corner, over)
              for k, line in enumerate(lines) for piece, over in line]
    network, targets = game.network, [leg.network.target for leg in trip.legs]
    ends = [network.source, targets[-1], *targets[:-1]]
    return {
        'columns': cells.shape[1], 'rows': cells.shape[0], 'cell': cell, 'levels': levels,
        'origin': corner.tolist(), 'yaw': risk_map.origin[2],
        'box': [*(low - corner).tolist(), *(high - corner).tolist()],
        'ends': (network.points[ends] - corner).tolist(),
        'discs': [[x - corner[0], y - corner[1], radius] for (x, y), radius in zip(
            game.secured.centres.tolist(), game.secured.radii.tolist(), strict=True) if radius > 0],
        'reach': game.reach, 'value': section.bounds[0], 'most_cost': covered * most_cost,
        'degrees': degrees, 'cells': packed(cells, 'u1'), 'costs': packed(codes, 'u1'),
        'block': costs.block * risk_map.resolution, 'blocks': codes.shape[1],
        'segments': packed((network.points - corner)[edges[used]], '<f4'),
        'shown': packed(p[used], '<f4'),
        'sites': packed(_sites(trip) - [*corner, 0.0], '<f4'),
        'routes': packed(np.concatenate([line for _, line, _ in pieces]), '<f4'),
        'pieces': [(k, len(line), over) for k, line, over in pieces],
    }


def map_cells(risk_map: RiskMap) -> tuple[npt.NDArray[np.uint8], list[float], float]:
    """Return cells as indices of losses, the losses, and the edge of a cell [m]."""
    shown = risk_map.coarser(MAX_CELLS)
    alpha, obstacles = np.asarray(shown.alpha), shown.obstacles
    levels = np.unique(alpha[~obstacles]) if not obstacles.all() else np.zeros(1)
    if len(levels) > OBSTACLE:
        levels = np.linspace(levels[0], levels[-1], OBSTACLE)
    middle = (levels[1:] + levels[:-1]) / 2.0
    index = np.where(obstacles, OBSTACLE, np.searchsorted(middle, alpha))
    return index.astype(np.uint8), levels.tolist(), shown.resolution


def packed(array: npt.ArrayLike, kind: str) -> str:
    """Return an array of a kind such as ``<f4`` as deflated base64."""
    return b64encode(zlib.compress(np.ascontiguousarray(array, kind).tobytes())).decode('ascii')


def _sites(trip: TripStrategy) -> FloatArray:
    """Position of each ambush site [m], and its probability relative to the likeliest (K, 3)."""
    q = trip.ambusher.q if trip.value > 0.0 else np.zeros(1)
    at = np.flatnonzero(q > MIN_SITE * q.max())
    return np.column_stack((trip.game.network.points[at], q[at] / (q.max() or 1.0)))
