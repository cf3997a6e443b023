"""The plan in force: the one that was departed on or solved last, with its markers."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace

from rclpy.clock import Clock
from rclpy.time import Time
from std_msgs.msg import Header

from ..errors import AmbushPlannerError
from ..recordings import RecordedMessage
from ..worker.solve_errors import SolveCancelled
from . import markers
from .inputs import Inputs
from .plan_cache import CachedPlan, PlanCache
from .publishers import Publishers
from .reporter import Reporter


class DisplayedPlan:
    """Shows a plan, tells how it stands on the newest map, has it solved anew when it is stale.

    Belongs to the thread of departures, where ``in_turn`` has work done.

    Attributes
    ----------
    held
        The plan; None before the first one.
    markers
        As they were published for it.
    """

    def __init__(
        self,
        plans: PlanCache,
        inputs: Inputs,
        outbox: Publishers,
        reporter: Reporter,
        clock: Clock,
        in_turn: Callable[[Callable[[], None]], None],
    ) -> None:
        self._plans, self._inputs, self._outbox = plans, inputs, outbox
        self._reporter, self._clock, self._in_turn = reporter, clock, in_turn
        self.held: CachedPlan | None = None
        self.markers: tuple[RecordedMessage, ...] = ()
        self._anew: Future[CachedPlan] | None = None  # the solve that the diagnostics tell of

    def show(self, held: CachedPlan) -> None:
        """Publish the markers of the plan that is in force from now on."""
        plan, strategy = held.plan, held.plan.strategy
        stamp = Time(nanoseconds=self._clock.now().nanoseconds).to_msg()
        header = Header(frame_id=held.trip.map.frame, stamp=stamp)
        self.markers = tuple(
            self._outbox.publish(topic, message)
            for topic, message in (
                ('network', markers.network_lines(plan.network, header)),
                ('edge_probabilities', markers.edge_probabilities(strategy, header)),
                ('mean_direction', markers.mean_direction(strategy, header)),
                ('ambush_sites', markers.ambush_sites(strategy, header)),
                ('stops', markers.stops(plan.network, header)),
            )
        )
        self.held = held
        newest = self._inputs.current_map()
        same = newest.same_ground(held.trip.map)
        self._reporter.plan_shown(plan, held.ground.standing(newest) if same else None)

    def review(self, tolerance: float, then: Callable[[], None] | None) -> None:
        """Tell how the plan stands on the map in force.

        If it is stale by the ``tolerance`` it is solved anew, after which ``then`` is called; not
        if that is None.
        """
        held, newest = self.held, self._inputs.current_map()
        self._plans.keep_ground(newest)
        if held is None or not newest.same_ground(held.trip.map):
            self._reporter.stands(None, '')
            return
        standing = held.ground.standing(newest)
        if not standing.stale(held.plan.strategy.value, tolerance):
            self._anew = None
            self._plans.withdraw_background()
            self._reporter.stands(standing, '')
            return
        why = 'the map has changed: ' + (
            f'new obstacles lie on {100.0 * (1.0 - standing.share):.0f} % of the routes'
            if standing.blocked else f'the value has risen to {standing.value:.4g}'
        )
        if then is None:
            self._reporter.stands(standing, why)
            return
        self._reporter.stands(standing, f'{why}; it is being solved anew')
        self._solve_anew(held, why, then)

    def _solve_anew(self, held: CachedPlan, why: str, then: Callable[[], None]) -> None:
        """Have the plan solved for the newest map, in the background, and show it then."""
        trip = replace(held.trip, map=self._inputs.current_map())

        def shown(solve: Future[CachedPlan]) -> None:
            try:
                self.show(solve.result())
            except SolveCancelled:
                if solve is self._anew:  # and not superseded
                    self._reporter.stale(f'{why}, and solving it anew was cancelled')
                return
            except AmbushPlannerError as error:
                self._reporter.stale(f'{why}, and cannot be solved anew: {error}')
                return
            then()

        solve = self._anew = self._plans.solve(trip, held.parameters, background=True)
        self._reporter.refresh()
        solve.add_done_callback(lambda done: self._in_turn(lambda: shown(done)))
