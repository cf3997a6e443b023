# SPDX-License-Identifier: Apache-2.0
"""Readers of routes: the SROS2 policy compared with a running node, and unpublished routes."""

import xml.etree.ElementTree as ElementTree
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import pytest
from nav_msgs.msg import Path as PathMessage
from rclpy.action.graph import get_action_server_names_and_types_by_node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from ros_harness import MARKER_TOPICS, interface_of, pose, stage, wait_until
from ros_yaml import type_of
from waiting import unstamped

from ambush_planner.recordings.recorded_departures import recordings_in
from ambush_planner.recordings.recording_file import read_recording
from ambush_planner.recordings.verify import Verifier

POLICY = Path(__file__).resolve().parent.parent / 'config' / 'ambush_planner.policy.xml'
# Topics of every node, which contain no routes.
EVERYBODYS = {'/bond', '/rosout', '/parameter_events', '/diagnostics', '/tf', '/tf_static',
              '/clock'}
INPUTS = ('alpha_map', 'start_pose', 'goal_pose', 'initialpose', 'via_poses')
START, GOAL = (1.5, 5.5), (8.5, 5.5)


class Profile:
    """The rules of one enclave's profile; names as SROS2 writes them out."""

    def __init__(self, enclave):
        (self._element,) = ElementTree.parse(POLICY).findall(
            f"enclaves/enclave[@path='{enclave}']/profiles/profile")

    def listed(self, kind, access, rule='ALLOW'):
        """The full names in a rule, like listed('topic', 'publish')."""
        return {
            self._full(each.text) for group in self._element.findall(f'{kind}s')
            if group.get(access) == rule for each in group
        }

    def may(self, kind, access, name):
        """The answer of DDS: the first rule that matches, those that deny first; else no."""
        for rule in ('DENY', 'ALLOW'):
            if any(fnmatchcase(name, each) for each in self.listed(kind, access, rule)):
                return rule == 'ALLOW'
        return False

    def _full(self, name):
        node = self._element.get('node')
        assert self._element.get('ns') == '/'
        return name if name.startswith('/') else '/' + name.replace('~', node, 1)


class Names:
    """The names that a node has in the graph."""

    def __init__(self, node):
        interface = interface_of(node)
        self.published, self.subscribed, self.served = (
            {name for name in found if '/_action/' not in name}
            for found in (interface.publishers, interface.subscribers, interface.services))
        self.actions = {name for name, _ in get_action_server_names_and_types_by_node(
            node, node.get_name(), node.get_namespace())}


@pytest.fixture(scope='module')
def names():
    with stage(parameters={'use_sim_time': True}) as running:
        yield Names(running.planner)


def test_the_node_may_do_all_that_it_does_and_publish_nothing_else(names):
    profile = Profile('/ambush_planner')
    assert {'/path', *(f'/ambush_planner/{topic}' for topic in MARKER_TOPICS)} <= names.published
    assert names.published <= profile.listed('topic', 'publish')
    assert names.subscribed <= profile.listed('topic', 'subscribe')
    assert names.served <= profile.listed('service', 'reply')
    assert names.actions <= profile.listed('action', 'execute')
    others = {'/ambush_planner/transition_event', '/bond', '/rosout'}  # not the node's own
    assert profile.listed('topic', 'publish') <= names.published | others


def test_an_operator_may_ask_and_read_but_not_pass_for_the_node(names):
    profile = Profile('/operator')
    assert all(profile.may('topic', 'subscribe', name) for name in names.published)
    assert all(profile.may('topic', 'publish', f'/{name}') for name in INPUTS)
    assert all(profile.may('service', 'request', name) for name in names.served)
    assert not profile.may('topic', 'publish', '/path')
    assert not any(profile.may('service', 'reply', name) for name in names.served)


def test_everybody_else_may_not(names):
    profile = Profile('/everybody')
    for name in names.published | Profile('/ambush_planner').listed('topic', 'publish'):
        assert profile.may('topic', 'subscribe', name) == (name in EVERYBODYS), name
    for name in names.subscribed:
        assert profile.may('topic', 'publish', name) == (name in EVERYBODYS), name
    for name in names.served | {'/ambush_planner/compute_path_to_pose/_action/get_result'}:
        assert not profile.may('service', 'request', name)
        assert not profile.may('service', 'reply', name)
    assert not profile.may('topic', 'publish', '/path')
    assert profile.may('topic', 'subscribe', '/scan')
    assert profile.may('service', 'request', '/map_server/map')


def spy_on_everything(running):
    """Subscribe to all topics of the graph, and return the bytes that arrive on each."""
    node, found = running.client.node, {}
    for topic in ('path', 'diagnostics', *(f'ambush_planner/{each}' for each in MARKER_TOPICS)):
        wait_until(lambda name=f'/{topic}': node.get_publishers_info_by_topic(name), topic)
    for topic, kinds in node.get_topic_names_and_types():
        found[topic] = []
        latched = any(
            each.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
            for each in node.get_publishers_info_by_topic(topic)
        )
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        node.create_subscription(
            type_of(kinds[0]), topic, found[topic].append,
            QoSProfile(depth=1000, durability=durability), raw=True,
        )
    return found


def test_a_route_that_is_not_published_is_in_the_answer_and_its_recording_alone(tmp_path, capfd):
    with stage(tmp_path, {'path.publish': False}) as running:
        client = running.give()
        heard = spy_on_everything(running)
        client.diagnostics(state='ready')
        paths = [client.get_plan(pose(*START), pose(*GOAL)) for _ in range(3)]
        assert all(path.poses for path in paths)
        refused = client.call('new_route')
        assert not refused.success and 'call get_plan' in refused.message
        client.diagnostics(departures='3', code='INVALID_OPTION')
        wait_until(lambda: len(list(tmp_path.rglob('*.mcap'))) == 3, 'recordings')
    assert not heard['/path']
    assert heard['/diagnostics'] and heard['/ambush_planner/edge_probabilities']
    # /rosout says what standard error does; one process with several nodes may have none.
    said = unstamped(''.join(capfd.readouterr()))
    for path in paths:
        # Coordinates between the ends belong to the route; they must not occur in any form.
        places = [(each.pose.position.x, each.pose.position.y) for each in path.poses[1:-1]]
        own = [xy for xy in places if not _of_the_network(xy, heard)]
        assert own
        for topic, messages in heard.items():
            for data in messages:
                assert not any(np.array(xy).tobytes() in data for xy in own), topic
        for x, y in own:
            assert f'{x:.4f}' not in said and f'{y!r}' not in said
    for file, path in zip(recordings_in(tmp_path), paths, strict=True):
        recorded = read_recording(file)
        assert '/path' not in {each.topic for each in recorded.messages}
        kept = recorded.in_role('path')
        assert kept.topic == '/ambush_planner/get_plan/path'
        assert deserialize_message(kept.data, PathMessage) == path
        assert Verifier().verify(file).holds


def _of_the_network(xy, heard):
    """Whether a marker of the whole network or strategy shows this place anyway."""
    return any(np.array(xy).tobytes() in data
               for topic in MARKER_TOPICS for data in heard[f'/ambush_planner/{topic}'])
