"""Markers from whole arrays beside markers from a Python object a point.

Both ways end with the serialised message. The peer is given the positions and colours as arrays
and is timed only for what it makes of them: objects, and their bytes. The table goes to the screen
and into results.md.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from geometry_msgs.msg import Point
from maps import block_network
from rclpy.serialization import deserialize_message, serialize_message
from report import RESULTS, conditions, table, write_block
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from ambush_planner import solve
from ambush_planner.arrays import FloatArray
from ambush_planner.ros import markers

REPEATS = 7
TARGET = 100.0  # for each topic [ms]


@dataclass(frozen=True)
class Row:
    """One topic: its points, and both ways' times [ms]."""

    topic: str
    points: int
    ours: float
    peers: float


def measure(topic: str, build: Callable[[], bytes]) -> Row:
    """Time one topic both ways; the peer makes the same message."""
    (marker,) = deserialize_message(build(), MarkerArray).markers
    points = np.array([(p.x, p.y) for p in marker.points])
    colours = np.array([(c.r, c.g, c.b, c.a) for c in marker.colors]).reshape(-1, 4)
    made = deserialize_message(from_objects(marker, points, colours), MarkerArray)
    if made != deserialize_message(build(), MarkerArray):
        raise RuntimeError(f'{topic}: the two ways make different messages')
    ours = median_ms(build)
    peers = median_ms(lambda: from_objects(marker, points, colours))
    return Row(topic, len(points), ours, peers)


def from_objects(marker: Marker, points: FloatArray, colours: FloatArray) -> bytes:
    """The message as it is made without knowing its bytes."""
    marker.points = [Point(x=x, y=y) for x, y in points.tolist()]
    marker.colors = [ColorRGBA(r=r, g=g, b=b, a=a) for r, g, b, a in colours.tolist()]
    data: bytes = serialize_message(MarkerArray(markers=[marker]))
    return data


def median_ms(run: Callable[[], bytes]) -> float:
    """Median time of a few runs [ms]."""
    times = []
    for _ in range(REPEATS):
        started = time.perf_counter()
        run()
        times.append(1e3 * (time.perf_counter() - started))
    return statistics.median(times)


def results(rows: list[Row]) -> str:
    """A row a topic and one for all; in bold how many times faster."""
    total = Row(
        'all four', sum(row.points for row in rows), sum(row.ours for row in rows),
        sum(row.peers for row in rows),
    )
    head = ('topic', 'times faster', 'points', 'from arrays [ms]', 'from objects [ms]')
    cells = [
        [row.topic, f'**{row.peers / row.ours:.3g}x**', str(row.points), f'{row.ours:.3g}',
         f'{row.peers:.3g}']
        for row in (*rows, total)
    ]
    slowest = max(rows, key=lambda row: row.ours)
    verdict = 'met' if slowest.ours < TARGET else '**missed**'
    return (
        f'{table(head, cells)}\n\nTarget: each topic in less than {TARGET:g} ms; {verdict}: the '
        f'slowest, {slowest.topic}, takes {slowest.ours:.3g} ms.'
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument(
        '--across', type=int, default=152, metavar='N', help='lattice nodes across the map'
    )
    parser.add_argument(
        '--results', type=Path, default=RESULTS, help='file whose block `markers` is replaced'
    )
    options = parser.parse_args()
    network = block_network(options.across)
    strategy = solve(network)
    header = Header(frame_id='map')
    rows = [
        measure('network', lambda: markers.network_lines(network, header)),
        measure('edge_probabilities', lambda: markers.edge_probabilities(strategy, header)),
        measure('mean_direction', lambda: markers.mean_direction(strategy, header)),
        measure('ambush_sites', lambda: markers.ambush_sites(strategy, header)),
    ]
    text = (
        f"{len(network.points)} nodes, {len(network.edges)} edges, {rows[1].points // 2} of them "
        f"in use; medians of {REPEATS} runs. {conditions('ros-jazzy-rclpy')}.\n\n{results(rows)}"
    )
    print(text)
    write_block(options.results, 'markers', text)


if __name__ == '__main__':
    main()
