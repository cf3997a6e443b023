"""Views for a map of any size: all of it in view, lines to be seen, the path above the others."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from audit_samples import GOAL, START, departure, drawn, record, sample_plan
from nav_msgs.msg import OccupancyGrid
from rclpy.serialization import deserialize_message
from ros_yaml import EXAMPLES
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from ambush_planner.commands.views import (
    FOXGLOVE,
    RVIZ,
    TOPICS,
    foxglove_text,
    main,
    rviz_text,
    scene_of,
)
from ambush_planner.maps.map_file import write_map
from ambush_planner.maps.occupancy import OccupancyMap
from ambush_planner.maps.risk_map import RiskMap
from ambush_planner.ros import markers

CONFIG = Path(__file__).resolve().parent.parent / 'config'
# Width and height [m], and origin: the example, a depot, a country, a tall one, a rotated one.
GROUNDS = {
    'example': (10.0, 8.0, (0.0, 0.0, 0.0)),
    'depot': (120.0, 80.0, (-60.0, -40.0, 0.0)),
    'country': (30_000.0, 32_000.0, (5e5, 4e6, 0.0)),
    'tall': (100.0, 4000.0, (0.0, 0.0, 0.0)),
    'rotated': (200.0, 50.0, (10.0, 20.0, 0.7)),
}


def scene(width, height, origin):
    resolution = min(width, height) / 16
    shape = round(height / resolution), round(width / resolution)
    return scene_of(RiskMap(np.ones(shape), np.zeros(shape, bool), resolution, origin))


def corners(width, height, origin):
    x, y, yaw = origin
    return [(x + math.cos(yaw) * u - math.sin(yaw) * v, y + math.sin(yaw) * u + math.cos(yaw) * v)
            for u in (0.0, width) for v in (0.0, height)]


def rviz(scene):
    return yaml.safe_load(rviz_text(scene))['Visualization Manager']


def panel(scene):
    return json.loads(foxglove_text(scene))['configById']['3D!planner']


def test_the_installed_files_are_those_of_the_example():
    info = yaml.safe_load((EXAMPLES / 'alpha_map.yaml').read_text())['info']
    size = info['width'] * info['resolution'], info['height'] * info['resolution']
    assert size == GROUNDS['example'][:2]
    example = scene(*GROUNDS['example'])
    assert (CONFIG / RVIZ).read_text() == rviz_text(example)
    assert (CONFIG / FOXGLOVE).read_text() == foxglove_text(example)


@pytest.mark.parametrize('ground', GROUNDS)
def test_all_of_the_map_is_in_view_and_fills_it(ground):
    looked_at = scene(*GROUNDS[ground])
    places = np.array(corners(*GROUNDS[ground]))
    view = rviz(looked_at)['Views']['Current']
    away = np.abs(places - (view['X'], view['Y'])).max(axis=0) * view['Scale']
    slack = 1e-3 * view['Scale'] * np.abs(places).max()  # numbers have four digits
    assert np.all(away <= np.array([900, 700]) / 2 + slack)
    assert np.any(away >= np.array([900, 700]) / 2 * 0.9 - slack)
    camera = panel(looked_at)['cameraState']
    away = np.abs(places - camera['targetOffset'][:2]).max(axis=0)
    half = camera['distance'] / 2 * np.array([1.2, 1.0])
    assert np.all(away <= half + 1e-3 * np.abs(places).max())
    assert np.any(away >= half * 0.8 - 1e-3 * np.abs(places).max())
    # An orthographic camera is that far up, and sees what is between these.
    assert camera['near'] < camera['distance'] - 100.0 * looked_at.scale / 1e4 < camera['far']


@pytest.mark.parametrize('ground', GROUNDS)
def test_lines_are_as_wide_as_the_map_wants(ground):
    looked_at = scene(*GROUNDS[ground])
    (path,) = [each for each in rviz(looked_at)['Displays']
               if each['Class'] == 'rviz_default_plugins/Path']
    assert path['Line Style'] == 'Billboards'  # plain lines are one pixel wide
    for width in (path['Line Width'], panel(looked_at)['topics']['/path']['lineWidth']):
        assert 1 / 200 < width / looked_at.scale < 1 / 50


@pytest.mark.parametrize('size', [10.0, 120.0, 30_000.0])
def test_nothing_hides_the_path_where_heights_say_what_is_in_front(size):
    """Foxglove draws lines after the map and the higher ones in front; RViz lifts the path."""
    strategy = sample_plan().strategy
    factor = size / np.ptp(strategy.network.points, axis=0).max()
    network = _Scaled(strategy.network, factor)
    heights = {
        name: _marker(draw) for name, draw in (
            ('network', markers.network_lines(network, Header())),
            ('edge_probabilities', markers.edge_probabilities(_Of(strategy, network), Header())),
            ('mean_direction', markers.mean_direction(_Of(strategy, network), Header())),
            ('ambush_sites', markers.ambush_sites(_Of(strategy, network), Header())),
        )
    }
    order = sorted(heights, key=lambda name: heights[name].pose.position.z)
    assert order == ['network', 'edge_probabilities', 'mean_direction', 'ambush_sites']
    steps = [heights[name].pose.position.z for name in order]
    assert steps[2] < 0.0 < steps[3]
    assert min(np.diff([*steps[:3], 0.0, steps[3]])) == pytest.approx(min(0.005 * size, 50.0))
    # Discs are drawn before lines, and what lets light through does not hide what comes later.
    assert heights['ambush_sites'].type == Marker.SPHERE_LIST
    assert max(colour.a for colour in heights['ambush_sites'].colors) < 1.0
    looked_at = scene(size, size, (0.0, 0.0, 0.0))
    topics = panel(looked_at)['topics']
    assert topics['/alpha_map']['alpha'] < 1.0
    assert all(int(colour[-2:], 16) < 255 for colour in topics['/path']['gradient'])
    (path,) = [each for each in rviz(looked_at)['Displays']
               if each['Class'] == 'rviz_default_plugins/Path']
    assert steps[3] < path['Offset']['Z'] < 500.0


class _Scaled:
    """A network with all lengths multiplied."""

    def __init__(self, network, factor):
        self._network, self.points = network, network.points * factor
        self.lengths = network.lengths * factor

    def __getattr__(self, name):
        return getattr(self._network, name)


class _Of:
    """A strategy on a network of other lengths."""

    def __init__(self, strategy, network):
        self._strategy, self.network = strategy, network

    def __getattr__(self, name):
        return getattr(self._strategy, name)


def _marker(data):
    (marker,) = deserialize_message(data, MarkerArray).markers
    return marker


def test_the_button_has_room():
    layout = json.loads(foxglove_text(scene(*GROUNDS['example'])))['layout']
    column = layout['second']
    assert column['first'] == 'CallService!new_route' and column['splitPercentage'] >= 30


def test_views_of_a_recording_have_its_frame_its_map_and_its_topics(tmp_path):
    plan = sample_plan()
    messages, metadata, files = departure(plan, drawn(plan, 1)[0])
    topics = metadata['topics']
    renamed = {topic: f'/convoy{topic}' for topic in topics.values()}
    messages = [_renamed(each, renamed) for each in messages]
    metadata |= {'topics': {role: renamed[topic] for role, topic in topics.items()}}
    record(tmp_path / 'runs', [(messages, metadata, files)])
    assert main([str(tmp_path / 'runs'), '-o', str(tmp_path / 'views'), '-q']) == 0
    scene = json.loads((tmp_path / 'views' / FOXGLOVE).read_text())['configById']['3D!planner']
    assert set(scene['topics']) > {'/convoy/path', '/convoy/alpha_map', '/convoy/start_pose'}
    grid = deserialize_message(messages[0].data, OccupancyGrid)
    size = np.array([grid.info.width, grid.info.height]) * grid.info.resolution
    assert scene['cameraState']['targetOffset'][:2] == (size / 2).tolist()
    assert all(np.abs(np.array(end) - size / 2).max() < size.max() / 2 for end in (START, GOAL))


def _renamed(message, names):
    return type(message)(names[message.topic], message.type, message.data, message.qos,
                         message.stamp_ns)


def test_views_of_a_map_beside_nav2(tmp_path, capsys):
    values = np.zeros((80, 120), np.int8)
    write_map(tmp_path / 'depot.yaml', OccupancyMap(values, 1.0, (-60.0, -40.0, 0.0)))
    arguments = [str(tmp_path / 'depot.yaml'), '-o', str(tmp_path), '--inputs', 'ambush']
    assert main([*arguments, '--json']) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told['centre'], told['size'], told['frame']) == ([0.0, 0.0], [120.0, 80.0], 'map')
    shown = yaml.safe_load((tmp_path / RVIZ).read_text())['Visualization Manager']
    topics = {each['Topic']['Value'] for each in (*shown['Displays'], *shown['Tools'])
              if 'Topic' in each}
    assert {'/ambush/goal_pose', '/ambush/start_pose', '/ambush/initialpose'} <= topics
    assert not {TOPICS['goal_pose'], TOPICS['initialpose']} & topics
    with pytest.raises(SystemExit):  # nothing is overwritten unasked
        main(arguments)
    assert main([*arguments, '--replace', '-q']) == 0


@pytest.mark.parametrize('name, content', [('no.yaml', None), ('bad.yaml', 'image: [')])
def test_what_cannot_be_read_is_named(tmp_path, capsys, name, content):
    if content is not None:
        (tmp_path / name).write_text(content)
    assert main([str(tmp_path / name), '-o', str(tmp_path / 'out')]) == 3
    assert name in capsys.readouterr().err
