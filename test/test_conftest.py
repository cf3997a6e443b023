"""A run ends by itself, names what went wrong, and leaves nothing, whatever its tests do."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
PARALLEL = '-n', '2', '--dist', 'loadfile', '--max-worker-restart', '0'
# A process in a session of its own with a segment of shared memory, as Fast DDS names it.
CHILD = """
import subprocess, sys
PROGRAM = '''
import mmap, os, sys, time
path = f'/dev/shm/fastrtps_{os.urandom(8).hex()}'
with open(path, 'wb+') as file, open(path + '_el', 'w'):
    file.truncate(4096)
    held = mmap.mmap(file.fileno(), 0)
print(os.getpid(), path, path + '_el', flush=True)
time.sleep(600)
'''
def leave_a_process():
    child = subprocess.Popen([sys.executable, '-c', PROGRAM], stdout=subprocess.PIPE, text=True,
                             start_new_session=True)
    with open('left', 'w') as file:
        file.write(child.stdout.readline())
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
    """Run pytest on these files with this suite's conftest.py; the exit code and the output."""
    for name in ('conftest.py', 'leftovers.py'):
        shutil.copy(HERE / name, folder)
    (folder / 'child.py').write_text(CHILD)
    for name, text in tests.items():
        (folder / f'{name}.py').write_text(text)
    (folder / 'pytest.ini').write_text('[pytest]\n')
    # The limit of this test is that of the run: 100 s are far from the 600 s that tests wait.
    done = subprocess.run(
        [sys.executable, '-m', 'pytest', *options], cwd=folder, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True, timeout=100, check=False)
    return done.returncode, done.stdout


def assert_nothing_left(folder):
    pid, *paths = (folder / 'left').read_text().split()
    stat = Path('/proc', pid, 'stat')
    assert not stat.exists() or stat.read_text().split()[2] == 'Z'
    assert len(paths) == 2 and not [path for path in paths if Path(path).exists()]


@pytest.mark.parametrize('options', [(), PARALLEL], ids=['alone', 'xdist'])
def test_what_a_test_leaves_running_is_ended(tmp_path, options):
    code, said = run(tmp_path, *options, test_a=PASSES)
    assert code == 0, said
    assert_nothing_left(tmp_path)


def test_a_worker_that_dies_ends_the_run_with_the_name_of_its_test(tmp_path):
    # The other worker is in a test that takes ten minutes.
    code, said = run(tmp_path, *PARALLEL, test_a=DIES, test_b=WAITS, test_c=WAITS, test_d=WAITS)
    assert code == 1, said
    assert "crashed while running 'test_a.py::test_dies'" in said
    assert_nothing_left(tmp_path)


@pytest.mark.parametrize('options', [(), PARALLEL], ids=['alone', 'xdist'])
def test_a_run_that_hangs_is_ended_by_its_limit(tmp_path, options):
    code, said = run(tmp_path, *options, '-o', 'session_limit=8', test_a=HANGS, test_b=WAITS)
    assert code == 1, said
    assert 'no end within 8 s; running: ' in said and 'test_a.py::test_hangs' in said
    assert_nothing_left(tmp_path)
