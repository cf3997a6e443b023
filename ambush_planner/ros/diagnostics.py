"""The node's status as a diagnostics message: stable keys, and never a route or a seed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Header

from ..game.game import Game
from ..game.revaluation import open_gap
from ..planning.changed_ground import Assessment
from ..planning.plan import DRAWN, Plan
from ..planning.solving import holds_anywhere
from ..worker.solve_errors import SolveCancelled
from .error_codes import OK_CODE, code_of

_DIFFERENT = f'different_paths_of_{DRAWN}'
_STRATEGY_NUMBERS = (
    'value', 'lower_bound', 'gap', 'edge_entropy', 'route_entropy', 'entropy_gap',
    'expected_length', 'shortest_length',
)


class Problem(NamedTuple):
    """An error: its code (``error_codes.code_of``), a message, and the level."""

    code: str
    message: str
    level: bytes


@dataclass(frozen=True)
class Status:
    """The node's status.

    ``problems`` are by what they concern: 'request', 'map' or 'recording'; ``warnings`` are texts
    on 'parameters' or 'alpha_map'. ``assessment`` is of the displayed plan on the current map, and
    ``stale`` says why that plan is stale, if it is. ``departure_worth`` is the assessment of the
    last departure; the ``last_answer`` may have been the rest of its path.
    """

    lifecycle: str = 'active'
    missing: tuple[str, ...] = ()
    solving: bool = False
    problems: Mapping[str, Problem] = field(default_factory=dict)
    warnings: Mapping[str, str] = field(default_factory=dict)
    plan: Plan | None = None
    assessment: Assessment | None = None
    stale: str = ''
    departures: int = 0
    departure_id: str = ''
    tight_turns: int = 0
    departure_worth: Assessment | None = None
    last_answer: str = ''
    recording: str = 'off'

    @property
    def state(self) -> str:
        """'solving', 'waiting' (for inputs) or 'ready'; if not active, the lifecycle state."""
        if self.lifecycle != 'active':
            return self.lifecycle
        if self.solving:
            return 'solving'
        return 'waiting' if self.missing else 'ready'

    def with_problem(self, concern: str, error: Exception) -> Status:
        """Return the status with ``error`` as the problem of ``concern``."""
        # A solve that was cancelled on request has not failed.
        cancelled = isinstance(error, SolveCancelled)
        level = DiagnosticStatus.WARN if cancelled else DiagnosticStatus.ERROR
        problem = Problem(code_of(error), str(error) or type(error).__name__, level)
        return replace(self, problems={**self.problems, concern: problem})

    def without_problem(self, concern: str) -> Status:
        """Return the status without a problem of ``concern``."""
        rest = {key: value for key, value in self.problems.items() if key != concern}
        return replace(self, problems=rest)


def status_to_ros(status: Status, name: str, stamp: Time) -> DiagnosticArray:
    """Return the status as the node called ``name`` publishes it on /diagnostics."""
    level, code, message = _summary(status)
    now, last = status.assessment, status.departure_worth
    values = {
        'state': status.state,
        'code': code,
        'message': message,
        **_strategy_values(status.plan),
        'current_value': f'{now.value:.9g}' if now else '',
        'current_gap': f'{now.gap:.9g}' if now else '',
        'current_length': f'{now.expected_length:.9g}' if now else '',
        'stale': ('yes' if status.stale else 'no') if now else '',
        'departures': str(status.departures),
        'departure_id': status.departure_id,
        'departure_value': f'{last.value:.9g}' if last else '',
        'departure_gap': f'{last.gap:.9g}' if last else '',
        'last_answer': status.last_answer,
        'tight_turns': str(status.tight_turns),
        'recording': status.recording,
    }
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    entry = DiagnosticStatus(level=level, name=name, message=message, values=pairs)
    return DiagnosticArray(header=Header(stamp=stamp), status=[entry])


def _summary(status: Status) -> tuple[bytes, str, str]:
    """Return (level, code, message): problems first, that of the last request before others."""
    concerns = ('request', 'map', 'recording')
    problems = [status.problems[each] for each in concerns if each in status.problems]
    if problems:
        message = '; '.join(dict.fromkeys(problem.message for problem in problems))
        return max(problem.level for problem in problems), problems[0].code, message
    if status.lifecycle != 'active':
        return DiagnosticStatus.OK, OK_CODE, status.lifecycle
    waiting = (f'waiting for {", ".join(status.missing)}',) if status.missing else ()
    if status.warnings or waiting:
        return DiagnosticStatus.WARN, OK_CODE, '; '.join((*waiting, *status.warnings.values()))
    changed = '; '.join(filter(None, (
        status.stale, _length_warning(status.assessment)
    )))
    warning = (changed or _gap_warning(status.plan)
               or _counting_gap_warning(status.plan) or _tight_turns_warning(status.tight_turns)
               or _bottleneck_warning(status.plan))
    if warning:
        return DiagnosticStatus.WARN, OK_CODE, f'{status.state}; {warning}'
    return DiagnosticStatus.OK, OK_CODE, status.state


def _gap_warning(plan: Plan | None) -> str:
    """Return a warning if the time limit ended the search for the best strategy."""
    gap = open_gap(plan.strategy, plan.options.strategy) if plan else 0.0
    if plan is None or gap == 0.0:
        return ''
    return (
        f'max_planning_time ended the search for the best strategy: the value '
        f'{plan.strategy.value:.4g} may be up to {gap:.3g} above the minimum, besides '
        'strategy.risk_slack; increase max_planning_time or network.spacing'
    )


def _counting_gap_warning(plan: Plan | None) -> str:
    """Return a warning if counting each route once left the value over its slack."""
    if plan is None or not plan.strategy.counting_gap:
        return ''
    return (
        f'no strategy closer to the bound was found, because some routes enter the reach of an '
        f'ambush more than once or cells between the nodes cost more: the value is '
        f'{plan.strategy.value:.4g}, the bound {plan.strategy.lower_bound:.4g}'
    )


def _length_warning(assessment: Assessment | None) -> str:
    """Return a warning if the routes that are still clear are longer than the budget allows."""
    if assessment is None or not assessment.is_over_budget:
        return ''
    unit = assessment.travel_unit
    length, budget = assessment.expected_length, assessment.length_budget
    return (f'the routes that are clear on the current map have a mean length of {length:.4g} '
            f'{unit}, {length / budget:.3g} times the budget of {budget:.4g} {unit} '
            '(strategy.max_detour)')


def _tight_turns_warning(count: int) -> str:
    if not count:
        return ''
    turns = '1 turn of the last path is' if count == 1 else f'{count} turns of the last path are'
    return (f'{turns} tighter than route.turning_radius, for lack of room; increase '
            'network.clearance or network.spacing')


def _bottleneck_warning(plan: Plan | None) -> str:
    """Return a warning if held ground decides too much: the value, or whether there is one."""
    if plan is None:
        return ''
    bottleneck, game = plan.bottleneck, plan.strategy.game
    held = game.options.held_radius
    if not len(game.sites):
        return (f'the value is 0: nobody can wait within {held:.4g} m of start, stops and goal, '
                'and no ambush elsewhere causes a loss; check the map and game.secured_radius')
    if not bottleneck.value > 0.0:
        return 'the value is 0: some routes meet no ambush that causes a loss; check the map'
    if 0.0 <= plan.options.game.secured_radius < game.reach:
        return (f'an ambush reaches {game.reach:.4g} m, tube included, but ground is held only '
                f'within {plan.options.game.secured_radius:.4g} m of start and goal: an ambush '
                'just outside may hit every route (game.secured_radius)')
    if not bottleneck.near_ends:
        return ''
    return (
        f'{len(bottleneck.sites)} nodes decide the value {bottleneck.value:.4g}, '
        f'{bottleneck.near_ends} of them within {bottleneck.distance:.3g} m of start or goal; if '
        f'that ground were held (game.secured_radius), the value would be '
        f'{bottleneck.secured_value:.4g}'
    )


def _is_chance(game: Game) -> bool:
    """Whether the value is a probability: one ambush, which costs 1 wherever it is."""
    return game.ambushers == 1 and not np.any((game.loss != 0.0) & (game.loss != 1.0))


def _strategy_values(plan: Plan | None) -> dict[str, str]:
    """Return the numbers of the displayed plan; empty ones before the first plan."""
    if plan is None:
        return dict.fromkeys((
            *_STRATEGY_NUMBERS, 'value_is', _DIFFERENT, 'value_holds_at', 'held_radius', 'nodes',
            'edges', 'deciding_sites', 'deciding_sites_near_ends', 'secured_value', 'stops',
            'order', 'solve_seconds',
        ), '')
    return {
        **{name: f'{getattr(plan.strategy, name):.9g}' for name in _STRATEGY_NUMBERS},
        'value_is': 'chance to be met' if _is_chance(plan.strategy.game) else 'mean loss',
        _DIFFERENT: '' if plan.different_paths is None else str(plan.different_paths),
        'value_holds_at': ('any cell of the map'
                           if holds_anywhere(plan.strategy.game, plan.options)
                           else "the network's nodes"),
        'held_radius': f'{plan.strategy.game.options.held_radius:.9g}',
        'nodes': str(len(plan.network.points)),
        'edges': str(len(plan.network.edges)),
        'deciding_sites': str(len(plan.bottleneck.sites)),
        'deciding_sites_near_ends': str(plan.bottleneck.near_ends),
        'secured_value': f'{plan.bottleneck.secured_value:.9g}',
        'stops': str(len(plan.order)),
        'order': plan.order_found if plan.order else '',
        'solve_seconds': f'{plan.seconds:.3f}',
    }
