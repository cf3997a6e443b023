# SPDX-License-Identifier: Apache-2.0
"""Output of ``ambush plan --routes``: files, a picture, a table for dice and cards."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..operations.random_draws import RandomDraw, random_draws
from ..planning.few import FewRoutes
from ..planning.plan import Plan, path_lengths
from ..planning.route_layers import strategy_tables
from ..route_files import Drawn
from ..words import percent, travel
from .cli import Console

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Tables of a plan that also hold for few of its routes.
_ALSO = ('places', 'secured_area', 'forbidden')


@dataclass(frozen=True, eq=False)
class FewDrawn(Drawn):
    """The few routes of a plan: files have a layer for each, with its number, leg and share."""

    few: FewRoutes

    @property
    def columns(self) -> dict[str, Any]:
        """Number, leg, share and length [m] of each route."""
        legs = {'leg': self.few.leg + 1} if len(self.trip.legs) > 1 else {}
        return {'route': range(1, len(self.paths) + 1), **legs, 'share': self.few.shares,
                'length': path_lengths(self.paths)}

    @property
    def names(self) -> Sequence[str]:
        """Numbers, legs and shares."""
        of_leg = ' of leg {}' if len(self.trip.legs) > 1 else ''
        return [f'Route {k}{of_leg.format(leg + 1)}, {percent(share)}' for k, (leg, share)
                in enumerate(zip(self.few.leg, self.few.shares, strict=True), start=1)]

    @cached_property
    def tables(self) -> Mapping[str, Any]:
        """A layer for each route, then secured area and forbidden ground."""
        layers = {f'route_{k + 1}': self.routes.iloc[[k]] for k in range(len(self.paths))}
        tables = strategy_tables(self.trip, self.risk_map)
        return {**layers, **{name: tables[name] for name in _ALSO if name in tables}}

    def picture(self) -> Figure:
        """All routes on one map, with the worst place for an ambush."""
        from matplotlib.figure import Figure
        from matplotlib.lines import Line2D

        from .. import figures, map_figures

        figure = Figure(figsize=(map_figures.WIDTH, 6.2), layout='compressed')
        axes, few = figure.subplots(), self.few
        title = (f'The best ambush causes a mean loss of {few.value * self.covered:#.3g}\nAll '
                 f'{few.candidates} paths that were tried: {few.lower_bound * self.covered:#.3g}')
        map_figures.colour_bar(axes, figures.draw_ground(axes, self.trip, self.risk_map, title),
                               map_figures.LOSS)
        figures.draw_routes(axes, [path[:, :2] for path in self.paths], [few.worst_xy])
        worst = figures.SITES.get_markerfacecolor()
        axes.plot(*few.worst_xy, marker='o', markersize=9, color=worst, markeredgecolor='white',
                  linestyle='none', zorder=9, label='worst ambush')
        keys = [Line2D([], [], label=name.removeprefix('Route '), **figures.route_style(k))
                for k, name in enumerate(self.names[:figures.MAX_NUMBERED])]
        figure.legend(handles=[*keys, axes.lines[-1], figures.SECURED_AREA,
                               *map_figures.ground_key(self.risk_map)], ncols=3,
                      loc='outside lower left', frameon=False, title='route and share',
                      alignment='left')
        return figure


def tell_few(plan: Plan, few: FewRoutes, asked: int, covered: float, console: Console) -> None:
    """Print the value and how to draw, and put all but the paths into the result.

    ``covered`` is the share of departures that an ambush at one of the times covers.
    """
    draws, count = random_draws(plan), int(np.bincount(few.leg).max())
    a_leg = ' a leg' if len(plan.legs) > 1 else ''
    if count < asked:
        console.say(f'{count} routes{a_leg} suffice: more do not lower the value.')
    curve = [(k, covered * value) for k, value in few.curve]
    console.line(f'value by routes{a_leg} ' + ', '.join(f'{k}: {value:.4g}' for k, value in curve))
    console.line(_as_text(plan, few, draws, covered))
    console.result['few'] = {
        'value': covered * few.value, 'lower_bound': covered * few.lower_bound,
        'candidates': few.candidates, 'worst_xy': few.worst_xy.tolist(),
        'legs': (few.leg + 1).tolist(), 'shares': few.shares.tolist(),
        'costs': few.costs.tolist(), 'curve': curve,
        'draws': {draw.name: {'value': covered * draw.value, 'outcomes': draw.ranges}
                  for draw in draws},
    }


def _as_text(plan: Plan, few: FewRoutes, draws: Sequence[RandomDraw], covered: float) -> str:
    """A table of the routes, and of what stands for them; its last row has the values."""
    columns = [['route', *map(str, range(1, len(few.paths) + 1)), 'value'],
               ['share', *map(percent, few.shares), f'{covered * few.value:.4g}'],
               ['length', *(travel(cost, plan.network.travel_unit) for cost in few.costs), '']]
    if len(plan.legs) > 1:
        columns.insert(0, ['leg', *map(str, few.leg + 1), ''])
    columns += [[draw.name, *draw.ranges, f'{covered * draw.value:.4g}'] for draw in draws]
    width = [max(map(len, column)) for column in columns]
    lines = ['  '.join(text.rjust(size) for text, size in zip(row, width, strict=True))
             for row in zip(*columns, strict=True)]
    return '\n'.join(lines)
