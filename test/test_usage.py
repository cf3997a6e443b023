"""``ambush_planner --help`` says what the node is; arguments that mean nothing are refused."""

import pytest
from ros_harness import stage
from standin_types import message_type

from ambush_planner.planning.parameters import PARAMETERS
from ambush_planner.ros import compute_path, subscriptions
from ambush_planner.ros.planner_node import main
from ambush_planner.ros.usage import INTERFACE, check_arguments

# What every node has.
COMMON = ('/parameter_events', '/rosout')
COMMON_SERVICES = (
    'change_state', 'get_state', 'get_available_states', 'get_available_transitions',
    'get_transition_graph', 'describe_parameters', 'get_parameter_types', 'get_parameters',
    'list_parameters', 'set_parameters', 'set_parameters_atomically', 'get_type_description',
)


def help_text(capsys, arguments=('--help',)):
    with pytest.raises(SystemExit) as ended:
        check_arguments(list(arguments))
    assert ended.value.code == 0
    return capsys.readouterr().out


def listed(kind, node):
    """{full name: type} of what the help has of a kind."""
    resolve = node.resolve_service_name if kind == 'srv' else node.resolve_topic_name
    middle = 'srv' if kind == 'srv' else 'msg'
    return {resolve(name): type_name.replace('/', f'/{middle}/')
            for each, name, type_name, _ in INTERFACE if each == kind}


def test_the_help_has_all_that_the_node_has(monkeypatch):
    monkeypatch.setattr(
        subscriptions, 'OccupancyGridUpdate', message_type('map_msgs', 'OccupancyGridUpdate'))
    monkeypatch.setattr(compute_path, '_installed', lambda: None)
    with stage() as running:
        node = running.planner
        name, namespace = node.get_name(), node.get_namespace()
        publishers, subscribers, services = (
            {name: kind for name, (kind,) in found}
            for found in (node.get_publisher_names_and_types_by_node(name, namespace),
                          node.get_subscriber_names_and_types_by_node(name, namespace),
                          node.get_service_names_and_types_by_node(name, namespace)))
        own = {f'/{name}/{each}' for each in COMMON_SERVICES}
        shown = {each: listed(each, node) for each in ('pub', 'sub', 'srv')}
    for each in (*COMMON, f'/{name}/transition_event'):
        publishers.pop(each)
    assert publishers == shown['pub']
    assert subscribers == shown['sub']
    assert {each: kind for each, kind in services.items() if each not in own} == shown['srv']


def test_the_action_is_in_the_help():
    (action,) = [row for row in INTERFACE if row[0] == 'act']
    assert action[1:3] == (compute_path.NAME, 'nav2_msgs/ComputePathToPose')


def test_the_help_has_every_parameter(capsys):
    text = help_text(capsys)
    for name, each in PARAMETERS.items():
        assert f'\n  {name} = {each.default!r}\n' in text
        assert ' '.join(each.description.split()) in ' '.join(text.split())
    for _, name, type_name, what in INTERFACE:
        assert any(name in line and type_name in line and what in line
                   for line in text.splitlines())


def test_help_is_found_beside_arguments_of_ros(capsys):
    assert 'usage: ros2 run' in help_text(capsys, ('--ros-args', '-p', 'seed:=1', '--', '-h'))
    check_arguments(['--ros-args', '-p', 'seed:=1', '-r', '__node:=planner'])


@pytest.mark.parametrize('arguments', [
    ('my.yaml',), ('--params-file', 'my.yaml'), ('--ros-args', '-p', 'seed:=1', '--', 'seed:=2'),
])
def test_a_stray_argument_is_an_error(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    out, err = capsys.readouterr()
    assert (ended.value.code, out) == (2, '')
    assert err.splitlines()[-1] == (
        f'ambush_planner: error: unrecognized arguments: {" ".join(arguments).split("-- ")[-1]}')
