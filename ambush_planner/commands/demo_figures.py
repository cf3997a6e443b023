"""The demo's picture: departures beside routes that never change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ..arrays import FloatArray
from ..game.strategy import Strategy
from ..maps.risk_map import RiskMap
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
    """Left: the routes (K, 2) of departures. Right: routes of planners that leave no choice."""
    figure = Figure(figsize=(15.0, 9.6), layout='compressed')
    # Room for the legend below.
    figure.get_layout_engine().set(rect=(0.0, 0.045, 1.0, 0.955), w_pad=0.08)
    left, right = figure.subplots(1, 2)
    loss = f'Whoever knows the strategy causes a mean loss of {strategy.value:.2f} at most'
    frame(left, risk_map, f'{len(routes)} departures of the random convoy\n{loss}')
    frame(
        right,
        risk_map,
        'The same route every day\nWhoever has seen it waits where it hurts most',
    )
    draw_routes(left, routes)
    handles: list[Line2D | Patch] = draw_fixed_routes(right, fixed)
    dot = {'marker': 'o', 'markersize': 10, 'color': AMBUSHER, 'markeredgecolor': 'white'}
    handles.append(
        Line2D([], [], linestyle='none', label='ambush on a route that is known', **dot)
    )
    if secured_radius > 0.0:
        handles.append(Line2D(
            [], [], color='black', linewidth=1.2, linestyle=SECURED_DASHES,
            label='secured ground: nobody can wait here',
        ))
    handles.append(Patch(color=OBSTACLE, label='obstacle'))
    network = strategy.network
    start, *stops, goal = network.points[[network.source, *network.stops, network.target]]
    for axes in (left, right):
        risk = draw_risk_map(axes, risk_map)
        if secured_radius > 0.0:
            draw_secured(axes, [start, *stops, goal], secured_radius)
        draw_ends(axes, start, goal, stops)
    figure.colorbar(
        risk,
        ax=[left, right],
        location='bottom',
        label='loss if the convoy is ambushed here',
        shrink=0.4,
        aspect=40,
    )
    figure.legend(handles=handles, loc='lower center', ncol=len(handles), handlelength=2.6)
    return figure


def draw_fixed_routes(axes: Axes, routes: Sequence[FixedRoute]) -> list[Line2D]:
    """Draw routes that are driven every time, and where the ambusher then waits."""
    lines = []
    for route, (colour, dashes) in zip(routes, FIXED, strict=False):
        lines += axes.plot(
            *route.points.T,
            color=colour,
            linestyle=dashes,
            linewidth=2.6,
            label=route.label,
            zorder=4,
        )
        axes.scatter(
            *route.worst_place, s=170, color=AMBUSHER, edgecolors='white', linewidths=0.9, zorder=5
        )
    return lines
