# SPDX-License-Identifier: Apache-2.0
"""The picture of ``ambush audit``."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from .. import figures, map_figures
from ..colours import AMBUSHER
from ..maps.risk_map import RiskMap
from ..recordings.audit import Audit


def audit_figure(risk_map: RiskMap, result: Audit) -> Figure:
    """Published and recorded frequencies on the map, and the losses caused by an observer."""
    wide = risk_map.size[0] > 1.6 * risk_map.size[1]
    figure = Figure((map_figures.WIDTH, 9.6 if wide else 8.0), layout='constrained')
    panels = figure.subplot_mosaic('a;b;c' if wide else 'ab;cc',
                                   height_ratios=(3, 3, 2.4) if wide else (5, 3))
    published, recorded, observer = panels['a'], panels['b'], panels['c']
    scale = figures.probability_scale(result.expected / result.departures)
    for axes, passages, title in (
        (published, result.expected, 'Published probability'),
        (recorded, result.passages, f'Share of {result.departures} departures'),
    ):
        risk = map_figures.draw_map(axes, risk_map, title)
        edges = figures.draw_segments(axes, result.segments, passages / result.departures, scale)
    figures.probability_bar(figure, edges, published, 'share of departures that pass',
                            location='bottom')
    map_figures.risk_bar(figure, risk, recorded, location='bottom')
    count = np.arange(1, len(result.observer_losses) + 1)
    observer.axhline(result.value, color='grey', label='published value')
    observer.plot(count, np.cumsum(result.observer_losses) / count, color=AMBUSHER,
                  label='observer who learns as he goes')
    observer.axhspan(*result.observer_range, color=AMBUSHER, alpha=0.15, linewidth=0.0,
                     label='where honest draws end in nine cases of ten')
    observer.set(xlabel='departures after the first', ylabel='mean loss', ylim=(0.0, None))
    observer.set_title('Could one predict the next departure?', loc='left', fontsize='medium')
    observer.xaxis.set_major_locator(MaxNLocator(integer=True))
    observer.legend()
    if key := map_figures.ground_key(risk_map):
        figure.legend(handles=key, loc='outside lower left', ncols=2, frameon=False)
    return figure
