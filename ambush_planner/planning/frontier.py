"""The trade-off between length, risk and entropy: one strategy for each of several budgets."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from ..errors import BudgetInfeasible, TimeLimit
from ..game.game import GameOptions
from ..game.solver import Multipliers
from ..game.strategy import StrategyOptions, solve
from ..network.network import Network

DETOURS = (1.02, 1.05, 1.1, 1.15, 1.2, 1.3, 1.5)
SLACKS = (0.0, 0.01, 0.03, 0.1, 0.3)
# Attributes that a row copies from its strategy.
MEASURED = (
    'value', 'lower_bound', 'expected_length', 'shortest_length', 'expected_exposure',
    'least_exposure', 'route_entropy',
)


@dataclass(frozen=True)
class FrontierRow:
    """Measures of the strategy for one pair of budgets.

    ``swept`` is the option that varies, 'max_detour' or 'risk_slack'; lengths are in m, exposures
    in loss x m, route entropy in nats. Without a strategy, ``error`` says why and the numbers are
    NaN.
    """

    swept: str
    max_detour: float
    risk_slack: float
    value: float = math.nan
    lower_bound: float = math.nan
    expected_length: float = math.nan
    shortest_length: float = math.nan
    expected_exposure: float = math.nan
    least_exposure: float = math.nan
    route_entropy: float = math.nan
    error: str = ''


def frontier(network: Network, game: GameOptions | None = None, detours: Sequence[float] = DETOURS,
             slacks: Sequence[float] = SLACKS, options: StrategyOptions | None = None,
             on_row: Callable[[FrontierRow], None] | None = None) -> tuple[FrontierRow, ...]:
    """Solve for each of ``detours``, then for each of ``slacks``, the rest as in ``options``.

    Each solve starts from the previous one, the longest detour first. ``on_row`` is called with
    each finished row; the result has the requested order. ``options.time_limit`` applies to
    each solve; at the limit the row is that of the best strategy so far, with its bound. Raises
    InvalidNetwork, InvalidOption and NoRoute as ``solve``, before the first solve.
    """
    options = options or StrategyOptions()
    game = game or GameOptions()
    tasks = [('max_detour', replace(options, max_detour=detour)) for detour in detours]
    tasks += [('risk_slack', replace(options, risk_slack=slack)) for slack in slacks]
    # Looser budgets make the better warm start.
    looseness = [(task.max_detour, task.risk_slack) for _, task in tasks]
    order = sorted(range(len(tasks)), key=looseness.__getitem__, reverse=True)
    rows: dict[int, FrontierRow] = {}
    solved: dict[StrategyOptions, FrontierRow] = {}
    warm: Multipliers | None = None
    for k in order:
        swept, budgets = tasks[k]
        if budgets not in solved:  # both sweeps may contain the budgets of ``options``
            solved[budgets], found = _row(network, game, swept, budgets, warm)
            warm = found or warm
        rows[k] = replace(solved[budgets], swept=swept)
        if on_row is not None:
            on_row(rows[k])
    return tuple(_best_within(rows[k], rows.values()) for k in range(len(tasks)))


def _best_within(row: FrontierRow, rows: Iterable[FrontierRow]) -> FrontierRow:
    """The row, or what is known to be better: tighter budgets' strategies, looser ones' bounds.

    A solve that ran out of time may be worse than one within tighter budgets.
    """
    same = [each for each in rows if each.risk_slack == row.risk_slack and not each.error]
    tighter = [each for each in same if each.max_detour <= row.max_detour]
    best = min(tighter, key=lambda each: each.value, default=row)
    if best.value < row.value * (1.0 - row.risk_slack):
        row = replace(best, swept=row.swept, max_detour=row.max_detour, lower_bound=row.lower_bound)
    bound = max((each.lower_bound for each in same if each.max_detour >= row.max_detour),
                default=row.lower_bound)
    return row if row.error else replace(row, lower_bound=max(row.lower_bound, bound))


def _row(network: Network, game: GameOptions, swept: str, options: StrategyOptions,
         warm: Multipliers | None) -> tuple[FrontierRow, Multipliers | None]:
    row = FrontierRow(swept, options.max_detour, options.risk_slack)
    try:
        strategy = solve(network, game, options, warm=warm)
    except BudgetInfeasible as error:
        return replace(row, error=str(error)), None
    except TimeLimit as error:
        if error.strategy is None:
            return replace(row, error=str(error)), None
        strategy = error.strategy
    measured = {name: getattr(strategy, name) for name in MEASURED}
    return replace(row, **measured), strategy.multipliers
