"""Run commands and benchmarks in this process, which is faster than to start Python."""

import re
import runpy
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

BENCHMARKS = Path(__file__).resolve().parent.parent / 'benchmarks'


def run_here(tool, *arguments):
    """Run a command's module; return its exit ``code`` and what it printed, ``out`` and ``err``."""
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            code = tool.main([*map(str, arguments)])
        except SystemExit as stop:
            code = stop.code
    return SimpleNamespace(code=code, out=out.getvalue(), err=err.getvalue())


def run_benchmark(script, *arguments):
    """Run a script of the benchmarks; as ``run_here`` otherwise."""
    path = BENCHMARKS / script
    out, err = StringIO(), StringIO()
    with (
        mock.patch.object(sys, 'path', [str(BENCHMARKS), *sys.path]),
        mock.patch.object(sys, 'argv', [script, *map(str, arguments)]),
        redirect_stdout(out), redirect_stderr(err),
    ):
        try:
            runpy.run_path(str(path), run_name='__main__')
            code = 0
        except SystemExit as stop:
            code = stop.code or 0
    return SimpleNamespace(code=code, out=out.getvalue(), err=err.getvalue())


def documented_keys(tool):
    """The keys of the JSON object that a command's help promises."""
    documented = re.search(r'--json: (\{.*?\})\n(?!")', tool.EPILOG, re.DOTALL)[1]
    inner = re.sub(r'[\[{][^\[\]{}]*[\]}]', '', re.sub(r'\{[^{}]*\}', '', documented[1:-1]))
    return set(re.findall(r'"(\w+)"', inner))
