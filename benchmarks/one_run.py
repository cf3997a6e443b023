# SPDX-License-Identifier: Apache-2.0
"""Run one function on one problem in a process of its own: one thread, a hard limit.

A separate process makes the peak memory the problem's own, and one that hangs or crashes is only
one row of a table. All times are processor seconds. ``run`` starts this file.
"""

from __future__ import annotations

import importlib
import json
import os
import resource
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import Any

from ambush_planner import AmbushPlannerError

Answer = dict[str, Any]
THREADS = {f'{name}_NUM_THREADS': '1' for name in ('OMP', 'OPENBLAS', 'MKL', 'RAYON')}
LATE = 'late'


def run(task: str, name: str, limit: float, checkout: Path | None = None, **given: Any) -> Answer:
    """Run ``task`` ('script.function') on a problem; ``failed`` if it did not end well.

    Its ``status`` is then the package's error, ``LATE``, or the last line of a crash. ``checkout``
    holds the package that is measured; None: the installed one.
    """
    path = {'PYTHONPATH': str(checkout)} if checkout else {}
    command = [sys.executable, __file__, task, name, str(limit), json.dumps(given)]
    done = subprocess.run(command, env=os.environ | THREADS | path, capture_output=True, text=True,
                          check=False)
    if done.returncode == 0:
        # HiGHS 1.16 prints its name first.
        answer: Answer = json.loads(done.stdout.splitlines()[-1])
    else:
        words = done.stderr.strip().splitlines()[-1:] or [f'exit code {done.returncode}']
        status = LATE if done.returncode == -signal.SIGPROF else f'crashed: {words[0]}'
        answer = {'failed': True, 'seconds': limit, 'status': status}
    print(f"{name:36s} {task:17s} {answer['seconds']:8.2f} s  {answer['status']}", file=sys.stderr)
    return answer | {'name': name, 'task': task}


def main() -> None:
    task, name, limit, given = sys.argv[1:]
    warnings.simplefilter('ignore')
    module, function = task.split('.')
    work = getattr(importlib.import_module(module), function)
    # Native code does not return to Python's handlers; SIGPROF's default ends the process.
    signal.setitimer(signal.ITIMER_PROF, float(limit))
    try:
        answer = work(name, **json.loads(given))
    except AmbushPlannerError as error:
        answer = {'failed': True, 'seconds': time.process_time(), 'status': type(error).__name__,
                  'words': str(error)}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(json.dumps(answer | {'peak': peak}))


if __name__ == '__main__':
    main()
