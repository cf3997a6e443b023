"""Layers of pictures of risk maps, strategies and routes.

Each ``draw_...`` function draws one layer on given axes, in world metres; ``frame`` sets the axes
to the map's extent, with ticks in km or m. Risk is grey, impassable ground black, the convoy blue
and the ambusher orange.
"""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Circle
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import FuncFormatter, MaxNLocator
from matplotlib.transforms import Affine2D

from .arrays import FloatArray
from .colours import AMBUSHER, OBSTACLE, ROUTES
from .maps.risk_map import RiskMap

if TYPE_CHECKING:
    from .game.strategy import Strategy

RISK = LinearSegmentedColormap.from_list('risk', ['#ffffff', '#848484'])
PROBABILITY = LinearSegmentedColormap.from_list(
    'probability', ['#7fb8e6', '#2f7fd0', '#1146b0', '#14075c']
)
# Minimum probability of edges in pictures.
LEAST_PROBABILITY = 1e-3
SECURED_DASHES = (0, (4, 3))
DOTS_PER_INCH = 140
HALO = [Stroke(linewidth=3.0, foreground='white'), Normal()]


def frame(axes: Axes, risk_map: RiskMap, title: str) -> None:
    """Give the axes the map's extent, equal scales, and ticks in km (m for maps under 2 km)."""
    (left, bottom), (right, top) = risk_map.bounds
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect='equal')
    unit, scale = ('km', 1000.0) if max(risk_map.size) >= 2000.0 else ('m', 1.0)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(nbins=7, steps=[1, 2, 5, 10]))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f'{value / scale:g}'))
    axes.set(xlabel=f'x [{unit}]', ylabel=f'y [{unit}]')
    axes.set_title(title, fontsize='large', loc='left', linespacing=1.4)


def draw_risk_map(axes: Axes, risk_map: RiskMap) -> AxesImage:
    """Draw losses in grey, the least one white, and obstacles in black."""
    width, height = risk_map.size
    x, y, yaw = risk_map.origin
    image = axes.imshow(np.ma.masked_array(risk_map.alpha, risk_map.obstacles), origin='lower',
                        extent=(0.0, width, 0.0, height), cmap=RISK.with_extremes(bad=OBSTACLE),
                        interpolation='nearest', zorder=0)
    image.set_transform(Affine2D().rotate(yaw).translate(x, y) + axes.transData)
    return image


def probability_scale(probability: npt.ArrayLike) -> LogNorm:
    """Return a logarithmic colour scale up to the largest probability."""
    largest = float(np.max(probability, initial=0.0))
    return LogNorm(LEAST_PROBABILITY, max(largest, 2.0 * LEAST_PROBABILITY), clip=True)


def draw_segments(axes: Axes, segments: FloatArray, probability: npt.ArrayLike,
                  scale: Normalize | None = None,
                  widths: tuple[float, float] = (0.5, 3.0)) -> LineCollection:
    """Draw segments (K, 2, 2); likelier ones are darker, wider and on top."""
    p = np.asarray(probability, dtype=np.float64)
    scale = scale or probability_scale(p)
    shown = np.flatnonzero(p >= LEAST_PROBABILITY)
    shown = shown[np.argsort(p[shown], kind='stable')]
    linewidths = widths[0] + (widths[1] - widths[0]) * np.asarray(scale(p[shown])) ** 2
    lines = LineCollection(segments[shown], array=p[shown], cmap=PROBABILITY, norm=scale,
                           linewidths=linewidths, capstyle='round', zorder=2)
    axes.add_collection(lines)
    return lines


def draw_ends(axes: Axes, start: npt.ArrayLike, goal: npt.ArrayLike,
              stops: npt.ArrayLike = ()) -> None:
    """Mark the start with a square, the goal with a star, stops with diamonds, with names."""
    marks = [(start, 's', 90, 'start'), (goal, '*', 260, 'goal')]
    marks += [(stop, 'D', 70, f'stop {k}') for k, stop in enumerate(np.asarray(stops), start=1)]
    for place, marker, size, name in marks:
        x, y = np.asarray(place, dtype=np.float64)
        axes.scatter(x, y, s=size, marker=marker, color='#ffd92f', edgecolors='black', zorder=7)
        axes.annotate(name, (x, y), xytext=(0, -10), textcoords='offset points', ha='center',
                      va='top', weight='bold', path_effects=HALO, zorder=8)


def draw_secured(axes: Axes, centres: npt.ArrayLike, radius: float) -> None:
    """Draw circles of ``radius`` [m] around places (K, 2) where nobody can wait."""
    for centre in np.asarray(centres, dtype=np.float64):
        axes.add_patch(Circle(centre, radius, fill=False, edgecolor='black', linewidth=1.2,
                              linestyle=SECURED_DASHES, zorder=6))


def draw_routes(axes: Axes, routes: Sequence[FloatArray]) -> None:
    """Draw routes (K, 2) as lines in different colours with white edges."""
    for k, route in enumerate(routes):
        axes.plot(*np.asarray(route).T, color=ROUTES[k % len(ROUTES)], linewidth=1.9,
                  path_effects=HALO, solid_joinstyle='round', zorder=4)


def draw_strategy(axes: Axes | None, strategy: Strategy, risk_map: RiskMap | None = None,
                  routes: Sequence[FloatArray] = ()) -> Axes:
    """Draw a strategy on its map, or alone, with ambush sites; on new axes of pyplot if None."""
    if axes is None:
        from matplotlib import pyplot

        _, axes = pyplot.subplots(figsize=(9.0, 8.0), layout='constrained')
    network, q = strategy.network, strategy.ambush_probability
    unit = strategy.network.travel_unit
    title = (f'Value {strategy.value:.3g}, mean length {strategy.expected_length:.0f} {unit}, '
             f'{strategy.expected_length / strategy.shortest_length:.2f} times the shortest')
    if risk_map is not None:
        frame(axes, risk_map, title)
        draw_risk_map(axes, risk_map)
    else:
        axes.set(aspect='equal', xlabel='x [m]', ylabel='y [m]', title=title)
    edges = draw_segments(axes, network.points[network.edges], strategy.edge_probability)
    axes.figure.colorbar(edges, ax=axes, shrink=0.6, label='probability that the convoy passes')
    if strategy.value > 0.0:
        share = q / q.max()
        waits = share > LEAST_PROBABILITY
        axes.scatter(*network.points[waits].T, s=90.0 * share[waits], color=AMBUSHER,
                     edgecolors='white', linewidths=0.6, zorder=5)
    draw_routes(axes, routes)
    ends = network.points[[network.source, network.target]]
    stops = network.points[network.stops]
    held = strategy.game.options.held_radius
    if held > 0.0:
        draw_secured(axes, [*ends, *stops], held)
    draw_ends(axes, ends[0], ends[1], stops)
    return axes


def as_png(figure: Figure) -> bytes:
    """Return the picture as a PNG file, without the name of the drawing program."""
    stream = BytesIO()
    figure.savefig(stream, format='png', dpi=DOTS_PER_INCH, bbox_inches='tight', pad_inches=0.08,
                   metadata={'Software': None})
    return stream.getvalue()
