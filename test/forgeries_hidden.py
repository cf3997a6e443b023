"""Manipulations that leave the departure as it is: hidden notes, other numbers, other packing.

Each is found (``HIDDEN``), or holds and is named in the help of ambush_verify (``NOT_COVERED``).
"""

import io
import zipfile
from dataclasses import replace

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from forgeries_around import report
from forging import AGAIN, GET_PLAN, NEW_ROUTE, SEEDED
from two_faced import assembled, encoded, split
from visualization_msgs.msg import MarkerArray


def edit(kind, which, change):
    """Change a message of a kind by a function that is given it."""
    return lambda forger, rng: forger.edit(forger.places(kind)[which], change)


def role(name, change):
    return lambda forger, rng: forger.edit(forger.place(name), change)


def entry(key, change):
    """Change the text of an entry."""
    def edit_text(forger, rng):
        forger.metadata[key] = change(forger.metadata[key])
    return edit_text


def entries(key, **changes):
    named = {name.replace('__', '.'): value for name, value in changes.items()}
    return lambda forger, rng: forger.edit_entry(key, **named)


def call(part, **changes):
    """Change fields of the recorded request or response."""
    return lambda forger, rng: forger.edit_call(part, **changes)


def request_start_stamp(forger, rng):
    start = forger.entry('call')['request']['start']
    start['header']['stamp']['sec'] = 7
    forger.edit_call('request', start=start)


def set_to(path, value):
    """Set a field of a message, given like ``pose.position.z``."""
    *names, last = path.split('.')

    def change(message):
        for name in names:
            message = message[int(name)] if name.isdecimal() else getattr(message, name)
        setattr(message, last, value)
    return change


def comment(forger, rng):
    stream = io.BytesIO(forger.attachments['strategy.npz'])
    with zipfile.ZipFile(stream, 'a') as archive:
        archive.comment = b'approved'
    forger.attachments['strategy.npz'] = stream.getvalue()


def prefix(forger, rng):
    forger.attachments['strategy.npz'] = b'approved' + forger.attachments['strategy.npz']


def other_types(forger, rng):
    forger.set_arrays(edges=forger.arrays()['edges'].astype(np.int32))


def second_qos(forger, rng):
    """The same profile, as another YAML document says it."""
    place = forger.place('path')
    text = forger.messages[place].qos_text.replace('\n', '  # approved\n', 1)
    forger.messages[place] = replace(forger.messages[place], qos=text)


def library(data):
    """A note behind the name of the library."""
    section, summary = split(data)
    (_, _, header), *rest = section
    note = encoded(replace(header, library=f'{header.library}; approved'))
    moved = len(note) - len(section[0][1])
    shifted = [
        encoded(_moved(record, moved)) for _, _, record in summary
    ]
    return assembled([note, *(raw for _, raw, _ in rest)], shifted)


def _moved(record, by):
    changes = {name: getattr(record, name) + by for name in ('offset', 'chunk_start_offset')
               if hasattr(record, name)}
    if hasattr(record, 'message_index_offsets'):
        changes['message_index_offsets'] = {
            key: place + by for key, place in record.message_index_offsets.items()
        }
    return replace(record, **changes)


def disguise(how):
    return lambda forger, rng: setattr(forger, 'disguise', how)


def double_status(report_):
    report_.status = [*report_.status, *report_.status]


def other_level(status):
    warns = status.level == DiagnosticStatus.WARN
    status.level = DiagnosticStatus.OK if warns else DiagnosticStatus.WARN


def long_solve(status):
    (value,) = [each for each in status.values if each.key == 'solve_seconds']
    value.value = '29.000'


def more_markers(shown):
    shown.markers = [*shown.markers, shown.markers[0]]


# (which recording, what is done, whether the stated hashes are corrected, what has to be named)
HIDDEN = [
    (NEW_ROUTE, entries('call', service='/other/get_plan'), True, 'service: the recorded call'),
    (NEW_ROUTE, entries('call', note='approved'), True, 'the recorded call is not just'),
    (NEW_ROUTE, entries('call', request_ns=1.5), True, 'the recorded call is not just'),
    (NEW_ROUTE, entries('call', request={'approved': True}), True, 'call: '),
    (GET_PLAN, call('response', plan={}), True, 'call: '),
    (NEW_ROUTE, call('response', success=1), True, 'call: '),
    (GET_PLAN, request_start_stamp, True, 'request: its start.header.stamp'),
    (GET_PLAN, call('request', tolerance=0.25), True, 'request: its tolerance'),
    (AGAIN, role('path', set_to('poses.3.header.frame_id', 'odom')), True,
     'path: its poses[3].header.frame_id'),
    (AGAIN, role('path', set_to('poses.2.header.stamp.nanosec', 7)), True,
     'path: its poses[2].header.stamp'),
    (SEEDED, role('start', set_to('pose.position.z', 0.25)), True,
     'path: its poses[0].pose.position.z'),
    (NEW_ROUTE, edit(MarkerArray, 1, more_markers), True, 'does not show the recorded strategy'),
    (NEW_ROUTE, edit(MarkerArray, 2, set_to('markers.0.text', 'approved')), True,
     'does not show the recorded strategy'),
    (NEW_ROUTE, edit(DiagnosticArray, 0, double_status), True, 'there is not one status'),
    (NEW_ROUTE, report(other_level), True, 'diagnostics: level, code and message'),
    (SEEDED, edit(DiagnosticArray, 0, set_to('status.0.values.13.value', '9')), True,
     'diagnostics: '),
    (NEW_ROUTE, entry('parameters', lambda text: text.replace(': ', ':  ', 1)), True,
     'parameters is not written as the recorder does it'),
    (NEW_ROUTE, entry('departure', lambda text: f' {text}'), True,
     'departure is not written as the recorder does it'),
    (NEW_ROUTE, entry('ends', lambda text: text.replace('.5', '.50', 1)), True,
     'ends is not written as the recorder does it'),
    (NEW_ROUTE, entries('parameters', recording__compression='lz4'), True,
     'file: it is not laid out'),
    (NEW_ROUTE, comment, True, 'strategy.npz holds bytes beside its arrays'),
    (NEW_ROUTE, prefix, True, 'strategy.npz'),
    (NEW_ROUTE, other_types, True, 'edges must be of the shape'),
    (NEW_ROUTE, second_qos, True, 'quality of service'),
    (NEW_ROUTE, disguise(library), False, 'the first difference is at HEADER'),
]
# (which recording, what is done, what of the help names it)
NOT_COVERED = [
    (NEW_ROUTE, role('map', set_to('header.stamp.sec', 7)), 'stamps of inputs, markers'),
    (NEW_ROUTE, role('map', set_to('info.origin.position.z', 7.0)), 'the height of the map'),
    (NEW_ROUTE, edit(DiagnosticArray, 0, set_to('header.stamp.sec', 7)), 'diagnostics'),
    (NEW_ROUTE, entries('parameters', replan__tolerance=0.5), 'parameters that nothing recorded'),
    (NEW_ROUTE, report(long_solve), 'nothing recorded proves the time that it took'),
    (NEW_ROUTE, entries('versions', numpy='1.0'), 'versions of software'),
]
