# SPDX-License-Identifier: Apache-2.0
"""Parameters: described, ranged, checked as a set, and set in any order."""

import math
import os

import numpy as np
import pytest
import yaml
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter, parameter_dict_from_yaml_file
from ros_harness import free_domain, ros_context, stage
from waiting import answer_of

from ambush_planner.errors import InvalidOption
from ambush_planner.game.game import GameOptions
from ambush_planner.game.strategy import StrategyOptions
from ambush_planner.maps.occupancy import OccupancyOptions, risk_from_occupancy
from ambush_planner.network.construction import NetworkOptions
from ambush_planner.parameters.table import PARAMETERS
from ambush_planner.parameters.values import parameters_from
from ambush_planner.planning.options import DriveOptions, PlanningOptions
from ambush_planner.ros.planner_node import PlannerNode

DEFAULTS = {name: declaration.default for name, declaration in PARAMETERS.items()}


@pytest.fixture(scope='module')
def node():
    with free_domain() as domain, ros_context(domain) as context:
        node = PlannerNode(context=context)
        yield node
        node.destroy_node()


def start(**overrides):
    """Start a node with parameters, as a launch file would."""
    values = [Parameter(name.replace('__', '.'), value=value) for name, value in overrides.items()]
    with free_domain() as domain, ros_context(domain) as context:
        PlannerNode(context=context, parameter_overrides=values).destroy_node()


def change(node, **values):
    """Set parameters together; return the answer."""
    return node.set_parameters_atomically(
        [Parameter(name.replace('__', '.'), value=value) for name, value in values.items()])


def test_unknown_parameters_are_named_at_the_start(capfd):
    start(network__spaceing=2.0, game__secured_radus=50.0)
    assert 'unknown parameters: game.secured_radus, network.spaceing;' in capfd.readouterr().err
    with pytest.raises(InvalidOption, match='game.ambushers was removed: leave it out'):
        start(game__ambushers=2)
    start(network__spacing=2.0, use_sim_time=True)
    assert 'unknown parameters' not in capfd.readouterr().err


def test_defaults_are_the_cores_own():
    parameters = parameters_from(DEFAULTS)
    assert parameters.occupancy == OccupancyOptions()
    assert parameters.planning.network == NetworkOptions()
    assert parameters.planning.game == GameOptions()
    assert parameters.planning.drive == DriveOptions(start_tolerance=math.inf)
    assert parameters.planning.max_gap == PlanningOptions().max_gap
    assert parameters.planning.strategy == StrategyOptions(time_limit=DEFAULTS['max_planning_time'])
    assert parameters.values['seed'] == -1


@pytest.mark.parametrize('values, words', [
    ({'map__alpha_min': 1e-10}, 'map.alpha_min must be 0 or in 1e-09..1e+09'),
    ({'game__ambush_radius': 5e-324}, 'game.ambush_radius must be 0 or in 0.001..1e+06 [m]'),
    ({'game__ambush_radius': 1e308}, 'Max: 1000000'),
    ({'map__crs': 'xxx'}, "map.crs: not a coordinate system: 'xxx'"),
    ({'map__crs': 'datum 41.0 nan 0.0'}, 'map.crs: a datum is'),
    ({'map__obstacle_threshold': 102}, 'Max: 101'),
    ({'map__obstacle_threshold': 50.0}, 'Wrong parameter type'),
    ({'network__method': 'hexagons'}, 'network.method must be one of uniform_delaunay'),
    ({'network__spacing': math.inf}, 'out of range'),
    ({'network__clearance': math.nan}, 'out of range'),
    ({'route__tube': -0.5}, 'route.tube must be finite and >= 0'),
    ({'route__tracking_error': 0.2, 'game__ambush_radius': 0.0}, 'game.ambush_radius must be'),
    ({'strategy__length_weight': 0.01, 'strategy__solver': 'max_entropy'},
     'strategy.length_weight 0.01 needs the strategy.solver'),
    *(({name: value}, 'read-only') for name, value in (
        ('seed', 7), ('path__publish', False), ('recording__enabled', False),
        ('network__graph', '/roads.gpkg'))),
])
def test_bad_values_are_refused_with_the_reason(node, values, words):
    before = [node.get_parameter(name).value for name in PARAMETERS]
    answer = change(node, **values)
    assert not answer.successful
    assert words in answer.reason
    assert [node.get_parameter(name).value for name in PARAMETERS] == before


@pytest.mark.parametrize('values, words', [
    ({'map__alpha_min': 20.0}, 'alpha_min 20.0 and alpha_max 10.0'),
    ({'recording__directory': ' '}, 'recording.directory must not be empty'),
    ({'recording__required': True, 'recording__enabled': False}, 'recording.enabled is false'),
])
def test_bad_values_stop_the_start_with_the_reason(values, words):
    with pytest.raises(InvalidOption, match=words):
        start(**values)


def test_locked_parameters_keep_their_values_while_the_node_is_active():
    with stage(parameters={'parameters.locked': True}) as running:
        planner = running.planner
        for name, value in (('strategy__max_detour', 1.4), ('use_sim_time', True)):
            answer = change(planner, **{name: value})
            assert not answer.successful and 'parameters.locked is true' in answer.reason
        assert change(planner, strategy__max_detour=1.2).successful
        planner.trigger_deactivate()
        assert change(planner, strategy__max_detour=1.4).successful


def test_a_costmap_gives_the_chance_to_be_met_or_losses():
    nav2 = {**DEFAULTS, 'map.preset': 'costmap', 'map.unknown_alpha': 3.0}
    met, risk = (parameters_from({**nav2, 'map.preset': preset}).occupancy
                 for preset in ('costmap', 'costmap_risk'))
    cells = np.array([[-1, 0, 50, 98, 99, 100]], dtype=np.int8)
    for options, losses in ((met, [1.0, 1.0, 1.0, 1.0]), (risk, [3.0, 1.0, 5.5, 9.82])):
        ground = risk_from_occupancy(cells, 1.0, (0.0, 0.0, 0.0), options)
        assert ground.obstacles.tolist() == [[False, False, False, False, True, True]]
        assert ground.alpha[0, :4] == pytest.approx(losses)


# Pairs that contradict the defaults of one another, infinities, and an empty string.
DUMPED = {
    'map.alpha_min': 20.0, 'map.alpha_max': 30.0, 'strategy.solver': 'simplex',
    'strategy.length_weight': 0.5, 'strategy.max_detour': math.inf, 'robot_base_frame': '',
    'recording.enabled': False, 'seed': 7,
}


def dump(node):
    """The parameters as ``ros2 param dump`` writes them."""
    # Read-only in each node of rclpy: loading a dump reports it and goes on.
    names = sorted({*node.list_parameters([], 0).names} - {'start_type_description_service'})
    tree = {}
    for name in names:
        *groups, last = name.split('.')
        branch = tree
        for group in groups:
            branch = branch.setdefault(group, {})
        branch[last] = node.get_parameter(name).value
    return yaml.dump({node.get_fully_qualified_name(): {'ros__parameters': tree}})


def test_a_dump_is_loaded_in_any_order(tmp_path):
    with stage(parameters=DUMPED) as first:
        (tmp_path / 'dump.yaml').write_text(dump(first.planner))
        expected = {name: first.planner.get_parameter(name).value for name in PARAMETERS}
    # What `ros2 param load` sends: this function reads the file, .inf as a text.
    loaded = parameter_dict_from_yaml_file(str(tmp_path / 'dump.yaml'))
    assert set(PARAMETERS) <= set(loaded)
    fixed = {name: value for name, value in DUMPED.items() if PARAMETERS[name].fixed}
    for names in (sorted(loaded), sorted(loaded, reverse=True)):
        with stage(parameters=fixed) as second:
            answers = {name: second.planner.set_parameters(
                [Parameter.from_parameter_msg(loaded[name])])[0] for name in names}
            refused = {name for name, each in answers.items() if not each.successful}
            assert refused == {name for name, each in PARAMETERS.items() if each.fixed}
            assert second.planner.describe_parameter('seed').read_only
            assert expected == {name: second.planner.get_parameter(name).value
                                for name in PARAMETERS}
            second.client.diagnostics(message='waiting for /alpha_map, /start_pose, /goal_pose')


def test_contradicting_parameters_are_reported_and_requests_refused():
    with stage() as running:
        client = running.give()
        service = client.node.create_client(SetParameters, 'ambush_planner/set_parameters')
        weight = Parameter('strategy.length_weight', value=0.5).to_parameter_msg()
        (answer,) = answer_of(service, SetParameters.Request(parameters=[weight])).results
        assert answer.successful
        assert 'contradict each other' in answer.reason
        found = client.diagnostics(code='NONE', level=b'\1')
        assert 'strategy.length_weight 0.5 needs the strategy.solver' in found['message']
        answer = client.call('new_route')
        assert not answer.success and 'contradict each other' in answer.message
        assert client.diagnostics(code='INVALID_OPTION')
        answer = change(running.planner, strategy__solver='simplex')
        assert answer.successful and answer.reason == ''
        assert client.call('new_route').success
        assert 'contradict' not in client.diagnostics(departures='1')['message']


def test_roads_that_cannot_be_read_stop_the_start_and_a_method_without_them_is_refused(
        node, tmp_path):
    os.mkfifo(tmp_path / 'pipe')
    (tmp_path / 'text.geojson').write_text('no roads')
    for name, words in (('pipe', 'is not a regular file'), ('none.gpkg', 'No such file'),
                        ('text.geojson', 'network.graph: ')):
        with pytest.raises(InvalidOption, match=words):
            start(network__graph=str(tmp_path / name), network__method='graph')
    answer = change(node, network__method='graph')
    assert not answer.successful and 'must name a file with roads' in answer.reason
