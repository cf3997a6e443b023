# SPDX-License-Identifier: Apache-2.0
"""The picture of ``ambush judge``."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from .. import figures, map_figures
from ..arrays import BoolArray, FloatArray
from ..colours import AMBUSHER
from ..maps.risk_map import RiskMap
from ..operations.judge import Habits
from ..words import distance

# Minimum share of trips and edges that are shown.
MIN_SHARE = 0.001
# What the panels show around the trips, as a multiple of their size; size of start and goal, which
# must not cover the secured area, as their names would.
MARGIN, MARKS = 1.25, 0.35
_CONVOY, _HIT = figures.PROBABILITY(0.4), figures.PROBABILITY(1.0)
_LEGEND = (
    Line2D([], [], linestyle='none', marker='o', markersize=11, markerfacecolor='none',
           markeredgewidth=2.0, color=AMBUSHER, label='worst place, and how far he reaches'),
    Line2D([], [], color=_HIT, linewidth=3.6, label='50 % of departures, hit there'),
    Line2D([], [], color=_CONVOY, linewidth=1.2, label='10 % of departures, not hit there'),
    figures.SITES,
    figures.START,
    figures.GOAL,
)


def judge_figure(habits: Habits, risk_map: RiskMap) -> Figure:
    """The trips as driven, their best shares, and the optimal strategy, side by side."""
    trip, driven, best = habits.plan.trip, habits.driven, habits.best
    ground, p = trip.ground_uses
    edges = trip.game.network.points[ground]
    paths, used = [trip.xy for trip in habits.trips], best.shares[best.shares >= MIN_SHARE]
    seen = np.concatenate((*paths, *edges[p >= MIN_SHARE]))
    middle, half = (seen.max(axis=0) + seen.min(axis=0)) / 2.0, np.ptp(seen, axis=0) / 2.0
    half = np.maximum(half, 0.5 * half.max())
    low, high = middle - MARGIN * half, middle + MARGIN * half
    low, high = np.maximum(low, risk_map.bounds[0]), np.minimum(high, risk_map.bounds[1])
    height = map_figures.WIDTH / 3.0 * (high[1] - low[1]) / (high[0] - low[0])
    figure = Figure((map_figures.WIDTH, height + 3.8), layout='compressed')
    figure.suptitle('Mean loss caused by an ambusher who has watched', x=0.0, ha='left')
    panels = figure.subplots(1, 3)
    for axes, name, value, length, text in (
        (panels[0], 'as driven', driven.value, float(driven.shares @ habits.lengths),
         f'{driven.hit.sum()} of {len(paths)} trips\npass the worst place\n95 %: '
         '{:.3g} to {:.3g}'.format(*habits.interval)),
        (panels[1], 'the same, reweighted', best.value, float(best.shares @ habits.lengths),
         f'{_less(best.value, driven.value)}\nthe best {len(used)} of the {len(paths)} trips\n'
         f'shares {100 * used.min():.0f} to {100 * used.max():.0f} %'),
        (panels[2], 'optimal', trip.value, habits.plan.driven_length,
         f'{_less(trip.value, driven.value)}\na fresh route each time\n'
         f'no strategy is below {trip.lower_bound:.3g}'),
    ):
        map_figures.frame(axes, risk_map, name, (low, high), ticks=2)
        risk = map_figures.draw_risk_map(axes, risk_map)
        figures.draw_ends(axes, trip, named=False, size=MARKS)
        map_figures.draw_scale_bar(axes, figures.places_of(trip))
        axes.label_outer()
        axes.set_xlabel(f'{text}\nmean length {distance(length)}', loc='left', linespacing=1.4)
        axes.annotate(f'{value:#.3g}', (0.0, 1.0), xycoords='axes fraction', xytext=(0, 22),
                      textcoords='offset points', fontsize=28, weight='bold', color=AMBUSHER)
    for axes, mixture in zip(panels, (driven, best), strict=False):
        _draw_lines(axes, paths, mixture.shares, mixture.hit)
        axes.add_patch(Circle(mixture.worst_xy, trip.game.options.ambush_radius, linewidth=2.0,
                              facecolor=f'{AMBUSHER}55', edgecolor=AMBUSHER, zorder=9))
    figures.draw_segments(panels[2], edges, p, widths=(0.2, 3.0),
                          cmap=ListedColormap([_CONVOY]))
    figures.draw_sites(panels[2], trip, MARKS)
    map_figures.colour_bar(panels[2], risk, map_figures.LOSS)
    shown = [*_LEGEND, *[figures.SECURED_AREA] * bool(trip.game.secured.radii.any()),
             *map_figures.ground_key(risk_map)]
    figure.legend(handles=shown, ncols=2, loc='outside lower left', frameon=False)
    return figure


def _less(value: float, driven: float) -> str:
    return f'{100.0 * (1.0 - value / driven):.0f} % less' if value < driven else 'no less'


def _draw_lines(axes: Axes, lines: list[FloatArray], shares: FloatArray, hit: BoolArray) -> None:
    """Draw lines (L, 2) as wide as their shares, those that are hit in another colour.

    Equal lines are one, with the sum of their shares.
    """
    same: dict[bytes, list[int]] = {}
    for k in np.argsort(hit, kind='stable').tolist():
        same.setdefault(lines[k].round().tobytes(), []).append(k)
    shown = [(numbers[0], share) for numbers in same.values()
             if (share := float(shares[numbers].sum())) >= MIN_SHARE]
    axes.add_collection(LineCollection(
        [lines[k] for k, _ in shown], colors=[_HIT if hit[k] else _CONVOY for k, _ in shown],
        linewidths=[0.6 + 6.0 * share for _, share in shown], capstyle='round', joinstyle='round',
        zorder=2))
