"""The value on finer and finer meshes, for ambushes that hit a node and for ambushes with a reach.

An ambush that hits only the routes through its own node is worth less the more nodes there are:
without an ambush radius the value belongs to the mesh and tends to 0. With one it converges. On
the same map both times; nobody waits within the radius of the source and the target. The table
goes to the screen and into results.md.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from maps import SIDE, network_across, terrain
from report import RESULTS, conditions, table, write_block

from ambush_planner import GameOptions, solve

CELLS = 100


@dataclass(frozen=True)
class Mesh:
    """One mesh: nodes across, nodes, the values without and with the radius, seconds for each."""

    across: int
    nodes: int
    values: tuple[float, float]
    seconds: tuple[float, float]


def solve_mesh(across: int, radius: float) -> Mesh:
    """Solve both games on one mesh."""
    network = network_across(across, terrain(CELLS))
    values, seconds = [], []
    for reach in (0.0, radius):
        started = time.perf_counter()
        strategy = solve(network, GameOptions(ambush_radius=reach, secured_radius=radius))
        seconds.append(time.perf_counter() - started)
        values.append(strategy.value)
        print(
            f"{across:5d} across  radius {reach:4g} m  value {strategy.value:.4f}"
            f"  {seconds[-1]:7.2f} s",
            file=sys.stderr,
        )
    return Mesh(across, len(network.points), (values[0], values[1]), (seconds[0], seconds[1]))


def report(meshes: list[Mesh], radius: float) -> str:
    """The table; in bold the value over the one on the next coarser mesh."""
    head = ("across", "spacing", "nodes", "radius 0", f"radius {radius:g} m", "seconds")
    rows = [_row(meshes[0], "", "")]
    for coarser, mesh in pairwise(meshes):
        pairs = zip(mesh.values, coarser.values, strict=True)
        changes = (f"**x {new / old:.3f}** " for new, old in pairs)
        rows.append(_row(mesh, *changes))
    about = f"Map of {SIDE:g} m x {SIDE:g} m; nobody waits within {radius:g} m of the ends."
    return f"{about} {conditions()}.\n\n{table(head, rows)}"


def _row(mesh: Mesh, *changes: str) -> list[str]:
    values = [f"{change}{value:.4f}" for change, value in zip(changes, mesh.values, strict=True)]
    seconds = " / ".join(f"{s:.2g}" for s in mesh.seconds)
    return [str(mesh.across), f"{SIDE / mesh.across:.2f} m", str(mesh.nodes), *values, seconds]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument(
        "--sizes", type=int, nargs="+", default=[15, 21, 30, 42, 60], metavar="N",
        help="lattice nodes across the map, coarse to fine",
    )
    parser.add_argument(
        "--radius", type=float, default=0.1 * SIDE, help="ambush radius of the second game [m]"
    )
    parser.add_argument(
        "--results", type=Path, default=RESULTS, help="file whose block `ambush_radius` is replaced"
    )
    options = parser.parse_args()
    meshes = [solve_mesh(across, options.radius) for across in options.sizes]
    text = report(meshes, options.radius)
    print(text)
    write_block(options.results, "ambush_radius", text)


if __name__ == "__main__":
    main()
