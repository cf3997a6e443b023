"""The demo's picture: random departures next to routes that never change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ..arrays import FloatArray
from ..game.strategy import Strategy
from ..maps.risk_map import RiskMap
from ..planning.evaluation import energy_efficient_route, evaluate, risk_avoiding_route
from .figures import (
    AMBUSHER,
    OBSTACLE,
    SECURED_DASHES,
    draw_ends,
    draw_risk_map,
    draw_routes,
    draw_secured,
    frame,
)

# Colours and dashes of the fixed routes.
FIXED = (('#332288', '-'), ('#cc3377', (0, (3, 1.2))), ('#117733', (0, (1, 1))))


@dataclass(frozen=True, eq=False)
class FixedRoute:
    """A route (K, 2) [m] that is driven every time, and the place (2,) of its worst ambush."""

    label: str
    points: FloatArray
    worst_place: FloatArray


def routes_figure(
    risk_map: RiskMap,
    strategy: Strategy,
    routes: Sequence[FloatArray],
    fixed: Sequence[FixedRoute],
    secured_radius: float = 0.0,
) -> Figure:
    """Draw the routes (K, 2) of departures on the left and the fixed routes on the right."""
    figure = Figure(figsize=(15.0, 9.6), layout='compressed')
    # The legend is below the panels.
    figure.get_layout_engine().set(rect=(0.0, 0.045, 1.0, 0.955), w_pad=0.08)
    left, right = figure.subplots(1, 2)
    frame(left, risk_map, f'{len(routes)} departures of the random convoy\nAn ambusher who knows '
                          f'the strategy causes a mean loss of {strategy.value:.2f} at most')
    frame(right, risk_map, 'The same route every day\n'
                           'An ambusher who has seen it waits at the worst place')
    network = strategy.network
    start, *stops, goal = network.points[[network.source, *network.stops, network.target]]
    for axes in (left, right):
        risk = draw_risk_map(axes, risk_map)
        if secured_radius > 0.0:
            draw_secured(axes, [start, *stops, goal], secured_radius)
        draw_ends(axes, start, goal, stops)
    draw_routes(left, routes)
    handles: list[Line2D | Patch] = draw_fixed_routes(right, fixed)
    handles.append(Line2D([], [], linestyle='none', marker='o', markersize=10, color=AMBUSHER,
                          markeredgecolor='white', label='ambush on a known route'))
    if secured_radius > 0.0:
        handles.append(Line2D([], [], color='black', linewidth=1.2, linestyle=SECURED_DASHES,
                              label='secured ground: nobody can wait here'))
    handles.append(Patch(color=OBSTACLE, label='obstacle'))
    figure.colorbar(risk, ax=[left, right], location='bottom', shrink=0.4, aspect=40,
                    label='loss if the convoy is ambushed here')
    figure.legend(handles=handles, loc='lower center', ncol=len(handles), handlelength=2.6)
    return figure


def draw_fixed_routes(axes: Axes, routes: Sequence[FixedRoute]) -> list[Line2D]:
    """Draw fixed routes and their worst ambushes; return the lines for a legend."""
    lines = []
    for route, (colour, dashes) in zip(routes, FIXED, strict=False):
        lines += axes.plot(*route.points.T, color=colour, linestyle=dashes, linewidth=2.6,
                           label=route.label, zorder=4)
        axes.scatter(*route.worst_place, s=170, color=AMBUSHER, edgecolors='white', linewidths=0.9,
                     zorder=5)
    return lines


def fixed_routes(strategy: Strategy) -> list[FixedRoute]:
    """Return the shortest and the safest route, each with its worst ambush once it is known."""
    game, points, measures = strategy.game, strategy.network.points, evaluate(strategy)
    routes = []
    for name, row, route in (
        ('shortest route', measures['energy_efficient'], energy_efficient_route(game)),
        ('safest route', measures['risk_avoidance'], risk_avoiding_route(game)),
    ):
        label = f'{name} ({row.expected_length / 1000:.1f} km, loss {row.v_repeated:.2f})'
        worst = route[np.argmax(game.loss[route])]
        routes.append(FixedRoute(label, points[route], points[worst]))
    return routes
