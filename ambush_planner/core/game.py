"""The ambush game on a network: who may wait where, what it costs, and bounds on the value.

Letters follow the paper: p (M,) expected uses of each edge, q (N,) the ambusher's probabilities,
z the value, alpha the losses, ``A p = b`` the conservation of flow, ``D`` the losses by site and
edge: row j of ``D p`` is what an ambush at site j costs on average (the paper's equation 1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

from .arrays import frozen_array, sums
from .errors import InvalidOption, NoRoute
from .network import IndexArray, Network
from .paths import distances_from, on_some_route
from .risk_map import FloatArray
from .sites import entering_edges

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class GameOptions:
    """What the ambusher can do and where the convoy may drive.

    Parameters
    ----------
    ambush_radius
        An ambush hits every route that passes within this distance of its site [m]. 0: routes
        through the site's node. Discs that hold the source or the target are no sites.
    secured_radius
        Nobody can wait within this distance of the source or the target [m].
    alpha_threshold
        Nodes whose alpha is over it are not driven through (the paper's "forbid areas").
    ambushers
        Number of sites held at once; only 1 is available.

    Raises
    ------
    InvalidOption
        A value is out of range or not available.
    """

    ambush_radius: float = 0.0
    secured_radius: float = 0.0
    alpha_threshold: float = math.inf
    ambushers: int = 1

    def __post_init__(self) -> None:
        for name in ("ambush_radius", "secured_radius"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InvalidOption(f"{name} must be finite and >= 0 [m], got {value}")
        if not self.alpha_threshold >= 0.0:
            raise InvalidOption(f"alpha_threshold must be >= 0, got {self.alpha_threshold}")
        if self.ambushers != 1:
            raise InvalidOption(
                f"ambushers must be 1, got {self.ambushers}: games against several ambushers at "
                "once are not available"
            )


@dataclass(frozen=True, eq=False)
class Game:
    """A network with the rows and bounds of its ambush game.

    ``playable`` (M,) marks the edges that lie on some route once forbidden nodes are gone;
    ``loss`` (N,) is alpha where an ambush is possible, else 0.
    """

    network: Network
    ambush_radius: float
    playable: BoolArray
    loss: FloatArray

    @property
    def node_count(self) -> int:
        """Number of nodes of the network, N."""
        return len(self.network.points)

    @cached_property
    def sites(self) -> IndexArray:
        """Nodes (S,) where an ambush costs something."""
        return np.flatnonzero(self.loss > 0.0)

    @cached_property
    def hits(self) -> csr_matrix:
        """(S, M) 0/1: which edges' use puts a route in each site's reach.

        Radius 0: the edges into the node. Otherwise the edges that enter the disc: their segment
        meets it and their tail lies outside, so that each passage counts once.
        """
        if self.ambush_radius > 0.0:
            return entering_edges(self.network, self.sites, self.ambush_radius)
        site_of = np.full(self.node_count, -1)
        site_of[self.sites] = np.arange(len(self.sites))
        edge = np.flatnonzero(site_of[self.network.heads] >= 0)
        row = site_of[self.network.heads[edge]]
        shape = (len(self.sites), len(self.network.edges))
        return csr_matrix((np.ones(len(edge)), (row, edge)), shape=shape)

    def site_losses(self, p: FloatArray) -> FloatArray:
        """Mean loss (S,) of an ambush at each site against strategy p: the rows of ``D p``."""
        losses: FloatArray = self.loss[self.sites] * (self.hits @ p)
        return losses

    def upper_bound(self, p: FloatArray) -> float:
        """z(p) = max_j alpha_j x_j: what the best ambush against p costs on average."""
        return float(self.site_losses(p).max(initial=0.0))

    def lower_bound(self, q: FloatArray, length_price: float = 0.0, budget: float = 0.0) -> float:
        """Value that no strategy of expected length <= ``budget`` can beat, given q (N,).

        For every such strategy p, every price >= 0 and every q >= 0 that sums to 1,
        ``z(p) >= q' D p >= q' D p + price (l' p - budget)``, and the right side is at least its
        minimum over single routes: one Dijkstra with the weights ``D' q + price l``.
        """
        price = self.hits.T @ (self.loss * q)[self.sites] + length_price * self.network.lengths
        price = np.maximum(price, 0.0)[self.playable]
        distance = distances_from(
            self.network.edges[self.playable], price, self.node_count, self.network.source
        )
        return float(distance[self.network.target]) - (length_price and length_price * budget)

    def visits(self, p: FloatArray) -> FloatArray:
        """Expected visits x (N,) of each node; the source is visited once more than entered."""
        x = sums(self.network.heads, p, self.node_count)
        x[self.network.source] += 1.0
        return x

    def conservation_residual(self, p: FloatArray) -> float:
        """Largest violation of ``A p = b``: one unit leaves the source and enters the target."""
        network = self.network
        balance = sums(network.tails, p, self.node_count)
        balance -= sums(network.heads, p, self.node_count)
        balance[network.source] -= 1.0
        balance[network.target] += 1.0
        return float(np.abs(balance).max())


def make_game(network: Network, options: GameOptions) -> Game:
    """Apply the options to the network.

    Raises
    ------
    NoRoute
        Nothing leads from the source to the target, perhaps because of ``alpha_threshold``.
    """
    allowed = network.alpha <= options.alpha_threshold
    usable = allowed[network.tails] & allowed[network.heads]
    count = len(network.points)
    useful = on_some_route(network.edges[usable], count, network.source, network.target)
    if not useful[network.source]:
        reason = (
            f"; alpha_threshold {options.alpha_threshold:g} discards {int((~allowed).sum())} nodes "
            "on the way, allow more"
            if not allowed.all()
            else ""
        )
        ends = network.points[[network.source, network.target]].tolist()
        raise NoRoute("no route leads from ({:.3f}, {:.3f}) to ({:.3f}, {:.3f})".format(
            *ends[0], *ends[1]) + reason)
    playable = usable & useful[network.tails] & useful[network.heads]
    loss = np.where(useful & _possible_sites(network, options), network.alpha, 0.0)
    return Game(
        network,
        options.ambush_radius,
        frozen_array(playable, np.bool_),
        frozen_array(loss, np.float64),
    )


def without_sites(game: Game, nodes: BoolArray) -> Game:
    """The game in which nobody can wait at ``nodes`` (N,)."""
    return replace(game, loss=frozen_array(np.where(nodes, 0.0, game.loss), np.float64))


def _possible_sites(network: Network, options: GameOptions) -> BoolArray:
    """Nodes (N,) where the ambusher can wait."""
    ends = network.points[[network.source, network.target]]
    gap = np.linalg.norm(network.points[:, None, :] - ends, axis=2).min(axis=1)
    # A radius of 0 is none: nodes may share the place of the ends, as where places do not matter.
    radius = max(options.secured_radius, options.ambush_radius)
    possible: BoolArray = (gap > radius) | (radius == 0.0)
    return possible
