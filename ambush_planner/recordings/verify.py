# SPDX-License-Identifier: Apache-2.0
"""Verifies recorded departures: network, certificate, route and path follow from what is recorded.

The network is built again from the recorded map and options, the certificate is judged on it, and
route and path are drawn again from the recorded entropy. That needs no second solve: the
certificate alone proves how close the strategy is to the best one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..arrays import FloatArray
from ..errors import AmbushPlannerError
from ..game.budget import length_budget
from ..game.distribution.acyclic import is_acyclic
from ..game.revaluation import open_gap
from ..game.solver import solve_legs
from ..game.strategy import TripStrategy
from ..game.tolerance import CERTIFICATE_TOLERANCE
from ..maps.risk_map import RiskMap
from ..network.hiding_places import with_places
from ..planning.cell_losses import CellLosses, CellSearch
from ..planning.departure import draw_route
from ..planning.moved_start import other_rest
from ..planning.options import PlanningOptions, holds_anywhere, solved_game
from ..planning.plan import gap_is_wide
from ..planning.solving import add_hiding_places
from ..planning.trip import Trip
from .ground_check import GroundCheck, Now
from .metadata import Metadata, PlanMetadata, RecordedTrip, numbers_of, typed
from .plan_file import KIND, SavedPlan, plan_in, recorded_trip
from .recorded_departure import RecordedDeparture, departure_in, ground_of, made_once
from .recorded_departures import MIN_BITS
from .recording_errors import NoPermission, UnreadableRecording
from .recording_file import read_recording

# Rounding between releases of numpy and scipy, relative and absolute.
_TOLERANCE = 1e-9
# Rounding of path poses [m, rad].
_POSE_TOLERANCE = 1e-6
# Number of results kept in memory: what belongs to the last four strategies and maps, or more.
_KEPT = 48


@dataclass(eq=False)
class Verdict:
    """The findings about one file.

    ``problems`` do not hold, and each begins with the part of the recording that it concerns;
    if the file is ``denied``, the user may not read it. ``notes`` are other remarks. ``route`` and
    ``drawn`` are nodes as in ``RecordedDeparture``; the strategies are not kept, since a folder may
    hold thousands. ``value`` and ``covered`` are those of ``RecordedDeparture``. ``now`` is the
    file on new ground, if that is asked for; ``plan`` is set if the file is a plan.
    """

    path: Path
    readable: bool = False
    denied: bool = False
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    metadata: Metadata | None = field(default=None, repr=False)
    route: tuple[tuple[int, ...], ...] = field(default=(), repr=False)
    drawn: tuple[tuple[int, ...], ...] = field(default=(), repr=False)
    nodes: int = 0
    value: float = math.nan
    covered: float = 1.0
    now: Now | None = field(default=None, repr=False)
    plan: PlanMetadata | None = field(default=None, repr=False)

    @property
    def holds(self) -> bool:
        """Return whether everything that was checked holds."""
        return not self.problems

    @property
    def plan_value(self) -> float:
        """The value of the plan, whose ambusher must choose one of its times, too."""
        slots = self.metadata and self.metadata.plan and self.metadata.plan.slots
        return self.value / self.covered * (slots.covered if slots else 1.0)


class Verifier:
    """Verifies departures and plans.

    With ``replan`` each strategy is also solved again from scratch; with files of a new map or new
    roads, verdicts say what is clear there and what it costs.
    """

    def __init__(self, replan: bool = False, map_file: Path | None = None,
                 roads_file: Path | None = None) -> None:
        self._replan = replan
        self._once = made_once(_KEPT)
        self._ground = GroundCheck(map_file, roads_file, self._once) if (
            map_file or roads_file) else None

    def verify(self, path: Path) -> Verdict:
        """Verify one file; problems are in the verdict and never raised.

        Raises the errors of a new map or of new roads.
        """
        verdict = Verdict(path)
        departure: RecordedDeparture | None = None
        saved: SavedPlan | None = None
        try:
            file = read_recording(path)
            verdict.readable = True
            if file.entries.get('kind') == KIND:
                saved = plan_in(file)
                verdict.plan = typed(file.entries, PlanMetadata, 'metadata')
                verdict.nodes = saved.plan.trip.game.node_count
                verdict.value = saved.value
                verdict.problems += self._plan_problems(saved)
            else:
                departure = departure_in(file, self._once)
                self._verify_departure(departure, verdict)
        except UnreadableRecording as error:
            verdict.denied = isinstance(error, NoPermission)
            verdict.problems.append(error.reason)
        except AmbushPlannerError as error:
            verdict.problems.append(f'no plan follows from map, trip and parameters: {error}')
        except Exception as error:  # a file may say anything, and others wait to be verified
            verdict.problems.append('no plan follows from map, trip and parameters '
                                    f'({type(error).__name__})')
        if self._ground and not verdict.problems:
            verdict.now = (self._ground.plan(saved) if saved else
                           self._ground.departure(departure) if departure else None)
        return verdict

    def _verify_departure(self, departure: RecordedDeparture, verdict: Verdict) -> None:
        verdict.metadata = departure.metadata
        verdict.route, verdict.drawn = map(numbers_of, (departure.route, departure.drawn))
        verdict.nodes = departure.trip.game.node_count
        verdict.value, verdict.covered = departure.value, departure.covered
        if departure.parameters.values['seed'] >= 0:
            verdict.notes.append('drawn with a fixed seed: anyone who knows it can predict it')
        wide = gap_problems(departure.trip, departure.parameters.planning)
        if departure.metadata.plan:  # it was accepted when the plan was saved
            verdict.notes += [f'{text}, and was accepted' for text in wide]
        else:
            verdict.problems += wide
        verdict.problems += self._problems(departure)

    def _plan_problems(self, saved: SavedPlan) -> list[str]:
        """Check a plan as each departure of it is."""
        plan, planning = saved.plan, saved.parameters.planning
        problems = [*network_problems(plan.trip, plan.own_map, planning, recorded_trip(plan)),
                    *certificate_problems(plan.trip, planning)]
        if not problems and self._replan:
            problems += replan_problems(plan.trip, planning)
        return problems

    def _problems(self, departure: RecordedDeparture) -> list[str]:
        trip, planning = departure.trip, departure.parameters.planning
        problems = [
            *self._once(network_problems, trip, departure.risk_map, planning,
                               departure.metadata.trip),
            *certificate_problems(trip, planning),
            *value_problems(departure), *source_problems(departure),
        ]
        if not problems:
            problems += self._draw_problems(departure)
        if not problems and self._replan:
            problems += self._once(replan_problems, trip, planning)
        return problems

    def _draw_problems(self, departure: RecordedDeparture) -> list[str]:
        """Draw route and path again as the node does."""
        parameters, newest, said = departure.parameters, departure.newest, departure.metadata
        ground = self._once(ground_of, departure.trip, departure.planned_on,
                                   parameters.occupancy, parameters.planning, departure.risk_map)
        plan, source = ground.plan, said.route_entropy_source
        spacing = parameters.values['route.path_spacing']
        if said.diversion:
            leg = len(said.diversion.left) - len(said.route)
            again = other_rest(ground, newest, said.ends, leg, np.array(said.diversion.ahead),
                               source, spacing)
        elif departure.joined:
            again = draw_route(departure.joined.plan, source, spacing, said.ends)
        else:
            again = draw_route(plan, source, spacing, said.ends, ground, newest)
        if again is None or numbers_of(again.route) != numbers_of(departure.drawn):
            return ['route: the recorded entropy draws another one']
        rows, poses = again.poses, departure.recorded_poses
        if len(poses) == len(rows) + 1:
            poses = poses[1:]  # before the route, the robot leaves a costmap's inflation
        if not _same_path(poses, rows):
            return ['path: it does not follow from the recorded route']
        return _slot_problems(said, again.rng)


def _same_path(poses: FloatArray, rows: FloatArray) -> bool:
    # The first and last poses have the headings that start and goal were given with.
    return poses.shape == rows.shape and bool(
        np.allclose(poses[:, :2], rows[:, :2], rtol=_TOLERANCE, atol=_POSE_TOLERANCE)
        and np.allclose(np.exp(1j * poses[1:-1, 2]), np.exp(1j * rows[1:-1, 2]),
                        rtol=0.0, atol=_POSE_TOLERANCE))


def _slot_problems(said: Metadata, rng: np.random.Generator) -> list[str]:
    """Draw the slot again, which comes after the route."""
    if not (said.day and said.day.slot_drawn):
        return []
    slots = said.plan.slots if said.plan else None
    if slots and said.day.slot == slots.draw(rng):
        return []
    return ['slot: the recorded entropy draws another one']


def network_problems(trip: TripStrategy, risk_map: RiskMap, planning: PlanningOptions,
                     said: RecordedTrip) -> list[str]:
    """Build the networks again and compare them bit for bit; then compare the game's budgets."""
    games, played = [leg.game for leg in trip.legs], solved_game(risk_map, planning)
    recorded = [game.network for game in games]
    laid = Trip(risk_map, said.start, said.goal, said.stops, planning).networks(recorded[0].refined)
    networks = add_hiding_places(laid, risk_map, planning, played)
    cells = CellLosses(risk_map, planning.game.ambush_in_obstacles)
    if holds_anywhere(planning):
        sites = recorded[0].points[len(networks[0].points):]
        networks = [with_places(each, sites, cells.losses_at(sites)) for each in networks]
    if len(networks) != len(recorded) or not all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for one, other in zip(recorded, networks, strict=True)
        for name in ('source', 'target', 'points', 'edges', 'alpha')
    ) or [each.ground_length for each in recorded] != [each.ground_length for each in networks]:
        return ['network: it does not follow from the recorded map, trip and parameters; if an '
                'earlier version planned it, plan again']
    if trip.game.options != played:
        return ['strategy: its reach or secured area is not that of the parameters']
    problems, law = [], trip.law
    search = CellSearch(cells, games, law.uses(trip.joint.edge_count) > 0.0)
    if holds_anywhere(planning) and len(
            worst := search.worst(law, trip.value * (1.0 + _TOLERANCE)).mean_loss):
        problems.append(f'strategy: an ambush between its sites costs {worst[0]:.9g}, more than '
                        f'its value {trip.value:.9g}')
    for leg in trip.legs if planning.strategy.length_weight == 0.0 else ():
        limit = length_budget(leg.game, planning.strategy.max_detour).limit
        if not math.isclose(leg.length_budget, limit, rel_tol=_TOLERANCE):
            problems.append(f'strategy: its length budget is {leg.length_budget:.9g}, the '
                            f'parameters give {limit:.9g}')
    return problems


def certificate_problems(trip: TripStrategy, planning: PlanningOptions) -> list[str]:
    """Check what the planner promises of every strategy, from its probabilities alone."""
    problems = []
    for leg in trip.legs:
        if planning.strategy.solver == 'max_entropy' and not is_acyclic(
                leg.network, leg.edge_probability):
            problems.append('strategy: its routes run in cycles')
        mean, budget = leg.expected_length, leg.length_budget
        if not mean <= budget * (1.0 + CERTIFICATE_TOLERANCE):
            problems.append(f'strategy: its length, {mean:.9g}, exceeds its budget of {budget:.9g}')
    return problems


def gap_problems(trip: TripStrategy, planning: PlanningOptions) -> list[str]:
    """Say so if a gap that more time would have narrowed is wide."""
    if trip.reason == 'stalled' or not gap_is_wide(trip, planning):
        return []
    return [f'strategy: its certificate does not close, the gap is {trip.gap:.3g}']


def value_problems(departure: RecordedDeparture) -> list[str]:
    """Compare the value that is stated of a departure with that on the map of that moment."""
    stated, found = departure.metadata.value, departure.value
    if stated is None or math.isclose(stated, found, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE):
        return []
    return [f'value: the departure is stated to cost {stated:.9g}, on the map of that moment it '
            f'costs {found:.9g}']


def source_problems(departure: RecordedDeparture) -> list[str]:
    """Check that the random source is one that the node makes."""
    said = departure.metadata
    seed, source = departure.parameters.values['seed'], said.route_entropy_source
    if seed >= 0:
        numbers = (said.departure, said.diversion.number) if said.diversion else (said.departure,)
        expected = source == (seed, *numbers)
        return [] if expected else ['random source: it does not follow from the parameter seed']
    if len(source) != 1 or source[0].bit_length() < MIN_BITS:
        return [f'random source: it has fewer than {MIN_BITS} bits']
    return []


def replan_problems(trip: TripStrategy, planning: PlanningOptions) -> list[str]:
    """Solve the game again, from scratch and without a time limit, and compare the values."""
    options = replace(planning.strategy, time_limit=math.inf)
    again = solve_legs(trip.joint.games, options)
    # Values differ within the slack that was asked for, and as far as a solve was cut short.
    allowed = (options.tolerance + 2.0 * CERTIFICATE_TOLERANCE) * again.value + max(
        open_gap(trip, options), open_gap(again, options)
    )
    if abs(trip.value - again.value) <= allowed:
        return []
    return [f'strategy: its value is {trip.value:.9g}, solved again {again.value:.9g}']
