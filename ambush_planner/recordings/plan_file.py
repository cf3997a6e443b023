# SPDX-License-Identifier: Apache-2.0
"""Plans as files: planned once, drawn from every morning, by anybody who has the file.

A plan file is an MCAP file like a recorded departure: the map as a message, the metadata record
with the entry ``kind`` 'plan', and as attachments the map, the strategy, and roads if there are
any. A departure that is drawn from it has the same, and its route. Needs no ROS.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any
from uuid import uuid4

from ..errors import InvalidOption
from ..maps.occupancy import OccupancyOptions
from ..maps.risk_map_file import map_from_bytes, npz_bytes
from ..network.road_network import in_map_frame
from ..operations.slots import Slots
from ..parameters.table import PARAMETERS
from ..parameters.values import NodeParameters, parameters_from
from ..planning.options import node_spacing
from ..planning.plan import Plan
from .attachments import (
    MAP_FILE,
    ROADS_FILE,
    STRATEGY_FILE,
    roads_file,
    roads_from_file,
    strategy_file,
    strategy_from_file,
)
from .encoding import encode
from .messages import RecordedMessage, map_message
from .metadata import (
    BEYOND,
    PlanMetadata,
    RecordedPlan,
    RecordedTrip,
    software_versions,
    typed,
    typed_values,
)
from .recording_errors import UnreadableRecording, part
from .recording_file import RecordingFile, read_recording
from .sources import Source

KIND = 'plan'


@dataclass(frozen=True, eq=False)
class SavedPlan:
    """A plan with its map, and what the node's parameters would be for it.

    ``names`` are those of start and goal, '' if they have none. Of a plan from a file, ``files``
    are its attachments and ``map_message`` is its map, both as they are there: departures have the
    same.
    """

    plan: Plan
    parameters: NodeParameters
    slots: Slots | None = None
    sources: tuple[Source, ...] = ()
    frame: str = 'map'
    names: tuple[str, str] = ('', '')
    id: str = ''
    made_ns: int = 0
    files: Mapping[str, bytes] = field(default_factory=dict, repr=False)
    map_message: RecordedMessage | None = field(default=None, repr=False)

    @property
    def value(self) -> float:
        """Mean loss per departure by the best ambush, which must choose a slot, too."""
        return self.plan.value * (self.slots.covered if self.slots else 1.0)


def saved_plan(plan: Plan, occupancy: OccupancyOptions | None = None,
               slots: Slots | None = None, sources: tuple[Source, ...] = (),
               names: tuple[str, str] = ('', '')) -> SavedPlan:
    """A new plan to save, with the files that it was made from, and names of start and goal.

    Raises InvalidOption if the plan was made in another process, so that its map is missing, or if
    it has few routes, which are drawn by hand.
    """
    if plan.few:
        raise InvalidOption('a plan of few routes is not saved: brief and draw them by hand')
    occupancy = occupancy or OccupancyOptions(crs=plan.own_map.crs)
    values = parameter_values(plan, occupancy)
    roads = plan.options.network.roads
    roads = roads and in_map_frame(roads, plan.own_map.crs)
    return SavedPlan(plan, parameters_from(values, roads), slots, sources, names=names,
                     id=str(uuid4()), made_ns=time.time_ns())


def parameter_values(plan: Plan, occupancy: OccupancyOptions) -> dict[str, Any]:
    """The options of a plan by the names of the node's parameters, and those that it has not."""
    options = plan.options
    values: dict[str, Any] = {name: each.default for name, each in PARAMETERS.items()}
    values |= {'max_planning_time': options.strategy.time_limit,
               'strategy.max_gap': options.max_gap, 'network.refine': -1}
    for group, part_of in (('map', occupancy), ('network', options.network),
                           ('game', options.game), ('strategy', options.strategy),
                           ('route', options.drive)):
        for each in fields(part_of):
            name, value = f'{group}.{each.name}', getattr(part_of, each.name)
            if name == 'network.graph' or value is None:
                continue  # an attachment; the default of the parameter stands for None
            if name in values or (name in BEYOND and value != each.default):
                values[name] = value
    return values | {'map.crs': plan.risk_map.crs or ''} if plan.risk_map else values


def plan_bytes(saved: SavedPlan) -> bytes:
    """The content of a plan file; write it with mode 0600."""
    plan, (message, files) = saved.plan, ground_of_plan(saved)
    said = PlanMetadata(KIND, saved.frame, dict(saved.parameters.values),
                        dict(software_versions()), {'map': message.topic},
                        recorded_trip(plan, saved.names), recorded_plan(saved))
    return encode([message], asdict(said), files, 'zstd')


def ground_of_plan(saved: SavedPlan) -> tuple[RecordedMessage, Mapping[str, bytes]]:
    """The map of a plan as a message, and its attachments."""
    plan = saved.plan
    return (saved.map_message or map_message(plan.own_map, saved.parameters.occupancy, saved.frame,
                                             saved.made_ns),
            saved.files or attachments_of(plan, plan.own_map.crs))


def recorded_plan(saved: SavedPlan) -> RecordedPlan:
    """Entries about the plan in its metadata record and in those of its departures."""
    plan = saved.plan
    return RecordedPlan(saved.id, saved.made_ns, plan.seconds, saved.slots,
                        saved.sources)


def recorded_trip(plan: Plan, names: tuple[str, str] = ('', '')) -> RecordedTrip:
    """The trip of a plan; ``names`` are those of start and goal."""
    return RecordedTrip(plan.start_xy, plan.goal_xy, plan.stops_xy, names)


def attachments_of(plan: Plan, crs: str | None) -> dict[str, bytes]:
    """The attached files of a plan, and of each departure drawn from it, on a map in ``crs``."""
    files = {STRATEGY_FILE: strategy_file(plan.trip)}
    if plan.risk_map is not None:
        files[MAP_FILE] = npz_bytes(plan.risk_map)
    if roads := plan.options.network.roads:
        files[ROADS_FILE] = roads_file(in_map_frame(roads, crs))
    return files


def read_plan(path: Path | str) -> SavedPlan:
    """Read a plan file; corridors are left to be measured for what is drawn.

    Raises UnreadableRecording if it is damaged, of another version, or a recorded departure.
    """
    return plan_in(read_recording(path))


def plan_in(file: RecordingFile) -> SavedPlan:
    """Return the plan in a file; raises UnreadableRecording as ``read_plan`` does."""
    if file.entries.get('kind') != KIND:
        raise UnreadableRecording(file.path, 'it is a recorded departure, not a plan')
    return part(file.path, 'plan', lambda: _plan_in(file))


def _plan_in(file: RecordingFile) -> SavedPlan:
    said: PlanMetadata = typed(file.entries, PlanMetadata, 'metadata')
    files, about = file.attachments, said.plan
    parameters = parameters_from(typed_values(said.parameters),
                                 roads_from_file(files.get(ROADS_FILE)))
    planning = parameters.planning
    risk_map = map_from_bytes(files[MAP_FILE])
    trip = strategy_from_file(files[STRATEGY_FILE], planning.game)
    plan = Plan(trip, (), planning, node_spacing(risk_map, planning.network), about.seconds,
                risk_map)
    message = next(each for each in file.messages if each.topic == said.topics['map'])
    return SavedPlan(plan, parameters, about.slots, about.sources, said.frame, said.trip.names,
                     about.id, about.made_ns, files, message)
