"""The picture of a frontier: what each budget buys, to choose by looking."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..planning.frontier import FrontierRow
from .figures import AMBUSHER, PROBABILITY

CONVOY = PROBABILITY(0.6)


def frontier_figure(
    rows: Sequence[FrontierRow], max_detour: float, risk_slack: float
) -> Figure:
    """Value, exposure and route entropy: left over the detour, right over the slack.

    The other budget is ``risk_slack`` on the left and ``max_detour`` on the right; where a sweep
    passes the value that is set, a line marks it.
    """
    figure = Figure(figsize=(11.0, 9.0), dpi=110, layout='constrained')
    panels = figure.subplots(3, 2, sharex='col', sharey='row')
    sweeps = (
        ('max_detour', max_detour, f'Longer way (risk_slack {risk_slack:g})',
         'max_detour: expected length over the shortest'),
        ('risk_slack', risk_slack, f'More risk (max_detour {max_detour:g})',
         'risk_slack: share of the value given up'),
    )
    for column, (name, here, title, label) in zip(panels.T, sweeps, strict=True):
        swept = [row for row in rows if row.swept == name and not row.error]
        _draw_sweep(column, swept, name)
        for axes in column:
            axes.axvline(here, color='0.6', linestyle=(0, (4, 3)), linewidth=1.2, zorder=1)
            axes.grid(color='0.92')
        column[0].set_title(title, loc='left')
        column[-1].set_xlabel(label)
    for axes, label, least in zip(
        panels[:, 0],
        ('mean loss by the best ambush', 'mean exposure over the least', 'route entropy [nats]'),
        (0.0, 1.0, 0.0),
        strict=True,
    ):
        axes.set_ylabel(label)
        # The margin at the top is then a share of all that is shown, enough for the markers.
        axes.update_datalim([(0.0, least)], updatex=False)
        axes.autoscale_view()
        axes.set_ylim(bottom=least)
    panels[0, 0].legend(loc='best', frameon=False)
    return figure


def over(value: float, least: float) -> float:
    """The quotient; NaN where the least is 0."""
    return value / least if least > 0.0 else math.nan


def _draw_sweep(column: Sequence[Axes], rows: Sequence[FrontierRow], name: str) -> None:
    rows = sorted(rows, key=lambda row: getattr(row, name))
    x = [getattr(row, name) for row in rows]

    def draw(axes: Axes, of: Callable[[FrontierRow], float], **look: object) -> None:
        axes.plot(x, [of(row) for row in rows], marker='o', markersize=5, zorder=3, **look)

    draw(column[0], lambda row: row.lower_bound, color='0.45', linestyle=':',
         label='no strategy within the budget has less')
    draw(column[0], lambda row: row.value, color=AMBUSHER, label='the strategy')
    draw(column[1], lambda row: over(row.expected_exposure, row.least_exposure), color=CONVOY)
    draw(column[2], lambda row: row.route_entropy, color=CONVOY)
