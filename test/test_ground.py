"""How a strategy stands on changed ground: against planning anew, cell by cell, and over DDS."""

import re
from functools import cache
from io import BytesIO
from threading import Event

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nav_msgs.msg import OccupancyGrid
from rclpy.parameter import Parameter
from ros_harness import Client, header, pose, risk_grid, stage, wait_until
from rosbags.typesys import Stores, get_typestore
from standin_types import grid_update, message_type
from waiting import TIMEOUT

from ambush_planner.game.game import GameOptions
from ambush_planner.game.strategy import solve
from ambush_planner.maps.obstacles import ObstacleField
from ambush_planner.maps.occupancy import OccupancyOptions, risk_map_from_occupancy
from ambush_planner.maps.ros_messages import path_from_ros
from ambush_planner.network.construction import NetworkOptions
from ambush_planner.network.network import Network
from ambush_planner.planning.changed_ground import ChangedGround, Standing
from ambush_planner.planning.plan import PlanningOptions, plan
from ambush_planner.recordings import read_departure, read_recording
from ambush_planner.ros import subscriptions
from ambush_planner.ros.cdr import read_grid_update
from ambush_planner.ros.current_map import CurrentMap
from ambush_planner.ros.displayed_plan import DisplayedPlan
from ambush_planner.worker.process import WorkerProcess

SIZE, RESOLUTION, ORIGIN = 24, 0.5, (3.0, -2.0, 0.0)
OCCUPANCY = OccupancyOptions()
START, GOAL = (1.25, 6.25), (10.75, 6.25)  # in map axes
UPDATE = message_type('map_msgs', 'OccupancyGridUpdate')

# Of sums of probabilities.
ROUNDING = 1e-12


def grid(values, origin=ORIGIN):
    return CurrentMap(values, RESOLUTION, origin, received=None)


def planned(values, clearance=0.0, game=None, origin=ORIGIN, spacing=1.0):
    """A plan, its map, and what it knows of other maps."""
    risk_map = risk_map_from_occupancy(values, RESOLUTION, origin, OCCUPANCY)
    game = game or GameOptions()
    options = PlanningOptions(NetworkOptions(spacing=spacing, clearance=clearance), game)
    made = plan(risk_map, *risk_map.to_world([START, GOAL]), options)
    on = grid(values, origin)
    return made, on, ChangedGround(made, on, OCCUPANCY)


def rough(seed):
    values = np.random.default_rng(seed).integers(0, 60, (SIZE, SIZE), dtype=np.int8)
    values[9:14, 10:13] = 100
    return values


@cache
def rough_plan(clearance):
    return planned(rough(1), clearance)


def changed(values, cells, new):
    result = values.copy()
    result[tuple(np.array(cells).reshape(-1, 2).T)] = new
    return result


@pytest.mark.parametrize('spacing', [0.5, 0.7, 1.0])
@pytest.mark.parametrize('yaw', [0.0, 0.3, 2.0])
def test_on_its_own_map_a_strategy_stands_as_it_was_made(yaw, spacing):
    """Also where nodes lie on the borders of cells, and a turn of the map rounds them."""
    made, on, ground = planned(rough(1), origin=(3.0, -2.0, yaw), spacing=spacing)
    assert ground.standing(on) == Standing(made.strategy.value, made.strategy.lower_bound)
    again = ground.standing(grid(on.values.copy(), on.origin))
    assert again.value == pytest.approx(made.strategy.value, rel=1e-12)
    assert again.lower_bound == pytest.approx(made.strategy.lower_bound, rel=1e-9)


cells = st.lists(st.tuples(*[st.integers(0, SIZE - 1)] * 2), min_size=1, max_size=30)


@settings(max_examples=100, deadline=None)
@given(st.sampled_from((0.0, 0.4)), cells)
def test_a_strategy_is_blocked_if_one_of_its_segments_meets_a_new_obstacle(clearance, where):
    """Against the exact test on the whole map: never missed, and false only within a cell."""
    made, on, ground = rough_plan(clearance)
    values = changed(on.values, where, 100)
    network, p = made.network, made.strategy.edge_probability
    risk_map = risk_map_from_occupancy(values, RESOLUTION, ORIGIN, OCCUPANCY)
    ends = risk_map.to_map_axes(network.points[network.edges[p > 1e-12]])
    field = ObstacleField(risk_map)
    blocked = ground.standing(grid(values)).share < 1.0
    assert blocked or field.clear_segments(ends[:, 0], ends[:, 1], clearance).all()
    if blocked:
        wide = clearance + 0.5 * RESOLUTION
        assert not field.clear_segments(ends[:, 0], ends[:, 1], wide).all()


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(*[st.integers(6, 17)] * 2), min_size=1, max_size=6))
def test_what_is_left_of_a_strategy_is_what_is_drawn_until_a_route_is_clear(where):
    """Its value, against the frequencies of routes that are drawn and kept."""
    made, on, ground = rough_plan(0.0)
    newest = grid(changed(on.values, where, 100))
    standing = ground.standing(newest)
    rng, count = np.random.default_rng(5), 1000
    routes = [made.strategy.sample_route(rng) for _ in range(count)]
    kept = [route for route in routes if ground.holds(route, newest)]
    assert len(kept) / count == pytest.approx(standing.share, abs=0.08)
    if standing.share > 0.3:
        visits = np.bincount(np.concatenate(kept), minlength=len(made.network.points)) / len(kept)
        loss = made.network.alpha * visits
        assert loss.max() == pytest.approx(standing.value, rel=0.35)
        assert standing.fit_to_depart(np.inf, 0.0)


@settings(max_examples=50, deadline=None)
@given(cells, st.integers(0, 99))
def test_value_and_bound_are_those_of_the_game_on_the_new_map(where, value):
    made, on, ground = rough_plan(0.0)
    values = changed(on.values, where, value)
    standing = ground.standing(grid(values))
    network, strategy = made.network, made.strategy
    risk_map = risk_map_from_occupancy(values, RESOLUTION, ORIGIN, OCCUPANCY)
    rows, columns = risk_map.cells(risk_map.to_map_axes(network.points))
    alpha = risk_map.alpha[rows, columns]
    alpha[[network.source, network.target]] = 0.0
    hits = alpha * (strategy.visit_probability)
    assert standing.value == pytest.approx(hits.max())
    assert standing.lower_bound <= standing.value
    assert standing.share == pytest.approx(1.0, abs=ROUNDING)
    # No strategy on this network goes below the bound: the best one there included.
    again = Network(network.points, alpha, network.edges, network.source, network.target)
    assert solve(again).value >= standing.lower_bound - 1e-9


def test_ground_that_becomes_free_or_cheap_leaves_a_strategy_as_it_is():
    made, on, ground = rough_plan(0.0)
    values = on.values.copy()
    values[9:14, 10:13] = 0
    standing = ground.standing(grid(values))
    assert standing.share == pytest.approx(1.0, abs=ROUNDING)
    assert not standing.stale(made.strategy.value, 0.0)
    assert standing.fit_to_depart(0.1, 0.0)


def test_losses_that_rise_make_it_stale_by_their_share():
    made, on, ground = rough_plan(0.0)
    dear = np.clip(on.values, 0, 99) + np.where(on.values == 100, 1, 0)
    dear = np.where(on.values == 100, 100, np.minimum(dear + 30, 99)).astype(np.int8)
    standing = ground.standing(grid(dear))
    rise = standing.value / made.strategy.value - 1.0
    assert rise > 0.1
    assert standing.stale(made.strategy.value, 0.99 * rise)
    assert not standing.stale(made.strategy.value, 1.01 * rise)
    assert standing.share == pytest.approx(1.0, abs=ROUNDING)


def test_a_slack_that_was_asked_for_is_no_reason_to_wait():
    with stage(parameters={'strategy.risk_slack': 0.6, 'strategy.max_gap': 0.05}) as running:
        client = running.give()
        assert client.call('new_route').success
        assert client.call('new_route').success
        assert shown(client) == 1
        assert float(client.diagnostics(departures='2')['gap']) > 0.0


def test_a_threshold_that_is_passed_blocks():
    values = np.full((SIZE, SIZE), 10, dtype=np.int8)
    made, on, ground = planned(values, game=GameOptions(alpha_threshold=5.0))
    node = int(np.argmax(np.where(made.network.alpha > 0, made.strategy.visit_probability, 0.0)))
    risk_map = risk_map_from_occupancy(values, RESOLUTION, ORIGIN, OCCUPANCY)
    row, column = risk_map.cells(risk_map.to_map_axes(made.network.points[node]))
    elsewhere = ground.standing(grid(changed(values, [(0, 0)], 90)))
    assert elsewhere.share == pytest.approx(1.0, abs=ROUNDING)
    standing = ground.standing(grid(changed(values, [(row, column)], 90)))
    assert standing.share == pytest.approx(1.0 - made.strategy.visit_probability[node])


def test_another_map_altogether_blocks_at_once():
    values = np.zeros((400, 400), dtype=np.int8)
    made, on, ground = planned(values, spacing=5.0)
    new = np.full_like(values, 100)
    new[8:18] = 0
    assert not ground.standing(grid(new)).fit_to_depart(1e9, 0.0)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from((0.0, 0.4)), st.integers(0, 1000))
def test_connections_are_clear_exactly_where_the_whole_map_says_so(clearance, seed):
    made, on, ground = rough_plan(clearance)
    rng = np.random.default_rng(seed)
    risk_map = risk_map_from_occupancy(on.values, RESOLUTION, ORIGIN, OCCUPANCY)
    a = rng.uniform(-0.5, SIZE * RESOLUTION + 0.5, (3, 2))
    b = a + rng.normal(size=(3, 2))
    wanted = bool(
        ObstacleField(risk_map).clear_segments(a, b, clearance).all()
        and risk_map.contains(np.concatenate((a, b))).all())
    assert ground.clear(risk_map.to_world(a), risk_map.to_world(b), on) == wanted


# Over DDS

@pytest.fixture(autouse=True)
def installed(monkeypatch):
    """The message of map updates, as a stand-in where it is not installed."""
    monkeypatch.setattr(subscriptions, 'OccupancyGridUpdate', UPDATE)


FLAT = np.full((20, 20), 10, dtype=np.int8)


@pytest.fixture
def running():
    with stage() as running:
        running.give(risk_grid(FLAT))
        assert running.client.call('new_route').success
        running.client.diagnostics(departures='1', stale='no')
        yield running


def update(client: Client, x, y, values, frame='map'):
    client.publish('alpha_map_updates', grid_update(frame, x, y, values), UPDATE)


def shown(client):
    return len(client.received['edge_probabilities'])


def test_updates_change_the_map_and_far_from_the_routes_not_the_strategy(running):
    client = running.client
    update(client, 0, 0, [[100, 100, 100]])
    wait_until(lambda: running.planner._inputs.current_map().values[0, 2] == 100, 'the update')
    assert client.call('new_route').success
    client.diagnostics(departures='2', stale='no', level=b'\1')
    assert shown(client) == 1


def test_many_updates_at_once_are_looked_through_once(running, monkeypatch):
    looked, review, go_on = [], DisplayedPlan.review, Event()
    monkeypatch.setattr(
        DisplayedPlan, 'review', lambda *given: (looked.append(1), review(*given))[1])
    running.planner._dispatcher._departures.do(lambda: go_on.wait(TIMEOUT))  # a departure, say
    for column in range(20):
        update(running.client, column, 0, [[100]])
    try:
        wait_until(lambda: (running.planner._inputs.current_map().values[0] == 100).all(),
                   'the updates')
    finally:
        go_on.set()
    assert running.client.call('new_route').success
    before = len(looked)
    assert before < 3, 'the last one may come after the others were begun'
    update(running.client, 0, 1, [[100]])
    wait_until(lambda: len(looked) > before, 'the next one')


def test_an_obstacle_on_a_route_is_solved_anew_before_anybody_departs(running):
    client = running.client
    wall = np.full((14, 1), 100)
    update(client, 10, 0, wall)
    client.last('edge_probabilities', 2)
    field = np.zeros((20, 20), bool)
    field[:14, 10] = True
    for number in range(2, 8):
        path = path_from_ros(client.get_plan(pose(1.5, 5.5), pose(8.5, 5.5)))
        client.diagnostics(departures=str(number))
        cells = np.floor(path[:, :2] / 0.5).astype(int)
        assert not field[cells[:, 1], cells[:, 0]].any()
    assert shown(client) == 2
    client.diagnostics(stale='no')


def test_a_value_that_rises_is_reported_and_solved_anew_in_the_background(running):
    client = running.client
    running.planner.set_parameters([Parameter('replan.tolerance', value=1e9)])
    before = client.diagnostics(departures='1')
    dear = FLAT.copy()
    dear[:, 8:12] = 80
    client.publish('alpha_map', risk_grid(dear))
    wait_until(lambda: client.diagnostics()['current_value'] != before['current_value'], 'a value')
    report = client.diagnostics(stale='no', departures='1', value=before['value'])
    assert float(report['current_value']) > 2 * float(before['value'])
    assert shown(client) == 1
    running.planner.set_parameters([Parameter('replan.tolerance', value=0.05)])
    dear[0, 0] = 11
    client.publish('alpha_map', risk_grid(dear))
    client.last('edge_probabilities', 2)
    after = client.diagnostics(stale='no', departures='1')
    assert float(after['value']) <= float(report['current_value'])
    assert after['current_value'] == after['value']


def test_a_solve_in_the_background_that_is_cancelled_is_not_told_as_going_on(
        running, monkeypatch):
    client, go_on, solve = running.client, Event(), WorkerProcess.solve
    monkeypatch.setattr(
        WorkerProcess, 'solve', lambda *given: (go_on.wait(TIMEOUT), solve(*given))[1])
    update(client, 10, 0, np.full((14, 1), 100))
    assert 'being solved anew' in client.diagnostics(stale='yes', state='solving')['message']
    try:
        assert client.call('cancel').success
    finally:
        go_on.set()
    report = client.diagnostics(stale='yes', state='ready', level=b'\1')
    wait_until(lambda: 'solving it anew was cancelled' in client.diagnostics()['message'],
               'the news')
    assert 'new obstacles' in report['message']
    assert client.call('new_route').success
    client.diagnostics(stale='no')


def test_ground_that_cannot_be_solved_anew_is_told_as_long_as_it_lasts(running):
    client = running.client
    running.planner.set_parameters([Parameter('diagnostics.error_hold', value=0.0)])
    wall = np.full((20, 1), 100)
    update(client, 10, 0, wall)
    report = client.diagnostics(stale='yes', state='ready', level=b'\1')
    wait_until(lambda: 'cannot be solved anew' in client.diagnostics()['message'], 'the reason')
    assert not client.call('new_route').success
    update(client, 10, 0, np.full((20, 1), 10))
    client.diagnostics(stale='no')
    assert client.call('new_route').success
    assert report['code'] == 'NONE'


@pytest.mark.parametrize('x, y, values, frame, words', [
    (18, 0, [[1, 2, 3]], 'map', r'3 x 1 cells from \(18, 0\) on do not lie within .* 20 x 20'),
    (-1, 0, [[1]], 'map', 'do not lie within'),
    (0, 0, [[101]], 'map', r'map update: cell values must be in -1..100, got 101'),
    (0, 0, [[1]], 'odom', "map update: it is given in the frame 'odom', the map in 'map'"),
])
def test_updates_that_do_not_fit_are_refused_and_the_map_stays(
        running, x, y, values, frame, words):
    client = running.client
    update(client, x, y, values, frame)
    report = client.diagnostics(code='INVALID_MAP')
    assert re.search(words, report['message'])
    assert (running.planner._inputs.current_map().values == FLAT).all()
    update(client, 0, 0, [[11]])
    client.diagnostics(code='NONE')


def test_an_update_before_any_map_and_bytes_that_are_none():
    with stage() as running:
        update(running.client, 0, 0, [[1]])
        running.client.diagnostics(code='NO_MAP')
        running.give()
        running.client.diagnostics(code='NONE')
        running.client.publish('alpha_map_updates', b'\0\1\0\0nothing', UPDATE)
        running.client.diagnostics(code='INVALID_MESSAGE')


def test_an_updated_map_is_recorded_whole(tmp_path):
    with stage(tmp_path) as running:
        client = running.give(risk_grid(FLAT))
        update(client, 3, 4, [[20, 30], [40, -1]])
        wait_until(lambda: running.planner._inputs.current_map().values[4, 3] == 20, 'the update')
        assert client.call('new_route').success
    (file,) = tmp_path.rglob('*.mcap')
    wanted = FLAT.copy()
    wanted[4:6, 3:5] = [[20, 30], [40, -1]]
    assert (read_departure(file).planned_on.values == wanted).all()
    data = read_recording(file).in_role('map').data
    other = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(data, 'nav_msgs/msg/OccupancyGrid')
    assert (other.data.reshape(20, 20) == wanted).all()


def test_what_a_departure_left_on_is_recorded(tmp_path):
    """The planned trip and map, where the path begins and ends, and what has changed since."""
    with stage(tmp_path) as running:
        client = running.give(risk_grid(FLAT))
        assert client.get_plan(pose(1.5, 5.5), pose(8.5, 5.5)).poses
        update(client, 0, 0, [[100, 90]])
        wait_until(lambda: running.planner._inputs.current_map().values[0, 0] == 100, 'the update')
        assert client.get_plan(pose(1.6, 5.4), pose(8.5, 5.6)).poses
    files = sorted(tmp_path.rglob('*.mcap'))
    first, second = map(read_departure, files)
    assert first.ends == ((1.5, 5.5), (8.5, 5.5))
    assert first.newest is first.planned_on
    assert second.ends == ((1.6, 5.4), (8.5, 5.6))
    assert second.trip == first.trip
    assert np.array_equal(second.planned_on.values, first.planned_on.values)
    path = second.path_poses
    assert (path[0, :2].tolist(), path[-1, :2].tolist()) == ([1.6, 5.4], [8.5, 5.6])
    changes = np.load(BytesIO(read_recording(files[1]).attachments['map_changes.npz']))
    assert changes['cells'].tolist() == [0, 1]
    assert changes['values'].tolist() == [100, 90]


def test_updates_are_read_as_an_independent_library_writes_them():
    values = np.arange(6, dtype=np.int8).reshape(2, 3)
    found = read_grid_update(grid_update('größer', 5, -7, values, stamp=(9, 8)))
    assert (found.frame, found.x, found.y, found.stamp.sec, found.stamp.nanosec) == (
        'größer', 5, -7, 9, 8)
    assert (found.values == values).all()


def test_a_costmap_has_obstacles_from_99_on():
    values = FLAT.copy()
    values[4:16, 8:12] = 99
    for preset, crosses in (('alpha', True), ('costmap', False)):
        with stage(parameters={'map.preset': preset}) as running:
            running.give(risk_grid(values))
            answer = running.client.get_plan(pose(1.5, 5.5), pose(5.0, 5.5))
            assert bool(answer.poses) == crosses


def test_maps_are_shared_and_not_copied():
    with stage() as running:
        running.give()
        held = running.planner._inputs.current_map()
        assert not len(held.received.message.data)
        assert held.values.base is not None
        message = OccupancyGrid(header=header())
        assert type(held.received.message) is type(message)
        assert np.shares_memory(held.values, np.frombuffer(held.received.data, np.uint8))


def test_a_start_moved_a_little_uses_the_steps_that_are_left(monkeypatch):
    """Where the first step of one route is lost, the others are enough for a start nearby."""
    solves, solve = [], WorkerProcess.solve
    monkeypatch.setattr(
        WorkerProcess, 'solve', lambda *given: (solves.append(1), solve(*given))[1])
    parameters = {'replan.tolerance': 1e9, 'strategy.max_gap': 1e9}
    with stage(parameters=parameters) as running:
        client = running.give(risk_grid(FLAT))
        assert client.call('new_route').success
        held = running.planner._dispatcher._in_force.held
        network = held.plan.network
        firsts = network.points[network.heads[
            (network.tails == network.source) & (held.plan.strategy.edge_probability > 0)]]
        assert len(firsts) > 1
        # Away from the start, so that the cell meets this step only.
        x, y = firsts[np.argmax(firsts[:, 1])] * 0.8 + np.array([1.5, 5.5]) * 0.2
        column, row = int(x / 0.5), int(y / 0.5)
        monkeypatch.setattr(DisplayedPlan, '_solve_anew', lambda *_: None)
        update(client, column, row, [[100]])
        client.diagnostics(stale='yes')
        path = client.get_plan(pose(1.5, 5.45), pose(8.5, 5.5))
        assert path_from_ros(path)[0, :2] == pytest.approx((1.5, 5.45))
        assert len(solves) == 1
