"""What the options of game and route change in what the node answers, held against geometry."""

import numpy as np
import pytest
from nav_msgs.srv import GetPlan
from ros_harness import pose, risk_grid, stage

from ambush_planner import GameOptions, StrategyOptions, TimeLimit, solve
from ambush_planner.game.strategy import solve_game
from ambush_planner.planning import solving as planner
from ambush_planner.planning.trip import plan_from_request
from ambush_planner.recordings import read_departure, recordings_in
from ambush_planner.worker.process import WorkerProcess

OPEN = np.full((40, 40), 10, dtype=np.int8)
START, GOAL = pose(2.5, 10.0), pose(17.5, 10.0)


def departures(folder, parameters, count=4):
    """Departures of a node on open ground: their paths, routes and strategies, and the values."""
    parameters = {'network.spacing': 2.0, 'route.path_spacing': 0.1, 'seed': 3, **parameters}
    with stage(folder, parameters) as running:
        client = running.give(risk_grid(OPEN))
        for _ in range(count):
            assert client.get_plan(START, GOAL).poses
        report = client.diagnostics(departures=str(count))
    found = [
        (each.path_poses, each.route.tolist(), each.strategy)
        for each in map(read_departure, recordings_in(folder))
    ]
    return found, report


def aside(rows, line):
    """The largest distance of poses from a polyline."""
    a, along = line[:-1], np.diff(line, axis=0)
    to = rows[:, None, :2] - a
    t = np.clip((to * along).sum(axis=2) / (along**2).sum(axis=1), 0.0, 1.0)
    return np.linalg.norm(to - t[..., None] * along, axis=2).min(axis=1).max()


def tightest(rows):
    """The smallest radius of a turn, between start and goal, whose yaws were asked for."""
    rows = rows[1:-1]
    turned = np.abs((np.diff(rows[:, 2]) + np.pi) % (2 * np.pi) - np.pi)
    gone = np.hypot(*np.diff(rows[:, :2], axis=0).T)
    return (gone[turned > 1e-6] / turned[turned > 1e-6]).min(initial=np.inf)


@pytest.mark.parametrize('tube', [0.0, 0.3, 0.9])
def test_the_path_is_in_its_tube_and_the_game_has_as_much_more_reach(tmp_path, tube):
    found, _ = departures(tmp_path, {'game.ambush_radius': 1.5, 'route.tube': tube})
    for rows, route, strategy in found:
        assert aside(rows, strategy.network.points[route]) <= tube + 1e-9
        options = strategy.game.options
        assert (options.ambush_radius, options.tube) == (1.5, pytest.approx(tube))
    if tube:  # and it is used
        assert max(aside(rows, each.network.points[route]) for rows, route, each in found) > 0.1


def test_turns_are_as_wide_as_asked_where_the_tube_has_the_room(tmp_path):
    """The same routes, by the seed; on open ground in a tube of half a spacing."""
    options = {'game.ambush_radius': 1.5, 'game.secured_radius': 5.0, 'route.tube': 1.0}
    sharp, _ = departures(tmp_path / 'sharp', options)
    wide, _ = departures(tmp_path / 'wide', {**options, 'route.turning_radius': 1.5})
    assert [route for _, route, _ in sharp] == [route for _, route, _ in wide]
    radii = [[tightest(rows) for rows, _, _ in each] for each in (sharp, wide)]
    assert min(radii[1]) > 1.2 * min(radii[0])
    assert sum(radius > 0.98 * 1.5 for radius in radii[1]) >= 2


@pytest.mark.parametrize('ambushers', [2, 3])
def test_losses_of_several_ambushers_add_up(tmp_path, ambushers):
    found, report = departures(tmp_path, {'game.ambushers': ambushers}, count=1)
    (_, _, strategy), = found
    into = np.bincount(
        strategy.network.heads, strategy.edge_probability, len(strategy.network.points))
    losses = np.sort(strategy.network.alpha * into)
    assert float(report['value']) == pytest.approx(losses[-ambushers:].sum())
    one = solve(strategy.network, GameOptions(), StrategyOptions())
    assert one.value * 1.5 < float(report['value']) <= ambushers * one.value * 1.02
    assert strategy.ambush_probability.sum() == pytest.approx(ambushers)


def short_of_time(game, options, ground, warm):
    """The result of a solve at the time limit: a strategy that is 4 % over the best."""
    rough = StrategyOptions(max_detour=options.max_detour, risk_slack=0.05)
    raise TimeLimit('time is up', solve_game(game, rough, ground))


@pytest.mark.parametrize('max_gap', [0.1, 0.01])
def test_what_was_reached_in_time_departs_with_a_warning_or_not_at_all(monkeypatch, max_gap):
    monkeypatch.setattr(WorkerProcess, 'solve', lambda _, request: plan_from_request(request))
    monkeypatch.setattr(planner, 'solve_game', short_of_time)
    with stage(parameters={'strategy.max_gap': max_gap}) as running:
        client = running.give()
        path = client.call('get_plan', GetPlan.Request(start=START_NEAR, goal=GOAL_NEAR)).plan
        if max_gap == 0.1:
            assert path.poses
            report = client.diagnostics(departures='1', code='NONE', level=b'\1')
            assert 'max_planning_time' in report['message']
            gap, value = float(report['gap']), float(report['value'])
            assert 0.01 * value < gap < 0.06 * value
        else:
            assert not path.poses
            report = client.diagnostics(departures='0', code='TIMEOUT', level=b'\2')
            assert 'more than max_gap 0.01' in report['message']


START_NEAR, GOAL_NEAR = pose(1.5, 5.5), pose(8.5, 5.5)


def test_a_slack_that_was_asked_for_is_not_warned_of():
    with stage(parameters={'strategy.risk_slack': 0.3}) as running:
        client = running.give(risk_grid(np.full((20, 20), 10)))
        assert client.call('new_route').success
        report = client.diagnostics(departures='1')
        assert float(report['gap']) > 0.1 * float(report['value'])
        assert 'ended the search' not in report['message']
