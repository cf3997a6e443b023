# SPDX-License-Identifier: Apache-2.0
"""The displayed plan: the last one that was departed on or solved, with its markers."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace

from rclpy.clock import Clock
from std_msgs.msg import Header

from ..errors import AmbushPlannerError
from ..planning.changed_ground import Assessment
from ..planning.plan import Plan
from ..recordings import RecordedMessage
from ..worker.serial_executor import SerialExecutor
from ..worker.solve_errors import SolveCancelled
from .inputs import Inputs
from .markers import MARKERS
from .plan_cache import CachedPlan, PlanCache
from .reporter import Reporter
from .topics import Publishers


class DisplayedPlan:
    """Shows a plan, assesses it on the newest map, and has it solved again when it is stale.

    Call all methods on the departures thread, which is that of ``departures``. The plan is
    ``cached``, None before the first one; ``markers`` are those of ``plan``, which may join it.
    """

    def __init__(self, plans: PlanCache, inputs: Inputs, publishers: Publishers, reporter: Reporter,
                 clock: Clock, departures: SerialExecutor) -> None:
        self._plans, self._inputs, self._publishers = plans, inputs, publishers
        self._reporter, self._clock, self._departures = reporter, clock, departures
        self.cached: CachedPlan | None = None
        self.plan: Plan | None = None
        self.markers: tuple[RecordedMessage, ...] = ()
        self._latest_resolve: Future[CachedPlan] | None = None

    def show(self, cached: CachedPlan, plan: Plan | None = None,
             assessment: Assessment | None = None) -> None:
        """Display a plan, perhaps one that joins it: publish markers and report its numbers.

        ``assessment``, if it is known, is what the displayed plan is worth on the newest map.
        """
        plan = plan or cached.plan
        header = Header(frame_id=cached.trip.map.frame, stamp=self._clock.now().to_msg())
        self.markers = tuple(self._publishers.publish(f'~/{name}', drawn(plan.strategy, header))
                             for name, drawn in MARKERS.items())
        self.cached, self.plan = cached, plan
        newest = self._inputs.current_map()
        if assessment is None and newest.same_ground(cached.trip.map):
            assessment = cached.ground.assess(newest)
        if cached.refined_by is not None:
            self._refine(cached)
        self._reporter.set(plan=cached.plan, assessment=assessment, stale='')

    def _refine(self, cached: CachedPlan) -> None:
        """Have a first plan's network refined, and show the new plan if it still shows this one."""
        def show_result(solve: Future[CachedPlan]) -> None:
            with suppress(AmbushPlannerError):  # the first plan stays
                refined = solve.result()
                if self.cached is cached:
                    self.show(refined)

        with suppress(SolveCancelled):  # the node is about to end
            solve = self._plans.refine(cached)
            solve.add_done_callback(lambda done: self._departures.submit(lambda: show_result(done)))

    def review(self, tolerance: float, after_resolve: Callable[[], None] | None) -> None:
        """Report how good the plan is on the current map.

        A plan that is blocked, or whose value has risen by more than ``tolerance``, is solved
        again, unless a robot has driven away from its start. Then ``after_resolve`` is called; if
        that is None, nothing is solved.
        """
        cached, newest = self.cached, self._inputs.current_map()
        self._plans.keep_ground(newest)
        if cached is None or not newest.same_ground(cached.trip.map):
            self._reporter.set(assessment=None, stale='')
            return
        assessment = cached.ground.assess(newest)
        if not assessment.is_stale(cached.plan.strategy.value, tolerance):
            if self._latest_resolve is not None:
                self._latest_resolve = None
                self._plans.withdraw_background()
            self._reporter.set(assessment=assessment, stale='')
            return
        why = 'the map has changed: ' + (
            f'new obstacles lie on {100.0 * (1.0 - assessment.clear_share):.0f} % of the routes'
            if assessment.is_blocked else f'the value has risen to {assessment.value:.4g}'
        )
        if after_resolve is None or cached.trip.moves:
            self._reporter.set(assessment=assessment, stale=why)
        else:
            self._reporter.set(assessment=assessment, stale=f'{why}; a new plan is being solved')
            self._resolve(cached, why, after_resolve)

    def _resolve(self, cached: CachedPlan, why: str, after_resolve: Callable[[], None]) -> None:
        """Have the plan solved for the current map in the background, and show the new one."""
        trip = replace(cached.trip, map=self._inputs.current_map())

        def show_result(solve: Future[CachedPlan]) -> None:
            try:
                self.show(solve.result())
                if solve is self._latest_resolve:
                    self._latest_resolve = None
            except SolveCancelled:
                if solve is self._latest_resolve:  # not superseded by a later one
                    self._reporter.set(stale=f'{why}, and the new solve was cancelled')
                return
            except AmbushPlannerError as error:
                self._reporter.set(stale=f'{why}, and the new solve failed: {error}')
                return
            after_resolve()

        solve = self._plans.solve(trip, cached.asked, background=True)
        self._latest_resolve = solve
        self._reporter.set()
        solve.add_done_callback(lambda done: self._departures.submit(lambda: show_result(done)))
