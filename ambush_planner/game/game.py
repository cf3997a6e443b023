"""The ambush game on a network: where the convoy may drive, who may wait where, what it costs.

Letters follow the paper: p (M,) expected uses of each edge, x (N,) visits, q (N,) the ambusher's
probabilities, z the value, alpha the losses, ``A p = b`` the conservation of flow, ``D`` the
losses by site and edge: row j of ``D p`` is what an ambush at site j costs on average (the
paper's equation 1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import BoolArray, FloatArray, IndexArray, frozen_array, sums
from ..errors import InvalidOption, NoRoute
from ..network.network import Network
from ..network.shortest_paths import distances_from, on_some_route
from ..option_checks import check_at_least, check_flag, check_whole
from .discs import entering_edges, near_ends


@dataclass(frozen=True)
class GameOptions:
    """What the ambusher can do and where the convoy may drive.

    Parameters
    ----------
    ambush_radius
        An ambush hits every route that passes within this distance of its site [m]. 0: routes
        through the site's node. Discs that hold the source, a stop or the target are no sites.
    secured_radius
        Nobody can wait within this distance of the source, a stop or the target [m].
    alpha_threshold
        Nodes whose alpha is over it are not driven through (the paper's "forbid areas"). With a
        reach the ambusher can wait there all the same.
    ambushers
        Number of different sites held at once; their losses add up.
    ambush_in_obstacles
        With a reach, the ambusher can also hide in obstacle cells: a plan makes them nodes that
        no edge leads to.

    Raises
    ------
    InvalidOption
        A value is out of range or of another type.
    """

    ambush_radius: float = 0.0
    secured_radius: float = 0.0
    alpha_threshold: float = math.inf
    ambushers: int = 1
    ambush_in_obstacles: bool = False

    def __post_init__(self) -> None:
        check_at_least('ambush_radius', self.ambush_radius, 0.0, 'm')
        check_at_least('secured_radius', self.secured_radius, 0.0, 'm')
        check_at_least('alpha_threshold', self.alpha_threshold, 0.0, finite=False)
        check_whole('ambushers', self.ambushers, 1)
        check_flag('ambush_in_obstacles', self.ambush_in_obstacles)


@dataclass(frozen=True, eq=False)
class Game:
    """A network with the rows of its ambush game.

    ``playable`` (M,) marks the edges that lie on some route once forbidden nodes are gone;
    ``loss`` (N,) is alpha where an ambush is possible, else 0. Where a trip has several legs, an
    ambush hits them all: each place is one site, and its hits add up over the layers.
    """

    network: Network
    ambush_radius: float
    ambushers: int
    playable: BoolArray
    loss: FloatArray

    @property
    def node_count(self) -> int:
        """Number of nodes of the network, N."""
        return len(self.network.points)

    @cached_property
    def sites(self) -> IndexArray:
        """Nodes (S,) where an ambush costs something; those of the first layer."""
        return np.flatnonzero(self.loss[: self.network.place_count] > 0.0)

    @cached_property
    def hits(self) -> csr_matrix:
        """(S, M) 0/1: which edges' use puts a route in each site's reach.

        Radius 0: the edges into the node. Otherwise the edges that enter the disc.
        """
        if self.ambush_radius > 0.0:
            return entering_edges(self.network, self.sites, self.ambush_radius)
        site_of = np.full(self.network.place_count, -1)
        site_of[self.sites] = np.arange(len(self.sites))
        site = site_of[self.network.places[self.network.heads]]
        edge = np.flatnonzero(site >= 0)
        row = site[edge]
        shape = (len(self.sites), len(self.network.edges))
        return csr_matrix((np.ones(len(edge)), (row, edge)), shape=shape)

    def site_losses(self, p: FloatArray) -> FloatArray:
        """Mean loss (S,) of an ambush at each site against strategy p: the rows of ``D p``."""
        losses: FloatArray = self.loss[self.sites] * (self.hits @ p)
        return losses

    def mean_loss_on_edges(self, q: FloatArray) -> FloatArray:
        """``D' q`` (M,): what the ambusher's strategy q (N,) costs on average on each edge."""
        on_edges: FloatArray = self.hits.T @ (self.loss * q)[self.sites]
        return on_edges

    def visits(self, p: FloatArray) -> FloatArray:
        """Expected visits x (N,) of each node; the source is visited once more than entered."""
        x = sums(self.network.heads, p, self.node_count)
        x[self.network.source] += 1.0
        return x

    def distances_ahead(self, weights: FloatArray) -> FloatArray:
        """Least weight (N,) of a way to each node from the source; inf where there is none."""
        edges = self.network.edges[self.playable]
        return distances_from(edges, weights[self.playable], self.node_count, self.network.source)

    def distances_behind(self, weights: FloatArray) -> FloatArray:
        """Least weight (N,) of a way from each node to the target; inf where there is none."""
        edges = self.network.edges[self.playable][:, ::-1]
        return distances_from(edges, weights[self.playable], self.node_count, self.network.target)

    def through(self, weights: FloatArray) -> FloatArray:
        """Least weight (M,) of a route by way of each edge; inf off the playable ones."""
        ahead = self.distances_ahead(weights)[self.network.tails]
        behind = self.distances_behind(weights)[self.network.heads]
        return np.where(self.playable, ahead + weights + behind, np.inf)

    def restricted_to(self, edges: BoolArray) -> Game | None:
        """The game on those of ``edges`` (M,) that still lie on a route; None if there is none."""
        network, usable = self.network, self.playable & edges
        useful = on_some_route(
            network.edges[usable], self.node_count, network.source, network.target
        )
        if not useful[network.source]:
            return None
        kept = usable & useful[network.tails] & useful[network.heads]
        return replace(self, playable=frozen_array(kept, np.bool_))

    def past_all_sites(self) -> Game | None:
        """The game on the edges that no ambush hits; None if no route is left."""
        return self.restricted_to(np.asarray(self.hits.getnnz(axis=0) == 0))

    def without_sites(self, nodes: BoolArray) -> Game:
        """The game in which nobody can wait at ``nodes`` (N,)."""
        return replace(self, loss=frozen_array(np.where(nodes, 0.0, self.loss), np.float64))


def make_game(network: Network, options: GameOptions) -> Game:
    """Apply the options to the network.

    Raises
    ------
    NoRoute
        Nothing leads from the source to the target, perhaps because of ``alpha_threshold``.
    InvalidOption
        There are more ambushers than nodes.
    """
    if options.ambushers > network.place_count:
        raise InvalidOption(
            f'{options.ambushers} ambushers need as many different sites, and the network has '
            f'{network.place_count} nodes'
        )
    allowed = network.alpha <= options.alpha_threshold
    everywhere = Game(
        network,
        options.ambush_radius,
        options.ambushers,
        frozen_array(np.ones(len(network.edges)), np.bool_),
        frozen_array(np.where(_possible_sites(network, options), network.alpha, 0.0), np.float64),
    )
    game = everywhere.restricted_to(allowed[network.tails] & allowed[network.heads])
    if game is None:
        raise NoRoute(_no_route(network, options, int((~allowed).sum())))
    if options.ambush_radius > 0.0:
        return game
    places = network.places
    driven = np.zeros(network.place_count, dtype=bool)
    driven[places[network.heads[game.playable]]] = True
    return game.without_sites(~driven[places])


def _no_route(network: Network, options: GameOptions, forbidden: int) -> str:
    (x, y), (u, v) = network.points[[network.source, network.target]].tolist()
    text = f'no route leads from ({x:.3f}, {y:.3f}) to ({u:.3f}, {v:.3f})'
    if forbidden == 0:
        return text
    return (
        f'{text}; alpha_threshold {options.alpha_threshold:g} discards {forbidden} nodes, allow '
        'more'
    )


def _possible_sites(network: Network, options: GameOptions) -> BoolArray:
    """Nodes (N,) where the ambusher can wait."""
    # A radius of 0 is none: nodes may share the place of the ends, as where places do not matter.
    radius = max(options.secured_radius, options.ambush_radius)
    if radius == 0.0:
        return np.ones(len(network.points), dtype=bool)
    return ~near_ends(network, radius)
