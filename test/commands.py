"""Commands run in this process, where a start of Python would add nothing."""

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
