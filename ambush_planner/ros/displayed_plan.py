# SPDX-License-Identifier: Apache-2.0
"""The displayed plan: the last one that was departed on or solved, with its markers."""

from __future__ import annotations

from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace

from ..errors import AmbushPlannerError
from ..planning.plan import Plan
from ..recordings.messages import RecordedMessage
from ..recordings.schemas import MARKER_NAMES
from ..worker.solve_errors import SolveCancelled
from .current_map import CurrentMap
from .diagnostics import Reporter
from .inputs import Inputs
from .markers import MARKERS
from .parameter_changes import NodeSettings
from .plan_cache import CachedPlan, Fit, PlanCache
from .serial_executor import SerialExecutor
from .topics import Publishers


class DisplayedPlan:
    """Shows a plan, assesses it on the newest map, and has it solved again when it is stale.

    Call ``show`` on the departures thread only, which is ``thread``. The plan is ``cached``; what
    is shown is ``plan``, that plan itself or one that joins it from where a robot is. Both are None
    before the first one. ``markers`` are those of ``plan`` without the whole network, which RViz
    and Foxglove hide: recordings keep these.
    """

    def __init__(self, plans: PlanCache, inputs: Inputs, settings: NodeSettings,
                 publishers: Publishers, reporter: Reporter, thread: SerialExecutor) -> None:
        self._plans, self._inputs, self._settings = plans, inputs, settings
        self._publishers, self._reporter, self._thread = publishers, reporter, thread
        self.cached: CachedPlan | None = None
        self.plan: Plan | None = None
        self.markers: tuple[RecordedMessage, ...] = ()
        self._map_is_new = False
        plans.on_solved = lambda solved: thread.submit(lambda: self._show_refined(solved))

    def show(self, fit: Fit) -> None:
        """Display a plan, perhaps one that joins it: publish markers and report its numbers.

        A first plan is refined from now on, also if that was cancelled before.
        """
        cached, plan = fit.cached, fit.plan
        if cached.is_first:
            with suppress(AmbushPlannerError):  # the node is inactive, or about to end
                self._plans.refine(cached)
        if plan is self.plan:
            return
        frame, now = cached.trip.map.frame, self._publishers.clock.now().nanoseconds
        sent = {name: self._publishers.publish(f'~/{name}', drawn(plan.trip, frame, now))
                for name, drawn in MARKERS.items()}
        self.markers = tuple(sent[name] for name in MARKER_NAMES)
        self.cached, self.plan = cached, plan
        self._reporter.set(plan=cached.plan, assessment=fit.assessment, stale='')
        if self._inputs.current_map() is not cached.trip.map:
            self.map_changed()

    def map_changed(self) -> None:
        """Assess the plan on the current map, and have it solved again if it is stale."""
        if not self._map_is_new:  # one review covers many updates
            self._map_is_new = True
            self._thread.submit(self._review)

    def _review(self) -> None:
        """Report how good the plan is on the current map.

        It is stale if it is blocked, or its value has risen by more than ``replan.tolerance``. Then
        it is solved again, unless a robot has driven away from its start.
        """
        self._map_is_new = False
        cached, newest = self.cached, self._inputs.map
        if newest is None:
            return
        self._plans.keep_ground(newest)
        if cached is None or not newest.same_ground(cached.trip.map):
            self._reporter.set(assessment=None, stale='')
            return
        assessment, stale = cached.ground.assess(newest), ''
        tolerance = self._settings.current.values['replan.tolerance']
        if assessment.is_stale(cached.plan.value, tolerance):
            stale = 'the map has changed: ' + (
                f'new obstacles lie on {100.0 * (1.0 - assessment.clear_share):.0f} % of the routes'
                if assessment.is_blocked else f'the value has risen to {assessment.value:.4g}'
            )
        self._reporter.set(assessment=assessment, stale=stale)
        if stale and not cached.trip.robot:
            with suppress(AmbushPlannerError):  # the node is inactive
                self._resolve(cached, newest, stale)

    def _resolve(self, cached: CachedPlan, newest: CurrentMap, stale: str) -> None:
        """Have the plan solved for the newest map in the background, and show the new one."""
        def show_result(solve: Future[CachedPlan]) -> None:
            try:
                self.show(solve.result().as_solved)
            except SolveCancelled:
                pass
            except AmbushPlannerError as error:
                if self.cached is cached and self._inputs.map is newest:
                    self._reporter.set(stale=f'{stale}, and the new solve failed: {error}')

        trip = replace(cached.trip, map=newest)
        self._thread.submit_after(self._plans.solve(trip, background=True), show_result)

    def _show_refined(self, solved: CachedPlan) -> None:
        """Show a plan instead of the first one for its trip."""
        if self.cached and self.cached.is_first and self.cached.trip == solved.trip:
            self.show(solved.as_solved)
