"""Recordings of departures: MCAP files as rosbag2 writes them, and back from them."""

from .messages import Attachment, RecordedMessage, type_name
from .reader import RecordedDeparture, read_departure, recordings_in
from .recorder import Recorder
from .recording_errors import RecordingFailed, UnreadableRecording

__all__ = [
    'Attachment',
    'RecordedDeparture',
    'RecordedMessage',
    'Recorder',
    'RecordingFailed',
    'UnreadableRecording',
    'read_departure',
    'recordings_in',
    'type_name',
]
