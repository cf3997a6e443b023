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
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Patch
from matplotlib.patheffects import Normal, Stroke
from matplotlib.transforms import Affine2D

from . import colours
from .arrays import BoolArray, FloatArray, pooled
from .errors import shown
from .maps.risk_map import RiskMap
from .rulers import north, scale_bar
from .rulers import ticks as ticks_along

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
    draw_scale_bar(axes, avoid)
    draw_north(axes, risk_map.crs)
    return draw_risk_map(axes, risk_map)


def frame(axes: Axes, risk_map: RiskMap, title: str = '', box: npt.ArrayLike | None = None,
          ticks: int = 4) -> None:
    """Give the axes the map's extent, or a box, equal scales, and ticks.

    Each edge has up to about ``ticks`` ticks.
    """
    corners = np.asarray(risk_map.bounds if box is None else box)
    axes.set(aspect='equal')
    axes.set_title(title, fontsize='medium', loc='left', linespacing=1.4)
    axes.patch.set(facecolor=UNKNOWN.get_facecolor(), edgecolor=UNKNOWN.get_edgecolor(),
                   hatch=UNKNOWN.get_hatch())
    along, unit = ticks_along(risk_map, corners, ticks)
    for name, axis, (at, texts) in zip('xy', (axes.xaxis, axes.yaxis), along, strict=True):
        axis.set_ticks(at, texts)
        axis.set_label_text(f'{name} [{unit}]')
    axes.set(xlim=corners[:, 0], ylim=corners[:, 1])


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


def draw_scale_bar(axes: Axes, avoid: FloatArray | None = None) -> None:
    """Draw a bar of a round length in the corner farthest from the places (K, 2) to ``avoid``."""
    bar = scale_bar(np.column_stack((axes.get_xlim(), axes.get_ylim())), avoid)
    x, y = bar.xy
    axes.plot((x, x + bar.length), (y, y), color='black', linewidth=3.0, solid_capstyle='butt',
              path_effects=HALO, zorder=8)
    axes.annotate(bar.text, (x, y), xytext=(0, 4 if bar.is_low else -4),
                  textcoords='offset points', va='baseline' if bar.is_low else 'top',
                  path_effects=HALO, zorder=8)


def draw_north(axes: Axes, crs: str | None) -> None:
    """Point to true north, right of the upper right corner, if the system is known."""
    away = north(crs, np.array([np.mean(axes.get_xlim()), np.mean(axes.get_ylim())]))
    if away is None:
        return
    axes.annotate('N', (1.04, 0.84), xytext=20.0 * away, ha='center', va='center',
                  xycoords='axes fraction', textcoords='offset points', weight='bold',
                  path_effects=HALO, zorder=8,
                  arrowprops={'arrowstyle': '<|-', 'color': 'black', 'linewidth': 1.4})


def colour_bar(axes: Axes, mappable: ScalarMappable, label: str, place: int = 0,
               **style: Any) -> None:
    """Explain a scale next to the axes, as tall as they are; ``place`` counts from the map."""
    bar = axes.inset_axes((1.09 + 0.2 * place, 0.0, 0.03, 1.0))
    axes.figure.colorbar(mappable, cax=bar, label=label, **style)


def as_png(figure: Figure, name: str = '', sources: Sequence[str] = ()) -> bytes:
    """Return the picture as a PNG file, cut to what is drawn, without the drawing program's name.

    Below it are its name, what it shows, and when it was drawn.
    """
    stream = BytesIO()
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
                   bbox_inches='tight', pad_inches=0.12)
    return stream.getvalue()
