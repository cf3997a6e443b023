"""The attachment ``strategy.npz``: a strategy with its network, written, read back and checked."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from io import BytesIO
from zipfile import ZipFile, ZipInfo

import numpy as np
from scipy.special import entr

from ..core.arrays import frozen_array, sums
from ..core.certificate import Budget, certify
from ..core.errors import AmbushPlannerError
from ..core.game import Game, GameOptions, make_game
from ..core.network import Network
from ..core.routes import RouteSampler
from ..core.strategy import CERTIFICATE_TOLERANCE, Strategy

STRATEGY_FILE = 'strategy.npz'
NUMBERS = (
    'value', 'lower_bound', 'length_budget', 'length_price', 'shortest_length',
    'expected_length', 'expected_exposure', 'least_exposure', 'exposure_budget', 'exposure_price',
    'edge_entropy', 'route_entropy',
)
_BUDGETS = ('length_budget', 'exposure_budget')
_ARRAYS = ('points', 'alpha', 'edges', 'edge_probability', 'ambush_probability')
_NODE_INDICES = ('source', 'target')
# Of trips with stops: the number of their legs.
_LEGS = 'legs'
# How far an ambush reaches in the game that was solved [m]: with the tube of the driven path.
_REACH = 'reach'
_SINGLE = (*NUMBERS, _REACH)
_NAMES = {*_ARRAYS, *_NODE_INDICES, *_SINGLE}
# Lattices join a node with eight others at most, triangulations with six on average.
_MOST_EDGES_OF_A_NODE = 8
# What a network of a million nodes takes (the most that network.target_nodes asks for): 224
# bytes a node with its edges.
_MOST_BYTES = 2**28
# What any file may unpack to, and otherwise as a multiple of its size: no two edges are the
# same, so that even an empty lattice is packed 13 times only.
_ALWAYS_UNPACKED = 2**24
_MOST_PACKED = 40


class BadStrategy(ValueError):
    """The bytes are no strategy of this format; the text says why."""


def strategy_file(strategy: Strategy) -> bytes:
    """Return the strategy and its network as an npz file (``numpy.load`` reads it)."""
    network = strategy.network
    stream = BytesIO()
    np.savez_compressed(
        stream,
        points=network.points,
        alpha=network.alpha,
        edges=network.edges,
        source=network.source,
        target=network.target,
        edge_probability=strategy.edge_probability,
        ambush_probability=strategy.ambush_probability,
        reach=strategy.game.ambush_radius,
        **({_LEGS: network.legs} if network.legs > 1 else {}),
        **{name: getattr(strategy, name) for name in NUMBERS},
    )
    return stream.getvalue()


def strategy_from_file(data: bytes, options: GameOptions) -> Strategy:
    """Return the strategy in the bytes of a ``strategy.npz``, for the game with these options.

    All that follows from the probabilities is computed again, the certificate too, and must be
    what the file states. Iterations and law are not in the file and come back as 0 and None.

    Raises
    ------
    BadStrategy
        An array is missing or of the wrong shape, a number is not finite, the probabilities are
        no strategy, or a stated number does not follow from them.
    """
    content = arrays_of(data)
    try:
        with warnings.catch_warnings():
            # Edges that the network drops are found by the shape of the probabilities.
            warnings.simplefilter('ignore', UserWarning)
            network = Network(
                content['points'], content['alpha'], content['edges'],
                int(content['source']), int(content['target']),
                legs=int(content.get(_LEGS, 1)),
            )
        game = make_game(network, replace(options, ambush_radius=float(content[_REACH])))
    except AmbushPlannerError as error:
        raise BadStrategy(str(error)) from error
    p = _probabilities(content, 'edge_probability', len(network.edges))
    q = _probabilities(content, 'ambush_probability', len(network.points))
    try:
        strategy = _strategy(game, p, q, content)
    except AmbushPlannerError as error:
        raise BadStrategy(str(error)) from error
    _compare(strategy, content)
    return strategy


def arrays_of(data: bytes) -> dict[str, np.ndarray]:
    """Return the arrays in the bytes of a ``strategy.npz``, checked for shape and size only.

    Raises
    ------
    BadStrategy
        An array is missing, of the wrong shape, or would take more memory than any strategy.
    """
    try:
        _check_sizes(data)
        with np.load(BytesIO(data), allow_pickle=False) as archive:
            content = {name: archive[name] for name in archive.files}
    except BadStrategy:
        raise
    except Exception as error:
        # zipfile, zlib and numpy raise a dozen kinds of errors at bytes that are not theirs.
        raise BadStrategy(f'{STRATEGY_FILE} is damaged ({type(error).__name__})') from error
    for name in _SINGLE:
        number = content[name]
        whole = number.shape == () and number.dtype.kind == 'f' and not np.isnan(number)
        if not whole or (name not in _BUDGETS and not math.isfinite(number)):
            raise BadStrategy(f'{name} is not a finite number')
    for name in (*_NODE_INDICES, _LEGS):
        number = content.get(name, np.array(1))
        if number.shape != () or number.dtype.kind not in 'iu':
            raise BadStrategy(f'{name} is not a whole number')
    return content


def _check_sizes(data: bytes) -> None:
    """Check what the file says of its arrays before any of them takes memory."""
    most = min(_MOST_BYTES, max(_ALWAYS_UNPACKED, _MOST_PACKED * len(data)))
    with ZipFile(BytesIO(data)) as archive:
        entries = archive.infolist()
        size = sum(entry.file_size for entry in entries)
        if size > most:
            raise BadStrategy(f'{STRATEGY_FILE} claims to hold {size} bytes, at most {most} can be')
        names = [entry.filename.removesuffix('.npy') for entry in entries]
        for name in sorted(_NAMES):
            if names.count(name) != 1:
                raise BadStrategy(f'{STRATEGY_FILE} has {names.count(name)} arrays {name!r}, not 1')
        if unknown := sorted(set(names) - _NAMES - {_LEGS}):
            raise BadStrategy(f'{STRATEGY_FILE} has an array {unknown[0][:60]!r}, not known')
        shapes = {name: _shape(archive, entry) for name, entry in zip(names, entries, strict=True)}
    nodes, edges = ((shapes[name] or (0,))[0] for name in ('points', 'edges'))
    expected = {
        'points': (nodes, 2), 'alpha': (nodes,), 'ambush_probability': (nodes,),
        'edges': (edges, 2), 'edge_probability': (edges,),
        **dict.fromkeys((*_NODE_INDICES, *_SINGLE), ()), **({_LEGS: ()} if _LEGS in shapes else {}),
    }
    for name, shape in expected.items():
        if shapes[name] != shape:
            raise BadStrategy(f'{name} must be of the shape {shape}, got {shapes[name]}')
    if edges > _MOST_EDGES_OF_A_NODE * nodes:
        raise BadStrategy(f'{nodes} points cannot have {edges} edges')


def _shape(archive: ZipFile, entry: ZipInfo) -> tuple[int, ...]:
    """The shape that an array's header states, which must be that of the bytes behind it."""
    with archive.open(entry) as file:
        version = np.lib.format.read_magic(file)
        read = (np.lib.format.read_array_header_1_0 if version == (1, 0)
                else np.lib.format.read_array_header_2_0)
        shape, _, dtype = read(file)
        if math.prod(shape) * dtype.itemsize != entry.file_size - file.tell():
            raise BadStrategy(f'{entry.filename[:60]} has not as many bytes as its header states')
    return shape


def _probabilities(content: dict[str, np.ndarray], name: str, size: int) -> np.ndarray:
    values = content[name]
    if values.shape != (size,) or values.dtype.kind != 'f':
        raise BadStrategy(f'{name} must be ({size},) floats, got {values.dtype} {values.shape}')
    if not (np.isfinite(values) & (values >= 0.0)).all():
        raise BadStrategy(f'{name} must be finite and >= 0')
    return frozen_array(values, np.float64)


def _strategy(
    game: Game, p: np.ndarray, q: np.ndarray, content: dict[str, np.ndarray]
) -> Strategy:
    network = game.network
    stated = {name: float(content[name]) for name in NUMBERS}
    length = Budget(
        game, network.lengths, stated['length_budget'], stated['shortest_length'], 'detour', 'm'
    )
    exposure = Budget(
        game, network.edge_exposure, stated['exposure_budget'], stated['least_exposure'],
        'exposure', 'loss x m',
    )
    prices = stated['length_price'], stated['exposure_price']
    certificate = certify(game, p, q, (length, exposure), prices)
    leaving = sums(network.tails, p, game.node_count)
    edge_entropy = float(entr(p).sum())
    return Strategy(
        game=game,
        edge_probability=p,
        visit_probability=frozen_array(game.visits(p), np.float64),
        ambush_probability=q,
        value=certificate.value,
        lower_bound=certificate.bound,
        gap=certificate.value - certificate.bound,
        edge_entropy=edge_entropy,
        # -sum p_ij ln(p_ij / x_i), with x_i as the sum of the p_ij.
        route_entropy=edge_entropy - float(entr(leaving).sum()),
        expected_length=length.mean(p),
        shortest_length=length.least,
        length_budget=length.limit,
        length_price=prices[0],
        expected_exposure=exposure.mean(p),
        least_exposure=exposure.least,
        exposure_budget=exposure.limit,
        exposure_price=prices[1],
        iterations=0,
        law=None,
        _sampler=RouteSampler(network, p),
    )


def _compare(strategy: Strategy, content: dict[str, np.ndarray]) -> None:
    for name in NUMBERS:
        stated, computed = float(content[name]), float(getattr(strategy, name))
        if not math.isclose(stated, computed, rel_tol=CERTIFICATE_TOLERANCE, abs_tol=1e-9):
            raise BadStrategy(
                f'{name} is stated as {stated:.9g}, the probabilities give {computed:.9g}'
            )
