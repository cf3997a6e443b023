# SPDX-License-Identifier: Apache-2.0
"""Departures drawn from a plan file, and their folder, ``NAME.departures`` next to ``NAME.plan``.

Each departure is one recording, named by its number and the day that it is for. Needs no ROS.
"""

from __future__ import annotations

import fcntl
import math
import os
import re
import secrets
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from uuid import uuid4

from ..arrays import FloatArray
from ..planning.departure import draw_route
from ..planning.plan import Route, path_lengths
from .durable_files import make_private_folders
from .encoding import encode
from .messages import path_message, pose_message
from .metadata import Metadata, RecordedCall, RecordedDay, numbers_of, software_versions
from .plan_file import SavedPlan, ground_of_plan, recorded_plan, recorded_trip
from .recording_errors import NoPermission, part
from .recording_file import read_recording

SUFFIX = '.departures'
# Distance up to which starts or goals of two plans are the same [m].
SAME_PLACE = 1.0
_NAME = re.compile(r'(\d+)_(\d{4}-\d\d-\d\d)\.mcap')


@dataclass(frozen=True, eq=False)
class DrawnDeparture:
    """One departure: its route, the nodes of each leg, and its path (L, 3) = (x, y, yaw).

    ``slot`` is when it leaves (HH:MM; '': not said), which was drawn, too, if ``slot_drawn``. All
    follows from the random ``source``.
    """

    source: int
    route: Route
    poses: FloatArray
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
    drawn = draw_route(saved.plan, [source])
    assert drawn is not None  # all routes are clear on the plan's own map
    slot_drawn = not slot and saved.slots is not None
    if saved.slots and not slot:
        slot = saved.slots.draw(drawn.rng)
    return DrawnDeparture(source, drawn.route, drawn.poses, slot, slot_drawn)


def departure_bytes(saved: SavedPlan, drawn: DrawnDeparture, number: int, date: str, stamp_ns: int,
                    replaces: str = '', why: str = '') -> bytes:
    """The recording of a departure: the node's format, with the plan it was drawn from.

    ``replaces`` is the id of an earlier one for the same day that was not driven, and ``why``.
    """
    trip = recorded_trip(saved.plan, saved.names)
    covered = saved.slots.covered if saved.slots and drawn.slot_drawn else 1.0
    ground, files = ground_of_plan(saved)
    roles = {
        'map': replace(ground, stamp_ns=stamp_ns),
        'start': pose_message('/start_pose', trip.start, saved.frame, stamp_ns),
        'goal': pose_message('/goal_pose', trip.goal, saved.frame, stamp_ns),
        'path': path_message(drawn.poses, saved.frame, stamp_ns),
    }
    said = Metadata(
        str(uuid4()), number, saved.frame, dict(saved.parameters.values), dict(software_versions()),
        {role: message.topic for role, message in roles.items()}, trip, (trip.start, trip.goal),
        False, numbers_of(drawn.route), (drawn.source,),
        RecordedCall('ambush draw', '', stamp_ns, stamp_ns, {'date': date}),
        saved.plan.value * covered, plan=recorded_plan(saved),
        day=RecordedDay(date, drawn.slot, drawn.slot_drawn, replaces, why,
                        local_zone(date, drawn.slot)))
    return encode(list(roles.values()), said.entries(), files, 'zstd')


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


def _metadata_of(path: Path) -> Metadata:
    return part(path, 'metadata', lambda: read_recording(path, False).metadata)


def earlier_departures(saved: SavedPlan, folder: Path,
                       dates: Sequence[str]) -> list[tuple[RecordedDay, Metadata]]:
    """The departures for the same trip on some dates, without those that a later one replaced.

    They are in the folder of the plan's departures, or in one next to it: that of an earlier plan,
    or of a copy of this one. Raises UnreadableRecording, but not of files next to it that the user
    may not read.
    """
    trip, said = recorded_trip(saved.plan), []
    for each in sorted(folder.parent.glob(f'*{SUFFIX}')):
        for path in (path for _, date, path in names_in(each) if date in dates):
            try:
                said.append(_metadata_of(path))
            except NoPermission:
                if each == folder:
                    raise
    found = [(each.day, each) for each in said if each.day and (
        (each.plan and each.plan.id == saved.id)
        or max(math.dist(each.trip.start, trip.start),
               math.dist(each.trip.goal, trip.goal)) <= SAME_PLACE)]
    replaced = {day.replaces for day, _ in found}
    return [(day, each) for day, each in found if each.departure_id not in replaced]


def file_name(number: int, date: str) -> str:
    """The name of a departure's file."""
    return f'{number:04d}_{date}.mcap'
