# SPDX-License-Identifier: Apache-2.0
"""The launch file and the commands of docs/nav2.md, run without ``ros2``."""

import json
import os
import re
import signal
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from contextlib import contextmanager

import interfaces
import yaml
from commands import ROOT, blocks
from rcl_interfaces.srv import GetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from ros_harness import Client, free_domain, ros_context, spinning, stage
from test_node_process import exit_code, node_process
from waiting import TIMEOUT, answer_of, wait_until

FILE = ROOT / 'launch' / 'ambush_planner.launch.xml'
NAV2 = ROOT / 'config' / 'nav2.yaml'
RVIZ = ROOT / 'config' / 'ambush_planner.rviz'
TREE = ElementTree.parse(FILE).getroot()
PAGE = 'docs/nav2.md'


def arguments(**given):
    """The launch file's arguments with their values."""
    values = {}
    for each in TREE.findall('arg'):
        values[each.get('name')] = substituted(each.get('default'), values)
    assert given.keys() <= values.keys()
    values |= given
    for each in TREE.findall('let'):
        wanted = 'true' if each.get('if') else 'false'
        if substituted(each.get('if') or each.get('unless'), values) == wanted:
            values[each.get('name')] = each.get('value')
    return values


def substituted(text, values):
    """Return a text of the launch file with its substitutions."""
    text = text.replace('$(find-pkg-share ambush_planner)', str(ROOT))
    text = re.sub(r'\$\(var (\w+)\)', lambda found: values[found[1]], text)
    assert '$(' not in text, text
    return text


def process(element, values):
    """The arguments that launch_ros gives a node of the file."""
    def read(tag, name):
        return substituted(tag.get(name), values)

    result = [*read(element, 'ros_args').split(), '-r', f'__node:={read(element, "name")}']
    if namespace := read(element, 'namespace'):
        result += ['-r', f'__ns:=/{namespace}']
    for each in element.findall('param'):
        if each.get('from'):
            result += ['--params-file', read(each, 'from')]
        else:
            result += ['-p', f'{each.get("name")}:={read(each, "value")}']
    for each in element.findall('remap'):
        result += ['-r', f'{read(each, "from")}:={read(each, "to")}']
    return result


def node_of(executable):
    (found,) = [each for each in TREE.findall('node') if each.get('exec') == executable]
    return found


@contextmanager
def launched(tmp_path, environment=None, **given):
    """A client's node next to the planner as the launch file starts it, which ends well."""
    values = arguments(**given)
    with free_domain() as domain, ros_context(domain) as context, node_process(
            domain, tmp_path, f'recording.directory:={json.dumps(str(tmp_path))}',
            arguments=process(node_of('ambush_planner'), values),
            environment=environment) as running:
        node = Node('client', context=context, namespace=values['namespace'])
        with spinning(node, SingleThreadedExecutor(context=context)):
            yield node
        assert exit_code(running, signal.SIGINT) == 0


def parameters(node, planner, *names):
    """Values of parameters of a node."""
    client = node.create_client(GetParameters, f'{planner}/get_parameters')
    return answer_of(client, GetParameters.Request(names=names)).values


def test_start_and_goal_are_not_nav2s_and_all_topics_of_rviz_are_remapped():
    remaps = {executable: {each.get('from').lstrip('/'): each.get('to')
                           for each in node_of(executable).findall('remap')}
              for executable in ('ambush_planner', 'rviz2')}
    for name in ('goal_pose', 'start_pose', 'initialpose'):
        assert all(each[name] == f'ambush/{name}' for each in remaps.values())
    assert remaps['ambush_planner']['via_poses'] == 'ambush/via_poses'
    shown = set(re.findall(r'Value: /([\w/]+)', RVIZ.read_text()))
    assert shown <= remaps['rviz2'].keys()


def test_arguments_reach_the_node(tmp_path):
    with launched(tmp_path, namespace='convoy', map='/risk', autostart='false',
                  use_sim_time='true', params_file=str(NAV2)) as node:
        autostart, sim_time, spacing, preset = parameters(
            node, '/convoy/ambush_planner', 'autostart', 'use_sim_time', 'route.path_spacing',
            'map.preset')
        assert not autostart.bool_value and sim_time.bool_value
        assert (spacing.double_value, preset.string_value) == (0.05, 'costmap')
        client = Client(node, '/convoy/ambush_planner')
        answer = client.call('new_route').message
        assert 'not configured' in answer and 'publish start and goal again' in answer
        names = '/risk, /convoy/ambush/start_pose, /convoy/ambush/goal_pose; each call of '
        said = (tmp_path / 'output').read_text()
        assert f'publish {names}/convoy/ambush_planner/new_route' in said
        assert not node.count_subscribers('/risk')


def test_costmap_and_log_level_reach_the_node(tmp_path):
    (tmp_path / 'costmap.yaml').write_text('/**: {ros__parameters: {map.costmap: true}}')
    with launched(tmp_path, costmap='/global_costmap/costmap', log_level='error',
                  params_file=str(tmp_path / 'costmap.yaml')) as node:
        wait_until(lambda: node.count_subscribers('/global_costmap/costmap'), 'the costmap')
        wait_until(lambda: node.count_subscribers('/ambush/via_poses'), 'the stops')
    assert 'publish /alpha_map' not in (tmp_path / 'output').read_text(), 'it is information'


# A substitute for nav2_simple_commander, with the names that the document uses.
COMMANDER = """
from enum import Enum
from types import SimpleNamespace
from rclpy.node import Node

TaskResult = Enum('TaskResult', 'SUCCEEDED FAILED')

class BasicNavigator(Node):
    def __init__(self):
        super().__init__('basic_navigator')
        self.looks = 0
    def followPath(self, path):
        print(len(path.poses), 'poses in', path.header.frame_id)
        return True
    def isTaskComplete(self):
        self.looks += 1
        return self.looks > 2
    def getFeedback(self):
        return SimpleNamespace(distance_to_goal=3.25)
    def getResult(self):
        return TaskResult.SUCCEEDED
"""


def test_the_documents_program_reports_the_drive(tmp_path):
    (program,) = blocks(PAGE, 'python')
    # The robot is at (1.5, 5.5).
    program = program.replace("'base_link'", "'map'").replace(
        'request.start.pose.orientation',
        'request.start.pose.position.x, request.start.pose.position.y = 1.5, 5.5\n'
        'request.start.pose.orientation')
    (tmp_path / 'nav2_simple_commander').mkdir()
    (tmp_path / 'nav2_simple_commander' / 'robot_navigator.py').write_text(COMMANDER)
    with stage() as running:
        running.give()
        domain = running.planner.context.get_domain_id()
        done = subprocess.run(
            [sys.executable, '-c', program], capture_output=True, text=True, timeout=TIMEOUT,
            check=False,
            env={**os.environ, 'ROS_DOMAIN_ID': str(domain), 'PYTHONPATH': str(tmp_path)})
    assert done.returncode == 0, done.stderr
    assert re.search(r'^\d+ poses in map', done.stdout)
    assert '3.2 m to go' in done.stdout and done.stdout.endswith('arrived\n')


def test_the_planner_takes_the_names_of_the_planner_server(tmp_path):
    for package in ('nav2_msgs', 'tf2_msgs'):
        interfaces.install(package)
    own = {f'/convoy/{name}' for name in (
        'compute_path_to_pose/_action/send_goal', 'compute_path_through_poses/_action/send_goal',
        'is_path_valid')}
    built = [str(interfaces.BUILT / package) for package in ('nav2_msgs', 'tf2_msgs')]
    with launched(tmp_path, {'PYTHONPATH': os.pathsep.join(built)}, namespace='convoy',
                  replace_planner_server='true', params_file=str(NAV2)) as node:
        wait_until(lambda: own <= {name for name, _ in node.get_service_names_and_types()},
                   'the services')
        wait_until(lambda: node.count_subscribers('/convoy/tf'), 'a listener to tf')
        assert not node.count_subscribers('/tf')
        (ids,) = parameters(node, '/convoy/ambush_planner', 'planner_ids')
        assert ids.string_array_value == ['', 'GridBased']


def test_the_blocks_of_the_document_are_what_their_readers_take():
    """YAML of Nav2's parameters, XML of a launch file, shell; the Python runs above."""
    (parameters,) = blocks(PAGE, 'yaml')
    assert yaml.safe_load(parameters) == yaml.safe_load(
        (ROOT / 'config/nav2_params.yaml').read_text())
    (node,) = (each['ros__parameters'] for each in yaml.safe_load(parameters).values())
    trees = [node[f'default_nav_{kind}_bt_xml'] for kind in ('to_pose', 'through_poses')]
    for tree in trees:
        assert (ROOT / tree.replace('$(find-pkg-share ambush_planner)/', '')).is_file()
    declared = {each.get('name') for each in TREE.findall('arg')}
    (launch,) = map(ElementTree.fromstring, blocks(PAGE, 'xml'))
    assert launch.tag == 'launch'
    (included,) = launch.findall('include')
    assert included.get('file').endswith('/launch/' + FILE.name)
    assert {each.get('name') for each in included} <= declared
    for each in launch.iter():
        for value in each.attrib.values():
            names = {arg.get('name') for arg in launch.findall('arg')}
            assert set(re.findall(r'\$\(var (\w+)\)', value)) <= names
    text = ''.join(blocks(PAGE, 'sh'))
    subprocess.run(['bash', '-n'], input=text, text=True, check=True)
    (given,) = re.findall(r'ambush_planner\.launch\.xml ((?:.|\\\n)*?)\n\n?', text + '\n')
    assert set(re.findall(r'(\w+):=', given)) <= declared
    assert not blocks(PAGE, 'text')


def test_the_trees_without_server_names_ask_for_nav2s(tmp_path):
    (command,) = [each for each in blocks(PAGE, 'sh') if 'sed' in each]
    command = command.replace('$(ros2 pkg prefix --share ambush_planner)', str(ROOT))
    subprocess.run(['bash', '-e', '-c', command], cwd=tmp_path, check=True)
    for name in ('ambush_tree.xml', 'ambush_tree_through_poses.xml'):
        both = [re.sub(r'\s+', ' ', (folder / name).read_text())
                for folder in (tmp_path, ROOT / 'config')]
        assert both[0] != both[1]
        assert both[0] == re.sub(' server_name="ambush_planner/[a-z_]+"', '', both[1])
