"""What all tests share."""

import gc
import os
import sys
from contextlib import suppress
from pathlib import Path

import pytest
import watchdog
from hypothesis import HealthCheck, settings

# The paper's commands are not installed; at the end, so that an installed package comes first.
sys.path.append(str(Path(__file__).resolve().parents[1]))
# How fast the machine is decides nothing; HUNT looks for new examples, as in games.py.
settings.register_profile('suite', deadline=None, derandomize='HUNT' not in os.environ,
                          database=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile('suite')
# The same examples, too, whatever modules a worker has imported: Hypothesis takes constants from
# them, although it is derandomised.
with suppress(ImportError, AttributeError):
    from hypothesis.internal.conjecture import providers
    providers._get_local_constants = lambda: providers._local_constants
# Not by shared memory: there a process that is killed could crash others, and what a process
# sends last is lost with it where the reader is slow. Demo and benchmarks set their own range.
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'SYSTEM_DEFAULT'
os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] = str(
    Path(__file__).resolve().parents[1] / 'config' / 'fastdds_udp.xml')
# Tests run side by side: numpy, not loaded yet, would only get in its own way with more threads.
os.environ.setdefault('OMP_NUM_THREADS', '1')


def pytest_addoption(parser):
    watchdog.pytest_addoption(parser)
    parser.addoption('--kills', type=int, default=2, help='nodes to kill while they record')


def pytest_configure(config):
    watchdog.pytest_configure(config)
    config.option.loadscopereorder = False  # xdist's: the files of most tests first


def pytest_collection_modifyitems(items):
    """Files with slow tests first, so that in the end no worker waits for another."""
    slow = {item.path for item in items if item.get_closest_marker('slow')}
    items.sort(key=lambda item: item.path not in slow)


def pytest_collection_finish():
    """All that is imported by now stays: garbage collections need not look at it again."""
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers():
    """Two workers more than there are cores: many tests wait for other processes."""
    return len(os.sched_getaffinity(0)) + 2


@pytest.fixture
def submitted(monkeypatch):
    """The keys of solves that are submitted in this process from now on."""
    from ambush_planner.worker.solve_queue import SolveQueue  # most tests need no worker
    keys, submit = [], SolveQueue.submit

    def tell(queue, key, *rest):
        solve = submit(queue, key, *rest)
        keys.append(key)
        return solve

    monkeypatch.setattr(SolveQueue, 'submit', tell)
    return keys
