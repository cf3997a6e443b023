# SPDX-License-Identifier: Apache-2.0
"""The layouts for RViz and Foxglove match the topics, types and QoS of a running node."""

import json
import re
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from rclpy.qos import (
    DurabilityPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from ros_harness import FRAME, interface_of, stage

LAYOUTS = Path(__file__).resolve().parent.parent / 'config'
DISPLAYS = {
    'rviz_default_plugins/Map': 'nav_msgs/msg/OccupancyGrid',
    'rviz_default_plugins/MarkerArray': 'visualization_msgs/msg/MarkerArray',
    'rviz_default_plugins/Path': 'nav_msgs/msg/Path',
    'rviz_default_plugins/Pose': 'geometry_msgs/msg/PoseStamped',
    'rviz_default_plugins/PoseWithCovariance': 'geometry_msgs/msg/PoseWithCovarianceStamped',
}
LATCHED_INPUT, *CLICKED = '/alpha_map', '/start_pose', '/goal_pose', '/initialpose'
TOOLS = {
    'rviz_default_plugins/SetInitialPose': 'geometry_msgs/msg/PoseWithCovarianceStamped',
    'rviz_default_plugins/SetGoal': 'geometry_msgs/msg/PoseStamped',
}
# Keys of the topics that Foxglove's 3D panel publishes.
CLICKS = {
    'poseTopic': 'geometry_msgs/msg/PoseStamped',
    'poseEstimateTopic': 'geometry_msgs/msg/PoseWithCovarianceStamped',
}
MESSAGE_PATH = re.compile(
    r'(/\w+)\.status\[:]\{name=="([\w: ]+)"}\.values\[:]\{key=="(\w+)"}\.value')


@pytest.fixture(scope='module')
def interface():
    """Types of the node's topics and services by name, its QoS, and its diagnostics."""
    def qos(infos):
        own = node.get_name(), f'_{node.get_name()}_map'
        (profile,) = [info.qos_profile for info in infos if info.node_name in own]
        return QoSProfile(depth=1, reliability=profile.reliability, durability=profile.durability)

    with stage() as running:
        node = running.planner
        graph = interface_of(node)
        published, subscribed = graph.publishers, graph.subscribers
        shown = {topic: subscribed[topic] for topic in (LATCHED_INPUT, *CLICKED)}
        shown |= {topic: kind for topic, kind in published.items()
                  if kind in DISPLAYS.values() and topic != '/plan'}  # the path, for Nav2's layout
        yield SimpleNamespace(
            published=published, subscribed=subscribed, shown=shown,
            services=graph.services,
            offered=lambda topic: qos(node.get_publishers_info_by_topic(topic)),
            requested=lambda topic: qos(node.get_subscriptions_info_by_topic(topic)),
            diagnostics=running.client.diagnostics(),
            status_name=running.client.last('/diagnostics').status[0].name,
        )


@pytest.fixture(scope='module')
def rviz():
    text = (LAYOUTS / 'ambush_planner.rviz').read_text()
    return yaml.safe_load(text)['Visualization Manager']


def qos_of(topic):
    """Return the QoS of RViz's settings of a topic."""
    return QoSProfile(
        depth=topic['Depth'],
        reliability=ReliabilityPolicy[topic['Reliability Policy'].upper().replace(' ', '_')],
        durability=DurabilityPolicy[topic['Durability Policy'].upper().replace(' ', '_')],
    )


def assert_compatible(publisher, subscription):
    verdict, reason = qos_check_compatible(publisher, subscription)
    assert verdict != QoSCompatibility.ERROR, reason


def test_rviz_shows_all_topics_and_its_tools_set_start_and_goal(interface, rviz):
    displays = {each['Topic']['Value']: each for each in rviz['Displays']}
    assert {topic: DISPLAYS[each['Class']] for topic, each in displays.items()} == interface.shown
    hidden = [topic for topic, each in displays.items() if not each['Enabled']]
    assert hidden == ['/ambush_planner/network']
    for topic, display in displays.items():
        if topic not in (LATCHED_INPUT, *CLICKED):
            assert_compatible(interface.offered(topic), qos_of(display['Topic']))
    tools = [tool for tool in rviz['Tools'] if 'Topic' in tool]
    assert {tool['Class'] for tool in tools} == set(TOOLS)
    for tool in tools:
        topic = tool['Topic']['Value']
        assert interface.subscribed[topic] == TOOLS[tool['Class']]
        assert_compatible(qos_of(tool['Topic']), interface.requested(topic))


def test_foxglove_shows_all_topics_its_clicks_set_start_and_goal_and_it_reads_the_diagnostics(
        interface):
    layout = json.loads((LAYOUTS / 'ambush_planner_foxglove.json').read_text())['configById']
    (scene,) = (each for name, each in layout.items() if name.startswith('3D!'))
    assert set(scene['topics']) == set(interface.shown)
    assert scene['followTf'] == FRAME
    for key, kind in CLICKS.items():
        assert interface.subscribed[scene['publish'][key]] == kind
    paths = [path['value'] for each in layout.values() for path in each.get('paths', ())
             if isinstance(path, dict)]
    assert len(paths) == 4
    for path in paths:
        topic, name, key = MESSAGE_PATH.fullmatch(path).groups()
        assert interface.published[topic] == 'diagnostic_msgs/msg/DiagnosticArray'
        assert name == interface.status_name and key in interface.diagnostics
