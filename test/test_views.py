# SPDX-License-Identifier: Apache-2.0
"""Views for maps of any size: the whole map in view, visible lines, the path on top."""

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

from ambush_planner.commands.views import FOXGLOVE, RVIZ, foxglove_text, main, rviz_text, scene_of
from ambush_planner.maps.map_file import write_map
from ambush_planner.maps.occupancy import OccupancyMap
from ambush_planner.maps.risk_map import RiskMap

CONFIG = Path(__file__).resolve().parent.parent / 'config'
# Width and height [m], and origin.
GROUNDS = {
    'example': (10.0, 8.0, (0.0, 0.0, 0.0)),
    'country': (30_000.0, 32_000.0, (5e5, 4e6, 0.0)),
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


def path_display(scene):
    (found,) = [display for display in rviz(scene)['Displays']
                if display['Class'] == 'rviz_default_plugins/Path']
    return found


def panel(scene):
    return json.loads(foxglove_text(scene))['configById']['3D!planner']


def test_installed_files_fit_the_example_map():
    info = yaml.safe_load((EXAMPLES / 'alpha_map.yaml').read_text())['info']
    size = info['width'] * info['resolution'], info['height'] * info['resolution']
    assert size == GROUNDS['example'][:2]
    example = scene(*GROUNDS['example'])
    assert (CONFIG / RVIZ).read_text() == rviz_text(example)
    assert (CONFIG / FOXGLOVE).read_text() == foxglove_text(example)


@pytest.mark.parametrize('ground', GROUNDS)
def test_whole_map_is_in_view_and_fills_it_with_visible_lines(ground):
    shown = scene(*GROUNDS[ground])
    scale = max(shown.size)
    places = np.array(corners(*GROUNDS[ground]))
    slack = 1e-3 * np.abs(places).max()  # numbers have four digits
    view, camera = rviz(shown)['Views']['Current'], panel(shown)['cameraState']
    for centre, half in (
            ((view['X'], view['Y']), np.array([450, 350]) / view['Scale']),
            (camera['targetOffset'][:2], camera['distance'] * np.array([0.6, 0.5]))):
        extent = np.abs(places - centre).max(axis=0)
        assert np.all(extent <= half + slack) and np.any(extent >= half * 0.8 - slack)
    # An orthographic camera shows only what is between `near` and `far`.
    assert camera['near'] < camera['distance'] - 0.01 * scale < camera['far']
    for width in (path_display(shown)['Line Width'], panel(shown)['topics']['/path']['lineWidth']):
        assert 1 / 200 < width / scale < 1 / 50


def test_views_of_a_recording_have_its_map_and_topics(tmp_path):
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


def test_views_of_a_map_alongside_nav2(tmp_path, capsys):
    values = np.zeros((80, 120), np.int8)
    write_map(tmp_path / 'depot.yaml', OccupancyMap(values, 1.0, (-60.0, -40.0, 0.0)))
    arguments = [str(tmp_path / 'depot.yaml'), '-o', str(tmp_path), '--inputs', 'ambush']
    assert main([*arguments, '--json']) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result['centre'], result['size'], result['frame']) == ([0.0, 0.0], [120.0, 80.0], 'map')
    shown = yaml.safe_load((tmp_path / RVIZ).read_text())['Visualization Manager']
    topics = {each['Topic']['Value'] for each in (*shown['Displays'], *shown['Tools'])
              if 'Topic' in each}
    assert {'/ambush/goal_pose', '/ambush/start_pose', '/ambush/initialpose'} <= topics
    assert not {'/goal_pose', '/initialpose'} & topics
    with pytest.raises(SystemExit):  # files exist already
        main(arguments)
    assert main([*arguments, '--replace', '-q']) == 0
