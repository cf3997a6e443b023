# SPDX-License-Identifier: Apache-2.0
"""Parameters: described, ranged, checked as a set, and set in any order."""

import math
import os

import numpy as np
import pytest
import yaml
from rclpy.parameter import Parameter, parameter_dict_from_yaml_file
from ros_harness import free_domain, ros_context, stage

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


def test_a_dump_is_loaded_but_for_what_is_read_only_or_contradicts_the_rest(tmp_path):
    given = {'map.alpha_min': 20.0, 'map.alpha_max': 30.0, 'strategy.solver': 'simplex',
             'strategy.length_weight': 0.5, 'strategy.max_detour': math.inf, 'seed': 7}
    with stage(parameters=given) as running:
        planner, tree = running.planner, {}
        for name in PARAMETERS:  # as `ros2 param dump` writes them
            *groups, last = name.split('.')
            branch = tree
            for group in groups:
                branch = branch.setdefault(group, {})
            branch[last] = planner.get_parameter(name).value
        (tmp_path / 'dump.yaml').write_text(
            yaml.dump({planner.get_fully_qualified_name(): {'ros__parameters': tree}}))
        before = planner._settings.current
    # What `ros2 param load` sends, one after the other: `.inf` is read as a text.
    loaded = parameter_dict_from_yaml_file(str(tmp_path / 'dump.yaml'))
    with stage(parameters={'seed': 7}) as running:
        planner = running.planner

        def refused():
            answers = {name: planner.set_parameters([Parameter.from_parameter_msg(loaded[name])])
                       for name in sorted(loaded)}
            return {name: each[0].reason for name, each in answers.items()
                    if not each[0].successful and not PARAMETERS[name].fixed}

        (reason,) = refused().values()
        assert reason.startswith('strategy.length_weight 0.5 needs the strategy.solver')
        assert reason.endswith('; set parameters that depend on each other in one call')
        assert not refused()
        assert planner._settings.current == before


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
