# SPDX-License-Identifier: Apache-2.0
"""The ambush game on a network: playable edges, ambush sites and losses.

Letters are the paper's: p (M,) expected uses of each edge, x (N,) visits of each node, q (N,) the
ambusher's probabilities, z the value, alpha (N,) the losses, ``A p = b`` conservation of flow, and
``D`` the loss matrix: row j of ``D p`` is the mean loss that an ambush at site j causes (its
equation 1).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import InitVar, dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, vstack

from ..arrays import BoolArray, FloatArray, IndexArray, frozen_array, sums
from ..errors import InvalidOption, NoRoute
from ..network.hiding_places import with_places
from ..network.network import Network
from ..network.shortest_paths import distances_from, on_some_route
from ..option_checks import allowed, check_options, length
from .discs import ExposedEdges, SecuredArea, secured_area

# Where a site stands for all places around it, one node is a site in each square of this side
# [reaches]; separation over the cells of the map adds what others could.
SITE_SQUARE = 0.4
# A disc of the secured area (x, y, radius) [m].
SecuredPlace = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class GameOptions:
    """Rules of the game: the ambusher's abilities, and the nodes that the convoy avoids.

    Parameters
    ----------
    ambush_radius
        Reach of an ambush: it hits every route that passes within this distance of its site [m].
        0: it hits routes through the site's node.
    secured_radius
        Radius of the secured area around the source, each stop and the target [m]: nobody can wait
        there, and with a reach nobody who drives there is hit. None, or -1: the reach plus the
        tube, which is an assumption.
    secured_places
        More of the secured area: discs (x, y, radius) [m] in world coordinates, such as a
        checkpoint on the way. As around the ends, nobody can wait there, and with a reach nobody
        who drives there is hit. The old name ``held_places`` works until the next release.
    alpha_threshold
        The convoy avoids nodes with a larger alpha (the paper's "forbid areas"). With a reach,
        the ambusher can still wait there.
    ambush_in_obstacles
        With a reach, the ambusher can also hide in obstacle cells; a plan adds them as nodes
        without edges.
    tube
        Largest distance of the driven path from the drawn route [m]. It adds to the reach, and the
        secured area protects only routes whose whole tube lies in it. A plan sets it.
    widened
        Largest distance of a place from the site that stands for it [m]. It adds to the reach, so
        that finitely many sites cover all places. A plan sets it.

    Raises
    ------
    InvalidOption
        A value is out of range or of another type.
    """

    ambush_radius: float = length(least=1e-3)
    secured_radius: float | None = length(None, automatic=-1.0)
    alpha_threshold: float = allowed(math.inf, finite=False)
    ambush_in_obstacles: bool = allowed(False)
    tube: float = length()
    widened: float = length()
    secured_places: tuple[SecuredPlace, ...] = ()
    held_places: InitVar[Iterable[Iterable[float]] | None] = None

    def __post_init__(self, held_places: Iterable[Iterable[float]] | None) -> None:
        check_options(self)
        given = self.secured_places if held_places is None else held_places
        object.__setattr__(self, 'secured_places', _checked_places(given))

    @property
    def reach(self) -> float:
        """Distance from a drawn route within which a site hits the driven path [m]."""
        return self.ambush_radius + self.tube + self.widened

    @property
    def secured_distance(self) -> float:
        """Radius of the secured area around source, stops and target [m]."""
        if self.secured_radius is None:
            return self.ambush_radius + self.tube
        return self.secured_radius


def _checked_places(given: Iterable[Iterable[float]]) -> tuple[SecuredPlace, ...]:
    """Return ``secured_places`` as tuples of numbers; raises InvalidOption."""
    try:
        places = tuple((float(x), float(y), float(radius)) for x, y, radius in given)
        good = all(math.isfinite(sum(place)) and place[2] > 0.0 for place in places)
    except (TypeError, ValueError):
        good = False
    if not good:
        raise InvalidOption('secured_places must each be x, y and a radius over 0 [m], got '
                            f'{given!r}')
    return places


@dataclass(frozen=True, eq=False)
class Game:
    """Ambush game of one leg: a network with its playable edges, sites and losses.

    ``playable`` (M,) marks the edges that lie on some route without forbidden nodes. ``loss`` (N,)
    is alpha if an ambush is possible at the node, else 0. ``known_rows`` initialises ``entering``,
    which is slow to compute with a reach.
    """

    network: Network
    options: GameOptions
    playable: BoolArray
    loss: FloatArray
    secured: SecuredArea
    known_rows: InitVar[csr_matrix | None] = None

    def __post_init__(self, known_rows: csr_matrix | None) -> None:
        if known_rows is not None:
            vars(self)['entering'] = known_rows  # a cached property looks there first

    @property
    def reach(self) -> float:
        """Distance from a drawn route within which an ambush hits [m]; 0: at nodes only."""
        return self.options.reach

    @property
    def no_reentry(self) -> bool:
        """Return whether simple routes enter a reach at most once, so that entries are hits."""
        return self.reach == 0.0

    @property
    def node_count(self) -> int:
        """Number of nodes of the network, N."""
        return len(self.network.points)

    @cached_property
    def sites(self) -> IndexArray:
        """The nodes (S,) at which an ambush causes a loss."""
        return np.flatnonzero(self.loss > 0.0)

    @cached_property
    def entering(self) -> csr_matrix:
        """(S, M) of 0 and 1: the edges by which a route enters each site's reach.

        These are the edges into the node if the reach is 0, else those that enter the disc. So
        ``entering @ p`` are mean entries; hits are at most that.
        """
        if self.reach > 0.0:
            return self.exposed().entering(self.network.points[self.sites], self.reach)
        row_of = np.full(self.node_count, -1)
        row_of[self.sites] = np.arange(len(self.sites))
        row = row_of[self.network.heads]
        edge = np.flatnonzero(row >= 0)
        shape = (len(self.sites), len(self.network.edges))
        return csr_matrix((np.ones(len(edge)), (row[edge], edge)), shape=shape)

    def exposed(self, edges: IndexArray | None = None) -> ExposedEdges:
        """The parts of edges, by default all, outside the secured area."""
        network = self.network
        return ExposedEdges(network.points, network.edges, self.secured.shrink(self.options.tube),
                            np.array([network.source]), edges)

    def visits(self, p: FloatArray) -> FloatArray:
        """Expected visits x (N,) of each node; 1 at the source."""
        x = sums(self.network.heads, p, self.node_count)
        x[self.network.source] += 1.0
        return x

    def distances_from_source(self, weights: FloatArray) -> FloatArray:
        """Least weight (N,) of a way from the source to each node; inf if unreachable."""
        edges = self.network.edges[self.playable]
        return distances_from(edges, weights[self.playable], self.node_count, self.network.source)

    def distances_to_target(self, weights: FloatArray) -> FloatArray:
        """Least weight (N,) of a way from each node to the target; inf if unreachable."""
        edges = self.network.edges[self.playable][:, ::-1]
        return distances_from(edges, weights[self.playable], self.node_count, self.network.target)

    def least_weights(self, weights: FloatArray) -> FloatArray:
        """Least weight (M,) of a route that uses each edge; inf if not playable."""
        first = self.distances_from_source(weights)[self.network.tails]
        rest = self.distances_to_target(weights)[self.network.heads]
        return np.where(self.playable, first + weights + rest, np.inf)

    def restricted_to(self, edges: BoolArray) -> Game | None:
        """Return the game on routes that use only ``edges`` (M,); None if there are none."""
        network, usable = self.network, self.playable & edges
        useful = on_some_route(network.edges[usable], self.node_count, network.source,
                               network.target)
        if not useful[network.source]:
            return None
        playable = usable & useful[network.tails] & useful[network.heads]
        return replace(self, playable=frozen_array(playable, np.bool_),
                       known_rows=vars(self).get('entering'))

    def avoiding(self, entering: csr_matrix) -> Game | None:
        """Return the game without edges that enter discs, rows (K, M); None if it has no route."""
        return self.restricted_to(np.asarray(entering.getnnz(axis=0) == 0))

    def with_sites(self, points: FloatArray, loss: FloatArray, entering: csr_matrix) -> Game:
        """Return the game with sites added, as nodes (K,) without edges.

        ``entering`` (K, M) has the edges that enter their discs.
        """
        if not len(loss):
            return self
        network = with_places(self.network, points, loss)
        rows = csr_matrix(vstack((self.entering, entering)))
        return replace(self, network=network, known_rows=rows,
                       loss=frozen_array(np.append(self.loss, loss), np.float64))

    def without_sites(self, nodes: BoolArray) -> Game:
        """Return the game in which nobody can wait at ``nodes`` (N,)."""
        return replace(self, loss=frozen_array(np.where(nodes, 0.0, self.loss), np.float64))


def make_game(network: Network, options: GameOptions) -> Game:
    """Make the game of a single leg; raises as ``make_games``."""
    return make_games((network,), options)[0]


def make_games(networks: Sequence[Network], options: GameOptions,
               waits: BoolArray | None = None) -> tuple[Game, ...]:
    """Make the games of a trip's legs, whose networks have the same nodes.

    All legs have the same secured area and sites: all nodes, or if a site stands for all places
    around it (``widened``), nodes without edges, those that ``waits`` (N,) marks, and a selection
    of the others. Raises NoRoute if no playable route leads from the source of a leg to its target.
    """
    ends = np.unique(np.concatenate([each.points[[each.source, each.target]]
                                     for each in networks]), axis=0)
    points, alpha = networks[0].points, networks[0].alpha
    secured = secured_area(ends, options.secured_distance, options.secured_places)
    # A site stands for all places within ``widened``: it is dropped only if all are secured.
    dropped = secured.shrink(options.widened).covers(points)
    if options.widened > 0.0:
        dropped |= ~(_selected_sites(networks, options.reach) | (False if waits is None else waits))
    loss = frozen_array(np.where(dropped, 0.0, alpha), np.float64)
    games = tuple(_leg_game(each, options, loss, secured) for each in networks)
    if options.reach > 0.0:
        return games
    driven = np.zeros(len(points), dtype=bool)
    for game in games:
        driven[game.network.heads[game.playable]] = True
    return tuple(game.without_sites(~driven) for game in games)


def _selected_sites(networks: Sequence[Network], reach: float) -> BoolArray:
    """Mark the nodes (N,) that are sites: one in each square, and those without edges."""
    selected = np.ones(len(networks[0].points), dtype=bool)
    for network in networks:
        selected[network.edges] = False
    driven = np.flatnonzero(~selected)
    squares = np.floor(networks[0].points[driven] / (SITE_SQUARE * reach))
    selected[driven[np.unique(squares, axis=0, return_index=True)[1]]] = True
    return selected


def _leg_game(network: Network, options: GameOptions, loss: FloatArray,
              secured: SecuredArea) -> Game:
    allowed = network.alpha <= options.alpha_threshold
    everywhere = Game(network, options, frozen_array(np.ones(len(network.edges)), np.bool_), loss,
                      secured)
    game = everywhere.restricted_to(allowed[network.tails] & allowed[network.heads])
    if game is None:
        raise _no_route(network, options, int((~allowed).sum()))
    return game


def _no_route(network: Network, options: GameOptions, forbidden: int) -> NoRoute:
    (x, y), (u, v) = network.points[[network.source, network.target]].tolist()
    text = f'no route leads from ({x:.3f}, {y:.3f}) to ({u:.3f}, {v:.3f})'
    if forbidden:
        text += (
            f'; alpha_threshold {options.alpha_threshold:g} discards {forbidden} nodes, raise it'
        )
    return NoRoute(text)
