"""From a risk map to a network (the paper's section III, table I)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IndexArray
from ..errors import (
    AmbushPlannerError,
    GoalBlocked,
    GoalOutsideMap,
    InvalidNetwork,
    InvalidOption,
    NoRoute,
    StartBlocked,
    StartOutsideMap,
    StopBlocked,
    StopOutsideMap,
)
from ..maps.obstacles import ObstacleField
from ..maps.risk_map import RiskMap
from ..option_checks import check_at_least, check_flag, check_whole
from .layout import FreeSpace, joined
from .network import Network
from .node_sampling import lattice_points, lattice_shape
from .passages import COVERED, passage_nodes, way_by_cells
from .shortest_paths import reachable_from

METHODS = (
    'uniform_delaunay',
    'lattice_delaunay',
    'uniform_grid8',
    'random_delaunay',
    'gradient_delaunay',
)


@dataclass(frozen=True)
class NetworkOptions:
    """How the network is laid over the map.

    Parameters
    ----------
    method
        'uniform_delaunay' (a lattice that prefers no direction), 'lattice_delaunay' (the square
        one, the paper's Method 3), 'uniform_grid8' (2), 'random_delaunay' (1) or
        'gradient_delaunay' (the paper's outlook).
    spacing
        Distance of lattice nodes [m]; random sampling draws as many nodes as the lattice has.
        0: chosen for about ``target_nodes`` nodes, never below the map's resolution.
    clearance
        Distance that nodes and edges keep from obstacle cells [m]; 0: they do not touch any.
    clear_of_edge
        Keep the clearance from the map's outer edge, too. Without it nothing touches the edge.
    seed
        Seed of random sampling. It decides where nodes lie, never which route is drawn.

    Raises
    ------
    InvalidOption
        A value is out of range or of another type.
    """

    method: str = 'uniform_delaunay'
    spacing: float = 0.0
    clearance: float = 0.0
    seed: int = 0
    target_nodes: int = 2500
    clear_of_edge: bool = True

    def __post_init__(self) -> None:
        if not isinstance(self.method, str) or self.method not in METHODS:
            raise InvalidOption(f"method must be one of {', '.join(METHODS)}, got {self.method!r}")
        check_at_least('spacing', self.spacing, 0.0, 'm')
        check_at_least('clearance', self.clearance, 0.0, 'm')
        check_whole('seed', self.seed, 0)
        check_whole('target_nodes', self.target_nodes, 2)
        check_flag('clear_of_edge', self.clear_of_edge)


# A spacing that is far too small for the map is a mistake, not a wish for 10^9 nodes.
MAX_CANDIDATES = 20_000_000
# Of the lattice, to tell how much of it is free: to some 2 % of it.
_TRIED = 4096
# What is raised where an end is off the map, and where it is blocked; else it is a stop.
REFUSED: dict[str, tuple[type[AmbushPlannerError], type[AmbushPlannerError]]] = {
    'start': (StartOutsideMap, StartBlocked),
    'goal': (GoalOutsideMap, GoalBlocked),
}


@dataclass(frozen=True, eq=False)
class Roads:
    """What can be driven, from any place to any other.

    Parameters
    ----------
    points : (N, 2), alpha : (N,)
        The nodes [m] and their losses; 0 at start, stops and goal.
    pairs : (P, 2)
        The nodes that are joined, in both directions.
    visits : tuple of int
        The nodes of start, stops and goal, as they were given; the same one where they meet.
    """

    points: FloatArray
    alpha: FloatArray
    pairs: IndexArray
    visits: tuple[int, ...]

    def network(self, visits: Sequence[int]) -> Network:
        """The network for driving from one of these nodes to the next: a layer for each leg."""
        count, legs = len(self.points), len(visits) - 1
        both = np.concatenate((self.pairs, self.pairs[:, ::-1]))
        layers = []
        for leg, (source, target) in enumerate(pairwise(visits)):
            edges = both[(both[:, 1] != source) & (both[:, 0] != target)]
            layers.append(edges + leg * count)
            if leg + 1 < legs:
                layers[-1][edges[:, 1] == target, 1] += count
        edges = np.concatenate(layers)
        return Network(
            np.tile(self.points, (legs, 1)),
            np.tile(self.alpha, legs),
            edges[np.lexsort((edges[:, 1], edges[:, 0]))],
            visits[0],
            visits[-1] + (legs - 1) * count,
            legs=legs,
        )


def build_network(
    risk_map: RiskMap,
    start_xy: npt.ArrayLike,
    goal_xy: npt.ArrayLike,
    options: NetworkOptions | None = None,
    stops: Iterable[npt.ArrayLike] = (),
) -> Network:
    """Build the network for driving from start to goal, by way of stops; world positions [m].

    Start, stops and goal are nodes at exactly the given positions; each takes the place of its
    nearest lattice node (random sampling: nearest sample). No node lies on the map's outer edge.
    Every pair of joined nodes gives two directed edges, except into the source and out of the
    target of a leg. Where no route leads through, nodes are added in the narrow places of a way
    that the map's cells show. Same inputs, options and seed give the same network, bit for bit.

    Raises
    ------
    StartBlocked, StopBlocked, GoalBlocked
        The position is not finite, off the map, or within the clearance of an obstacle.
    InvalidNetwork
        Two positions that follow one another are the same.
    InvalidOption
        The spacing asks for more than ``MAX_CANDIDATES`` nodes.
    NoRoute
        No route leads from start to goal, or to a stop.
    """
    roads = lay_roads(risk_map, start_xy, goal_xy, options or NetworkOptions(), stops)
    return roads.network(roads.visits)


def lay_roads(
    risk_map: RiskMap,
    start_xy: npt.ArrayLike,
    goal_xy: npt.ArrayLike,
    options: NetworkOptions,
    stops: Iterable[npt.ArrayLike] = (),
) -> Roads:
    """Lay the nodes and join them; raises as ``build_network``."""
    field = ObstacleField(risk_map, options.clear_of_edge)
    asked = _asked(risk_map, field, [start_xy, *stops, goal_xy], options)
    # Different places only, start and goal last.
    places = list(dict.fromkeys([asked[-1], *asked[:1], *asked[-2:0:-1]]))[::-1]
    ends = np.array(places)
    uv_ends = risk_map.to_map_axes(ends)
    ground = FreeSpace(risk_map, field, uv_ends, chosen_spacing(risk_map, options), options)
    begin = places.index(asked[0])
    uv, pairs = joined(ground, np.empty((0, 2)))
    if apart := _apart(pairs, len(uv), len(ends), begin):
        uv, pairs = _through_passages(ground, begin, apart)
    points = risk_map.to_world(uv)
    points[-len(ends):] = ends
    first = len(uv) - len(ends)
    alpha = risk_map.alpha[risk_map.cells(uv)]
    alpha[first:] = 0.0
    return Roads(points, alpha, pairs, tuple(first + places.index(place) for place in asked))


def _apart(pairs: IndexArray, count: int, ends: int, begin: int) -> list[int]:
    """Which of the last ``ends`` nodes no way leads to from the one at ``begin`` among them."""
    first = count - ends
    both = np.concatenate((pairs, pairs[:, ::-1]))
    return np.flatnonzero(~reachable_from(both, count, first + begin)[first:]).tolist()


def _through_passages(
    ground: FreeSpace, begin: int, apart: list[int]
) -> tuple[FloatArray, IndexArray]:
    """Lay nodes along the narrow parts of ways by cells, where the network alone finds none.

    ``apart`` are the ends to which no route leads from the one at ``begin``.

    Raises
    ------
    NoRoute
        There is no such way, or the method has no place for more nodes.
    """
    options, passage = ground.options, np.empty((0, 2))
    for end in apart:
        way, room = _way_to(ground, begin, end)
        if options.method != 'uniform_grid8':
            passage = np.concatenate((passage, passage_nodes(way, room, ground.spacing)))
            passage = np.unique(passage, axis=0) if len(apart) > 1 else passage
    passage = passage[ground.field.clear_points(passage, options.clearance)]
    uv, pairs = joined(ground, passage)
    left = _apart(pairs, len(uv), len(ground.uv_ends), begin)
    if not left:
        return uv, pairs
    way, room = _way_to(ground, begin, left[0])
    finer = max(float(room.min()) / COVERED, ground.risk_map.resolution / 2)
    raise NoRoute(
        f'{_from_to(ground, begin, left[0])} keeps clear of the obstacles at a spacing of '
        f'{ground.spacing:g} m; the map has a way, which a spacing of '
        f'{min(finer, ground.spacing / 2):.3g} m would find'
    )


def _from_to(ground: FreeSpace, begin: int, end: int) -> str:
    ends = ground.risk_map.to_world(ground.uv_ends[[begin, end]])
    return 'no route from ({:.3f}, {:.3f}) to ({:.3f}, {:.3f})'.format(*ends[0], *ends[1])


def _way_to(ground: FreeSpace, begin: int, end: int) -> tuple[FloatArray, FloatArray]:
    """The way by cells from one end to another, and its room; raises NoRoute without one."""
    options, ends = ground.options, ground.uv_ends[[begin, end]]
    way, room = way_by_cells(ground.risk_map, ground.field, ends, options.clearance)
    if len(way) == 0:
        clearance = f' at a clearance of {options.clearance:g} m' if options.clearance else ''
        raise NoRoute(
            f'{_from_to(ground, begin, end)}: obstacles cut the map in two between them'
            f'{clearance}; neither the spacing of {ground.spacing:g} m nor any other leads through'
        )
    return way, room


def chosen_spacing(risk_map: RiskMap, options: NetworkOptions) -> float:
    """Spacing [m]: as given, or (0) for about ``target_nodes`` nodes on the free cells."""
    spacing = options.spacing
    if spacing == 0.0:
        free_area = float((~risk_map.obstacles).sum()) * risk_map.resolution**2
        spacing = max(risk_map.resolution, math.sqrt(free_area / options.target_nodes))
    width, height = risk_map.size
    if width / spacing * height / spacing > MAX_CANDIDATES:
        raise InvalidOption(
            f'spacing {spacing} m on a map of {width:g} m x {height:g} m asks for more than '
            f'{MAX_CANDIDATES} nodes; choose a larger spacing'
        )
    return spacing


def expected_nodes(risk_map: RiskMap, options: NetworkOptions) -> float:
    """About how many nodes a network would have, found without building it.

    Of the positions of the lattice, some are tried; random samples are as many, and about as
    many of them are free.

    Raises
    ------
    InvalidOption
        The spacing asks for more than ``MAX_CANDIDATES`` nodes.
    """
    spacing = chosen_spacing(risk_map, options)
    rows, columns = lattice_shape(risk_map, spacing)
    if rows * columns == 0:
        return 0.0
    tried = np.random.default_rng(0).integers(rows * columns, size=_TRIED)
    cells = np.stack((tried // columns, tried % columns), axis=1)
    uv = lattice_points(cells, spacing, options.method)
    field = ObstacleField(risk_map, options.clear_of_edge)
    free = field.clear_points(uv, options.clearance)
    return rows * columns * float(free.mean())


def _asked(
    risk_map: RiskMap, field: ObstacleField, given: list[npt.ArrayLike], options: NetworkOptions
) -> list[tuple[float, float]]:
    """Start, stops and goal as positions, if all can be driven from one to the next."""
    last = len(given) - 1
    names = ['start', *(f'stop {k}' for k in range(1, last)), 'goal']
    # The ends first: what is wrong with them concerns everybody.
    for k in (0, last, *range(1, last)):
        _check_position(risk_map, field, given[k], names[k], options)
    asked = [(float(x), float(y)) for x, y in np.asarray(given, dtype=np.float64)]
    for (one, a), (other, b) in pairwise(zip(names, asked, strict=True)):
        if a == b:
            raise InvalidNetwork(f'{one} and {other} are the same position, {a}')
    return asked


def _check_position(
    risk_map: RiskMap, field: ObstacleField, xy: npt.ArrayLike, name: str, options: NetworkOptions
) -> None:
    off_map, blocked = REFUSED.get(name, (StopOutsideMap, StopBlocked))
    try:
        position = np.asarray(xy, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as cause:
        raise blocked(f'{name} must be a position (x, y): {cause}') from cause
    if position.shape != (2,):
        raise blocked(f'{name} must be a position (x, y), got shape {position.shape}')
    if not np.isfinite(position).all():
        raise blocked(f'{name} must be finite, got ({position[0]}, {position[1]})')
    where = f'{name} ({position[0]:.3f}, {position[1]:.3f})'
    uv = risk_map.to_map_axes(position)
    if not risk_map.contains(uv):
        width, height = risk_map.size
        raise off_map(
            f'{where} is outside the map, which is {width:g} m x {height:g} m from '
            f'(x, y, yaw) {risk_map.origin}'
        )
    clearance = options.clearance
    if not field.clear_points(uv[None], clearance)[0]:
        edge = " or of the map's edge" if options.clear_of_edge else ''
        near = f' or within the clearance {clearance:g} m of one{edge}' if clearance else ''
        lower = ', or lower the clearance' if clearance else ''
        raise blocked(
            f'{where} lies in an obstacle{near}; move it{lower}. Unknown cells are obstacles '
            'unless they are given a loss'
        )
