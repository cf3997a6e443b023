"""The core stands alone: it imports without ROS, and no file of it asks for ROS."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import ambush_planner
import ambush_planner.core

CORE = Path(ambush_planner.core.__file__).parent
FILES = sorted(CORE.glob('*.py'))
WORKER = sorted((CORE.parent / 'worker').glob('*.py'))
ALLOWED = {'numpy', 'scipy'} | set(sys.stdlib_module_names)

BLOCKED = """
import sys

class NoRos:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top in ("rclpy", "builtin_interfaces", "mcap", "mcap_ros2", "matplotlib", "yaml") or (
            top.endswith(("_msgs", "_srvs", "_interfaces"))
        ):
            raise ImportError(name + " is blocked")

sys.meta_path.insert(0, NoRos())
import importlib, pkgutil
import ambush_planner, ambush_planner.core
for module in pkgutil.iter_modules(ambush_planner.core.__path__):
    importlib.import_module("ambush_planner.core." + module.name)
network = ambush_planner.Network([[0, 0], [1, 0], [2, 0]], [0, 3, 0], [(0, 1), (1, 2)], 0, 2)
print(round(ambush_planner.solve(network).value, 5))
"""


def imported_modules(path: Path) -> set[str]:
    """Top-level names of the absolute imports, and 'ambush_planner.x' of those out of the core."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition('.')[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add((node.module or '').partition('.')[0])
        elif isinstance(node, ast.ImportFrom) and node.level > 1:
            found.add(f"ambush_planner.{node.module or ''}")
    return found


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_a_core_file_imports_only_numpy_scipy_and_the_core(path):
    assert imported_modules(path) <= ALLOWED


@pytest.mark.parametrize('path', WORKER, ids=lambda path: path.name)
def test_the_worker_process_knows_the_core_only(path):
    inside = {name for name in imported_modules(path) if name.startswith('ambush_planner.core.')}
    assert imported_modules(path) - inside <= ALLOWED


def test_the_core_imports_and_solves_with_ros_blocked():
    root = str(Path(ambush_planner.__file__).parent.parent)
    done = subprocess.run(
        [sys.executable, '-c', BLOCKED], capture_output=True, text=True, timeout=60, cwd=root
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == '3.0'


@pytest.mark.parametrize('command', ['terrain', 'table'])
def test_commands_that_take_no_recordings_need_no_ros(command):
    module = f'ambush_planner.tools.{command}'
    pytest.importorskip('matplotlib', reason='the preview takes the extra figures')
    seen = f"import sys, {module}; print([m for m in sys.modules if m in ('rclpy', 'nav_msgs')])"
    done = subprocess.run(
        [sys.executable, '-c', seen], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stdout.strip() == '[]', done.stderr


def test_every_public_name_is_there():
    for name in ambush_planner.__all__:
        assert getattr(ambush_planner, name) is not None
