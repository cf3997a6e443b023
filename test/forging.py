"""Recordings of a real node, and somebody who changes what is in them and writes them anew."""

import hashlib
import json
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from io import BytesIO
from unittest import mock

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from recording_samples import encoded_departure
from ros_harness import pose, stage

from ambush_planner.commands import verify
from ambush_planner.recordings import Attachment, read_departure, recordings_in, type_name
from ambush_planner.recordings.recorded_case import TYPES
from ambush_planner.recordings.verify import Verifier

TEXTS = ('parameters', 'route_entropy_source', 'route', 'trip', 'ends')
NEW_ROUTE, AGAIN, MOVED_GOAL, GET_PLAN, SEEDED, SEEDED_AGAIN = range(6)


def record_runs(tmp_path_factory):
    """The files of six departures of two nodes, the second with a fixed seed.

    All modules of a test process read the same ones; none changes them.
    """
    return _recorded(tmp_path_factory.getbasetemp() / 'recorded')


@cache
def _recorded(folder):
    with stage(folder) as running:
        client = running.give()
        answer = client.call('new_route')
        assert answer.success, answer.message
        answer = client.call('new_route')
        assert answer.success, answer.message
        # In the block: moved to a cell beside it.
        assert client.get_plan(pose(1.5, 5.5), pose(5.0, 5.2), tolerance=3.0).poses
        assert client.get_plan(pose(1.5, 4.5), pose(8.5, 6.5, 1.0)).poses
    with stage(folder, {'seed': 5}) as running:
        client = running.give()
        answer = client.call('new_route')
        assert answer.success, answer.message
        answer = client.call('new_route')
        assert answer.success, answer.message
    files = recordings_in(folder)
    assert len(files) == 6
    return files


@contextmanager
def one_verifier():
    """A Verifier, which the command in this process uses, too: all share its worker and solves."""
    with Verifier() as verifier, mock.patch.object(verify, 'Verifier', _Kept(verifier)):
        yield verifier


class _Kept:
    """Stands for the class: each time that one is made, it is the same, and has seen nothing."""

    def __init__(self, verifier):
        self._verifier = verifier

    def __call__(self, planning):
        return self

    def __enter__(self):
        self._verifier._seen.clear()
        return self._verifier

    def __exit__(self, *_):
        pass


class Forger:
    """The content of a recording, to be changed and saved as a file with valid checksums."""

    def __init__(self, path):
        recorded = read_departure(path)
        self.recorded = recorded
        self.messages = list(recorded.messages)
        self.metadata = dict(recorded.metadata.texts)
        self.attachments = dict(recorded.attachments)
        self.disguise = bytes  # of the bytes of the file in the end

    def entry(self, key):
        return json.loads(self.metadata[key])

    def set_entry(self, key, value):
        self.metadata[key] = json.dumps(value)

    def edit_entry(self, key, **changes):
        self.set_entry(key, {**self.entry(key), **changes})

    def edit_call(self, part, **changes):
        """Change fields of the recorded request or response."""
        self.edit_entry('call', **{part: {**self.entry('call')[part], **changes}})

    def place(self, role):
        """The index of the message in a role."""
        topic = self.entry('inputs')[role]
        (found,) = [k for k, message in enumerate(self.messages) if message.topic == topic]
        return found

    def places(self, kind):
        """The indices of the messages of a type."""
        name = type_name(kind)
        return [k for k, message in enumerate(self.messages) if message.type == name]

    def message(self, place):
        message = self.messages[place]
        return deserialize_message(message.data, TYPES[message.type])

    def put(self, place, message):
        self.messages[place] = replace(self.messages[place], data=serialize_message(message))

    def edit(self, place, change):
        """Change a message by a function that is given it."""
        message = self.message(place)
        change(message)
        self.put(place, message)

    def arrays(self):
        """The arrays of the strategy's file."""
        with np.load(BytesIO(self.attachments['strategy.npz'])) as archive:
            return dict(archive)

    def set_arrays(self, **arrays):
        stream = BytesIO()
        np.savez_compressed(stream, **{**self.arrays(), **arrays})
        self.attachments['strategy.npz'] = stream.getvalue()

    def correct(self):
        """State the hashes of what is there now, as a clever forger does."""
        contents = {role: self.messages[self.place(role)].data for role in self.entry('inputs')}
        contents |= {key: self.metadata[key].encode() for key in TEXTS}
        for name in ('strategy', 'map_changes'):
            contents[name] = self.attachments.get(f'{name}.npz', b'')
        hashes = {name: hashlib.sha256(data).hexdigest() for name, data in contents.items()}
        self.set_entry('sha256', hashes)

    def save(self, path):
        kind = 'application/zip'
        files = [Attachment(name, kind, data) for name, data in self.attachments.items()]
        data = encoded_departure(self.messages, self.metadata, files, 'zstd')
        path.write_bytes(self.disguise(data))
        return path
