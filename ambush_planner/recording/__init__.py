"""Recordings of departures: MCAP files as rosbag2 writes them."""

from .errors import RecordingFailed
from .recorder import RecordedMessage, Recorder

__all__ = ['RecordedMessage', 'Recorder', 'RecordingFailed']
