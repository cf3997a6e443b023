"""Recorded departures as records: round trip, grouping, and refusals that say what is wrong."""

import json
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from audit_samples import (
    GOAL,
    NUMBERS,
    START,
    START_NS,
    corrected,
    departure,
    drawn,
    occupancy,
    parameters,
    record,
    restamped,
    sample_plan,
    source,
    without,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recording_samples import encoded_departure

from ambush_planner.game.game import GameOptions
from ambush_planner.maps.occupancy import risk_map_from_occupancy
from ambush_planner.recordings import UnreadableRecording, read_departure, recordings_in
from ambush_planner.recordings.audit import audit
from ambush_planner.recordings.map_changes import map_changes_file
from ambush_planner.recordings.metadata import Link, chain_text
from ambush_planner.recordings.recorded_case import Case
from ambush_planner.recordings.recorded_departures import read_departures


@pytest.fixture(scope='module')
def a_plan():
    return sample_plan()


@pytest.fixture(scope='module')
def other_plan():
    return sample_plan(hill=90)


def read(folder):
    errors = []
    return read_departures(recordings_in(folder), errors.append), errors


def only_error(folder, *departures):
    """The one error that reading these departures gives."""
    record(folder, departures)
    found, errors = read(folder)
    assert not found and len(errors) == 1
    assert isinstance(errors[0], UnreadableRecording)
    return str(errors[0])


def test_a_departure_comes_back_as_it_was(tmp_path, a_plan):
    (route,) = drawn(a_plan, 1)
    (path,) = record(tmp_path, [departure(a_plan, route, 3)])
    (found,), errors = read(tmp_path)
    assert not errors and found.path == path
    assert found.route.tolist() == route.tolist()
    assert (found.metadata.number, found.metadata.service, found.metadata.frame) == (
        3, 'new_route', 'map')
    assert found.metadata.id.endswith('003')
    assert found.metadata.route_entropy_source == [source(3)]
    assert found.metadata.planner_version == '0.1.0'
    assert found.metadata.versions['numpy'] == '1.26.4'
    assert found.metadata.trip.start_xy == START and found.metadata.trip.goal_xy == GOAL
    assert found.metadata.trip.tolerance == 0.0
    assert found.parameters.planning.game == GameOptions(secured_radius=40.0)
    assert str(source(3)) not in repr(found)


def test_the_strategy_comes_back_with_its_network_and_certificate(tmp_path, a_plan):
    (route,) = drawn(a_plan, 1)
    record(tmp_path, [departure(a_plan, route)])
    (found,), _ = read(tmp_path)
    ours, theirs = found.strategy, a_plan.strategy
    for name in ('points', 'alpha', 'edges', 'source', 'target'):
        assert np.array_equal(getattr(ours.network, name), getattr(theirs.network, name))
    for name in ('edge_probability', 'visit_probability', 'ambush_probability'):
        assert np.array_equal(getattr(ours, name), getattr(theirs, name))
    for name in NUMBERS:
        assert getattr(ours, name) == pytest.approx(getattr(theirs, name), rel=1e-12)
    assert ours.gap == theirs.gap
    assert np.array_equal(ours.game.loss, theirs.game.loss)
    rngs = [np.random.default_rng(5) for _ in range(2)]
    assert ours.sample_route(rngs[0]).tolist() == theirs.sample_route(rngs[1]).tolist()


def test_the_risk_map_comes_back(tmp_path, a_plan):
    (route,) = drawn(a_plan, 1)
    record(tmp_path, [departure(a_plan, route)])
    (found,), _ = read(tmp_path)
    expected = risk_map_from_occupancy(occupancy(), 5.0)
    assert np.array_equal(found.risk_map.alpha, expected.alpha)
    assert np.array_equal(found.risk_map.obstacles, expected.obstacles)


def test_departures_of_one_strategy_share_it_and_come_in_the_order_of_time(
    tmp_path, a_plan, other_plan
):
    routes, others = drawn(a_plan, 4), drawn(other_plan, 2)
    late = [departure(a_plan, route, k + 10) for k, route in enumerate(routes)]
    early = [departure(other_plan, route, k + 1, hill=90) for k, route in enumerate(others)]
    record(tmp_path, [late[2], early[1], late[0], late[3], early[0], late[1]])
    found, errors = read(tmp_path)
    assert not errors
    assert [each.metadata.number for each in found] == [1, 2, 10, 11, 12, 13]
    for part in (found[:2], found[2:]):
        assert len({id(each.strategy) for each in part}) == 1
        assert len({id(each.risk_map) for each in part}) == 1
    assert found[0].strategy is not found[2].strategy


def test_the_same_strategy_in_another_game_is_another_one(tmp_path, a_plan):
    """A strategy may serve two games; measures and sites are those of each."""
    routes = drawn(a_plan, 2)
    texts = {'parameters': json.dumps(parameters(**{'game.secured_radius': 30.0}))}
    record(tmp_path, [departure(a_plan, routes[0]), departure(a_plan, routes[1], 2, texts=texts)])
    found, errors = read(tmp_path)
    assert len({id(each.strategy) for each in found}) == len(found)


BLOCKED = np.s_[8:20, 36:44]  # rows and columns that become an obstacle, beside the hill


def clear_edges(network):
    """Edges that stay as far from the new cells as their corners are from their centres."""
    row, column = np.mgrid[BLOCKED].reshape(2, -1)
    centres = (np.column_stack((column, row)) + 0.5) * 5.0
    found = set()
    for tail, head in network.edges.tolist():
        a, along = network.points[tail], network.points[head] - network.points[tail]
        t = np.clip((centres - a) @ along / (along @ along), 0.0, 1.0)
        if np.hypot(*(a + t[:, None] * along - centres).T).min() > 5.0 * np.sqrt(0.5):
            found.add((tail, head))
    return found


def test_on_a_map_that_has_changed_departures_have_the_law_of_the_routes_that_are_left(
    tmp_path, a_plan
):
    """Compared with routes drawn until they are clear, which is what the node does."""
    clear = clear_edges(a_plan.network)
    routes = a_plan.strategy.sample_routes(4000, np.random.default_rng(3))
    left = [route for route in routes if clear.issuperset(pairwise(route.tolist()))]
    assert 1000 < len(left) < 3600
    after = occupancy()
    after[BLOCKED] = 100
    changes = map_changes_file(occupancy(), after)
    record(tmp_path, [
        departure(a_plan, route, k + 1, changes=changes) for k, route in enumerate(left[:3])
    ] + [departure(a_plan, drawn(a_plan, 1)[0], 4)])
    found, errors = read(tmp_path)
    assert not errors and len({id(each.strategy) for each in found}) == 1
    law = found[0].law
    assert found[1].law is law and found[3].law is found[3].strategy
    pairs = {pair: k for k, pair in enumerate(map(tuple, law.network.edges.tolist()))}
    driven = np.zeros(len(pairs))
    for route in left:
        for pair in pairwise(route.tolist()):
            driven[pairs[pair]] += 1.0 / len(left)
    p = law.edge_probability
    apart = np.abs(driven - p)
    assert np.all(apart < 5.0 * np.sqrt(np.maximum(p * (1.0 - p), 1.0 / len(left)) / len(left)))
    for strategy, finding in ((law, False), (a_plan.strategy, True)):
        departures = [SimpleNamespace(drawn_from=strategy, route=each) for each in left[:120]]
        assert audit(departures).finding == finding


def test_a_copied_file_counts_once(tmp_path, a_plan):
    (route,) = drawn(a_plan, 1)
    (path,) = record(tmp_path, [departure(a_plan, route)])
    (path.parent / 'copy.mcap').write_bytes(path.read_bytes())
    (found,), errors = read(tmp_path)
    assert not errors


def test_two_departures_of_one_id_are_refused(tmp_path, a_plan):
    one, two = drawn(a_plan, 2)
    same = {'departure_id': '00000000-0000-4000-8000-000000000001'}
    record(tmp_path, [departure(a_plan, one), departure(a_plan, two, 2, texts=same)])
    (found,), (error,) = read(tmp_path)
    assert 'departure_id' in str(error)


def test_one_bad_file_does_not_hide_the_others(tmp_path, a_plan):
    routes = drawn(a_plan, 3)
    paths = record(tmp_path, [departure(a_plan, r, k) for k, r in enumerate(routes)])
    paths[0].write_bytes(paths[0].read_bytes()[:500])
    found, errors = read(tmp_path)
    assert len(found) == 2 and [error.path for error in errors] == [paths[0]]


def test_equal_times_are_ordered_by_number(tmp_path, a_plan):
    routes = drawn(a_plan, 3)
    record(tmp_path, [
        departure(a_plan, routes[k], k, stamp_ns=START_NS) for k in (2, 0, 1)
    ])
    found, _ = read(tmp_path)
    assert [each.metadata.number for each in found] == [0, 1, 2]


@pytest.mark.parametrize('key', [
    'departure', 'departure_id', 'service', 'frame', 'planner_version', 'versions', 'parameters',
    'trip', 'route', 'route_entropy_source', 'sha256', 'inputs',
])
def test_every_entry_is_missed(tmp_path, a_plan, key):
    messages, metadata, files = departure(a_plan, drawn(a_plan, 1)[0])
    del metadata[key]
    assert key in only_error(tmp_path, (messages, metadata, files))


BAD_TEXTS = [
    ('departure', '-1'), ('departure', 'one'), ('departure', '9' * 30), ('departure', ''),
    ('route', '[]'), ('route', '[1]'), ('route', 'nonsense'), ('route', '[0, 1, 2.5]'),
    ('route', '[0, -1]'), ('route', '[0, 999999]'), ('route', '[0, 99999999999999999999]'),
    ('route', '[true, false]'), ('route', '{"a": 1}'), ('route', '[['), ('route', '[0, NaN]'),
    ('route', '[' * 100_000), ('route', '[0, ' + '9' * 5000 + ']'), ('route', ' ' * 2**23),
    ('route_entropy_source', '[]'), ('route_entropy_source', '[-3]'),
    ('route_entropy_source', '7'), ('route_entropy_source', '[' + '9' * 4000 + ']'),
    ('trip', '[]'), ('trip', '{}'),
    ('trip', '{"start": [1, 2], "goal": [3], "tolerance": 0}'),
    ('trip', '{"start": [1, 2], "goal": [3, NaN], "tolerance": 0}'),
    ('trip', '{"start": [1, 2], "goal": [3, "x"], "tolerance": 0}'),
    ('trip', '{"start": [1, 2], "goal": [3, 4], "tolerance": Infinity}'),
    ('trip', '{"start": [1, 2], "goal": [3, 4], "tolerance": 0, "more": 1}'),
    ('trip', '{"start": [1, 2], "goal": [3, 4], "tolerance": 0, "tolerance": 0}'),
    ('parameters', '{}'), ('parameters', '7'), ('parameters', '{"a": {"b": 1}}'),
    ('versions', '[]'), ('inputs', '[]'), ('inputs', '{"map": "/nowhere"}'), ('sha256', '{}'),
    ('sha256', '{"map": 7}'), ('chain', '{}'), ('chain', '{"file": 3}'),
]


@pytest.mark.parametrize('key, text', BAD_TEXTS)
def test_malformed_entries_are_refused(tmp_path, a_plan, key, text):
    error = only_error(tmp_path, departure(a_plan, drawn(a_plan, 1)[0], texts={key: text}))
    assert 'not readable as a recording' in error and '\n' not in error.strip()
    # A route or a seed is never repeated in a message.
    assert '999999' not in error


@pytest.mark.parametrize('name, value', [
    ('map.alpha_max', 0.0), ('map.alpha_min', 'much'), ('game.secured_radius', [1]),
    ('game.ambushers', 2), ('game.unheard_of', 1), ('strategy.solver', 'guess'),
    ('network.spacing', None), ('recording.directory', 7), ('max_planning_time', 'soon'),
    ('map.obstacle_threshold', [50]), ('game.alpha_threshold', 0.5),
])
def test_malformed_parameters_are_refused(tmp_path, a_plan, name, value):
    texts = {'parameters': json.dumps(parameters(**{name: value}))}
    assert only_error(tmp_path, departure(a_plan, drawn(a_plan, 1)[0], texts=texts))


@pytest.mark.parametrize('name', ['map', 'start', 'path', 'parameters', 'route', 'trip',
                                  'strategy', 'route_entropy_source'])
def test_a_hash_that_does_not_hold_is_named(tmp_path, a_plan, name):
    messages, metadata, files = departure(a_plan, drawn(a_plan, 1)[0])
    hashes = json.loads(metadata['sha256'])
    hashes[name] = '0' * 64
    metadata['sha256'] = json.dumps(hashes)
    assert f'sha256 of {name}' in only_error(tmp_path, (messages, metadata, files))


def test_a_missing_map_path_or_strategy_is_named(tmp_path, a_plan):
    messages, metadata, files = departure(a_plan, drawn(a_plan, 1)[0])
    for k, topic in enumerate(('/alpha_map', '/path')):
        left = without(messages, topic)
        assert topic.split('_')[-1].strip('/') in only_error(
            tmp_path / str(k), (left, metadata, files)
        )
    assert 'strategy.npz' in only_error(tmp_path / 'npz', (messages, metadata, []))


def test_a_map_of_another_type_is_refused(tmp_path, a_plan):
    texts = {'inputs': json.dumps(
        {'map': '/path', 'start': '/start_pose', 'goal': '/goal_pose', 'path': '/path'}
    )}
    route = drawn(a_plan, 1)[0]
    messages, metadata, files = departure(a_plan, route, texts=texts)
    hashes = json.loads(metadata['sha256'])
    metadata['sha256'] = json.dumps(hashes | {'map': hashes['path']})
    assert 'not of the type OccupancyGrid' in only_error(tmp_path, (messages, metadata, files))


def test_a_time_before_the_epoch_does_not_exist_and_one_far_ahead_does(tmp_path, a_plan):
    messages, metadata, files = departure(a_plan, drawn(a_plan, 1)[0])
    record(tmp_path, [(restamped(messages, 2**63 - 1), metadata, files)])
    (found,), _ = read(tmp_path)
    assert found.stamp_ns == 2**63 - 1


@pytest.fixture(scope='module')
def one_departure(a_plan):
    return departure(a_plan, drawn(a_plan, 1)[0])


@settings(max_examples=100, deadline=None, derandomize=True, database=None,
          suppress_health_check=list(HealthCheck))
@given(key=st.sampled_from(['parameters', 'trip', 'route', 'route_entropy_source', 'versions',
                            'inputs', 'departure', 'sha256']), data=st.data())
def test_any_text_in_the_metadata_is_read_or_refused(tmp_path, one_departure, key, data):
    messages, metadata, files = one_departure
    text = metadata[key]
    place = data.draw(st.integers(0, len(text)))
    alphabet = st.sampled_from('0123456789-.:,[]{}&*!|>%@`\'"#? \nabnN~\\\t\x00')
    changed = (
        text[:place] + data.draw(st.text(alphabet, max_size=4))
        + text[place + data.draw(st.integers(0, 3)):]
    )
    path = tmp_path / 'one.mcap'
    metadata = {**corrected({**metadata, key: changed}), 'chain': chain_text(Link())}
    path.write_bytes(encoded_departure(messages, metadata, files, 'zstd'))
    try:
        Case(read_departure(path)).strategy()
    except UnreadableRecording as error:
        assert str(path) in str(error)


@pytest.mark.parametrize('key, text', [
    ('versions', '{numpy: [1]}'), ('versions', '{numpy: "' + 'x' * 5000 + '"}'),
    ('versions', '{numpy: ' + '9' * 90 + '}'), ('versions', '{"\\e[2J": []}'),
    ('frame', 'm' * 300), ('departure_id', '\x1b[2J' * 99), ('planner_version', 'x\n' * 200),
    ('parameters', json.dumps(parameters(seed=10**90))),
    ('parameters', json.dumps(parameters(unheard_of=1))),
    ('parameters', json.dumps(parameters(**{'recording.directory': 'x' * 5000}))),
])
def test_what_nobody_can_show_is_refused(tmp_path, a_plan, key, text):
    error = only_error(tmp_path, departure(a_plan, drawn(a_plan, 1)[0], texts={key: text}))
    assert error.replace('\n', '').isprintable() and len(error) < 600


def test_an_unknown_attachment_is_refused(tmp_path, a_plan):
    messages, metadata, files = departure(a_plan, drawn(a_plan, 1)[0])
    error = only_error(tmp_path, (messages, metadata, [*files, replace(files[0], name='more')]))
    assert "'more'" in error
