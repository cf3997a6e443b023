"""How soon the node answers: beside a long solve, to a large map, and with a route.

The node is a process of its own (but for the map's callback, which is called directly); times are
the caller's, from the request to the answer read, in milliseconds. Exit code 1 if a target is
missed.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path

from node_rig import FAILURES, percentiles, say
from node_timings import NOTHING, Beside, Departures, beside_a_solve, departures, large_maps
from report import RESULTS, conditions, table, write_block

PERIOD = 0.05  # s
CELLS = 2000
# Targets [ms]: 99th percentile beside a solve; a map's callback; median of a path's arrival.
BESIDE, MAP, PATH = 50.0, 50.0, 25.0
# Of an answer that has arrived, with recording on and 20 departures a second.
ANSWERS = {
    '`new_route`: answer arrived': (3.0, 10.0),
    '`get_plan`: answer with the path arrived': (12.0, 30.0),
}


def spread(samples: Sequence[float]) -> str:
    """Median / 99th percentile / largest."""
    return ' / '.join(f'{value:.3g}' for value in percentiles(samples))


def verdict(*met: bool) -> str:
    """A cell."""
    return 'yes' if all(met) else '**no**'


def beside_results(beside: Beside) -> tuple[str, bool]:
    """The node's answers during a solve, and whether the target is met."""
    met = {name: percentiles(times)[1] < BESIDE for name, times in beside.during.items()}
    rows = [
        [name, f'**{percentiles(times)[1] / percentiles(beside.idle[name])[1]:.2f}x**',
         spread(times), spread(beside.idle[name]), verdict(met[name])]
        for name, times in beside.during.items()
    ]
    head = ('median / 99 % / largest [ms]', '99 %, during : idle', 'during the solve', 'idle',
            f'99 % < {BESIDE:g} ms')
    count = len(next(iter(beside.during.values())))
    text = (
        '### Beside a solve of minutes (simplex, 40 000 nodes)\n\n'
        f'{count} questions of each kind in turns, one every {1e3 * PERIOD:g} ms, in the first '
        f'{beside.seconds:.0f} s of the solve. `cancel` ended it in {beside.cancel:.3g} ms.\n\n'
        f'{table(head, rows)}'
    )
    return text, all(met.values())


def map_results(times: Sequence[float]) -> tuple[str, bool]:
    """The map's callback, and whether the target is met."""
    met = max(times) < MAP
    text = (
        f'### A map of {CELLS} x {CELLS} cells\n\nCallback, reading the message included: median '
        f'{statistics.median(times):.3g} ms, largest {max(times):.3g} ms of {len(times)} '
        f'different maps. Target < {MAP:g} ms for each: {verdict(met)}.'
    )
    return text, met


def departure_results(
    found: Sequence[Departures], calls: int, nodes: int
) -> tuple[str, bool]:
    """Times of departures, and whether the targets are met."""
    rows, every = [], []
    for each in found:
        pace = f'every {1e3 * each.period:g} ms' if each.period else 'back to back'
        for name, times in each.times.items():
            median, seldom, _ = percentiles(times)
            target, judged = ANSWERS.get(name), each.period > 0.0
            met = not target or not judged or (median < target[0] and seldom < target[1])
            if name.endswith('`path` received'):
                met = median < PATH
            every.append(met)
            shown = f'< {target[0]:g} / {target[1]:g}' if target and judged else ''
            nothing = statistics.median(each.times[NOTHING])
            rows.append([name, 'on' if each.recording else 'off', pace, spread(times),
                         f'{median / nothing:.1f}', shown, verdict(met) if shown else ''])
    poses = statistics.median(sum((each.poses for each in found), []))
    head = ('departure', 'recording', 'calls', 'median / 99 % / largest [ms]',
            "median, times the empty service's", 'target', 'met')
    text = (
        f'### A departure on a known strategy ({nodes} nodes)\n\n{calls} calls a row; paths of '
        f'{poses:.0f} poses (median).\n\n{table(head, rows)}'
    )
    return text, all(every)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument(
        '--samples', type=int, default=300, metavar='N', help='questions of each kind and state'
    )
    parser.add_argument('--calls', type=int, default=500, metavar='N', help='departures a row')
    parser.add_argument('--nodes', type=int, default=10_000, metavar='N', help='of the network')
    parser.add_argument('--maps', type=int, default=20, metavar='N', help='large maps')
    parser.add_argument(
        '--results', type=Path, default=RESULTS, help='file whose block `node_latency` is replaced'
    )
    options = parser.parse_args()
    try:
        parts = (
            beside_results(beside_a_solve(options.samples, PERIOD)),
            map_results(large_maps(options.maps, CELLS)),
            departure_results(
                departures(options.calls, options.nodes, (PERIOD, 0.0)), options.calls,
                options.nodes),
        )
    except FAILURES as error:
        say(f'node_latency: {error}')
        return 2
    text = '\n\n'.join((f"{conditions('ros-jazzy-rclpy')}.", *(part for part, _ in parts)))
    print(text)
    write_block(options.results, 'node_latency', text)
    return int(not all(met for _, met in parts))


if __name__ == '__main__':
    sys.exit(main())
