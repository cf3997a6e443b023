# SPDX-License-Identifier: Apache-2.0
"""Recordings of a real node, and their contents edited and written again with valid checksums."""

from dataclasses import replace
from io import BytesIO

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from ros_harness import pose, stage

from ambush_planner.commands.replay import _message_class
from ambush_planner.recordings.encoding import encode
from ambush_planner.recordings.recorded_departures import recordings_in
from ambush_planner.recordings.recording_file import read_recording

NEW_ROUTE, AGAIN, MOVED_GOAL, GET_PLAN, SEEDED, SEEDED_AGAIN = range(6)


def record_runs(folder):
    """The files of six departures of two nodes, the second with a fixed seed."""
    with stage(folder) as running:
        client = running.give()
        for _ in range(2):
            answer = client.call('new_route')
            assert answer.success, answer.message
        # The goal lies in an obstacle and is moved to a free cell nearby.
        assert client.get_plan(pose(1.5, 5.5), pose(5.0, 5.2), tolerance=3.0).poses
        assert client.get_plan(pose(1.5, 4.5), pose(8.5, 6.5, 1.0)).poses
    with stage(folder, {'seed': 5}) as running:
        client = running.give()
        for _ in range(2):
            answer = client.call('new_route')
            assert answer.success, answer.message
    files = recordings_in(folder)
    assert len(files) == 6
    return files


class Forger:
    """The contents of a recording, to be changed and saved."""

    def __init__(self, path):
        file = read_recording(path)
        self.path = path
        self.messages = list(file.messages)
        self.entries = dict(file.entries)
        self.attachments = dict(file.attachments)

    def edit(self, role, change):
        """Change the message in a role by a function that takes it."""
        topic = self.entries['topics'][role]
        ((place, recorded),) = [
            (k, message) for k, message in enumerate(self.messages) if message.topic == topic]
        message = deserialize_message(recorded.data, _message_class(recorded.type))
        change(message)
        self.messages[place] = replace(recorded, data=serialize_message(message))

    def arrays(self):
        """The arrays of the strategy's file."""
        with np.load(BytesIO(self.attachments['strategy.npz'])) as archive:
            return dict(archive)

    def set_arrays(self, **arrays):
        stream = BytesIO()
        np.savez_compressed(stream, **{**self.arrays(), **arrays})
        self.attachments['strategy.npz'] = stream.getvalue()

    def save(self, path):
        path.write_bytes(encode(self.messages, self.entries, self.attachments, 'zstd'))
        return path
