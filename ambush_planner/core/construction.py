"""From a risk map to a network (the paper's section III, table I)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .arrays import FloatArray, IndexArray
from .errors import (
    GoalBlocked,
    GoalOutsideMap,
    InvalidNetwork,
    InvalidOption,
    NoRoute,
    StartBlocked,
    StartOutsideMap,
)
from .layout import Ground, joined
from .network import Network
from .obstacles import ObstacleField
from .options import check_at_least, check_flag, check_whole
from .passages import COVERED, passage_nodes, way_by_cells
from .paths import reachable_from
from .risk_map import RiskMap
from .sampling import lattice_points, lattice_shape

METHODS = (
    "uniform_delaunay",
    "lattice_delaunay",
    "uniform_grid8",
    "random_delaunay",
    "gradient_delaunay",
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

    method: str = "uniform_delaunay"
    spacing: float = 0.0
    clearance: float = 0.0
    seed: int = 0
    target_nodes: int = 2500
    clear_of_edge: bool = True

    def __post_init__(self) -> None:
        if not isinstance(self.method, str) or self.method not in METHODS:
            raise InvalidOption(f"method must be one of {', '.join(METHODS)}, got {self.method!r}")
        check_at_least("spacing", self.spacing, 0.0, "m")
        check_at_least("clearance", self.clearance, 0.0, "m")
        check_whole("seed", self.seed, 0)
        check_whole("target_nodes", self.target_nodes, 2)
        check_flag("clear_of_edge", self.clear_of_edge)


# A spacing that is far too small for the map is a mistake, not a wish for 10^9 nodes.
MAX_CANDIDATES = 20_000_000
# Of the lattice, to tell how much of it is free: to some 2 % of it.
_TRIED = 4096


def build_network(
    risk_map: RiskMap,
    start_xy: npt.ArrayLike,
    goal_xy: npt.ArrayLike,
    options: NetworkOptions | None = None,
) -> Network:
    """Build the network for driving from start to goal, both world positions [m].

    Start and goal are nodes at exactly the given positions; each takes the place of its nearest
    lattice node (random sampling: nearest sample). No node lies on the map's outer edge. Every pair
    of joined nodes gives two directed edges, except into the source and out of the target. Where
    no route leads through, nodes are added in the narrow places of a way that the map's cells show.
    Same inputs, options and seed give the same network, bit for bit.

    Raises
    ------
    StartBlocked, GoalBlocked
        The position is not finite, off the map, or within the clearance of an obstacle.
    InvalidNetwork
        Start and goal are the same position.
    InvalidOption
        The spacing asks for more than ``MAX_CANDIDATES`` nodes.
    NoRoute
        No route leads from start to goal.
    """
    options = options or NetworkOptions()
    field = ObstacleField(risk_map, options.clear_of_edge)
    ends = np.stack([_position(start_xy, StartBlocked), _position(goal_xy, GoalBlocked)])
    uv_ends = risk_map.to_map_axes(ends)
    _check_ends(risk_map, field, ends, uv_ends, options)
    ground = Ground(risk_map, field, uv_ends, chosen_spacing(risk_map, options), options)
    uv, pairs = joined(ground, np.empty((0, 2)))
    if not _leads_through(pairs, len(uv)):
        uv, pairs = _through_a_passage(ground)
    points = risk_map.to_world(uv)
    points[-2:] = ends
    return Network(points, _losses(risk_map, uv), _directed(pairs, len(uv)), *_ends(len(uv)))


def _leads_through(pairs: IndexArray, count: int) -> bool:
    source, target = _ends(count)
    return bool(reachable_from(np.concatenate((pairs, pairs[:, ::-1])), count, source)[target])


def _through_a_passage(ground: Ground) -> tuple[FloatArray, IndexArray]:
    """Lay nodes along the narrow parts of a way by cells, where the network alone finds none.

    Raises
    ------
    NoRoute
        There is no such way, or the method has no place for more nodes.
    """
    options = ground.options
    way, room = way_by_cells(ground.risk_map, ground.field, ground.uv_ends, options.clearance)
    ends = ground.risk_map.to_world(ground.uv_ends)
    where = "no route from ({:.3f}, {:.3f}) to ({:.3f}, {:.3f})".format(*ends[0], *ends[1])
    if len(way) == 0:
        clearance = f" at a clearance of {options.clearance:g} m" if options.clearance else ""
        raise NoRoute(
            f"{where}: obstacles cut the map in two between them{clearance}; neither the spacing "
            f"of {ground.spacing:g} m nor any other leads through"
        )
    if options.method != "uniform_grid8":
        passage = passage_nodes(way, room, ground.spacing)
        passage = passage[ground.field.clear_points(passage, options.clearance)]
        uv, pairs = joined(ground, passage)
        if _leads_through(pairs, len(uv)):
            return uv, pairs
    finer = max(float(room.min()) / COVERED, ground.risk_map.resolution / 2)
    raise NoRoute(
        f"{where} keeps clear of the obstacles at a spacing of {ground.spacing:g} m; the map has "
        f"a way, which a spacing of {min(finer, ground.spacing / 2):.3g} m would find"
    )


def chosen_spacing(risk_map: RiskMap, options: NetworkOptions) -> float:
    """Spacing [m]: as given, or (0) for about ``target_nodes`` nodes on the free cells."""
    spacing = options.spacing
    if spacing == 0.0:
        free_area = float((~risk_map.obstacles).sum()) * risk_map.resolution**2
        spacing = max(risk_map.resolution, math.sqrt(free_area / options.target_nodes))
    width, height = risk_map.size
    if width / spacing * height / spacing > MAX_CANDIDATES:
        raise InvalidOption(
            f"spacing {spacing} m on a map of {width:g} m x {height:g} m asks for more than "
            f"{MAX_CANDIDATES} nodes; choose a larger spacing"
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


def _position(xy: npt.ArrayLike, error: type[StartBlocked] | type[GoalBlocked]) -> FloatArray:
    position = np.asarray(xy, dtype=np.float64)
    name = "start" if error is StartBlocked else "goal"
    if position.shape != (2,):
        raise error(f"{name} must be a position (x, y), got shape {position.shape}")
    if not np.isfinite(position).all():
        raise error(f"{name} must be finite, got ({position[0]}, {position[1]})")
    return position


def _check_ends(
    risk_map: RiskMap,
    field: ObstacleField,
    ends: FloatArray,
    uv: FloatArray,
    options: NetworkOptions,
) -> None:
    width, height = risk_map.size
    clearance = options.clearance
    for k, (name, off_map, blocked) in enumerate(
        (("start", StartOutsideMap, StartBlocked), ("goal", GoalOutsideMap, GoalBlocked))
    ):
        where = f"{name} ({ends[k, 0]:.3f}, {ends[k, 1]:.3f})"
        if not risk_map.contains(uv[k]):
            raise off_map(
                f"{where} is outside the map, which is {width:g} m x {height:g} m from "
                f"(x, y, yaw) {risk_map.origin}"
            )
        if not field.clear_points(uv[k : k + 1], clearance)[0]:
            edge = " or of the map's edge" if options.clear_of_edge else ""
            near = f" or within the clearance {clearance:g} m of one{edge}" if clearance else ""
            lower = ", or lower the clearance" if clearance else ""
            raise blocked(
                f"{where} lies in an obstacle{near}; move it{lower}. Unknown cells are obstacles "
                "unless they are given a loss"
            )
    if np.array_equal(ends[0], ends[1]):
        raise InvalidNetwork(f"start and goal are the same position, {tuple(ends[0].tolist())}")


def _ends(count: int) -> tuple[int, int]:
    """Source and target are the last two nodes."""
    return count - 2, count - 1


def _losses(risk_map: RiskMap, uv: FloatArray) -> FloatArray:
    alpha = risk_map.alpha[risk_map.cells(uv)]
    alpha[-2:] = 0.0
    return alpha


def _directed(pairs: IndexArray, count: int) -> IndexArray:
    """Both directions of each pair, without edges into the source or out of the target, sorted."""
    source, target = _ends(count)
    edges = np.concatenate((pairs, pairs[:, ::-1]))
    edges = edges[(edges[:, 1] != source) & (edges[:, 0] != target)]
    return edges[np.lexsort((edges[:, 1], edges[:, 0]))]


