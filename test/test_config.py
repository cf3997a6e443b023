# SPDX-License-Identifier: Apache-2.0
"""config/ambush_planner.yaml, the declared parameters and docs/ros_interface.md say the same."""

import yaml
from commands import ROOT, table_under

from ambush_planner.parameters.table import PARAMETERS

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


def documented_table():
    """Each parameter of the documented table with the text of its default."""
    found = {}
    for names, defaults, text in table_under('docs/ros_interface.md', 'Parameters'):
        pairs = zip(names.split(', '), defaults.split(', '), strict=True)
        for name, default in pairs:
            assert name.strip('`') not in found, f'{name} has two rows'
            found[name.strip('`')] = default.strip('`')
            choices = (PARAMETERS[name.strip('`')].choices if ',' not in names else ())
            assert all(f'`{each}`' in defaults + text for each in choices), name
    return found


def test_the_file_holds_every_default_in_its_type():
    (node,) = yaml.safe_load(FILE.read_text()).items()
    assert node[0] == '/**'
    assert exact(flat(node[1]['ros__parameters'])) == exact(DEFAULTS)


def test_the_documented_table_has_every_default():
    table = documented_table()
    assert sorted(table) == sorted(DEFAULTS)
    assert exact({name: yaml.safe_load(text) for name, text in table.items()}) == exact(DEFAULTS)
