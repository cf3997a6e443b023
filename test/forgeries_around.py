"""What a forger may do around the content of a departure: to the file and its indexes."""

from dataclasses import replace

from diagnostic_msgs.msg import DiagnosticArray, KeyValue
from forging import GET_PLAN, NEW_ROUTE
from nav_msgs.srv import GetPlan
from std_srvs.srv import Trigger
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


def call_at(kind, which, seconds):
    """A request or an answer that much later, in the message too."""
    def move(forger, rng):
        place = forger.places(kind)[which]
        forger.edit(
            place, lambda event: setattr(event.info.stamp, 'sec', event.info.stamp.sec + seconds)
        )
        message = forger.messages[place]
        moved = message.stamp_ns + seconds * 10**9
        forger.messages[place] = replace(message, stamp_ns=moved)
    return move


def add_to_the_answer(forger, rng):
    forger.edit(
        forger.places(Trigger.Event)[1],
        lambda event: setattr(
            event.response[0], 'message', event.response[0].message + '; it was revoked'
        ),
    )


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
    (NEW_ROUTE, log('map', 2**62), True, 'times: map, start, stops and goal are not'),
    (NEW_ROUTE, call_at(Trigger.Event, 1, -10), True, 'times: a message is from before'),
    (GET_PLAN, call_at(GetPlan.Event, 0, 10), True, 'times: a message is from before'),
    (NEW_ROUTE, add_to_the_answer, True, 'response: it does not tell'),
    (NEW_ROUTE, report(lambda status: status.values.insert(0, KeyValue(key='value', value='0.1'))),
     True, 'diagnostics: there are not the values'),
    (GET_PLAN, report(lambda status: status.values.append(KeyValue(key='approved', value='yes'))),
     True, 'diagnostics: there are not the values'),
    (GET_PLAN, report(lambda status: setattr(status, 'hardware_id', 'x')), True, 'no hardware'),
    (NEW_ROUTE, add_metadata, True, "metadata: an entry 'approved' is not known"),
    (NEW_ROUTE, first_of('versions', '"approved": 1'), True, "versions: an entry 'approved'"),
    (NEW_ROUTE, first_of('parameters', '"seed": 4242'), True, 'a key that comes twice'),
    (NEW_ROUTE, first_of('trip', '"tolerance": 9.0'), True, 'a key that comes twice'),
    (NEW_ROUTE, disguise(hidden_chunk), False, 'its index leads to another content'),
    (NEW_ROUTE, disguise(renamed_topics), False, 'its index leads to another content'),
    (NEW_ROUTE, disguise(early_message_index), False, 'file: it is not laid out as'),
]
