# SPDX-License-Identifier: Apache-2.0
"""What ``ambush plan --routes`` writes and prints: files, a picture, a table for dice and cards."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from scipy.spatial import cKDTree

from ..colours import AMBUSHER, ROUTES
from ..figures import (
    HALO,
    HELD_DASHES,
    WIDTH,
    draw_ground,
    ground_key,
    number_badge,
    risk_bar,
)
from ..maps.risk_map_file import npz_bytes
from ..planning.few_routes import FewRoutes
from ..planning.plan import Plan
from ..planning.random_draws import RandomDraw, random_draws
from ..planning.route_layers import few_table, strategy_tables
from ..planning.route_sheet import RouteSheet, sheet_bytes, sheet_route
from ..planning.slots import SlotMixture
from ..route_files import Drawn
from .cli import Console, count, write_private
from .report_words import percent, travel

SHEET = '.json'
# Most routes with a panel each, and most in the legend.
MAX_PANELS, MAX_KEYS = 6, 20
# Line styles, one after another when all colours have been used.
_STYLES = ('solid', 'dashed', 'dotted', 'dashdot')
# Tables of a plan that also hold for few of its routes.
_GROUND = ('held_ground', 'forbidden')


@dataclass(frozen=True, eq=False)
class FewDrawn(Drawn):
    """The few routes of a plan: files have a layer for each, with its number and share."""

    few: FewRoutes

    @cached_property
    def routes(self) -> Any:
        """The table of routes."""
        return few_table(self.few, self.risk_map.crs)

    @property
    def names(self) -> list[str]:
        """Numbers and shares."""
        return [f'Route {k}, {percent(share)}' for k, share in enumerate(self.few.shares, start=1)]

    @cached_property
    def tables(self) -> Mapping[str, Any]:
        """A layer for each route, then held and forbidden ground."""
        layers = {f'route_{k + 1}': self.routes.iloc[[k]] for k in range(len(self.paths))}
        ground = strategy_tables(self.strategy, self.risk_map)
        return {**layers, **{name: ground[name] for name in _GROUND if name in ground}}

    def picture(self) -> Figure:
        """An overview with the curve of values, and up to six panels of a route each."""
        panels = len(self.paths) if len(self.paths) <= MAX_PANELS else 0
        rows, (width, height) = -(-panels // 3), self.risk_map.size
        tall = rows * (0.8 + 2.0 * min(max(height / width, 0.2), 1.5))  # inches
        figure = Figure(figsize=(WIDTH, 4.8 + tall), layout='constrained')
        top, below = (figure.subfigures(2, 1, height_ratios=(4.8, tall)) if rows
                      else (figure.subfigures(), None))
        grid = top.add_gridspec(2, 2, width_ratios=(2.1, 1.0), height_ratios=(1.9, 1.0))
        overview = top.add_subplot(grid[:, 0])
        title = f'Mean loss {self.few.value:#.3g}'
        risk_bar(top, draw_ground(overview, self.strategy, self.risk_map, title), overview,
                 location='bottom', shrink=0.6, aspect=30)
        self._key(top.add_subplot(grid[0, 1]))
        _curve(top.add_subplot(grid[1, 1]), self.few)
        for k in range(len(self.paths)):
            self._route(overview, k)
        overview.plot(*self.few.worst_xy, marker='o', markersize=9, color=AMBUSHER,
                      markeredgecolor='white', zorder=9)
        for k, axes in enumerate(below.subplots(rows, 3).flat if below else ()):
            if k < panels:
                draw_ground(axes, self.strategy, self.risk_map, self.names[k])
                self._route(axes, k)
            else:
                axes.set_axis_off()
        return figure

    def _style(self, k: int) -> dict[str, Any]:
        return {'color': ROUTES[k % len(ROUTES)], 'linewidth': 1.9, 'path_effects': HALO,
                'linestyle': _STYLES[k // len(ROUTES) % len(_STYLES)]}

    def _route(self, axes: Axes, k: int) -> None:
        """Draw a route with its number where it is farthest from the others and the ambush."""
        path = self.paths[k][:, :2]
        axes.plot(*path.T, **self._style(k), solid_joinstyle='round', zorder=4)
        others = [other[:, :2] for other in (*self.paths[:k], *self.paths[k + 1 :])]
        others = others or [path[[0, -1]]]
        away, _ = cKDTree(np.concatenate((*others, [self.few.worst_xy]))).query(path)
        at = away.argmax() if away.any() else len(path) // 2
        number_badge(axes, k + 1, path[at], self._style(k)['color'])

    def _key(self, axes: Axes) -> None:
        lines = [Line2D([], [], **self._style(k), label=name.removeprefix('Route '))
                 for k, name in enumerate(self.names[:MAX_KEYS])]
        worst = Line2D([], [], linestyle='none', marker='o', markersize=9, color=AMBUSHER,
                       markeredgecolor='white', label='worst ambush')
        held = Line2D([], [], color='black', linewidth=1.2, linestyle=HELD_DASHES,
                      label='held ground')
        axes.legend(handles=[*lines, worst, held, *ground_key(self.risk_map)], frameon=False,
                    title='route and share', loc='upper left', alignment='left',
                    ncols=1 + len(lines) // 11, labelspacing=0.3,
                    fontsize='medium' if len(lines) < 11 else 'small')
        axes.set_axis_off()


def _curve(axes: Axes, few: FewRoutes) -> None:
    """The value over the number of routes, and the lower bound."""
    axes.plot(*zip(*few.curve, strict=True), color=AMBUSHER, marker='o', markersize=4)
    axes.axhline(few.lower_bound, color='0.45', linestyle=':')
    low = few.lower_bound < 0.3 * max(value for _, value in few.curve)
    axes.annotate("plan's lower bound", (0.0, few.lower_bound), xycoords=('axes fraction', 'data'),
                  xytext=(3, 3 if low else -3), textcoords='offset points', va='bottom' if low
                  else 'top', color='0.35', fontsize='small', path_effects=HALO)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel='number of routes', ylabel='mean loss', ylim=(0.0, None))
    axes.grid(color='0.92')


def write_sheets(paths: Sequence[Path], drawn: FewDrawn, map_file: Path | None,
                 slots: Sequence[str], day: SlotMixture | None) -> None:
    """Write route sheets with mode 0600; ``day`` is the mixture of the slots, if there are any.

    Without a file of the map, each sheet gets one next to it, by ``map_beside``.
    """
    few, crs, network = drawn.few, drawn.risk_map.crs, drawn.strategy.network
    start, *stops, goal = network.points[[network.source, *network.stops, network.target]].tolist()
    routes = tuple(sheet_route(k, float(share), path, crs)
                   for k, (share, path) in enumerate(zip(few.shares, few.paths, strict=True), 1))
    game = drawn.strategy.game.options
    sheet = RouteSheet((map_file or Path()).absolute(), crs, start, goal, tuple(stops),
                       game.held_radius, game.ambush_radius, few.value, few.lower_bound, routes)
    if day:
        sheet = replace(sheet, value=day.value, lower_bound=day.lower_bound,
                        slots=tuple(zip(slots, day.shares.tolist(), strict=True)))
    for path in paths:
        if map_file is None:
            sheet = replace(sheet, map=map_beside(path).absolute())
            write_private(path.parent, {sheet.map.name: npz_bytes(drawn.risk_map)})
        write_private(path.parent, {path.name: sheet_bytes(sheet, path.parent.absolute())})


def map_beside(sheet: Path) -> Path:
    """The map of a sheet that was planned on an elevation model."""
    return sheet.with_name(f'{sheet.stem}_map.npz')


def tell_few(plan: Plan, few: FewRoutes, console: Console) -> None:
    """Print the value and how to draw, and put all but the paths into the result."""
    draws, tube = random_draws(plan), plan.strategy.game.options.tube
    price = float(few.value / few.lower_bound)
    below = (f'; it may be below, because the bound lets convoys stray {tube:.3g} m from their '
             'routes, and these are fixed') * (price < 1.0)
    console.line(f'\n{count(len(few.paths), "route")}: value {few.value:.4g}, {price:.3g} times '
                 f'the lower bound{below}')
    console.line('value by routes ' + ', '.join(f'{k}: {value:.4g}' for k, value in few.curve))
    console.line(_as_text(plan, few, draws))
    console.result['few'] = {
        'value': few.value, 'lower_bound': few.lower_bound, 'worst_xy': few.worst_xy.tolist(),
        'shares': few.shares.tolist(), 'costs': few.costs.tolist(), 'curve': few.curve,
        'draws': {draw.name: {'value': draw.value, 'outcomes': draw.ranges} for draw in draws},
    }


def _as_text(plan: Plan, few: FewRoutes, draws: Sequence[RandomDraw]) -> str:
    """A table of the routes, and of what stands for them; its last row has the values."""
    columns = [['route', *map(str, range(1, len(few.paths) + 1)), 'value'],
               ['share', *map(percent, few.shares), f'{few.value:.4g}'],
               ['length', *(travel(plan.strategy, cost) for cost in few.costs), '']]
    columns += [[draw.name, *draw.ranges, f'{draw.value:.4g}'] for draw in draws]
    width = [max(map(len, column)) for column in columns]
    lines = ['  '.join(text.rjust(size) for text, size in zip(row, width, strict=True))
             for row in zip(*columns, strict=True)]
    return '\n'.join(lines)
