# SPDX-License-Identifier: Apache-2.0
"""The picture of ``ambush hold``."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from .. import figures, map_figures
from ..labels import Labels
from ..maps.risk_map import RiskMap
from ..operations.hold import Holding
from ..words import count

HELD = '#35c48c'  # a green that is none of the routes'
_KEY = Line2D([], [], linestyle='none', marker='o', markersize=12, color=HELD, alpha=0.5,
              markeredgewidth=0.0, label='held: nobody can wait here')


def hold_figure(found: Holding, radius: float, risk_map: RiskMap) -> Figure:
    """The places on the map, with the strategy if all are held."""
    width, height = risk_map.size
    figure = Figure(figsize=(map_figures.WIDTH, 3.0 + 4.2 * height / width), layout='compressed')
    overview = figure.subplots()
    figures.draw_strategy(overview, found.strategies[-1], risk_map, key=[_KEY])
    held = f'{count(len(found.steps), "place")} held (green)'
    overview.set_title(f'{held}\n{overview.get_title(loc="left")}', fontsize='medium', loc='left',
                       linespacing=1.4)
    frame = np.column_stack((overview.get_xlim(), overview.get_ylim()))
    size = np.full(2, figures.BADGE * float(np.ptp(frame[:, 0])))
    marks = figures.marks_of(found.strategies[-1])
    labels = Labels(frame, marks, np.hstack((marks - size / 4.0, marks + size / 4.0)))
    for k, step in enumerate(found.steps, start=1):
        overview.add_patch(Circle(step.xy, radius, color=HELD, alpha=0.5, linewidth=0, zorder=5))
        spot = labels.place(np.array(step.xy), size, 0.25 * float(size[0]), True)
        figures.number_badge(overview, k, np.array(step.xy), HELD, spot)
    return figure
