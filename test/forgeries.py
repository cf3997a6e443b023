"""What a forger may do to a recording, and what has to be said of it."""

from dataclasses import replace

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from forgeries_around import AROUND
from forgeries_hidden import HIDDEN
from forging import AGAIN, GET_PLAN, MOVED_GOAL, NEW_ROUTE, SEEDED, SEEDED_AGAIN, Forger
from nav_msgs.msg import Path as PathMessage
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from ambush_planner.game.hits import worst_loss
from ambush_planner.game.route_sampler import route_strategy, shortest_route
from ambush_planner.recordings import RecordedMessage, recordings_in, type_name
from ambush_planner.recordings.recorded_case import Case


def cell_at(forger, node):
    """The index of the map's cell under a node."""
    info, (x, y) = forger.message(forger.place('map')).info, forger.arrays()['points'][node]
    return int(y // info.resolution) * info.width + int(x // info.resolution)


def change_risk(forger, rng):
    """Another risk under one node."""
    inner = len(forger.arrays()['points']) - 2
    cell = cell_at(forger, int(rng.integers(inner)))
    forger.edit(forger.place('map'), lambda grid: grid.data.__setitem__(cell, 70))


def add_obstacle(forger, rng):
    """A block over one node."""
    inner = len(forger.arrays()['points']) - 2
    cell = cell_at(forger, int(rng.integers(inner)))
    forger.edit(forger.place('map'), lambda grid: grid.data.__setitem__(cell, 100))


def change_resolution(forger, rng):
    forger.edit(
        forger.place('map'), lambda grid: setattr(grid.info, 'resolution', 0.5 + rng.random() / 9)
    )


def move(role):
    def move_it(forger, rng):
        def change(message):
            message.pose.position.x += 0.01 * (1.0 + rng.random())

        forger.edit(forger.place(role), change)
    return move_it


def turn_goal(forger, rng):
    forger.edit(forger.place('goal'), lambda goal: setattr(goal.pose.orientation, 'z', 1.0)
                or setattr(goal.pose.orientation, 'w', 0.0))


def change_path(change):
    def edit(forger, rng):
        forger.edit(forger.place('path'), lambda path: change(path, rng))
    return edit


def move_pose(path, rng):
    path.poses[int(rng.integers(1, len(path.poses) - 1))].pose.position.y += 1e-6


def drop_pose(path, rng):
    del path.poses[int(rng.integers(1, len(path.poses) - 1))]


def turn_last(path, rng):
    path.poses[-1].pose.orientation.z, path.poses[-1].pose.orientation.w = 0.6, 0.8


def lift_first(path, rng):
    path.poses[0].pose.position.z = 0.5


def change_route(forger, rng):
    route = forger.entry('route')
    k = int(rng.integers(1, len(route) - 1))
    forger.set_entry('route', [*route[:k], (route[k] + 1) % 90, *route[k + 1:]])


def leave_network(forger, rng):
    forger.set_entry('route', [10**6, *forger.entry('route')[1:]])


def change_source(forger, rng):
    """Another source, of another route: by chance it could draw the same."""
    strategy = Case(forger.recorded).strategy()
    while True:
        source = int(rng.integers(2**62))
        drawn = strategy.sample_route(np.random.default_rng([source]))
        if drawn.tolist() != forger.entry('route'):
            break
    forger.set_entry('route_entropy_source', [source])


def longer_source(forger, rng):
    forger.set_entry('route_entropy_source', [*forger.entry('route_entropy_source'), 1])


def parameter(**changes):
    def set_it(forger, rng):
        named = {name.replace('__', '.'): value for name, value in changes.items()}
        forger.edit_entry('parameters', **named)
    return set_it


def forget_parameter(forger, rng):
    values = forger.entry('parameters')
    del values['recording.compression']
    forger.set_entry('parameters', values)


def swap_strategy(forger, rng):
    other = Forger(recordings_in(forger.recorded.path.parent)[MOVED_GOAL])
    forger.attachments = other.attachments


def scale(name, factor):
    def change(forger, rng):
        forger.set_arrays(**{name: forger.arrays()[name] * factor})
    return change


def lose_flow(forger, rng):
    p = forger.arrays()['edge_probability']
    p[int(rng.choice(np.flatnonzero(p > 1e-3)))] *= 0.9
    forger.set_arrays(edge_probability=p)


def change_loss(forger, rng):
    """A node where nobody waits and whose loss decides nothing."""
    arrays = forger.arrays()
    node = int(rng.choice(np.flatnonzero(arrays['ambush_probability'] == 0.0)[:-2]))
    arrays['alpha'][node] *= 0.999
    forger.set_arrays(alpha=arrays['alpha'])


def always_shortest(forger, rng):
    """Another strategy, all of whose numbers follow from it: always the shortest route."""
    strategy = Case(forger.recorded).strategy()
    network = strategy.network
    p = route_strategy(network, shortest_route(network, np.arange(len(network.edges))))
    forger.set_arrays(
        edge_probability=p, value=worst_loss(strategy.game, p), edge_entropy=0.0,
        route_entropy=0.0, expected_length=float(p @ network.lengths),
        expected_exposure=float(p @ network.edge_exposure),
    )


def edit_trip(change):
    def edit(forger, rng):
        trip = forger.entry('trip')
        change(trip, rng)
        forger.set_entry('trip', trip)
    return edit


def move_end(which):
    def edit(forger, rng):
        ends = forger.entry('ends')
        ends[which][0] += 0.2 * rng.random()
        forger.set_entry('ends', ends)
    return edit


def move_trip(end):
    return edit_trip(lambda trip, rng: trip[end].__setitem__(0, trip[end][0] + rng.random()))


def drop(kind, which=0):
    def drop_it(forger, rng):
        del forger.messages[forger.places(kind)[which]]
    return drop_it


def repeat(kind):
    def repeat_it(forger, rng):
        forger.messages.append(forger.messages[forger.places(kind)[0]])
    return repeat_it


def answer_no(forger, rng):
    forger.edit_call('response', success=False)


def move_request(forger, rng):
    goal = forger.entry('call')['request']['goal']
    goal['pose']['position']['x'] += rng.random()
    forger.edit_call('request', goal=goal)


def change_call(**changes):
    return lambda forger, rng: forger.edit_entry('call', **changes)


def add_event(forger, rng):
    """A message of the call, where none is recorded."""
    forger.messages.append(RecordedMessage(
        '/ambush_planner/new_route/_service_event', type_name(Trigger.Event),
        serialize_message(Trigger.Event()), QoSProfile(depth=1), forger.entry('call')['request_ns'],
    ))


def metadata(key, value):
    def set_it(forger, rng):
        forger.metadata[key] = value
    return set_it


def swap_roles(forger, rng):
    topics = forger.entry('inputs')
    forger.edit_entry('inputs', start=topics['goal'], goal=topics['start'])


def move_marker(forger, rng):
    forger.edit(
        forger.places(MarkerArray)[int(rng.integers(4))],
        lambda shown: setattr(shown.markers[0].points[0], 'x', -1.0),
    )


def change_report(key, text):
    def change(report):
        (value,) = [each for each in report.status[0].values if each.key == key]
        value.value = text

    return lambda forger, rng: forger.edit(forger.places(DiagnosticArray)[0], change)


def retype(forger, rng):
    """A path where the map should be."""
    place, path = forger.place('map'), serialize_message(PathMessage())
    kind = 'nav_msgs/msg/Path'
    forger.messages[place] = replace(forger.messages[place], type=kind, data=path)


def other_frame(forger, rng):
    """A goal that cannot be compared, and a path that ends elsewhere."""
    forger.edit(forger.place('goal'), lambda goal: setattr(goal.header, 'frame_id', 'other'))
    forger.edit(
        forger.place('path'), lambda path: setattr(path.poses[-1].pose.position, 'x', 3.0)
    )


def add_attachment(forger, rng):
    forger.attachments['more'] = b'more'


def swap_markers(forger, rng):
    one, other = forger.places(MarkerArray)[:2]
    first, second = forger.messages[one], forger.messages[other]
    forger.messages[one] = replace(first, topic=second.topic)
    forger.messages[other] = replace(second, topic=first.topic)


def report_error(forger, rng):
    forger.edit(
        forger.places(DiagnosticArray)[0], lambda report: setattr(report.status[0], 'level', b'\2')
    )


def lose_attachment(forger, rng):
    forger.attachments.clear()


def in_a_hurry(forge):
    """Also state that the solve took so long that time was up."""
    def both(forger, rng):
        change_report('solve_seconds', '29.000')(forger, rng)
        forge(forger, rng)
    return both


# (which recording, what is done, whether the stated hashes are corrected, what has to be named)
FORGERIES = [
    (NEW_ROUTE, change_risk, False, 'sha256 of map does not hold'),
    (NEW_ROUTE, change_risk, True, 'network: it does not follow from map'),
    (SEEDED, change_risk, True, 'alpha are others'),
    (NEW_ROUTE, add_obstacle, True, 'network: it does not follow from map'),
    (NEW_ROUTE, change_resolution, True, 'network: it does not follow from map'),
    (NEW_ROUTE, move('start'), False, 'sha256 of start does not hold'),
    (NEW_ROUTE, move('start'), True, 'ends: the first one is not'),
    (GET_PLAN, move('start'), True, 'request: its start.pose.position.x'),
    (GET_PLAN, move('goal'), True, 'ends: the last one is not'),
    (AGAIN, turn_goal, True, 'path: its poses['),
    (NEW_ROUTE, change_path(move_pose), False, 'sha256 of path does not hold'),
    (NEW_ROUTE, change_path(move_pose), True, 'path: its poses['),
    (SEEDED, change_path(drop_pose), True, 'path: its poses.length'),
    (SEEDED, change_path(turn_last), True, 'path: its poses['),
    (MOVED_GOAL, change_path(lift_first), True, 'path: its poses[0].pose.position.z'),
    (NEW_ROUTE, change_route, False, 'sha256 of route does not hold'),
    (NEW_ROUTE, change_route, True, 'route: it is not what'),
    (SEEDED, leave_network, True, 'route: it leaves the network'),
    (AGAIN, change_source, False, 'sha256 of route_entropy_source does not hold'),
    (AGAIN, change_source, True, 'route: it is not what route_entropy_source draws'),
    (AGAIN, longer_source, True, 'route_entropy_source: it is not one number'),
    (SEEDED_AGAIN, change_source, True, 'route_entropy_source: it is not what'),
    (NEW_ROUTE, parameter(seed=7), True, 'route_entropy_source: it is not what'),
    (SEEDED, parameter(seed=6), True, 'route_entropy_source: it is not what'),
    (NEW_ROUTE, parameter(seed=7), False, 'sha256 of parameters does not hold'),
    (NEW_ROUTE, parameter(network__spacing=0.9), True, 'network: it does not follow'),
    (MOVED_GOAL, parameter(map__alpha_max=9.0), True, 'network: it does not follow'),
    (GET_PLAN, parameter(strategy__max_detour=1.4), True, 'strategy: length_budget'),
    (SEEDED, parameter(route__path_spacing=0.4), True, 'path: its poses.length'),
    (NEW_ROUTE, parameter(game__secured_radius=2.0), True, 'recorded strategy'),
    (NEW_ROUTE, forget_parameter, True, 'parameters'),
    (NEW_ROUTE, swap_strategy, False, 'sha256 of strategy does not hold'),
    (NEW_ROUTE, swap_strategy, True, 'network: it does not follow'),
    (NEW_ROUTE, scale('value', 1.01), True, 'recorded strategy: value is stated'),
    (NEW_ROUTE, scale('value', 1.0 + 1e-8), True, 'strategy: value is stated'),
    (GET_PLAN, scale('edge_entropy', 1.0 + 1e-8), True, 'strategy: edge_entropy is stated'),
    (NEW_ROUTE, lose_flow, True, 'recorded strategy: p is not a flow'),
    (NEW_ROUTE, change_loss, True, 'alpha are others'),
    (NEW_ROUTE, always_shortest, True, 'strategy: its certificate does not close'),
    (NEW_ROUTE, in_a_hurry(always_shortest), True, 'strategy: its certificate does not close'),
    (NEW_ROUTE, in_a_hurry(scale('value', 1.0 + 1e-8)), True, 'strategy: value is stated'),
    (NEW_ROUTE, in_a_hurry(scale('lower_bound', 0.9)), True, 'strategy: lower_bound is stated'),
    (NEW_ROUTE, move_trip('start'), True, 'network: it does not follow'),
    (NEW_ROUTE, move_end(0), True, 'ends: the first one is not'),
    (GET_PLAN, move_end(1), True, 'ends: the last one is not'),
    (MOVED_GOAL, move_trip('goal'), True, 'trip: its goal is not where'),
    (MOVED_GOAL, edit_trip(lambda trip, rng: trip.update(tolerance=0.5)), True, 'trip:'),
    (NEW_ROUTE, drop(MarkerArray, 2), True, 'markers: mean_direction is missing'),
    (NEW_ROUTE, drop(PathMessage), False, "0 messages in the role 'path'"),
    (NEW_ROUTE, change_call(response={}), True, 'call: they are not the fields of a Trigger_Resp'),
    (GET_PLAN, change_call(request=[]), True, 'the recorded call is not just'),
    (NEW_ROUTE, change_call(type='std_srvs/srv/Empty'), True, 'is not a service of the planner'),
    (NEW_ROUTE, change_call(type='nav_msgs/srv/GetPlan'), True, 'call: they are not the fields'),
    (NEW_ROUTE, add_event, True, "messages: there are 1 of the kind 'service event', not 0"),
    (NEW_ROUTE, drop(DiagnosticArray), True, 'diagnostics: there is not one'),
    (NEW_ROUTE, repeat(MarkerArray), True, 'messages: there are 6'),
    (NEW_ROUTE, answer_no, True, 'response: its success'),
    (GET_PLAN, move_request, True, 'request: its goal.pose'),
    (NEW_ROUTE, metadata('departure_id', '0' * 36), True, 'response: its message'),
    (GET_PLAN, metadata('departure_id', '0' * 36), True, 'diagnostics: departure_id'),
    (NEW_ROUTE, metadata('departure', '7'), True, 'response: its message'),
    (NEW_ROUTE, metadata('service', 'get_plan'), True, 'service: the recorded call'),
    (NEW_ROUTE, metadata('frame', 'odom'), True, 'frame: the map is in the frame'),
    (NEW_ROUTE, metadata('format', '1'), True, "states the format '1'"),
    (NEW_ROUTE, swap_roles, True, 'ends: the first one is not'),
    (NEW_ROUTE, move_marker, True, 'does not show the recorded strategy'),
    (NEW_ROUTE, change_report('value', '0.1'), True, 'diagnostics: value is not'),
    (NEW_ROUTE, retype, True, 'map: it is not of the type OccupancyGrid'),
    (NEW_ROUTE, other_frame, True, 'path: its poses['),
    (NEW_ROUTE, add_attachment, True, "an attachment 'more' is not known"),
    (NEW_ROUTE, swap_markers, True, 'are on the topic of'),
    (NEW_ROUTE, report_error, True, 'diagnostics: level, code and message'),
    (NEW_ROUTE, lose_attachment, False, "no attachment 'strategy.npz'"),
    *AROUND,
    *HIDDEN,
]
