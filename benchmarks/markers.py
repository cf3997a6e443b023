"""Marker messages from whole arrays, compared with one Python object per point.

Both ways end with the serialised message. The peer is given positions and colours as arrays and is
timed only for creating objects and serialising them.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import Point
from rclpy.serialization import deserialize_message, serialize_message
from report import conditions, new_parser, publish, table
from scenarios import block_network
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import MarkerArray

from ambush_planner import solve
from ambush_planner.ros import markers

REPEATS = 7


def measure(topic: str, build: Callable[[], bytes]) -> list[str]:
    """Time one topic both ways; both must make the same message."""
    message = deserialize_message(build(), MarkerArray)
    (marker,) = message.markers
    points = np.array([(p.x, p.y) for p in marker.points])
    colours = np.array([(c.r, c.g, c.b, c.a) for c in marker.colors]).reshape(-1, 4)

    def from_objects() -> bytes:
        marker.points = [Point(x=x, y=y) for x, y in points.tolist()]
        marker.colors = [ColorRGBA(r=r, g=g, b=b, a=a) for r, g, b, a in colours.tolist()]
        return bytes(serialize_message(MarkerArray(markers=[marker])))

    if deserialize_message(from_objects(), MarkerArray) != message:
        raise RuntimeError(f'{topic}: the two ways make different messages')
    ours, peers = median_ms(build), median_ms(from_objects)
    return [topic, f'**{peers / ours:.3g}x**', str(len(points)), f'{ours:.3g}', f'{peers:.3g}']


def median_ms(run: Callable[[], bytes]) -> float:
    """Median time of a few runs [ms]."""
    times = []
    for _ in range(REPEATS):
        started = time.perf_counter()
        run()
        times.append(1e3 * (time.perf_counter() - started))
    return statistics.median(times)


def main() -> None:
    parser = new_parser(__doc__)
    parser.add_argument('--across', type=int, default=152, metavar='N', help='nodes across the map')
    options = parser.parse_args()
    network = block_network(options.across)
    strategy, header = solve(network), Header(frame_id='map')
    rows = [
        measure('network', lambda: markers.network_lines(network, header)),
        measure('edge_probabilities', lambda: markers.edge_probabilities(strategy, header)),
        measure('mean_direction', lambda: markers.mean_direction(strategy, header)),
        measure('ambush_sites', lambda: markers.ambush_sites(strategy, header)),
    ]
    head = ('topic', 'times faster', 'points', 'from arrays [ms]', 'from objects [ms]')
    publish(options.results, 'markers', (
        f"{len(network.points)} nodes, {len(network.edges)} edges; medians of {REPEATS} runs. "
        f"{conditions('ros-jazzy-rclpy')}.\n\n{table(head, rows)}"
    ))


if __name__ == '__main__':
    main()
