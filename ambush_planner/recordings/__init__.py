# SPDX-License-Identifier: Apache-2.0
"""Recordings of departures: MCAP files that rosbag2 and Foxglove take, and what is read from them.

``Recorder`` writes a departure's messages, metadata and strategy as one file. ``read_recording``
reads the file, ``RecordedDeparture`` holds what the departure was drawn from, ``Verifier`` checks
that the recorded route and path follow from it. Nothing here needs a ROS node; reading and
verifying need no ROS installation.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .messages import RecordedMessage, type_name
    from .recorded_departure import RecordedDeparture, read_departure
    from .recorded_departures import read_departures, recordings_in, source_findings
    from .recorder import Recorder
    from .recording_errors import RecordingFailed, UnreadableRecording
    from .recording_file import RecordingFile, read_recording

# Imported when a name of theirs is used: ``ambush draw`` needs few of them.
_MODULES = ('messages', 'recording_errors', 'recorder', 'recording_file', 'recorded_departure',
            'recorded_departures')
__all__ = [
    'RecordedDeparture',
    'RecordedMessage',
    'Recorder',
    'RecordingFailed',
    'RecordingFile',
    'UnreadableRecording',
    'read_departure',
    'read_departures',
    'read_recording',
    'recordings_in',
    'source_findings',
    'type_name',
]


def __getattr__(name: str) -> Any:
    if name in __all__:
        for each in _MODULES:
            if hasattr(module := import_module(f'.{each}', __name__), name):
                return getattr(module, name)
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
