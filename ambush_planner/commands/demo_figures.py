"""The demo's picture: random departures next to routes that never change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from .. import figures
from ..arrays import FloatArray
from ..colours import AMBUSHER, OBSTACLE
from ..figures import SECURED_DASHES
from ..game.hits import largest_losses
from ..game.route_sampler import route_strategy
from ..game.strategy import Strategy
from ..maps.risk_map import RiskMap
from ..planning.evaluation import energy_efficient_route, evaluate, risk_avoiding_route

# Colours and dashes of the fixed routes.
FIXED = (('#332288', '-'), ('#cc3377', (0, (3, 1.2))))


@dataclass(frozen=True, eq=False)
class FixedRoute:
    """A route (K, 2) [m] that is driven every time, and the place (2,) of its worst ambush."""

    label: str
    points: FloatArray
    worst_place: FloatArray


def routes_figure(risk_map: RiskMap, strategy: Strategy, routes: Sequence[FloatArray],
                  fixed: Sequence[FixedRoute], secured_radius: float) -> Figure:
    """Draw the routes (K, 2) of departures on the left and the fixed routes on the right."""
    figure = Figure(figsize=(15.0, 9.6), layout='compressed')
    # The legend is below the panels.
    figure.get_layout_engine().set(rect=(0.0, 0.045, 1.0, 0.955), w_pad=0.08)
    left, right = figure.subplots(1, 2)
    network = strategy.network
    start, goal = network.points[[network.source, network.target]]
    for axes, title in (
        (left, f'{len(routes)} departures of the random convoy\nAn ambusher who knows the strategy '
               f'causes a mean loss of {strategy.value:.2f} at most'),
        (right, 'The same route every day\nAn ambusher who has seen it waits at the worst place'),
    ):
        figures.frame(axes, risk_map, title)
        risk = figures.draw_risk_map(axes, risk_map)
        figures.draw_secured(axes, [start, goal], secured_radius)
        figures.draw_ends(axes, start, goal)
    figures.draw_routes(left, routes)
    handles: list[Line2D | Patch] = []
    for route, (colour, dashes) in zip(fixed, FIXED, strict=True):
        handles += right.plot(*route.points.T, color=colour, linestyle=dashes, linewidth=2.6,
                              label=route.label, zorder=4)
        right.scatter(*route.worst_place, s=170, color=AMBUSHER, edgecolors='white',
                      linewidths=0.9, zorder=5)
    handles += [
        Line2D([], [], linestyle='none', marker='o', markersize=10, color=AMBUSHER,
               markeredgecolor='white', label='ambush on a known route'),
        Line2D([], [], color='black', linewidth=1.2, linestyle=SECURED_DASHES,
               label='secured ground: nobody can wait here'),
        Patch(color=OBSTACLE, label='obstacle'),
    ]
    figure.colorbar(risk, ax=[left, right], location='bottom', shrink=0.4, aspect=40,
                    label='loss if the convoy is ambushed here')
    figure.legend(handles=handles, loc='lower center', ncol=len(handles), handlelength=2.6)
    return figure


def fixed_routes(strategy: Strategy) -> list[FixedRoute]:
    """Return the shortest and the safest route, each with its worst ambush once it is known."""
    game, points, measures = strategy.game, strategy.network.points, evaluate(strategy)
    routes = []
    for name, row, route in (
        ('shortest route', measures['energy_efficient'], energy_efficient_route(game)),
        ('safest route', measures['risk_avoidance'], risk_avoiding_route(game)),
    ):
        label = f'{name} ({row.expected_length / 1000:.1f} km, loss {row.v_repeated:.2f})'
        _, worst = largest_losses(game, route_strategy(strategy.network, route))
        routes.append(FixedRoute(label, points[route], points[game.sites[worst[0]]]))
    return routes
