"""What a forger may do around the content of a departure: to the file and its indexes."""

from dataclasses import replace

from diagnostic_msgs.msg import DiagnosticArray, KeyValue
from forging import GET_PLAN, NEW_ROUTE
from two_faced import early_message_index, hidden_chunk, renamed_topics


def disguise(how):
    """Bytes in which some readers find another departure."""
    return lambda forger, rng: setattr(forger, 'disguise', how)


def stamp_path(seconds):
    """Another time in the path, and in its poses."""
    def change(path):
        for each in (path, *path.poses):
            each.header.stamp.sec += seconds

    return lambda forger, rng: forger.edit(forger.place('path'), change)


def log(role, stamp_ns):
    """Another time of a message in the file."""
    def log_it(forger, rng):
        place = forger.place(role)
        forger.messages[place] = replace(forger.messages[place], stamp_ns=stamp_ns)
    return log_it


def call_at(which, seconds):
    """A request or an answer that much later."""
    def move(forger, rng):
        forger.edit_entry('call', **{which: forger.entry('call')[which] + seconds * 10**9})
    return move


def add_to_the_answer(forger, rng):
    said = forger.entry('call')['response']['message']
    forger.edit_call('response', message=f'{said}; it was revoked')


def report(change):
    return lambda forger, rng: forger.edit(
        forger.places(DiagnosticArray)[0], lambda report: change(report.status[0])
    )


def add_metadata(forger, rng):
    forger.metadata['approved'] = 'yes'


def first_of(key, pair):
    """A pair before all others, which a later one of its name overrides."""
    def add(forger, rng):
        forger.metadata[key] = f'{{{pair}, {forger.metadata[key][1:]}'
    return add


AROUND = [
    (NEW_ROUTE, stamp_path(-10**9), True, 'times: the path is stamped'),
    (GET_PLAN, stamp_path(60), True, 'times: the path is stamped'),
    (NEW_ROUTE, log('path', 1), True, 'times: a message is from before the request'),
    (NEW_ROUTE, log('map', 2**62), True, 'times: map and poses are not'),
    (NEW_ROUTE, call_at('response_ns', -10), True, 'times: a message is from before'),
    (GET_PLAN, call_at('request_ns', 10), True, 'times: a message is from before'),
    (NEW_ROUTE, add_to_the_answer, True, 'response: its message'),
    (NEW_ROUTE, report(lambda status: status.values.insert(0, KeyValue(key='value', value='0.1'))),
     True, 'diagnostics: there are not the values'),
    (GET_PLAN, report(lambda status: status.values.append(KeyValue(key='approved', value='yes'))),
     True, 'diagnostics: there are not the values'),
    (GET_PLAN, report(lambda status: setattr(status, 'hardware_id', 'x')), True, 'no hardware'),
    (NEW_ROUTE, add_metadata, True, "metadata: an entry 'approved' is not known"),
    (NEW_ROUTE, first_of('versions', '"approved": 1'), True, "versions: an entry 'approved'"),
    (NEW_ROUTE, first_of('parameters', '"seed": 4242'), True, 'not written as the recorder'),
    (NEW_ROUTE, first_of('trip', '"tolerance": 9.0'), True, 'not written as the recorder'),
    (NEW_ROUTE, disguise(hidden_chunk), False, 'its index leads to another content'),
    (NEW_ROUTE, disguise(renamed_topics), False, 'its index leads to another content'),
    (NEW_ROUTE, disguise(early_message_index), False, 'file: it is not laid out as'),
]
