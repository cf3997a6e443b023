# SPDX-License-Identifier: Apache-2.0
"""What ``ambush plan --routes`` writes and prints: files, a picture, a table for dice and cards."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..maps.risk_map_file import npz_bytes
from ..planning.few_routes import FewRoutes
from ..planning.plan import Plan
from ..planning.random_draws import RandomDraw, random_draws
from ..planning.route_layers import lengths, strategy_tables
from ..planning.route_sheet import RouteSheet, sheet_bytes, sheet_route
from ..planning.slots import SlotMixture
from ..route_files import Drawn
from .cli import Console, count, write_private
from .console import percent, travel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHEET = '.json'
# Tables of a plan that also hold for few of its routes.
_GROUND = ('held_ground', 'forbidden')


@dataclass(frozen=True, eq=False)
class FewDrawn(Drawn):
    """The few routes of a plan: files have a layer for each, with its number and share."""

    few: FewRoutes

    @property
    def columns(self) -> dict[str, Any]:
        """Number, share and length [m] of each route."""
        return {'route': range(1, len(self.paths) + 1), 'share': self.few.shares,
                'length': lengths(self.paths)}

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
        from .few_figure import few_figure

        return few_figure(self)


def write_sheets(paths: Sequence[Path], drawn: FewDrawn, map_file: Path | None,
                 slots: Sequence[str], day: SlotMixture | None) -> None:
    """Write route sheets with mode 0600; ``day`` is the mixture of the slots, if there are any.

    Without a ``map_file``, the map is written next to each sheet, to ``map_of(sheet)``.
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
            sheet = replace(sheet, map=map_of(path).absolute())
            write_private(path.parent, {sheet.map.name: npz_bytes(drawn.risk_map)})
        write_private(path.parent, {path.name: sheet_bytes(sheet, path.parent.absolute())})


def map_of(sheet: Path) -> Path:
    """The map of a sheet that was planned on an elevation model."""
    return sheet.with_name(f'{sheet.stem}_map.npz')


def tell_few(plan: Plan, few: FewRoutes, console: Console) -> None:
    """Print the value and how to draw, and put all but the paths into the result."""
    draws = random_draws(plan)
    price = few.value / few.lower_bound if few.lower_bound else math.inf
    console.line(f'\n{count(len(few.paths), "route")}: value {few.value:.4g}, {price:.2f} times '
                 f'that of all {few.candidates} paths tried, mixed at best and driven as they are')
    console.line('value by routes ' + ', '.join(f'{k}: {value:.4g}' for k, value in few.curve))
    console.line(_as_text(plan, few, draws))
    console.result['few'] = {
        'value': few.value, 'lower_bound': few.lower_bound, 'candidates': few.candidates,
        'worst_xy': few.worst_xy.tolist(),
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
