"""What processes that were killed leave behind: their children, and shared memory of Fast DDS."""

import os
import signal
import time
from pathlib import Path

SHARED = Path('/dev/shm')


def marked(name, value):
    """Process ids of all others that have this in their environment."""
    wanted, found = f'{name}={value}'.encode(), []
    for folder in Path('/proc').glob('[0-9]*'):
        try:
            words = (folder / 'environ').read_bytes().split(b'\0')
        except OSError:  # it has just ended, or is somebody else's
            continue
        if wanted in words and int(folder.name) != os.getpid():
            found.append(int(folder.name))
    return found


def end_processes(name, value, seconds=5.0):
    """Kill them, and those that they start meanwhile, and see them off."""
    end = time.monotonic() + seconds
    while (found := marked(name, value)) and time.monotonic() < end:
        for pid in found:
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
        time.sleep(0.05)


def remove_shared_memory(since):
    """Remove what Fast DDS has made since then, if no process maps it any more."""
    mapped = _mapped()
    for path in SHARED.glob('fastrtps_*'):
        if path.name.endswith(('_el', '_sl')) or path in mapped or not _ours(path, since):
            continue
        beside = [f'{path.name}_el', f'{path.name}_sl', f'sem.{path.name}_mutex']
        for each in (path, *map(path.with_name, beside)):
            each.unlink(missing_ok=True)


def _mapped():
    found = set()
    for maps in Path('/proc').glob('[0-9]*/maps'):
        try:
            lines = maps.read_text().splitlines()
        except OSError:
            continue
        found.update(Path(line.split()[5]) for line in lines if f' {SHARED}/' in line)
    return found


def _ours(path, since):
    try:
        found = path.stat()
    except FileNotFoundError:
        return False
    # What is a second old may be about to be mapped, by another run.
    return found.st_uid == os.getuid() and since <= found.st_ctime < time.time() - 1.0
