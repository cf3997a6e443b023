"""The report's pictures, one thing each: the ground, the strategy, the routes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from io import BytesIO

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter

from ..core.arrays import FloatArray
from ..core.risk_map import RiskMap
from ..core.strategy import Strategy
from .figures import (
    AMBUSHER,
    OBSTACLE,
    SECURED_DASHES,
    draw_ambush_sites,
    draw_edges,
    draw_ends,
    draw_risk_map,
    draw_routes,
    draw_secured,
    frame,
)

# Small, so that letters are large, also where a phone shows the picture.
WIDTH = 7.0
DOTS_PER_INCH = 140
# On the first picture risk is all there is to see; on the others it stands back, in grey.
DANGER = LinearSegmentedColormap.from_list('danger', ['#fffdf5', '#fdd49e', '#ef6548', '#990000'])
FADED = 0.65
# Of routes that have no colour of their own.
THIN = '#33557f'


def as_png(figure: Figure) -> bytes:
    """Return the picture as a PNG file, without the name of the program that made it."""
    stream = BytesIO()
    figure.savefig(
        stream,
        format='png',
        dpi=DOTS_PER_INCH,
        bbox_inches='tight',
        pad_inches=0.08,
        metadata={'Software': None},
    )
    return stream.getvalue()


def ground_figure(risk_map: RiskMap, strategy: Strategy, secured_radius: float) -> Figure:
    """The map: what an ambush would cost where, start and goal, ground that is held."""
    figure, axes = _panel(risk_map, 1.3)
    risk = _ground(axes, risk_map, strategy, secured_radius)
    risk.set(cmap=DANGER.with_extremes(bad=OBSTACLE), alpha=1.0)
    _bar(figure, axes, risk, 'loss if the convoy is ambushed here: the darker, the worse')
    _legend(figure, [_obstacles(1.0), *_secured(secured_radius)])
    return figure


def strategy_figure(risk_map: RiskMap, strategy: Strategy, secured_radius: float) -> Figure:
    """Where the convoy may drive, and how likely; where the ambusher waits."""
    figure, axes = _panel(risk_map, 1.3)
    _ground(axes, risk_map, strategy, secured_radius)
    edges = draw_edges(axes, strategy.network, strategy.edge_probability)
    waits = []
    if strategy.value > 0.0:
        draw_ambush_sites(axes, strategy.network, strategy.ambush_probability)
        look = {'marker': 'o', 'markersize': 10, 'color': AMBUSHER, 'markeredgecolor': 'white'}
        label = 'here the best ambusher waits'
        waits = [Line2D([], [], linestyle='none', label=label, **look)]
    bar = _bar(figure, axes, edges, 'chance that a departure drives here')
    bar.ax.xaxis.set_major_formatter(FuncFormatter(lambda p, _: f'{100.0 * p:.3g} %'))
    _legend(figure, [*waits, _obstacles(), *_secured(secured_radius)])
    return figure


def routes_figure(
    risk_map: RiskMap,
    strategy: Strategy,
    routes: Sequence[FloatArray],
    colours: Mapping[int, str],
    secured_radius: float,
) -> Figure:
    """The routes (K, 2) of departures: those in ``colours`` (by index) named, others thin."""
    figure, axes = _panel(risk_map, 0.9)
    _ground(axes, risk_map, strategy, secured_radius)
    lines = []
    for number, route in enumerate(routes):
        if number in colours:
            draw_routes(axes, [route], [colours[number]])
            lines.append(Line2D([], [], color=colours[number], linewidth=1.9, label=number + 1))
        else:
            axes.plot(*route.T, color=THIN, linewidth=0.8, alpha=0.5, zorder=3)
    if len(lines) < len(routes):
        lines.append(Line2D([], [], color=THIN, linewidth=0.8, label='earlier ones'))
    _legend(figure, [*lines, _obstacles(), *_secured(secured_radius)], across=5)
    return figure


def _panel(risk_map: RiskMap, room: float) -> tuple[Figure, Axes]:
    """A picture as high as the map demands, within reason, and ``room`` for bar and legend."""
    width, height = risk_map.size
    high = float(np.clip(WIDTH * height / width, 0.35 * WIDTH, 1.4 * WIDTH)) + room
    figure = Figure(figsize=(WIDTH, high), layout='constrained')
    return figure, figure.add_subplot()


def _ground(
    axes: Axes, risk_map: RiskMap, strategy: Strategy, secured_radius: float
) -> AxesImage:
    frame(axes, risk_map, '')
    risk = draw_risk_map(axes, risk_map)
    risk.set_alpha(FADED)
    network = strategy.network
    start, *stops, goal = network.points[[network.source, *network.stops, network.target]]
    if secured_radius > 0.0:
        draw_secured(axes, [start, *stops, goal], secured_radius)
    draw_ends(axes, start, goal, stops)
    return risk


def _bar(figure: Figure, axes: Axes, colours: ScalarMappable, label: str) -> Colorbar:
    return figure.colorbar(
        colours, ax=axes, location='bottom', label=label, shrink=0.8, aspect=45, pad=0.02
    )


def _legend(figure: Figure, handles: list[Line2D | Patch], across: int = 3) -> None:
    """Lines of ``across`` entries below everything else."""
    columns = min(len(handles), across)
    room = 0.1 + 0.2 * -(-len(handles) // columns)
    bottom = room / figure.get_size_inches()[1]
    figure.get_layout_engine().set(rect=(0.0, bottom, 1.0, 1.0 - bottom))
    figure.legend(handles=handles, loc='lower center', ncol=columns, frameon=False)


def _obstacles(alpha: float = FADED) -> Patch:
    return Patch(color=OBSTACLE, alpha=alpha, linewidth=0.0, label='impassable')


def _secured(radius: float) -> list[Line2D]:
    label = 'held ground: nobody can wait here'
    line = Line2D([], [], color='black', linewidth=1.2, linestyle=SECURED_DASHES, label=label)
    return [line] if radius > 0.0 else []
