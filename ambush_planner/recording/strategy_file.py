"""The attachment ``strategy.npz``: a strategy with its network, written, read back and checked."""

from __future__ import annotations

import math
import warnings
from io import BytesIO
from zipfile import ZipFile, ZipInfo

import numpy as np
from scipy.special import entr

from ..core.arrays import frozen_array, sums
from ..core.errors import AmbushPlannerError
from ..core.game import Game, GameOptions, make_game
from ..core.network import Network
from ..core.routes import RouteSampler
from ..core.strategy import CERTIFICATE_TOLERANCE, CONSERVATION_TOLERANCE, Strategy

STRATEGY_FILE = 'strategy.npz'
NUMBERS = (
    'value', 'lower_bound', 'length_budget', 'length_price', 'shortest_length',
    'expected_length', 'edge_entropy', 'route_entropy',
)
_ARRAYS = ('points', 'alpha', 'edges', 'edge_probability', 'ambush_probability')
_NODE_INDICES = ('source', 'target')
_NAMES = {*_ARRAYS, *_NODE_INDICES, *NUMBERS}
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
        **{name: getattr(strategy, name) for name in NUMBERS},
    )
    return stream.getvalue()


def strategy_from_file(data: bytes, options: GameOptions) -> Strategy:
    """Return the strategy in the bytes of a ``strategy.npz``, for the game with these options.

    All that follows from the probabilities is computed again, the certificate too, and must be
    what the file states. The number of iterations is not in the file and comes back as 0.

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
            )
        game = make_game(network, options)
    except AmbushPlannerError as error:
        raise BadStrategy(str(error)) from error
    p = _probabilities(content, 'edge_probability', len(network.edges))
    q = _probabilities(content, 'ambush_probability', len(network.points))
    if not game.conservation_residual(p) <= 10.0 * CONSERVATION_TOLERANCE:
        raise BadStrategy('edge_probability does not lead one convoy from start to goal')
    if not abs(q.sum() - 1.0) <= CERTIFICATE_TOLERANCE:
        raise BadStrategy(f'ambush_probability sums to {q.sum():.9g}, not to 1')
    strategy = _strategy(game, p, q, content)
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
    for name in NUMBERS:
        number = content[name]
        whole = number.shape == () and number.dtype.kind == 'f' and not np.isnan(number)
        if not whole or (name != 'length_budget' and not math.isfinite(number)):
            raise BadStrategy(f'{name} is not a finite number')
    for name in _NODE_INDICES:
        if content[name].shape != () or content[name].dtype.kind not in 'iu':
            raise BadStrategy(f'{name} is not a node index')
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
        if unknown := sorted(set(names) - _NAMES):
            raise BadStrategy(f'{STRATEGY_FILE} has an array {unknown[0][:60]!r}, not known')
        shapes = {name: _shape(archive, entry) for name, entry in zip(names, entries, strict=True)}
    nodes, edges = ((shapes[name] or (0,))[0] for name in ('points', 'edges'))
    expected = {
        'points': (nodes, 2), 'alpha': (nodes,), 'ambush_probability': (nodes,),
        'edges': (edges, 2), 'edge_probability': (edges,),
        **dict.fromkeys((*_NODE_INDICES, *NUMBERS), ()),
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
    budget, price = float(content['length_budget']), float(content['length_price'])
    value = game.upper_bound(p)
    bound = min(game.lower_bound(q, price, budget), value)
    leaving = sums(network.tails, p, game.node_count)
    edge_entropy = float(entr(p).sum())
    return Strategy(
        game=game,
        edge_probability=p,
        visit_probability=frozen_array(game.visits(p), np.float64),
        ambush_probability=q,
        value=value,
        lower_bound=bound,
        gap=value - bound,
        edge_entropy=edge_entropy,
        # -sum p_ij ln(p_ij / x_i), with x_i as the sum of the p_ij.
        route_entropy=edge_entropy - float(entr(leaving).sum()),
        expected_length=float(p @ network.lengths),
        shortest_length=float(content['shortest_length']),
        length_budget=budget,
        length_price=price,
        iterations=0,
        _sampler=RouteSampler(network, p),
    )


def _compare(strategy: Strategy, content: dict[str, np.ndarray]) -> None:
    for name in NUMBERS:
        stated, computed = float(content[name]), float(getattr(strategy, name))
        if not math.isclose(stated, computed, rel_tol=CERTIFICATE_TOLERANCE, abs_tol=1e-9):
            raise BadStrategy(
                f'{name} is stated as {stated:.9g}, the probabilities give {computed:.9g}'
            )
