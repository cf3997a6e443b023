"""The picture of a frontier: what each budget buys."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.figure import Figure

from ..planning.frontier import FrontierRow
from .figures import AMBUSHER, PROBABILITY

CONVOY = PROBABILITY(0.6)
# The label and the least value of each row of panels.
ROWS = (
    ('mean loss by the best ambush', 0.0),
    ('mean exposure over the least', 1.0),
    ('route entropy [nats]', 0.0),
)


def frontier_figure(
    rows: Sequence[FrontierRow], max_detour: float, risk_slack: float
) -> Figure:
    """Plot value, exposure and route entropy: over the detour (left) and over the slack (right).

    Dashed lines mark ``max_detour`` and ``risk_slack``, each of which is fixed in the sweep of the
    other.
    """
    figure = Figure(figsize=(11.0, 9.0), dpi=110, layout='constrained')
    panels = figure.subplots(3, 2, sharex='col', sharey='row')
    sweeps = (
        ('max_detour', max_detour, f'Longer detour (risk_slack {risk_slack:g})',
         'max_detour: expected length over the shortest'),
        ('risk_slack', risk_slack, f'More risk (max_detour {max_detour:g})',
         'risk_slack: share of the value given up'),
    )
    for column, (name, fixed, title, label) in zip(panels.T, sweeps, strict=True):
        solved = [row for row in rows if row.swept == name and not row.error]
        solved.sort(key=lambda row: getattr(row, name))
        x = [getattr(row, name) for row in solved]
        value, exposure, entropy = column
        style = {'marker': 'o', 'markersize': 5, 'zorder': 3}
        value.plot(x, [row.lower_bound for row in solved], color='0.45', linestyle=':',
                   label='lower bound', **style)
        value.plot(x, [row.value for row in solved], color=AMBUSHER, label='the strategy', **style)
        exposure.plot(x, [relative_exposure(row) for row in solved], color=CONVOY, **style)
        entropy.plot(x, [row.route_entropy for row in solved], color=CONVOY, **style)
        for axes in column:
            axes.axvline(fixed, color='0.6', linestyle=(0, (4, 3)), linewidth=1.2, zorder=1)
            axes.grid(color='0.92')
        value.set_title(title, loc='left')
        entropy.set_xlabel(label)
    for axes, (label, least) in zip(panels[:, 0], ROWS, strict=True):
        axes.set_ylabel(label)
        # With the least value in view, the margin at the top has room for the markers.
        axes.update_datalim([(0.0, least)], updatex=False)
        axes.autoscale_view()
        axes.set_ylim(bottom=least)
    panels[0, 0].legend(loc='best', frameon=False)
    return figure


def relative_exposure(row: FrontierRow) -> float:
    """Return the exposure over the least possible one; NaN if that is 0."""
    least = row.least_exposure
    return row.expected_exposure / least if least > 0.0 else math.nan
