"""The attachment ``strategy.npz``: a strategy with its network, read back and checked."""

from __future__ import annotations

import math
import warnings
from io import BytesIO
from zipfile import ZipFile

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
# As much as a network of ten million edges takes.
_MOST_BYTES = 2**30


class BadStrategy(ValueError):
    """The bytes are no strategy of this format; the text says why."""


def strategy_from_file(data: bytes, options: GameOptions) -> Strategy:
    """Return the strategy in the bytes of a ``strategy.npz``, for the game with these options.

    All that follows from the probabilities is computed again, the certificate too, and must be
    what the file states. The number of iterations is not in the file and comes back as 0.

    Raises:
        BadStrategy: An array is missing or of the wrong shape, a number is not finite, the
            probabilities are no strategy, or a stated number does not follow from them.
    """
    content = _content(data)
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


def _content(data: bytes) -> dict[str, np.ndarray]:
    try:
        with ZipFile(BytesIO(data)) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > _MOST_BYTES:
            raise BadStrategy(f'{STRATEGY_FILE} claims to hold {size} bytes')
        with np.load(BytesIO(data), allow_pickle=False) as archive:
            content = {name: archive[name] for name in archive.files}
    except BadStrategy:
        raise
    except Exception as error:
        # zipfile, zlib and numpy raise a dozen kinds of errors at bytes that are not theirs.
        raise BadStrategy(f'{STRATEGY_FILE} is damaged ({type(error).__name__})') from error
    for name in (*_ARRAYS, *NUMBERS, 'source', 'target'):
        if name not in content:
            raise BadStrategy(f'{STRATEGY_FILE} has no array {name!r}')
    for name in NUMBERS:
        number = content[name]
        whole = number.shape == () and number.dtype.kind == 'f' and not np.isnan(number)
        if not whole or (name != 'length_budget' and not math.isfinite(number)):
            raise BadStrategy(f'{name} is not a finite number')
    for name in ('source', 'target'):
        if content[name].shape != () or content[name].dtype.kind not in 'iu':
            raise BadStrategy(f'{name} is not a node index')
    return content


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
