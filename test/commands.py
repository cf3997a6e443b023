# SPDX-License-Identifier: Apache-2.0
"""Run commands in this process, which is faster than to start Python; and documents in another."""

import os
import re
import subprocess
import sys
import warnings
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

from ambush_planner import AmbushPlannerWarning

# Begins a script that has to run without ROS.
NO_ROS = """
import sys

class NoRos:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        ros = ("rclpy", "builtin_interfaces", "ament_index_python")
        if top in ros or top.endswith(("_msgs", "_srvs", "_interfaces")):
            raise ImportError(name + " is blocked")

sys.meta_path.insert(0, NoRos())
"""


def run_here(tool, *arguments):
    """Run a command's module; return its exit ``code`` and what it printed, ``out`` and ``err``."""
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            code = tool.main([*map(str, arguments)])
        except SystemExit as stop:
            code = stop.code
    return SimpleNamespace(code=code, out=out.getvalue(), err=without_progress(err.getvalue()))


def without_progress(errors):
    """Leave out the lines that only tell that a machine takes its time."""
    return re.sub(r'(?m)^ *\d+\.\d s  .*\n', '', errors)


def run_python(script, folder=None):
    """Run Python in a process of its own; return the process."""
    return subprocess.run([sys.executable, '-c', script], cwd=folder, capture_output=True,
                          text=True, check=False)


def run_without(missing, folder, *lines):
    """Run command lines in a folder where some packages are not installed; return the process.

    It prints their exit codes last.
    """
    return run_python(f'import sys\nsys.modules |= dict.fromkeys({missing!r})\n'
                      'from ambush_planner.commands import cli\n'
                      f'print(*[cli.main(line.split()) for line in {lines!r}])', folder)


def heard(act, *arguments, **options):
    """Return the result of a function, and the texts of our warnings in one."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter('always', AmbushPlannerWarning)
        result = act(*arguments, **options)
    return result, ' '.join(str(each.message) for each in said
                            if issubclass(each.category, AmbushPlannerWarning))


def documented_keys(tool):
    """The keys of the JSON object that a command's help promises."""
    text = getattr(tool, 'DETAILS', tool.EPILOG)
    documented = re.search(r'--json: (\{.*?\})\n(?!")', text, re.DOTALL)[1]
    inner = re.sub(r'[\[{][^\[\]{}]*[\]}]', '', re.sub(r'\{[^{}]*\}', '', documented[1:-1]))
    return set(re.findall(r'"(\w+)"', inner))


ROOT = Path(__file__).resolve().parent.parent
# Commands draw the same each time.
SEEDED = {'PYTHONPATH': os.pathsep.join(
    [str(ROOT / 'test/seeded'), os.environ.get('PYTHONPATH', '')])}


def table_under(page, heading):
    """The rows of all tables of a section of a document, as the texts of their cells."""
    section = (ROOT / page).read_text().split(f'\n## {heading}\n')[1].split('\n#')[0]
    tables = re.findall(r'(?m)^\|.*\n\|[-|]+\n((?:\|.*\n)+)', section)
    return [[cell.strip() for cell in row.strip('|').split('|')]
            for table in tables for row in table.splitlines()]


def fenced(page):
    """Kind and text of each block of a document, by its path in the checkout."""
    return re.findall(r'(?ms)^```(\w+)\n(.*?)^```$', (ROOT / page).read_text())


def blocks(page, wanted):
    """The texts of the blocks of one kind."""
    return [text for kind, text in fenced(page) if kind == wanted]


def script_of(page):
    """A shell script of the blocks of a document: sh, python, and yaml, which is a layers.yaml."""
    runs = {'sh': '{}', 'python': "python - <<'END'\n{}END\n",
            'yaml': "cat > layers.yaml <<'END'\n{}END\n"}
    return ''.join(runs[kind].format(text) for kind, text in fenced(page)
                   if kind != 'text')


def run_script(script, folder):
    """Run a script with this environment's commands on the path; return the process."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ['PATH']])
    return subprocess.run(['bash', '-ec', script], cwd=folder, capture_output=True, text=True,
                          env={**os.environ, **SEEDED, 'PATH': path, 'HOME': str(folder)},
                          check=False)
