"""The value on finer and finer meshes, with and without an ambush radius.

An ambush that hits only the routes through its own node is worth less the more nodes there are:
without an ambush radius the value depends on the mesh and tends to 0. With a radius it converges,
but not monotonically, because the ambusher still waits at nodes only.
"""

from __future__ import annotations

import sys
import time
from itertools import pairwise

from report import conditions, new_parser, publish, table
from scenarios import SIDE, block, hills, network_across

from ambush_planner import GameOptions, RiskMap, solve

CELLS = 100
# Radius around the ends in which nobody waits [ambush radii].
SECURED = 2.0


def mesh_table(risk_map: RiskMap, sizes: list[int], radius: float) -> str:
    """A row for each mesh, with the ratio to the coarsest mesh in bold, and a summary."""
    rows, values = [], []
    for across in sizes:
        network = network_across(risk_map, across)
        cells = [str(across), f'{SIDE / across:.2f} m', str(len(network.points))]
        values.append([])
        for k, reach in enumerate((0.0, radius)):
            game = GameOptions(ambush_radius=reach, secured_radius=SECURED * radius)
            started = time.process_time()
            values[-1].append(solve(network, game).value)
            seconds = time.process_time() - started
            ratio = values[-1][k] / values[0][k]
            cells += [f'**{ratio:.3f}** ({values[-1][k]:.4f})', f'{seconds:.2g}']
        print(*cells, file=sys.stderr)
        rows.append(cells)
    head = ('across', 'spacing', 'nodes', 'radius 0', 's', f'radius {radius:g} m', 's')
    falls = all(fine[0] < coarse[0] for coarse, fine in pairwise(values))
    reached = [value[1] for value in values]
    return (
        f"{table(head, rows)}\n\nWithout a radius the value "
        f"{'falls on every mesh' if falls else 'does not always fall'}, to "
        f'{values[-1][0] / values[0][0]:.2f} of the first while the spacing falls to '
        f'{sizes[0] / sizes[-1]:.2f}; with it the largest value is '
        f'{max(reached) / min(reached):.2f} times the smallest.'
    )


def main() -> None:
    parser = new_parser(__doc__)
    parser.add_argument(
        '--sizes', type=int, nargs='+', default=[14, 20, 28, 36, 44], metavar='N',
        help='lattice nodes across the map, coarse to fine',
    )
    parser.add_argument(
        '--radius', type=float, default=0.1 * SIDE, help='ambush radius of the second game [m]'
    )
    options = parser.parse_args()
    parts = [
        f'Maps of {SIDE:g} m x {SIDE:g} m, {CELLS} cells across; nobody waits within '
        f'{SECURED * options.radius:g} m of the ends. {conditions()}.'
    ]
    for make_map in (hills, block):
        rows = mesh_table(make_map(CELLS), options.sizes, options.radius)
        parts.append(f'### Map `{make_map.__name__}`\n\n{rows}')
    publish(options.results, 'ambush_radius', '\n\n'.join(parts))


if __name__ == '__main__':
    main()
