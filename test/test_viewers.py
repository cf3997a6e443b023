"""What the files for RViz and Foxglove show and send is what a running node has.

Neither viewer runs here; the files are held against the node's own topics, types and QoS.
"""

import json
import re
from pathlib import Path

import pytest
import yaml
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from ros_harness import FRAME, stage, wait_until, whole_graph
from ros_yaml import EXAMPLES

VIEWS = Path(__file__).resolve().parent.parent / 'config'
DISPLAYS = {
    'rviz_default_plugins/Map': 'nav_msgs/msg/OccupancyGrid',
    'rviz_default_plugins/MarkerArray': 'visualization_msgs/msg/MarkerArray',
    'rviz_default_plugins/Path': 'nav_msgs/msg/Path',
    'rviz_default_plugins/Pose': 'geometry_msgs/msg/PoseStamped',
    'rviz_default_plugins/PoseWithCovariance': 'geometry_msgs/msg/PoseWithCovarianceStamped',
}
INPUTS = ('/alpha_map', '/start_pose', '/goal_pose', '/initialpose')
TOOLS = {
    'rviz_default_plugins/SetInitialPose': 'geometry_msgs/msg/PoseWithCovarianceStamped',
    'rviz_default_plugins/SetGoal': 'geometry_msgs/msg/PoseStamped',
}
# What Foxglove's 3D panel sends, by the key of the topic.
CLICKS = {
    'poseTopic': 'geometry_msgs/msg/PoseStamped',
    'poseEstimateTopic': 'geometry_msgs/msg/PoseWithCovarianceStamped',
}
DIAGNOSTICS = '/diagnostics'
MESSAGE_PATH = re.compile(
    r'(/\w+)\.status\[:]\{name=="(\w+)"}\.values\[:]\{key=="(\w+)"}\.value')


class Interface:
    """A node's topics with their types and QoS, its services, and what its diagnostics hold."""

    def __init__(self, running):
        node = running.planner
        who = node.get_name(), node.get_namespace()
        wait_until(lambda: whole_graph(node), 'the graph')
        self._node = node
        self.published = self._types(node.get_publisher_names_and_types_by_node(*who))
        self.subscribed = self._types(node.get_subscriber_names_and_types_by_node(*who))
        self.services = self._types(node.get_service_names_and_types_by_node(*who))
        self.diagnostics = running.client.diagnostics()
        self.name = running.client.last(DIAGNOSTICS).status[0].name

    @property
    def shown(self):
        """The topics that can be drawn: map, start and goal, and what it publishes."""
        taken = {topic: self.subscribed[topic] for topic in INPUTS}
        kinds = DISPLAYS.values()
        return taken | {name: kind for name, kind in self.published.items() if kind in kinds}

    def offered(self, topic):
        """The QoS with which a drawn topic is published; the node demands that of the map."""
        infos = self._node.get_publishers_info_by_topic(topic)
        return self._only(infos or self._node.get_subscriptions_info_by_topic(topic))

    def demanded(self, topic):
        """The QoS with which the node subscribes."""
        return self._only(self._node.get_subscriptions_info_by_topic(topic))

    def _only(self, infos):
        (found,) = [info for info in infos if info.node_name == self._node.get_name()]
        # Nobody here has a deadline, but the graph reports the longest one that there is.
        qos = found.qos_profile
        return QoSProfile(depth=1, reliability=qos.reliability, durability=qos.durability,
                          liveliness=qos.liveliness)

    @staticmethod
    def _types(names_and_types):
        return {name: kind for name, (kind,) in names_and_types}


@pytest.fixture(scope='module')
def interface():
    with stage() as running:
        yield Interface(running)


@pytest.fixture(scope='module')
def rviz():
    text = (VIEWS / 'ambush_planner.rviz').read_text()
    return yaml.safe_load(text)['Visualization Manager']


@pytest.fixture(scope='module')
def foxglove():
    return json.loads((VIEWS / 'ambush_planner_foxglove.json').read_text())


def panels(foxglove, kind):
    """The settings of all panels of a kind."""
    return [each for name, each in foxglove['configById'].items() if name.startswith(f'{kind}!')]


def named(policy, name):
    """RViz' name of a policy's value, such as 'Transient Local'."""
    return policy[name.upper().replace(' ', '_')]


def qos_of(topic):
    """The QoS that RViz makes of what stands below ``Topic``."""
    return QoSProfile(
        depth=topic['Depth'],
        history=named(HistoryPolicy, topic['History Policy']),
        reliability=named(ReliabilityPolicy, topic['Reliability Policy']),
        durability=named(DurabilityPolicy, topic['Durability Policy']),
        liveliness=LivelinessPolicy.AUTOMATIC,
    )


def assert_compatible(publisher, subscription):
    verdict, reason = qos_check_compatible(publisher, subscription)
    assert verdict == QoSCompatibility.OK, reason


def tools_with_topics(rviz):
    return [tool for tool in rviz['Tools'] if 'Topic' in tool]


def test_rviz_shows_all_that_can_be_drawn(interface, rviz):
    shown = {each['Topic']['Value']: DISPLAYS[each['Class']] for each in rviz['Displays']}
    assert shown == interface.shown
    assert len(rviz['Displays']) == len(shown)


def test_rviz_gets_what_was_published_before_it_came(interface, rviz):
    for display in rviz['Displays']:
        qos = qos_of(display['Topic'])
        assert_compatible(interface.offered(display['Topic']['Value']), qos)
        lasting = DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE
        assert qos.durability == lasting[display['Topic']['Value'] in INPUTS[1:]]


def test_rviz_tools_set_start_and_goal(interface, rviz):
    tools = tools_with_topics(rviz)
    assert {tool['Class'] for tool in tools} == set(TOOLS)
    for tool in tools:
        topic = tool['Topic']['Value']
        assert interface.subscribed[topic] == TOOLS[tool['Class']]
        assert_compatible(qos_of(tool['Topic']), interface.demanded(topic))


def test_rviz_hides_the_network_only(rviz):
    assert all(each['Enabled'] == each['Value'] for each in rviz['Displays'])
    hidden = [each['Topic']['Value'] for each in rviz['Displays'] if not each['Enabled']]
    assert hidden == ['/network']


def test_rviz_looks_from_above_in_the_examples_frame(rviz):
    assert rviz['Views']['Current']['Class'] == 'rviz_default_plugins/TopDownOrtho'
    example = yaml.safe_load((EXAMPLES / 'alpha_map.yaml').read_text())
    assert rviz['Global Options']['Fixed Frame'] == example['header']['frame_id'] == FRAME


def test_foxglove_shows_all_that_can_be_drawn(interface, foxglove):
    (scene,) = panels(foxglove, '3D')
    assert set(scene['topics']) == set(interface.shown)
    hidden = [topic for topic, each in scene['topics'].items() if not each['visible']]
    assert hidden == ['/network']
    assert scene['followTf'] == FRAME


def test_foxglove_clicks_set_start_and_goal(interface, foxglove):
    (scene,) = panels(foxglove, '3D')
    for key, kind in CLICKS.items():
        assert interface.subscribed[scene['publish'][key]] == kind


def test_foxglove_calls_the_service(interface, foxglove):
    (button,) = panels(foxglove, 'CallService')
    assert interface.services[button['serviceName']] == 'std_srvs/srv/Trigger'
    assert json.loads(button['requestPayload']) == {}


def test_foxglove_reads_the_diagnostics(interface, foxglove):
    (detail,) = panels(foxglove, 'DiagnosticStatusPanel')
    assert detail['topicToRender'] == DIAGNOSTICS
    assert detail['selectedName'] == interface.name
    paths = [path['value'] for kind in ('Plot', 'StateTransitions')
             for panel in panels(foxglove, kind) for path in panel['paths']]
    assert len(paths) == 4
    for path in paths:
        topic, name, key = MESSAGE_PATH.fullmatch(path).groups()
        assert interface.published[topic] == 'diagnostic_msgs/msg/DiagnosticArray'
        assert name == interface.name
        assert key in interface.diagnostics


def test_foxglove_places_every_panel_once(foxglove):
    def leaves(part):
        return [part] if isinstance(part, str) else leaves(part['first']) + leaves(part['second'])

    assert sorted(leaves(foxglove['layout'])) == sorted(foxglove['configById'])
