# SPDX-License-Identifier: Apache-2.0
"""Edges that enter discs, against independent geometry: points along the drawn line."""

import numpy as np
import pytest
from drive_samples import dense
from games import examples
from hypothesis import assume, given
from hypothesis import strategies as st

from ambush_planner import GameOptions, Network, solve
from ambush_planner.game.discs import ExposedEdges, SecuredArea

# Distances within NEAR radii of the circle are ambiguous.
NEAR = 1e-6


def corridor(points) -> Network:
    """Nodes joined one after the other, driven one way."""
    count = len(points)
    edges = np.stack((np.arange(count - 1), np.arange(1, count)), axis=1)
    alpha = np.r_[0.0, np.ones(count - 2), 0.0]
    return Network(points, alpha, edges, 0, count - 1)


def entries(network: Network, centre_node: int, radius: float) -> np.ndarray:
    """Row (M,) of one site."""
    return _everywhere(network).entering(network.points[[centre_node]], radius).toarray()[0]


def _everywhere(network: Network) -> ExposedEdges:
    nothing = SecuredArea(np.empty((0, 2)), np.empty(0))
    return ExposedEdges(network.points, network.edges, nothing, np.array([network.source]))


def visits_to_disc(points: np.ndarray, centre: np.ndarray, radius: float) -> tuple[int, int]:
    """Least and largest number of entries of a polyline into a disc, by points along it."""
    distance = np.sqrt(((dense(points, 0.01) - centre) ** 2).sum(axis=1))

    def runs(inside) -> int:
        return int((inside[1:] & ~inside[:-1]).sum())

    counts = [runs(distance < radius * (1 + room)) for room in (-1e-2, -NEAR, NEAR, 1e-2)]
    return min(counts), max(counts)


@examples(40)
@given(st.integers(0, 10**9))
def test_entries_of_any_polyline_match_its_sampled_points(seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-10, 10, (rng.integers(3, 7), 2))
    site = int(rng.integers(1, len(points)))
    # Half of the time a node lies on the circle.
    apart = np.sqrt(((points - points[site]) ** 2).sum(axis=1))
    radius = float(rng.choice(apart[apart > 0.0])) if seed % 2 else rng.uniform(0.5, 6.0)
    assume(apart[0] > radius * (1 + NEAR))
    least, most = visits_to_disc(points, points[site], radius)
    assert least <= entries(corridor(points), site, radius).sum() <= most


@pytest.mark.parametrize('radius', [np.sqrt(2.0), 2.0, 5.0])
def test_every_walk_into_a_disc_on_a_rotated_lattice_is_counted(radius):
    """Nodes exactly at the reach on a lattice rotated by 1.1 rad; integers decide."""
    side = 15
    grid = np.stack(np.divmod(np.arange(side * side), side), axis=1)
    turn = np.array([[np.cos(1.1), -np.sin(1.1)], [np.sin(1.1), np.cos(1.1)]])
    step = np.abs(grid[:, None] - grid).max(axis=2) == 1
    edges = np.argwhere(step)
    edges = edges[(edges[:, 1] != 0) & (edges[:, 0] != len(grid) - 1)]
    alpha = np.r_[0.0, np.ones(len(grid) - 2), 0.0]
    network = Network(grid @ turn.T, alpha, edges, 0, len(grid) - 1)
    centre = side * side // 2
    row = entries(network, centre, radius)
    tail, head = (((grid[k] - grid[centre]) ** 2).sum(axis=1) for k in edges.T)
    squared = round(radius**2)
    # An edge from outside into the disc counts; one from inside never does.
    assert (row[(tail > squared) & (head < squared)] == 1.0).all()
    assert (row[(tail < squared)] == 0.0).all()
    # A node on the circle is inside for all of its edges, or for none.
    for node in np.flatnonzero(((grid - grid[centre]) ** 2).sum(axis=1) == squared):
        into = row[(edges[:, 1] == node) & (tail > squared)]
        out = row[(edges[:, 0] == node) & (head < squared)]
        assert len({*into, *(1.0 - out)}) == 1


def test_a_node_on_the_rim_of_the_secured_area_hides_no_hit():
    """Rounding puts the third node a hair outside the secured area; the way passes 1.62 m away."""
    step, cells = 0.2, 9
    row = [((column + 0.5) * step, 3.5 * step) for column in (15, 23, 24, 25, 75)]
    site = row[2][0] + 0.1 * step, row[2][1] + 0.9 * cells * step
    edges = np.stack((np.arange(4), np.arange(1, 5)), axis=1)
    network = Network(np.array([*row, site]), np.array([0, 0, 0, 0, 0, 1.0]), edges, 0, 4)
    assert solve(network, GameOptions(ambush_radius=cells * step,
                                      secured_radius=cells * step)).value == pytest.approx(1.0)
