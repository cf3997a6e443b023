# SPDX-License-Identifier: Apache-2.0
"""The picture of few routes: all on one map, the curve of values, and a map for each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from .. import figures, map_figures
from ..colours import AMBUSHER
from ..planning.few import FewRoutes

if TYPE_CHECKING:
    from .few_files import FewDrawn

# Maximum number of routes with a panel each.
MAX_PANELS = 6
# Maximum number of routes in the legend.
MAX_KEYS = 20
_WORST: dict[str, Any] = {'marker': 'o', 'markersize': 9, 'color': AMBUSHER,
                          'markeredgecolor': 'white', 'linestyle': 'none'}


def few_figure(drawn: FewDrawn) -> Figure:
    """An overview with the curve of values, and up to ``MAX_PANELS`` panels of a route each."""
    panels = len(drawn.paths) if len(drawn.paths) <= MAX_PANELS else 0
    rows, (width, height) = -(-panels // 3), drawn.risk_map.size
    shape = min(max(height / width, 0.2), 1.5)
    tall, head = rows * (0.4 + 2.1 * shape), max(4.4, 0.7 + 3.5 * shape)  # inches
    figure = Figure(figsize=(map_figures.WIDTH, head + tall), layout='constrained')
    top, below = (figure.subfigures(2, 1, height_ratios=(head, tall)) if rows
                  else (figure.subfigures(), None))
    grid = top.add_gridspec(2, 2, width_ratios=(2.7, 1.0), height_ratios=(1.9, 1.0))
    overview = top.add_subplot(grid[:, 0])
    title = f'Mean loss {drawn.few.value * drawn.covered:#.3g}'
    risk = figures.draw_ground(overview, drawn.trip, drawn.risk_map, title)
    map_figures.colour_bar(overview, risk, map_figures.LOSS)
    _key(drawn, top.add_subplot(grid[0, 1]))
    _curve(top.add_subplot(grid[1, 1]), drawn.few, drawn.covered)
    paths = [path[:, :2] for path in drawn.paths]
    figures.draw_stripes(overview, paths, [figures.route_style(k) for k in range(len(paths))])
    for k, place in enumerate(figures.badge_places(paths, drawn.few.worst_xy)):
        figures.number_badge(overview, k + 1, place, figures.route_style(k)['color'])
    overview.plot(*drawn.few.worst_xy, zorder=9, **_WORST)
    for k, axes in enumerate(below.subplots(rows, 3).flat if below else ()):
        if k < panels:
            figures.draw_ground(axes, drawn.trip, drawn.risk_map, drawn.names[k], small=True)
            figures.draw_stripes(axes, [paths[k]], [figures.route_style(k)])
        else:
            axes.set_axis_off()
    return figure


def _key(drawn: FewDrawn, axes: Axes) -> None:
    lines = [Line2D([], [], linewidth=figures.ROUTE_WIDTH, **figures.route_style(k),
                    label=name.removeprefix('Route '))
             for k, name in enumerate(drawn.names[:MAX_KEYS])]
    worst = Line2D([], [], label='worst ambush', **_WORST)
    secured = Line2D([], [], color='black', linewidth=1.2, linestyle=figures.SECURED_DASHES,
                     label='secured area')
    handles = [*lines, worst, secured, *map_figures.ground_key(drawn.risk_map)]
    axes.legend(handles=handles, frameon=False, title='route and share', loc='upper left',
                alignment='left', ncols=1 + len(lines) // 11, labelspacing=0.3,
                fontsize='medium' if len(lines) < 11 else 'small')
    axes.set_axis_off()


def _curve(axes: Axes, few: FewRoutes, covered: float) -> None:
    """The value over the number of routes, and what all candidates could reach."""
    counts, values = np.transpose(few.curve)
    axes.plot(counts, covered * values, color=AMBUSHER, marker='o', markersize=4)
    axes.axhline(covered * few.lower_bound, color='0.45', linestyle=':')
    low = few.lower_bound < 0.3 * values.max()
    axes.annotate(f'all {few.candidates} paths', (0.0, covered * few.lower_bound),
                  xycoords=('axes fraction', 'data'), xytext=(3, 3 if low else -3),
                  textcoords='offset points', va='bottom' if low else 'top', color='0.35',
                  fontsize='small', path_effects=map_figures.HALO)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel='number of routes' + ' a leg' * bool(few.leg[-1]), ylabel='mean loss',
             ylim=(0.0, None))
    axes.grid(color='0.92')
