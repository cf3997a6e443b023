"""The value on finer and finer meshes, for ambushes that hit a node and for ambushes with a reach.

An ambush that hits only the routes through its own node is worth less the more nodes there are:
without an ambush radius the value belongs to the mesh and tends to 0. With one it converges; but
as the ambusher still waits at nodes only, it wavers while the spacing is not small beside the
radius. The table goes to the screen and into results.md.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from maps import SIDE, block, hills, network_across
from report import RESULTS, conditions, table, write_block

from ambush_planner import GameOptions, RiskMap, solve

CELLS = 100
# Nobody waits within so many radii of the ends, whose surroundings would decide the value.
SECURED = 2.0


@dataclass(frozen=True)
class Mesh:
    """Nodes across, all nodes, values and seconds, each without and with the radius."""

    across: int
    nodes: int
    values: tuple[float, float]
    seconds: tuple[float, float]


def solve_mesh(make_map: Callable[[int], RiskMap], across: int, radius: float) -> Mesh:
    """Solve both games on one mesh."""
    network = network_across(make_map(CELLS), across)
    values, seconds = [], []
    for reach in (0.0, radius):
        game = GameOptions(ambush_radius=reach, secured_radius=SECURED * radius)
        started = time.process_time()
        values.append(solve(network, game).value)
        seconds.append(time.process_time() - started)
        print(
            f'{make_map.__name__:6s} {across:4d} across  radius {reach:4g} m  '
            f'value {values[-1]:.4f}  {seconds[-1]:7.2f} s',
            file=sys.stderr,
        )
    return Mesh(across, len(network.points), (values[0], values[1]), (seconds[0], seconds[1]))


def mesh_table(meshes: list[Mesh], radius: float) -> str:
    """A row a mesh; in bold the value over the one on the coarsest mesh."""
    head = ('across', 'spacing', 'nodes', 'radius 0', f'radius {radius:g} m', 'processor seconds')
    return table(head, [_row(mesh, meshes[0]) for mesh in meshes])


def _row(mesh: Mesh, coarsest: Mesh) -> list[str]:
    values = [
        f'**{value / first:.3f}** ({value:.4f})'
        for value, first in zip(mesh.values, coarsest.values, strict=True)
    ]
    seconds = ' / '.join(f'{s:.2g}' for s in mesh.seconds)
    return [str(mesh.across), f'{SIDE / mesh.across:.2f} m', str(mesh.nodes), *values, seconds]


def summary(meshes: list[Mesh]) -> str:
    """Whether the one falls and the other stays, in one sentence."""
    falls = all(fine.values[0] < coarse.values[0] for coarse, fine in pairwise(meshes))
    fallen = meshes[-1].values[0] / meshes[0].values[0]
    spacing = meshes[0].across / meshes[-1].across
    reached = [mesh.values[1] for mesh in meshes]
    return (
        f"Without a radius the value {'falls on every mesh' if falls else 'does not always fall'}, "
        f"to {fallen:.2f} of the first while the spacing falls to {spacing:.2f}; with it the "
        f"largest value is {max(reached) / min(reached):.2f} times the smallest."
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument(
        '--sizes', type=int, nargs='+', default=[14, 20, 28, 36, 44], metavar='N',
        help='lattice nodes across the map, coarse to fine',
    )
    parser.add_argument(
        '--radius', type=float, default=0.1 * SIDE, help='ambush radius of the second game [m]'
    )
    parser.add_argument(
        '--results', type=Path, default=RESULTS, help='file whose block `ambush_radius` is replaced'
    )
    options = parser.parse_args()
    parts = [
        f'Maps of {SIDE:g} m x {SIDE:g} m, {CELLS} cells across; nobody waits within '
        f'{SECURED * options.radius:g} m of the ends. {conditions()}.'
    ]
    for make_map in (hills, block):
        meshes = [solve_mesh(make_map, across, options.radius) for across in options.sizes]
        parts.append(f'### Map `{make_map.__name__}`\n\n{mesh_table(meshes, options.radius)}')
        parts.append(summary(meshes))
    text = '\n\n'.join(parts)
    print(text)
    write_block(options.results, 'ambush_radius', text)


if __name__ == '__main__':
    main()
