# SPDX-License-Identifier: Apache-2.0
"""Pictures of risk maps, on which other layers are drawn.

Each ``draw_...`` function draws one layer on given axes, in world metres; ``draw_map`` comes
first, those of ``figures`` follow. Risk is grey, the darker the more dangerous; obstacles are
black, and they and unknown ground are hatched.
Pictures are at most ``WIDTH`` inches wide: text of 9 points has 16 pixels on a page of 900, and 7
on a telephone of 400.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from io import BytesIO
from textwrap import fill
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Patch
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import FuncFormatter, MaxNLocator
from matplotlib.transforms import Affine2D

from . import colours
from .arrays import BoolArray, FloatArray, pooled
from .errors import InvalidCoordinates, shown
from .maps.coordinates import Coordinates
from .maps.risk_map import RiskMap
from .maps.road_file import RoadGraph

RISK = LinearSegmentedColormap.from_list('risk', colours.RISK)
# Maximum cells across a picture; of larger maps it shows blocks of cells (``RiskMap.coarser``).
MAX_CELLS = 1000
# The same for hatched ground.
MAX_HATCHED = 500
WIDTH = 7.0  # inches
ROAD = '0.4'
LOSS = 'loss if ambushed here'
DOTS_PER_INCH = 200
HALO = [Stroke(linewidth=3.0, foreground='white'), Normal()]
# Legend entries.
HATCH = '////'
with rc_context({'hatch.color': 'white', 'hatch.linewidth': 0.5}):
    OBSTACLE = Patch(facecolor=colours.OBSTACLE, hatch=HATCH, label='impassable')
UNKNOWN = Patch(facecolor='#f2f2f2', edgecolor='#a8a8a8', hatch='////', label='unknown')


def draw_map(axes: Axes, risk_map: RiskMap, title: str = '', box: npt.ArrayLike | None = None,
             avoid: FloatArray | None = None) -> AxesImage:
    """Draw the map, or the part in a box ((left, bottom), (right, top)), with scale and north.

    The scale bar keeps away from the places (K, 2) to ``avoid``.
    """
    frame(axes, risk_map, title, box)
    scale_bar(axes, avoid)
    north_arrow(axes, risk_map.crs)
    return draw_risk_map(axes, risk_map)


def frame(axes: Axes, risk_map: RiskMap, title: str = '', box: npt.ArrayLike | None = None,
          ticks: int = 4) -> None:
    """Give the axes the map's extent, or a box, equal scales, and up to about ``ticks`` ticks.

    Ticks are latitudes and longitudes, with a graticule, as they are not parallel to the edges; for
    maps without a coordinate system, the map's own coordinates in km (m for maps under 2 km).
    """
    (left, bottom), (right, top) = np.asarray(risk_map.bounds if box is None else box).tolist()
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect='equal')
    axes.set_title(title, fontsize='medium', loc='left', linespacing=1.4)
    axes.patch.set(facecolor=UNKNOWN.get_facecolor(), edgecolor=UNKNOWN.get_edgecolor(),
                   hatch=UNKNOWN.get_hatch())
    if system := _coordinates(risk_map.crs):
        bottom_edge, left_edge = (np.linspace((left, bottom), end)
                                  for end in ((right, bottom), (left, top)))
        box = np.array([(left, bottom), (right, bottom), (left, top), (right, top)])
        for axis, edge in ((axes.xaxis, bottom_edge), (axes.yaxis, left_edge)):
            _graticule(axes, system, box, *_degrees(axis, system, edge, ticks))
        axes.set(xlim=(left, right), ylim=(bottom, top))
        return
    unit, scale = ('km', 1000.0) if max(risk_map.size) >= 2000.0 else ('m', 1.0)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(nbins=ticks, steps=[1, 2, 5, 10]))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f'{value / scale:g}'))
    axes.set(xlabel=f'x [{unit}]', ylabel=f'y [{unit}]')


def _coordinates(crs: str | None) -> Coordinates | None:
    """Return the coordinate system; None if it is unknown, or pyproj is not installed."""
    try:
        return Coordinates(crs or '')
    except InvalidCoordinates:
        return None


def _graticule(axes: Axes, system: Coordinates, box: FloatArray, kind: int, step: float) -> None:
    """Draw the lines of round latitudes (kind 0) or longitudes (1) across the corners of a box."""
    low, high = (getattr(system.to_lat_lon(box), end)(axis=0) for end in ('min', 'max'))
    other = np.linspace(low[1 - kind], high[1 - kind], 30)
    for value in np.arange(np.ceil(low[kind] / step), high[kind] / step) * step:
        line = np.column_stack((np.full(30, value), other)[:: 1 - 2 * kind])
        axes.plot(*system.from_lat_lon(line).T, color='0.3', linewidth=0.5, alpha=0.5, zorder=1)


def _degrees(axis: Axis, system: Coordinates, edge: FloatArray, most: int) -> tuple[int, float]:
    """Mark round latitudes or longitudes, whichever vary, along an edge (K, 2) of the axes.

    Returns 0 for latitudes, 1 for longitudes, and their distance.
    """
    degrees = system.to_lat_lon(edge)
    kind = int(np.ptp(degrees, axis=0).argmax())
    order = degrees[:, kind].argsort()
    found = degrees[order, kind]
    ticks = MaxNLocator(nbins=most, steps=[1, 2, 5, 10]).tick_values(found[0], found[-1])
    step = float(ticks[1] - ticks[0])
    ticks = ticks[(found[0] <= ticks) & (ticks <= found[-1])]
    at = np.interp(ticks, found, edge[order, 'xy'.index(axis.axis_name)])
    signs = ('NS', 'EW')[kind]
    axis.set_ticks(at, [f'{abs(tick):.6g}°{signs[int(tick < 0.0)]}' for tick in ticks],
                   fontsize='small')
    return kind, step


def draw_risk_map(axes: Axes, risk_map: RiskMap) -> AxesImage:
    """Draw losses, the least one white, and obstacles."""
    risk_map = risk_map.coarser(MAX_CELLS)
    blocked = _blocked(risk_map)
    draw_cells(axes, risk_map, np.ma.masked_equal(blocked, False),
               cmap=ListedColormap([colours.OBSTACLE]))
    _hatch(axes, risk_map, blocked)
    return draw_cells(axes, risk_map, np.ma.masked_array(risk_map.alpha, risk_map.obstacles),
                      cmap=RISK)


def _hatch(axes: Axes, risk_map: RiskMap, marked: BoolArray) -> None:
    """Hatch the marked cells (H, W), other than lone ones."""
    block = -(-max(marked.shape) // MAX_HATCHED)
    inside = pooled(np.logical_and, marked, block)
    if not inside.any() or min(inside.shape) < 2:
        return
    rows, columns = inside.shape
    places = (np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) + 0.5)
    x, y = np.moveaxis(risk_map.to_world(places.reshape(-1, 2) * block * risk_map.resolution)
                       .reshape(rows, columns, 2), 2, 0)
    with rc_context({'hatch.color': 'white', 'hatch.linewidth': 0.5}):
        axes.contourf(x, y, inside.astype(float), levels=[0.5, 1.5], colors='none',
                      hatches=[HATCH], zorder=0)


def ground_key(risk_map: RiskMap) -> list[Patch]:
    """Return the entries of a legend for obstacles and unknown ground."""
    return ([OBSTACLE] * bool(_blocked(risk_map).any())
            + [UNKNOWN] * (risk_map.unknown is not None))


def _blocked(risk_map: RiskMap) -> BoolArray:
    if risk_map.unknown is None:
        return risk_map.obstacles
    return risk_map.obstacles & ~risk_map.unknown


def draw_cells(axes: Axes, risk_map: RiskMap, values: npt.NDArray[Any], **style: Any) -> AxesImage:
    """Draw values (H, W) of the map's cells, except masked ones."""
    width, height = risk_map.size
    x, y, yaw = risk_map.origin
    limits = axes.get_xlim(), axes.get_ylim()
    image = axes.imshow(values, origin='lower', extent=(0.0, width, 0.0, height),
                        interpolation='nearest', zorder=0, **style)
    image.set_transform(Affine2D().rotate(yaw).translate(x, y) + axes.transData)
    axes.set(xlim=limits[0], ylim=limits[1])
    return image


def scale_bar(axes: Axes, avoid: FloatArray | None = None) -> FloatArray:
    """Draw a bar of a round length in the corner farthest from the places (K, 2) to ``avoid``.

    Without places, that is the lower left one. Returns the rectangle (left, bottom, right, top)
    that it takes.
    """
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    ticks = MaxNLocator(nbins=1, steps=[1, 2, 5, 10]).tick_values(0.0, 0.3 * (right - left))
    length = float(ticks[ticks <= 0.3 * (right - left)][-1])
    aside, up = 0.04 * (right - left), 0.04 * (top - bottom)
    corners = np.array([(x, y) for y in (bottom + up, top - up)
                        for x in (left + aside, right - aside - length)])
    best = 0
    if avoid is not None:
        gaps = corners[:, None] + (0.5 * length, 0.0) - avoid
        best = int(np.hypot(*gaps.T).min(axis=0).argmax())
    x, y = corners[best]
    axes.plot((x, x + length), (y, y), color='black', linewidth=3.0, solid_capstyle='butt',
              path_effects=HALO, zorder=8)
    text = f'{length / 1000:g} km' if length >= 1000.0 else f'{length:g} m'
    axes.annotate(text, (x, y), xytext=(0, 4 if best < 2 else -4), textcoords='offset points',
                  va='baseline' if best < 2 else 'top', path_effects=HALO, zorder=8)
    tall = 0.05 * (right - left)
    return np.array((x, y - tall * (best >= 2), x + length, y + tall * (best < 2)))


def north_arrow(axes: Axes, crs: str | None) -> None:
    """Point to true north, right of the upper right corner, if the system is known."""
    system = _coordinates(crs)
    if system is None:
        return
    middle = np.array([np.mean(axes.get_xlim()), np.mean(axes.get_ylim())])
    north = system.from_lat_lon(system.to_lat_lon(middle) + (1e-4, 0.0)) - middle
    axes.annotate('N', (1.04, 0.84), xytext=20.0 * north / np.hypot(*north), ha='center',
                  va='center', xycoords='axes fraction', textcoords='offset points', weight='bold',
                  path_effects=HALO, zorder=8,
                  arrowprops={'arrowstyle': '<|-', 'color': 'black', 'linewidth': 1.4})


def colour_bar(axes: Axes, mappable: ScalarMappable, label: str, place: int = 0,
               **style: Any) -> None:
    """Explain a scale next to the axes, as tall as they are; ``place`` counts from the map."""
    bar = axes.inset_axes((1.09 + 0.2 * place, 0.0, 0.03, 1.0))
    axes.figure.colorbar(mappable, cax=bar, label=label, **style)


def draw_roads(axes: Axes, roads: RoadGraph) -> None:
    """Draw all roads as thin grey lines."""
    lines = LineCollection(roads.points[roads.pairs], colors=ROAD, linewidths=1.1, zorder=2,
                           capstyle='round', path_effects=[Stroke(linewidth=2.2,
                                                                  foreground='white'), Normal()])
    axes.add_collection(lines, autolim=False)


def as_png(figure: Figure, name: str = '', sources: Sequence[str] = (),
           tight: bool = True) -> bytes:
    """Return the picture as a PNG file, without the name of the drawing program.

    A ``tight`` one is cut to what is drawn, and says below its name, what it shows, and when it was
    drawn.
    """
    stream = BytesIO()
    if tight:
        figure.draw_without_rendering()
        figure.set_layout_engine('none')  # what follows moves nothing
        for legend in figure.legends:
            legend.set_bbox_to_anchor((0.0, 0.0, 1.0, 1.0), figure.transFigure)
        corner = figure.transFigure.inverted().transform(
            figure.dpi_scale_trans.transform(figure.get_tightbbox().min))
        what = '; '.join(filter(None, (': '.join(filter(None, (
            shown(name), ', '.join(map(shown, sources))))),
            f'drawn {datetime.now():%Y-%m-%d %H:%M}')))
        figure.text(*(corner - (0.0, 0.01)), fill(what, 90), va='top', fontsize=9, color='0.35')
    figure.savefig(stream, format='png', dpi=DOTS_PER_INCH, metadata={'Software': None},
                   **({'bbox_inches': 'tight', 'pad_inches': 0.12} if tight else {}))
    return stream.getvalue()
