# SPDX-License-Identifier: Apache-2.0
"""The demo's picture: random departures next to routes that never change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from ambush_planner import figures
from ambush_planner.arrays import FloatArray
from ambush_planner.colours import AMBUSHER, ROUTES
from ambush_planner.figures import SECURED_AREA, SITES
from ambush_planner.game.hits import largest_product, law_of
from ambush_planner.game.route_sampler import route_strategy
from ambush_planner.game.strategy import Strategy, TripStrategy
from ambush_planner.map_figures import HALO, LOSS, OBSTACLE, WIDTH
from ambush_planner.maps.risk_map import RiskMap
from ambush_planner.planning.evaluation import energy_efficient_route, evaluate, risk_avoiding_route

# Colours and dashes of the fixed routes.
FIXED = ((ROUTES[0], '-'), (ROUTES[1], (0, (3, 1.2))))


@dataclass(frozen=True, eq=False)
class FixedRoute:
    """A route (K, 2) [m] driven every time; place (2,) and loss of its worst ambush."""

    name: str
    points: FloatArray
    worst_place: FloatArray
    loss: float


def routes_figure(risk_map: RiskMap, trip: TripStrategy, routes: Sequence[FloatArray],
                  fixed: Sequence[FixedRoute]) -> Figure:
    """Draw the routes (K, 2) of departures on the left and the fixed routes on the right."""
    figure = Figure(figsize=(WIDTH, 5.5), layout='compressed')
    left, right = figure.subplots(1, 2)
    worst = max(route.loss for route in fixed)
    for axes, title in (
        (left, f'{len(routes)} departures of the random convoy\n'
               f'Mean loss of {trip.value:.2f} if the strategy is known'),
        (right, f'The same route every day\nLoss of up to {worst:.2f} once the route is known'),
    ):
        risk = figures.draw_ground(axes, trip, risk_map, title)
    right.label_outer()
    figures.draw_routes(left, routes, figures.marks_of(trip))
    figures.draw_sites(left, trip)
    for route, (colour, dashes), (side, share) in zip(
        fixed, FIXED, (('left', 0.62), ('right', 0.75)), strict=True
    ):
        right.plot(*route.points.T, color=colour, linestyle=dashes, linewidth=2.4, zorder=4)
        length = np.hypot(*np.diff(route.points, axis=0).T).sum() / 1000.0
        place = route.points[int(share * len(route.points))]
        right.annotate(f'{route.name}\n{length:.1f} km', place,
                       xytext=(12 if side == 'left' else -12, 0), textcoords='offset points',
                       ha=side, va='center', color=colour, path_effects=HALO, zorder=9)
    # The place further right has the label at the lower right, so that no line meets another place.
    corners = ((0.97, 0.3), 'right'), ((0.02, 0.91), 'left')
    for (corner, side), route in zip(
        corners, sorted(fixed, key=lambda route: -route.worst_place[0]), strict=True
    ):
        right.scatter(*route.worst_place, s=130, color=AMBUSHER, edgecolors='white', zorder=5)
        right.annotate(
            f'worst place of\nthe {route.name}:\nloss {route.loss:.2f}', route.worst_place,
            xytext=corner, textcoords='axes fraction', ha=side, va='center', ma='left',
            path_effects=HALO, zorder=9,
            arrowprops={'arrowstyle': '-', 'relpos': (0.5, 0.0 if side == 'left' else 1.0),
                        'linewidth': 1.2},
        )
    figure.colorbar(risk, ax=[left, right], label=LOSS, location='bottom', shrink=0.5, aspect=40)
    figure.legend(handles=[SITES, SECURED_AREA, OBSTACLE], loc='outside lower center', ncols=2,
                  frameon=False)
    return figure


def fixed_routes(strategy: Strategy) -> list[FixedRoute]:
    """Return the shortest and the safest route, each with its worst ambush once it is known."""
    game, points, measures = strategy.game, strategy.network.points, evaluate(strategy)
    routes = []
    for name, row, route in (
        ('shortest route', measures['energy_efficient'], energy_efficient_route(game)),
        ('safest route', measures['risk_avoidance'], risk_avoiding_route(game)),
    ):
        law = law_of(game, route_strategy(strategy.network, route))
        _, worst = largest_product(game.loss[game.sites], game.entering, law)
        place = points[game.sites[worst]]
        routes.append(FixedRoute(name, points[route], place, row.v_repeated))
    return routes
