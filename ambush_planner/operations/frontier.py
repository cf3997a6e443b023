# SPDX-License-Identifier: Apache-2.0
"""The trade-off between length, risk and entropy: one strategy for each of several budgets."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy.typing as npt

from ..errors import BudgetInfeasible, TimeLimit
from ..game.game import GameOptions, make_games
from ..game.solver import solve_legs
from ..game.strategy import StrategyOptions, TripStrategy
from ..game.tolerance import within
from ..maps.risk_map import RiskMap
from ..network.network import Network
from ..planning.options import PlanningOptions
from ..planning.solving import Ground, WarmStart
from ..planning.trip import Trip, plan_trip

DETOURS = (1.02, 1.05, 1.1, 1.15, 1.2, 1.3, 1.5)
SLACKS = (0.0, 0.01, 0.03, 0.1, 0.3)
# Attributes that a row copies from its strategy.
MEASURED = (
    'value', 'lower_bound', 'expected_length', 'shortest_length', 'expected_exposure',
    'route_entropy',
)


@dataclass(frozen=True)
class FrontierRow:
    """Measures of the strategy for one length budget and risk slack.

    ``swept`` is the option that varies, 'max_detour' or 'risk_slack'. Lengths are in m, or in s if
    the network has driving times, exposures in loss x m, route entropy in nats. If there is no
    strategy, ``error`` is the reason, and the numbers are NaN.
    """

    swept: str
    max_detour: float
    risk_slack: float
    value: float = math.nan
    lower_bound: float = math.nan
    expected_length: float = math.nan
    shortest_length: float = math.nan
    expected_exposure: float = math.nan
    route_entropy: float = math.nan
    error: str = ''


def frontier(network: Network, game: GameOptions | None = None, detours: Sequence[float] = DETOURS,
             slacks: Sequence[float] = SLACKS, options: StrategyOptions | None = None,
             on_row: Callable[[FrontierRow], None] | None = None) -> tuple[FrontierRow, ...]:
    """Solve for each of ``detours``, then for each of ``slacks``, otherwise as in ``options``.

    Values are those of ``solve``, at the network's nodes; ``Plan.frontier`` has those of plans.
    ``on_row`` is called with each finished row, the longest detour first; the result has the
    requested order. ``options.time_limit`` applies to each solve; at the limit, the row is that of
    the incumbent.

    Raises
    ------
    InvalidNetwork, InvalidOption, NoRoute
        As ``solve``, before the first solve.

    Examples
    --------
    >>> from ambush_planner import Network, frontier
    >>> network = Network(points=[(0, 0), (1, 1), (1, -3), (2, 0)], alpha=[0, 1, 1, 0],
    ...                   edges=[(0, 1), (0, 2), (1, 3), (2, 3)], source=0, target=3)
    >>> [round(row.lower_bound, 2) for row in frontier(network, detours=(1.0, 2.0), slacks=())]
    [1.0, 0.5]
    """
    tasks = _tasks(detours, slacks, options or StrategyOptions())
    games = make_games((network,), game or GameOptions())

    return _rows(partial(solve_legs, games), tasks, on_row)


def trip_frontier(risk_map: RiskMap, start_xy: npt.ArrayLike, goal_xy: npt.ArrayLike,
                  options: PlanningOptions, detours: Sequence[float] = DETOURS,
                  slacks: Sequence[float] = SLACKS,
                  on_row: Callable[[FrontierRow], None] | None = None, *,
                  stops: Sequence[npt.ArrayLike] = (),
                  planned: TripStrategy | None = None) -> tuple[FrontierRow, ...]:
    """Compute the rows of ``frontier`` for plans of a trip, with the values of ``plan_trip``.

    ``stops`` are as in ``Plan.stops_xy``. All rows are on the network of the strategy ``planned``
    with the options, which is one of them; by default it is planned now. Raises the errors of
    ``plan_trip``.
    """
    tasks = _tasks(detours, slacks, options.strategy)
    if planned is None:
        planned = plan_trip(risk_map, start_xy, goal_xy, options, stops=stops).trip
    ground = Ground.of(risk_map, options)
    networks = Trip(risk_map, start_xy, goal_xy, stops, options).networks(
        planned.game.network.refined)
    games, site_search = ground.make_games(networks, WarmStart.of(planned))

    def solve(budgets: StrategyOptions) -> TripStrategy:
        if budgets == options.strategy:
            return planned
        return solve_legs(games, budgets, site_search and site_search.with_losses(ground.cells))

    return _rows(solve, tasks, on_row)


def _tasks(detours: Sequence[float], slacks: Sequence[float],
           options: StrategyOptions) -> list[tuple[str, StrategyOptions]]:
    """The options to solve for, each after the name of the one that varies."""
    tasks = [('max_detour', replace(options, max_detour=detour)) for detour in detours]
    return tasks + [('risk_slack', replace(options, risk_slack=slack)) for slack in slacks]


def _rows(solve: Callable[[StrategyOptions], TripStrategy],
          tasks: Sequence[tuple[str, StrategyOptions]],
          on_row: Callable[[FrontierRow], None] | None) -> tuple[FrontierRow, ...]:
    """Solve the tasks, the loosest first, and return their rows in order."""
    looseness = [(task.max_detour, task.risk_slack) for _, task in tasks]
    order = sorted(range(len(tasks)), key=looseness.__getitem__, reverse=True)
    rows: dict[int, FrontierRow] = {}
    known: dict[StrategyOptions, FrontierRow] = {}
    for k in order:
        swept, budgets = tasks[k]
        row = FrontierRow(swept, budgets.max_detour, budgets.risk_slack)
        if budgets not in known:  # both sweeps may contain the budgets of ``options``
            try:
                found = solve(budgets)
                row = replace(row, **{name: getattr(found, name) for name in MEASURED})
            except (BudgetInfeasible, TimeLimit) as error:
                row = replace(row, error=str(error))
            known[budgets] = row
        rows[k] = replace(known[budgets], swept=swept)
        if on_row is not None:
            on_row(rows[k])
    return tuple(_best_within(rows[k], rows.values()) for k in range(len(tasks)))


def _best_within(row: FrontierRow, rows: Iterable[FrontierRow]) -> FrontierRow:
    """Improve a row by the strategies of smaller budgets and the bounds of larger ones.

    A solve that reached its time limit may be worse than one within a smaller budget.
    """
    if row.error:
        return row
    same = [each for each in rows if each.risk_slack == row.risk_slack and not each.error]
    tighter = [each for each in same if each.max_detour <= row.max_detour]
    best = min(tighter, key=lambda each: each.value, default=row)
    if not within(row.value, best.value, row.risk_slack):
        row = replace(best, swept=row.swept, max_detour=row.max_detour, lower_bound=row.lower_bound)
    bound = max((each.lower_bound for each in same if each.max_detour >= row.max_detour),
                default=row.lower_bound)
    return replace(row, lower_bound=min(max(row.lower_bound, bound), row.value))
