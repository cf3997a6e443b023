"""Departures of a folder: their order, copies, and the strategy that each was drawn from."""

import shutil
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from audit_samples import START_NS, departure, drawn, occupancy, record, sample_plan

from ambush_planner.recordings import recordings_in
from ambush_planner.recordings.audit import audit
from ambush_planner.recordings.map_changes import map_changes_file
from ambush_planner.recordings.recorded_departures import read_departures


@pytest.fixture(scope='module')
def a_plan():
    return sample_plan()


def read(folder):
    errors = []
    return read_departures(recordings_in(folder), errors.append), errors


def test_departures_come_in_order_of_time_then_number_and_copies_count_once(tmp_path, a_plan):
    routes = drawn(a_plan, 4)
    stamps = [START_NS + 5, START_NS, START_NS, START_NS + 9]
    paths = record(tmp_path, [
        departure(a_plan, route, number, stamp_ns=stamp)
        for route, number, stamp in zip(routes, (7, 3, 2, 1), stamps, strict=True)
    ])
    shutil.copy(paths[0], tmp_path / 'copy_0.mcap')
    found, errors = read(tmp_path)
    assert not errors and [each.number for each in found] == [2, 3, 7, 1]


BLOCKED = np.s_[8:20, 36:44]  # rows and columns that become an obstacle, next to the hill


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


def test_after_a_map_change_departures_are_drawn_from_the_conditioned_strategy(tmp_path, a_plan):
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
    conditioned = found[0].drawn_from
    assert found[1].drawn_from is conditioned and found[3].drawn_from is found[3].strategy
    pairs = {pair: k for k, pair in enumerate(map(tuple, conditioned.network.edges.tolist()))}
    driven = np.zeros(len(pairs))
    for route in left:
        for pair in pairwise(route.tolist()):
            driven[pairs[pair]] += 1.0 / len(left)
    p = conditioned.edge_probability
    apart = np.abs(driven - p)
    assert np.all(apart < 5.0 * np.sqrt(np.maximum(p * (1.0 - p), 1.0 / len(left)) / len(left)))
    for strategy, finding in ((conditioned, False), (a_plan.strategy, True)):
        departures = [SimpleNamespace(drawn_from=strategy, route=each) for each in left[:120]]
        assert audit(departures).finding == finding
