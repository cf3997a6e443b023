"""A run ends, says why, and leaves no process, whatever its tests do."""

import shutil
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

from waiting import wait_until

HERE = Path(__file__).parent
PARALLEL = '-n', '2', '--dist', 'loadfile', '--max-worker-restart', '0'
# Leaves a process in a session of its own.
CHILD = """
import os, subprocess
def leave_a_process():
    child = subprocess.Popen(['sleep', '600'], start_new_session=True)
    with open('being_written', 'w') as file:
        file.write(str(child.pid))
    os.rename('being_written', 'left')
"""
PASSES = 'from child import leave_a_process\ndef test_passes(): leave_a_process()\n'
DIES = """
import os, signal
from child import leave_a_process
def test_dies():
    leave_a_process()
    os.kill(os.getpid(), signal.SIGKILL)
def test_that_comes_later(): pass
"""
HANGS = """
import signal, time
from child import leave_a_process
def test_hangs():
    leave_a_process()
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGALRM])  # deaf to pytest-timeout
    while True: time.sleep(600)
"""
WAITS = 'import time\ndef test_waits(): time.sleep(600)\n'


def run(folder, *options, **tests):
    """Run pytest on these files; the exit code and the output."""
    with started(folder, *options, **tests) as process:
        said, _ = process.communicate()
    return process.returncode, said


@contextmanager
def started(folder, *options, **tests):
    """Start pytest on these files, guarded as this suite is."""
    shutil.copy(HERE / 'watchdog.py', folder / 'conftest.py')
    (folder / 'child.py').write_text(CHILD)
    for name, text in tests.items():
        (folder / f'{name}.py').write_text(text)
    (folder / 'pytest.ini').write_text('[pytest]\n')
    with subprocess.Popen(
            [sys.executable, '-m', 'pytest', *options], cwd=folder, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def assert_nothing_left(folder):
    stat = Path('/proc', (folder / 'left').read_text(), 'stat')
    assert not stat.exists() or stat.read_text().split()[2] == 'Z'


def test_what_a_test_leaves_running_is_ended(tmp_path):
    code, said = run(tmp_path, test_a=PASSES)
    assert code == 0, said
    assert_nothing_left(tmp_path)


def test_a_worker_that_dies_ends_the_run_with_the_name_of_its_test(tmp_path):
    # The other worker is in a test that takes ten minutes.
    code, said = run(tmp_path, *PARALLEL, test_a=DIES, test_b=WAITS, test_c=WAITS, test_d=WAITS)
    assert code == 1, said
    assert "crashed while running 'test_a.py::test_dies'" in said
    assert_nothing_left(tmp_path)


def test_a_run_that_hangs_can_be_ended_and_names_what_hangs(tmp_path):
    with started(tmp_path, test_a=HANGS) as process:
        wait_until((tmp_path / 'left').exists, 'the test to hang')
        process.terminate()
        said, _ = process.communicate()
    assert process.returncode == 1, said
    assert 'ended by SIGTERM; running: ' in said and 'test_a.py::test_hangs' in said
    assert 'in test_hangs' in said, 'with the place'
    assert_nothing_left(tmp_path)
