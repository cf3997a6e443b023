# SPDX-License-Identifier: Apache-2.0
"""Run commands in this process, which is faster than to start Python."""

import re
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from types import SimpleNamespace


def run_here(tool, *arguments):
    """Run a command's module; return its exit ``code`` and what it printed, ``out`` and ``err``."""
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            code = tool.main([*map(str, arguments)])
        except SystemExit as stop:
            code = stop.code
    return SimpleNamespace(code=code, out=out.getvalue(), err=err.getvalue())


def documented_keys(tool):
    """The keys of the JSON object that a command's help promises."""
    documented = re.search(r'--json: (\{.*?\})\n(?!")', tool.EPILOG, re.DOTALL)[1]
    inner = re.sub(r'[\[{][^\[\]{}]*[\]}]', '', re.sub(r'\{[^{}]*\}', '', documented[1:-1]))
    return set(re.findall(r'"(\w+)"', inner))
