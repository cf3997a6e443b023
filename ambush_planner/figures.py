# SPDX-License-Identifier: Apache-2.0
"""Layers of pictures of strategies and routes, above the map of ``map_figures``.

The convoy is blue, unless routes are drawn over a pale network, and the ambusher is orange.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap, ListedColormap, LogNorm
from matplotlib.image import AxesImage
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.ticker import FuncFormatter
from matplotlib.transforms import ScaledTranslation, Transform
from scipy.spatial import cKDTree

from . import colours
from .arrays import FloatArray
from .map_figures import HALO, LOSS, WIDTH, colour_bar, draw_map, ground_key
from .maps.risk_map import RiskMap
from .routes.shared_roads import stripes

if TYPE_CHECKING:
    from .game.strategy import TripStrategy

PROBABILITY = LinearSegmentedColormap.from_list('probability', colours.PROBABILITY)
# Minimum probability of edges in pictures, and of sites relative to the likeliest one.
MIN_PROBABILITY, MIN_SITE = 1e-3, 0.01
SECURED_DASHES = (0, (4, 3))
PASSES = 'probability that the convoy passes'
PERCENT = FuncFormatter(lambda value, _: f'{100.0 * value:g} %')
ROUTE_WIDTH, STRIPE = 1.9, 1.6  # of a route, and more for each route on it [points]
# Maximum number of routes with numbers; line styles, one after another when all colours are used.
MAX_NUMBERED = 20
_DASHES = ('solid', 'dashed', 'dotted', 'dashdot')
# Size of a number, and room for one on a route, as shares of the picture.
BADGE, ROOM = 0.04, 0.07
# Minimum radius of the secured area that a mark does not cover, as a share of the picture.
SEEN = 0.015
# Legend entries.
SITES = Line2D([], [], linestyle='none', marker='o', markersize=9, color=colours.AMBUSHER,
               markeredgecolor='white', label='ambush site: the larger, the likelier')
SECURED_AREA = Line2D([], [], color='black', linewidth=1.2, linestyle=SECURED_DASHES,
                     label='secured area: nobody can wait here')
START = Line2D([], [], linestyle='none', marker='s', markersize=8, color=colours.ENDS,
               markeredgecolor='black', label='start')
GOAL = Line2D([], [], linestyle='none', marker='*', markersize=13, color=colours.ENDS,
              markeredgecolor='black', label='goal')
# Distance of a legend from the map above it, for its ticks and labels [inches].
BELOW = 0.5
NETWORK = Line2D([], [], color=colours.NETWORK, linewidth=2.5,
                 label='the convoy may drive here: the wider, the likelier')


def draw_ground(axes: Axes, trip: TripStrategy, risk_map: RiskMap, title: str) -> AxesImage:
    """Draw the map with start, stops, goal and secured area of a strategy."""
    image = draw_map(axes, risk_map, title, avoid=places_of(trip))
    draw_ends(axes, trip)
    return image


def draw_network(axes: Axes, trip: TripStrategy, below_routes: bool = False) -> LineCollection:
    """Draw how likely the convoy drives where; below routes in one pale colour."""
    edges, p = trip.ground_uses
    pale = {'cmap': ListedColormap([colours.NETWORK])} if below_routes else {}
    return draw_segments(axes, trip.game.network.points[edges], p, **pale)


def probability_scale(probability: npt.ArrayLike) -> LogNorm:
    """Return a logarithmic colour scale up to the largest probability."""
    largest = float(np.max(probability, initial=0.0))
    return LogNorm(MIN_PROBABILITY, max(largest, 2.0 * MIN_PROBABILITY), clip=True)


def draw_segments(axes: Axes, segments: FloatArray, probability: npt.ArrayLike,
                  scale: LogNorm | None = None, widths: tuple[float, float] = (0.5, 3.0),
                  cmap: Colormap = PROBABILITY) -> LineCollection:
    """Draw segments (K, 2, 2); likelier ones are darker, wider and on top."""
    p = np.asarray(probability, dtype=np.float64)
    scale = scale or probability_scale(p)
    shown = np.flatnonzero(p >= MIN_PROBABILITY)
    shown = shown[np.argsort(p[shown], kind='stable')]
    linewidths = widths[0] + (widths[1] - widths[0]) * np.asarray(scale(p[shown])) ** 2
    lines = LineCollection(segments[shown], array=p[shown], cmap=cmap, norm=scale,
                           linewidths=linewidths, capstyle='round', zorder=2)
    axes.add_collection(lines)
    return lines


def draw_ends(axes: Axes, trip: TripStrategy, named: bool = True, size: float = 1.0) -> None:
    """Mark start, stops and goal of a trip, and its secured area.

    ``size`` is that of the marks, as a share of the usual area.
    """
    options = trip.game.options
    secured = [(x, y) for x, y, _ in options.secured_places]
    draw_places(axes, places_of(trip), options.secured_distance, named, size,
                np.array([*secured, *sites_of(trip)[0]]))
    for x, y, radius in options.secured_places:
        _circle(axes, (x, y), radius)


def places_of(trip: TripStrategy) -> FloatArray:
    """Start, stops and goal (P, 2) [m]."""
    nodes = [trip.legs[0].network.source, *(leg.network.target for leg in trip.legs)]
    return trip.game.network.points[nodes]


def draw_places(axes: Axes, places: FloatArray, secured_distance: float, named: bool = True,
                size: float = 1.0, avoid: FloatArray | None = None) -> None:
    """Mark start (square), stops (diamonds) and goal (star) with names; circle the secured area.

    Names are above or below, where they cover fewer of the points (K, 2) to ``avoid``.
    """
    stops = [('D', 70, f'stop {k}') for k in range(1, len(places) - 1)]
    marks = [('s', 90, 'start'), *stops, ('*', 260, 'goal')]
    if np.array_equal(places[0], places[-1]):  # a round trip
        places, marks = places[:-1], [('*', 260, 'start and goal'), *stops]
    for (x, y), (marker, area, name) in zip(places, marks, strict=True):
        axes.scatter(x, y, s=size * area, marker=marker, color=colours.ENDS,
                     edgecolors='black', zorder=7)
        if named:
            _name(axes, (x, y), name, places if avoid is None else avoid)
        if secured_distance > 0.0:
            _circle(axes, (x, y), secured_distance)


def _name(axes: Axes, xy: tuple[float, float], name: str, avoid: FloatArray) -> None:
    """Write the name of a mark below it, or above it if fewer points (K, 2) are there."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    wide, tall = 0.02 * len(name) * (right - left), 0.07 * (right - left)
    inwards = xy[0] + wide > right
    x, y = (avoid - xy).T
    covered = (np.abs(x) < 0.3 * wide) | ((0.0 < -x if inwards else 0.0 < x) & (np.abs(x) < wide))
    above, below = (np.sum(covered & (0.0 < up) & (up < tall)) for up in (y, -y))
    up = xy[1] + tall < high and (above < below or xy[1] - tall < low)
    axes.annotate(name, xy, xytext=(4 if inwards else -4, 8 if up else -8),
                  textcoords='offset points', ha='right' if inwards else 'left',
                  va='bottom' if up else 'top', weight='bold', path_effects=HALO, zorder=10)


def _circle(axes: Axes, centre: tuple[float, float], radius: float) -> None:
    axes.add_patch(Circle(centre, radius, fill=False, edgecolor='black', linewidth=1.2,
                          linestyle=SECURED_DASHES, zorder=6))


def draw_routes(axes: Axes, routes: Sequence[FloatArray],
                avoid: Iterable[FloatArray] = ()) -> tuple[Line2D, ...]:
    """Draw routes (K, 2), each with its number far from the others and the places to ``avoid``.

    Those that share a road are stripes of one line. More than ``MAX_NUMBERED`` routes have the
    first colour and no numbers. Returns a handle for a legend with ``HandlerTuple``.
    """
    styles = [route_style(k) for k in range(len(routes))]
    if len(routes) > MAX_NUMBERED:
        styles = styles[:1]
        for route in routes:
            axes.plot(*route.T, color=styles[0]['color'], linewidth=1.1, alpha=0.7, zorder=4)
    else:
        draw_stripes(axes, routes, styles)
    if 1 < len(routes) <= MAX_NUMBERED:
        for k, place in enumerate(badge_places(routes, *avoid)):
            number_badge(axes, k + 1, place, styles[k]['color'])
    return tuple(Line2D([], [], color=style['color'], linewidth=ROUTE_WIDTH)
                 for style in styles[:len(colours.ROUTES)])


def route_style(k: int) -> dict[str, Any]:
    """Colour and dashes of the route with index ``k``."""
    return {'color': colours.ROUTES[k % len(colours.ROUTES)], 'path_effects': HALO,
            'linestyle': _DASHES[k // len(colours.ROUTES) % len(_DASHES)]}


def draw_stripes(axes: Axes, routes: Sequence[FloatArray], styles: Sequence[Any]) -> None:
    """Draw routes (K, 2), wider where later ones, drawn on top, follow the same road."""
    for pieces, style in zip(stripes(routes), styles, strict=True):
        for piece, over in pieces:
            axes.plot(*piece.T, linewidth=ROUTE_WIDTH + STRIPE * over, zorder=4,
                      solid_joinstyle='round', **style)


def badge_places(routes: Sequence[FloatArray], *avoid: FloatArray) -> list[FloatArray]:
    """A place for the number of each route (K, 2): on it, far from the others and other numbers.

    Numbers also keep away from the ends of routes, and from the places to ``avoid``.
    """
    size = float(np.ptp(np.concatenate(routes), axis=0).max()) or 1.0
    taken = [*(route[end] for route in routes for end in (0, -1)), *avoid]
    places = []
    for k, route in enumerate(routes):
        others = [each for other, each in enumerate(routes) if other != k] or [route[[0, -1]]]
        away = cKDTree(np.concatenate(others)).query(route)[0]
        free = cKDTree(np.array(taken)).query(route)[0]
        # First of all room for the badge; then far from the other routes.
        best = int((np.minimum(free, ROOM * size) * 10.0 + away + 0.1 * free).argmax())
        places.append(route[best])
        taken.append(route[best])
    return places


def number_badge(axes: Axes, number: int, xy: FloatArray, colour: str,
                 spot: FloatArray | None = None) -> None:
    """Write a number in a circle of a route's colour, at its place or at a spot near it."""
    line = {'arrowstyle': '-', 'color': colour, 'shrinkA': 0.0, 'shrinkB': 0.0}
    axes.annotate(str(number), tuple(xy), tuple(xy if spot is None else spot), ha='center',
                  arrowprops=None if spot is None else line, va='center', fontsize=8, weight='bold',
                  zorder=9, bbox={'boxstyle': 'circle,pad=0.25', 'facecolor': 'white',
                                  'edgecolor': colour, 'linewidth': 1.6})


def draw_sites(axes: Axes, trip: TripStrategy, size: float = 1.0) -> None:
    """Draw where the ambusher waits, each dot's area in proportion to its probability.

    ``size`` is a factor for all areas.
    """
    places, shares = sites_of(trip)
    axes.scatter(*places.T, s=np.maximum(110.0 * size * shares, 6.0), color=colours.AMBUSHER,
                 edgecolors='white', linewidths=0.3 + 0.4 * np.sqrt(shares), zorder=8)


def sites_of(trip: TripStrategy) -> tuple[FloatArray, FloatArray]:
    """Return the ambush sites (K, 2), and their probabilities (K,) relative to the likeliest."""
    q = trip.ambusher.q
    shown = np.flatnonzero(q > MIN_SITE * q.max())
    return trip.game.network.points[shown], q[shown] / q.max()


def marks_of(trip: TripStrategy) -> FloatArray:
    """Places without numbers (K, 2): start, stops, goal, and the likelier ambush sites."""
    sites, shares = sites_of(trip)
    return np.concatenate((places_of(trip), sites[shares > 0.1]))


def draw_strategy(axes: Axes | None, trip: TripStrategy, risk_map: RiskMap | None = None,
                  routes: Sequence[FloatArray] = (), covered: float = 1.0,
                  key: Sequence[Any] = ()) -> Axes:
    """Draw a trip's strategies on their map, or alone, with ambush sites; None: on new axes.

    ``covered`` is the share of departures that an ambush at one of the times covers. The legend
    also has the entries of ``key``.
    """
    if axes is None:
        from matplotlib import pyplot

        _, axes = pyplot.subplots(figsize=(WIDTH, 6.2), layout='compressed')
    longer = trip.expected_length / trip.shortest_length
    title = (f'The best ambush causes a mean loss of {trip.value * covered:#.3g}\n'
             f'Along the network, routes are on average {longer:.2f} times the shortest')
    key = list(key)
    if risk_map is not None:
        colour_bar(axes, draw_ground(axes, trip, risk_map, title), LOSS)
        key += ground_key(risk_map)
    else:
        axes.set(aspect='equal', xlabel='x [m]', ylabel='y [m]', title=title)
        draw_ends(axes, trip)
    edges = draw_network(axes, trip, below_routes=bool(routes))
    if routes:
        lines = draw_routes(axes, routes, marks_of(trip))
        key = [NETWORK, lines, *key]
    else:
        colour_bar(axes, edges, PASSES, int(risk_map is not None), format=PERCENT)
    if trip.value > 0.0:
        draw_sites(axes, trip)
        key = [SITES, *key]
    if trip.game.secured.radii.max(initial=0.0) > SEEN * np.ptp(axes.get_xlim()):
        key = [*key, SECURED_AREA]
    drawn = f'{len(routes)} route{"s" * (len(routes) != 1)} drawn'
    axes.legend(key, [drawn if isinstance(each, tuple) else each.get_label() for each in key],
                handler_map={tuple: HandlerTuple(None, 0.0)}, loc='upper left', frameon=False,
                borderaxespad=0.0, bbox_to_anchor=(0.0, -BELOW), bbox_transform=inches(axes))
    return axes


def inches(axes: Axes) -> Transform:
    """Inches from the lower left corner of axes."""
    return axes.figure.dpi_scale_trans + ScaledTranslation(0.0, 0.0, axes.transAxes)
