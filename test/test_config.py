"""config/ambush_planner.yaml, the declared parameters and docs/ros_interface.md say the same."""

import math
from pathlib import Path

import rclpy
import yaml
from rclpy.context import Context
from ros_harness import free_domain

from ambush_planner.planning.parameters import PARAMETERS
from ambush_planner.ros.planner_node import PlannerNode

ROOT = Path(__file__).resolve().parent.parent
FILE = ROOT / 'config' / 'ambush_planner.yaml'
DEFAULTS = {name: declaration.default for name, declaration in PARAMETERS.items()}


def flat(tree, prefix=''):
    """{'a': {'b': 1}} as {'a.b': 1}."""
    result = {}
    for name, value in tree.items():
        whole = f'{prefix}{name}'
        result |= flat(value, f'{whole}.') if isinstance(value, dict) else {whole: value}
    return result


def exact(values):
    """Values with their types: 1, 1.0 and True are three different parameters."""
    return {name: (type(value), value) for name, value in values.items()}


def explained(declaration):
    """What the file says above a parameter."""
    text = declaration.description
    if declaration.choices:
        text += f' One of {", ".join(declaration.choices)}.'
    elif isinstance(declaration.default, bool | str | list):
        pass
    elif declaration.high == math.inf:
        text += f' Range: from {declaration.low:g}.'
    else:
        text += f' Range: {declaration.low:g} to {declaration.high:.10g}.'
    return text + (' Only read at the start.' if declaration.fixed else '')


def documented_table():
    """Each parameter of the documented table with the text of its default."""
    table = (ROOT / 'docs/ros_interface.md').read_text()
    table = table.split('| parameter | default |')[1].split('\n\n')[0]
    found = {}
    for row in table.splitlines()[2:]:
        names, defaults = (cell.strip() for cell in row.split('|')[1:3])
        pairs = zip(names.split(', '), defaults.split(', '), strict=True)
        for name, default in pairs:
            assert name.strip('`') not in found, f'{name} has two rows'
            found[name.strip('`')] = default.strip('`')
    return found


def test_the_file_holds_every_default_in_its_type():
    (node,) = yaml.safe_load(FILE.read_text()).items()
    assert node[0] == '/**'
    assert exact(flat(node[1]['ros__parameters'])) == exact(DEFAULTS)


def test_every_parameter_is_explained_as_it_is_declared():
    text = ' '.join(FILE.read_text().replace('#', ' ').split())
    for name, each in PARAMETERS.items():
        assert f"{explained(each)} {name.rpartition('.')[2]}:" in text


def test_the_documented_table_has_every_default():
    table = documented_table()
    assert sorted(table) == sorted(DEFAULTS)
    assert exact({name: yaml.safe_load(text) for name, text in table.items()}) == exact(DEFAULTS)


def test_the_planner_takes_the_file():
    context = Context()
    with free_domain() as domain:
        arguments = ['--ros-args', '--params-file', str(FILE)]
        rclpy.init(args=arguments, context=context, domain_id=domain)
        node = PlannerNode(context=context)
        try:
            assert {name: node.get_parameter(name).value for name in DEFAULTS} == DEFAULTS
        finally:
            node.destroy_node()
            context.try_shutdown()
