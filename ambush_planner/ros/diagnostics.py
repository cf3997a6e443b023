"""What the node tells about itself: one status with stable keys, never a route or a seed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Header

from ..game.bottleneck import Bottleneck
from ..game.revaluation import open_gap
from ..planning.changed_ground import Standing
from ..planning.plan import DRAWN, Plan
from ..worker.solve_errors import SolveCancelled
from .error_codes import OK_CODE, code_of

_DIFFERENT = f'different_paths_of_{DRAWN}'


class Problem(NamedTuple):
    """What is wrong: a code (``errors.code_of``), the message for people, and the level."""

    code: str
    message: str
    level: bytes = DiagnosticStatus.ERROR


@dataclass(frozen=True)
class Status:
    """The node's state; ``problems`` by what they concern: 'request', 'map' or 'recording'.

    ``lifecycle`` is the state of the node: unconfigured, inactive, active or finalized.
    ``warnings`` are texts by what they concern: 'parameters' or 'alpha_map'. ``standing`` tells how
    the plan stands on the map in force; ``stale`` says in words, if it is so, that the plan has to
    be solved anew. ``tight_turns`` are those of the last departure's path
    that are tighter than was asked for.
    """

    lifecycle: str = 'active'
    missing: tuple[str, ...] = ()
    solving: bool = False
    problems: Mapping[str, Problem] = field(default_factory=dict)
    warnings: Mapping[str, str] = field(default_factory=dict)
    plan: Plan | None = None
    standing: Standing | None = None
    stale: str = ''
    departures: int = 0
    departure_id: str = ''
    tight_turns: int = 0
    recording: str = 'off'

    @property
    def state(self) -> str:
        """'solving', 'waiting' (for inputs) or 'ready'; where it is not active, its lifecycle's."""
        if self.lifecycle != 'active':
            return self.lifecycle
        if self.solving:
            return 'solving'
        return 'waiting' if self.missing else 'ready'

    def with_problem(self, concern: str, error: Exception) -> Status:
        """Return the status with ``error`` as what is wrong with ``concern``."""
        # Somebody wanted a solve to end: nothing has failed.
        level = (
            DiagnosticStatus.WARN if isinstance(error, SolveCancelled) else DiagnosticStatus.ERROR
        )
        problem = Problem(code_of(error), str(error) or type(error).__name__, level)
        return replace(self, problems={**self.problems, concern: problem})

    def without_problem(self, concern: str) -> Status:
        """Return the status with nothing wrong with ``concern``."""
        rest = {key: value for key, value in self.problems.items() if key != concern}
        return replace(self, problems=rest)


def status_to_ros(status: Status, name: str, stamp: Time) -> DiagnosticArray:
    """Return the status as the node called ``name`` publishes it on /diagnostics."""
    level, code, message = _summary(status)
    values = {
        'state': status.state,
        'code': code,
        'message': message,
        **_strategy_values(status.plan),
        **_standing_values(status.standing, status.stale),
        'departures': str(status.departures),
        'departure_id': status.departure_id,
        'tight_turns': str(status.tight_turns),
        'recording': status.recording,
    }
    entry = DiagnosticStatus(
        level=level,
        name=name,
        message=message,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )
    return DiagnosticArray(header=Header(stamp=stamp), status=[entry])


def _summary(status: Status) -> tuple[bytes, str, str]:
    """(level, code, message): problems first, the last request's before all others."""
    concerns = [concern for concern in ('request', 'map', 'recording')
                if concern in status.problems]
    if concerns:
        problems = [status.problems[concern] for concern in concerns]
        message = '; '.join(problem.message for problem in problems)
        return max(problem.level for problem in problems), problems[0].code, message
    if status.lifecycle != 'active':
        return DiagnosticStatus.OK, OK_CODE, status.lifecycle
    waiting = (f'waiting for {", ".join(status.missing)}',) if status.missing else ()
    if status.warnings or waiting:
        message = '; '.join((*waiting, *status.warnings.values()))
        return DiagnosticStatus.WARN, OK_CODE, message
    if status.stale:
        return DiagnosticStatus.WARN, OK_CODE, f'{status.state}; {status.stale}'
    if status.plan is not None and (warning := _gap_warning(status.plan)):
        return DiagnosticStatus.WARN, OK_CODE, f'{status.state}; {warning}'
    if status.tight_turns:
        return DiagnosticStatus.WARN, OK_CODE, f'{status.state}; {_tight_warning(status)}'
    if status.plan is not None and (warning := _warning(status.plan.bottleneck)):
        return DiagnosticStatus.WARN, OK_CODE, f'{status.state}; {warning}'
    return DiagnosticStatus.OK, OK_CODE, status.state


def _gap_warning(plan: Plan) -> str:
    """Say so where the time was up before the strategy was the best."""
    gap = open_gap(plan.strategy, plan.options.strategy)
    if gap == 0.0:
        return ''
    return (
        f'time was up before the best strategy was found: beyond strategy.risk_slack, the value '
        f'{plan.strategy.value:.4g} may be {gap:.3g} over the least one; allow more '
        'max_planning_time, or choose a larger network.spacing'
    )


def _tight_warning(status: Status) -> str:
    turns = '1 turn' if status.tight_turns == 1 else f'{status.tight_turns} turns'
    return (
        f'{turns} of the last path tighter than route.turning_radius, for want of room: a larger '
        'network.clearance or network.spacing leaves more'
    )


def _warning(bottleneck: Bottleneck) -> str:
    """Say so where there is no game, or where the minimum cut hugs the start or the goal."""
    if not bottleneck.value > 0.0:
        return (
            'the value is 0: no ambush that is possible costs anything, so the routes are random '
            'but need not be; check the map and game.secured_radius'
        )
    if not bottleneck.near_ends:
        return ''
    return (
        f'{len(bottleneck.sites)} nodes decide the value {bottleneck.value:.4g}, '
        f'{bottleneck.near_ends} of them within {bottleneck.distance:.3g} m of start or goal; if '
        f'that ground were secured (game.secured_radius), it would be '
        f'{bottleneck.secured_value:.4g}'
    )


def _standing_values(standing: Standing | None, stale: str) -> dict[str, str]:
    """The strategy in force on the newest map."""
    return {
        'current_value': '' if standing is None else f'{standing.value:.9g}',
        'current_gap': '' if standing is None else f'{standing.gap:.9g}',
        'stale': '' if standing is None else 'yes' if stale else 'no',
    }


def _strategy_values(plan: Plan | None) -> dict[str, str]:
    """The strategy in force; the keys are there, and empty, as long as there is none."""
    names = ('value', 'lower_bound', 'gap', 'edge_entropy', 'route_entropy',
             'expected_length', 'shortest_length')
    if plan is None:
        return dict.fromkeys(
            (*names, _DIFFERENT, 'nodes', 'edges', 'deciding_sites', 'deciding_sites_near_ends',
             'secured_value', 'stops', 'order', 'solve_seconds'),
            '',
        )
    return {
        **{name: f'{getattr(plan.strategy, name):.9g}' for name in names},
        _DIFFERENT: '' if plan.different_paths is None else str(plan.different_paths),
        'nodes': str(len(plan.network.points)),
        'edges': str(len(plan.network.edges)),
        'deciding_sites': str(len(plan.bottleneck.sites)),
        'deciding_sites_near_ends': str(plan.bottleneck.near_ends),
        'secured_value': f'{plan.bottleneck.secured_value:.9g}',
        'stops': str(len(plan.order)),
        'order': plan.order_found if plan.order else '',
        'solve_seconds': f'{plan.seconds:.3f}',
    }
