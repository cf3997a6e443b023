# SPDX-License-Identifier: Apache-2.0
"""The rooms of the package: each imports only from rooms before it, and ROS comes last."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest
from commands import NO_ROS, run_python

import ambush_planner

PACKAGE = Path(ambush_planner.__file__).parent
ROOMS = ('maps', 'network', 'game', 'routes', 'planning', 'operations', 'parameters', 'worker',
         'recordings', 'ros', 'commands')
FILES = sorted(path for room in ROOMS for path in (PACKAGE / room).rglob('*.py'))
# Everything before the worker needs only these; map files also need a YAML reader.
CORE_NEEDS = {'numpy', 'scipy', *sys.stdlib_module_names}
MAP_FILES_NEED = {'yaml', 'rasterio', 'pyproj', 'PIL', 'matplotlib', 'geopandas', 'pandas',
                  'pyogrio', 'shapely', 'mgrs'}
NEEDED_ALSO = {'route_layers.py': {'geopandas', 'shapely', 'rasterio'},
               'growing_program.py': {'highspy'}}

SOLVES = NO_ROS + """
sys.modules.update(dict.fromkeys(('mcap', 'mcap_ros2', 'matplotlib', 'yaml')))  # not needed
import ambush_planner
assert 'scipy.optimize' not in sys.modules, 'it is slow to load'
network = ambush_planner.Network([[0, 0], [1, 0], [2, 0]], [0, 3, 0], [(0, 1), (1, 2)], 0, 2)
print(round(ambush_planner.solve(network).value, 5))
"""


def imports(path: Path) -> tuple[set[str], set[str]]:
    """Top-level names of the absolute imports, and rooms of this package that are imported."""
    absolute, rooms, above = set(), set(), len(path.relative_to(PACKAGE).parts)
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            absolute |= {alias.name.partition('.')[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            absolute.add((node.module or '').partition('.')[0])
        elif isinstance(node, ast.ImportFrom) and node.level == above and node.module:
            rooms.add(node.module.partition('.')[0])
    return absolute, rooms & set(ROOMS)


def test_a_file_imports_only_from_rooms_before_its_own_and_ros_in_its_room_only():
    for path in FILES:
        room = path.relative_to(PACKAGE).parts[0]
        needed, rooms = imports(path)
        assert rooms <= set(ROOMS[:ROOMS.index(room) + 1]), path
        if room in ROOMS[:ROOMS.index('recordings')]:
            also = MAP_FILES_NEED if room == 'maps' else NEEDED_ALSO.get(path.name, set())
            assert needed <= CORE_NEEDS | also, path
        assert room != 'recordings' or 'rclpy' not in needed, path


# The files of the game's room, and its own rooms, in their order.
GAME = (('discs', 'game', 'budget', 'legs', 'tolerance'), ('distribution',),
        ('route_sampler', 'faces', 'ambusher'), ('hits',), ('certificate',),
        ('strategy',), ('value',), ('search',), ('value_search',), ('distribution_search', 'proof'),
        ('solver',), ('revaluation', 'bottleneck'))


def test_a_file_of_the_game_imports_only_from_those_before_its_own():
    level = {name: k for k, names in enumerate(GAME) for name in names}
    files = [path for path in (PACKAGE / 'game').rglob('*.py') if path.stem != '__init__']
    for path in files:
        parts = path.relative_to(PACKAGE / 'game').with_suffix('').parts
        room, above = parts[0], len(parts)  # dots to the game's own files
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.level == above:
                names = [node.module] if node.module else [each.name for each in node.names]
                for name in names:
                    assert level[name.partition('.')[0]] <= level[room], (path, name)


def test_the_core_imports_and_solves_with_ros_blocked():
    done = run_python(SOLVES, PACKAGE.parent)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == '3.0'


COMMANDS_WITHOUT_ROS = NO_ROS + """
import importlib
from ambush_planner.commands.cli import COMMANDS

for command in COMMANDS:
    try:
        importlib.import_module("ambush_planner.commands." + command).parser().format_help()
    except ImportError as error:
        print(command, error)
"""


def test_commands_are_imported_and_print_their_help_without_ros():
    pytest.importorskip('matplotlib', reason='some commands draw pictures')
    done = run_python(COMMANDS_WITHOUT_ROS)
    assert (done.returncode, done.stdout) == (0, ''), done.stderr
