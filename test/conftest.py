# SPDX-License-Identifier: Apache-2.0
"""Settings and fixtures of all tests."""

import gc
import os
import random
import secrets
import signal
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parents[1]
# `paper` is not installed; at the end of the path, so that an installed package takes precedence.
sys.path.append(str(ROOT))
# Slow machines must not fail tests; HUNT searches for new examples, as in games.py.
settings.register_profile('suite', deadline=None, derandomize='HUNT' not in os.environ,
                          database=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile('suite')
# Shared memory of DDS is off: a killed process could crash others through it, and its last messages
# would be lost if the reader is slow. Demo and benchmarks set their own discovery range.
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'SYSTEM_DEFAULT'
os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] = str(ROOT / 'config' / 'fastdds_udp.xml')
# Tests run in parallel, so numpy, which is not imported yet, needs only one thread.
os.environ.setdefault('OMP_NUM_THREADS', '1')
# Draws from the operating system's entropy are the same in each run, unless new ones are searched.
ENTROPY = random.SystemRandom() if 'HUNT' in os.environ else random.Random()


def pytest_addoption(parser):
    parser.addoption('--kills', type=int, default=2, help='nodes to kill while they record')


def pytest_configure(config):
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in `make test &`
        signal.signal(signal.SIGINT, signal.default_int_handler)
    from numpy.random import bit_generator
    secrets.randbits = bit_generator.randbits = ENTROPY.getrandbits
    # xdist would end with the files that have few tests, which are the longest ones.
    config.option.loadscopereorder = False


def pytest_collection_modifyitems(items):
    """Begin with the largest files: they take longest, and workers then end at about one time."""
    items.sort(key=lambda item: -item.path.stat().st_size)


def pytest_collection_finish():
    """Exclude everything imported so far from garbage collection, which makes it faster."""
    gc.freeze()


def pytest_fixture_setup(fixturedef, request):
    ENTROPY.seed(f'{fixturedef.baseid} {fixturedef.argname} {request.param_index}')


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_call(item):
    ENTROPY.seed(item.nodeid)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers():
    """Use two workers more than cores, because many tests wait for other processes."""
    return len(os.sched_getaffinity(0)) + 2


@pytest.fixture(scope='module')
def nav2():
    """The types of Nav2's actions and services, which nodes then offer."""
    import interfaces  # builds them
    interfaces.install('nav2_msgs')
    yield
    interfaces.uninstall('nav2_msgs')


@pytest.fixture(scope='session')
def files(tmp_path_factory):
    """Recordings of six departures of a node, which tests read and do not change."""
    from forging import record_runs  # imports ROS
    return record_runs(tmp_path_factory.mktemp('recorded'))


@pytest.fixture
def submitted(monkeypatch):
    """The keys of all solves that are submitted in this process."""
    from ambush_planner.worker.solve_queue import SolveQueue  # most tests need no worker
    keys, submit = [], SolveQueue.submit

    def tell(queue, key, *rest):
        solve = submit(queue, key, *rest)
        keys.append(key)
        return solve

    monkeypatch.setattr(SolveQueue, 'submit', tell)
    return keys
