# SPDX-License-Identifier: Apache-2.0
"""Departures drawn from a plan file, and their folder, ``NAME.departures`` next to ``NAME.plan``.

Each departure is one recording, named by its number and the day that it is for. Needs no ROS.
"""

from __future__ import annotations

import fcntl
import os
import re
import secrets
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from uuid import uuid4

import numpy as np

from ..arrays import FloatArray, IndexArray
from ..planning.plan import departure_path, path_lengths
from .durable_files import make_private_folders
from .metadata import Metadata, RecordedCall, RecordedDay
from .plain_messages import map_message, path_message, pose_message
from .plan_file import SavedPlan, attachments_of, recorded_plan, recorded_trip
from .recording_errors import part
from .recording_file import encode, read_recording
from .versions import software_versions

SUFFIX = '.departures'
_NAME = re.compile(r'(\d+)_(\d{4}-\d\d-\d\d)\.mcap')


@dataclass(frozen=True, eq=False)
class DrawnDeparture:
    """One departure: nodes of its route, and its path (L, 3) = (x, y, yaw).

    ``few_route`` is the index of one of few routes. ``slot`` is when it leaves (HH:MM; '': not
    said), which was drawn, too, if ``slot_drawn``. All follows from the random ``source``.
    """

    source: int
    nodes: IndexArray
    poses: FloatArray
    few_route: int | None
    slot: str
    slot_drawn: bool

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return float(path_lengths([self.poses])[0])


def draw_departure(saved: SavedPlan, slot: str = '', source: int | None = None) -> DrawnDeparture:
    """Draw a departure's route, then its slot unless one is given.

    ``source`` are 256 random bits, by default the operating system's.
    """
    source = secrets.randbits(256) if source is None else source
    rng, plan, few_route = np.random.default_rng([source]), saved.plan, None
    if plan.few is None:
        nodes = plan.strategy.sample_route(rng)
        poses = departure_path(plan, nodes, plan.spacing)
    else:
        few_route = plan.few.draw(rng)
        nodes, poses = plan.few.routes[few_route], plan.few.paths[few_route]
    drawn = not slot and saved.slots is not None
    if saved.slots and not slot:
        slot = saved.slots.drawn(rng)
    return DrawnDeparture(source, nodes, poses, few_route, slot, drawn)


def departure_bytes(saved: SavedPlan, drawn: DrawnDeparture, number: int, date: str, stamp_ns: int,
                    previous: str = '', replaces: str = '') -> tuple[str, bytes]:
    """The id and the recording of a departure: the node's format, with the plan it was drawn from.

    ``previous`` is the id of the departure before, ``replaces`` that of an earlier one for the same
    day that was not driven.
    """
    plan, trip = saved.plan, recorded_trip(saved)
    roles = {
        'map': map_message(plan.own_map, saved.parameters.occupancy, saved.frame, stamp_ns),
        'start': pose_message('/start_pose', trip.start, saved.frame, stamp_ns),
        'goal': pose_message('/goal_pose', trip.goal, saved.frame, stamp_ns),
        'path': path_message(drawn.poses, saved.frame, stamp_ns),
    }
    said = Metadata(
        str(uuid4()), number, saved.frame, dict(saved.parameters.values), dict(software_versions()),
        {role: message.topic for role, message in roles.items()}, trip, (trip.start, trip.goal),
        False, tuple(drawn.nodes.tolist()), (drawn.source,),
        RecordedCall('ambush draw', '', stamp_ns, stamp_ns, {'date': date}), previous=previous,
        plan=recorded_plan(saved),
        day=RecordedDay(date, drawn.slot, drawn.slot_drawn, drawn.few_route, replaces,
                        local_zone(date, drawn.slot)))
    return said.departure_id, encode(list(roles.values()), said.entries(),
                                     attachments_of(plan, plan.own_map.crs), 'zstd')


def local_zone(date: str, slot: str) -> str:
    """The time zone of this computer on a day and at a time (HH:MM), such as ``UTC+01:00``."""
    then = datetime.strptime(f'{date} {slot or "12:00"}', '%Y-%m-%d %H:%M').astimezone()
    offset = f'{then:%z}'
    return f'UTC{offset[:3]}:{offset[3:5]}'


def departures_folder(plan_file: Path) -> Path:
    """The folder of the departures that are drawn from a plan file."""
    return plan_file.with_suffix(SUFFIX)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Make the folder, with mode 0700, and keep other draws out of it."""
    make_private_folders(folder)
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def names_in(folder: Path) -> list[tuple[int, str, Path]]:
    """Number, date and path of the departures in a folder, in the order of their numbers."""
    found = ((match, path) for path in folder.glob('*.mcap')
             if (match := _NAME.fullmatch(path.name)))
    return sorted((int(match[1]), match[2], path) for match, path in found)


def last_id(folder: Path) -> str:
    """The id of the folder's last departure; '' if there is none. Raises UnreadableRecording."""
    names = names_in(folder)
    return _metadata_of(names[-1][2]).departure_id if names else ''


def _metadata_of(path: Path) -> Metadata:
    return part(path, 'metadata', lambda: read_recording(path).metadata)


def earlier_departures(folder: Path,
                       dates: Sequence[str]) -> list[tuple[RecordedDay, Metadata]]:
    """The departures for some dates, without those that were replaced by a later one.

    Raises UnreadableRecording.
    """
    said = [_metadata_of(path) for _, date, path in names_in(folder) if date in dates]
    found = [(each.day, each) for each in said if each.day]
    replaced = {day.replaces for day, _ in found}
    return [(day, each) for day, each in found if each.departure_id not in replaced]


def file_name(number: int, date: str) -> str:
    """The name of a departure's file."""
    return f'{number:04d}_{date}.mcap'
