"""Strategy files: read back whole, and refused when anything in them is wrong."""

import io
import zipfile

import numpy as np
import pytest
from ambush_planner.recordings.npz import BadAttachment
from audit_samples import NUMBERS, npz, sample_plan, strategy_arrays
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ambush_planner.game.game import GameOptions
from ambush_planner.recordings.strategy_file import strategy_from_file


@pytest.fixture(scope='module')
def a_plan():
    return sample_plan()


@pytest.mark.parametrize('solver', ['interior_point', 'simplex'])
def test_strategies_of_linear_programs_come_back_too(tmp_path, solver):
    theirs = sample_plan(solver).strategy
    ours = strategy_from_file(npz(strategy_arrays(theirs)), GameOptions(secured_radius=40.0))
    for name in NUMBERS:
        assert getattr(ours, name) == pytest.approx(getattr(theirs, name), rel=1e-9)


def bad_strategies(arrays):
    p, q, edges = (arrays[n] for n in ('edge_probability', 'ambush_probability', 'edges'))
    yield 'edge_probability', p[:-1]
    yield 'edge_probability', p * 0.5
    yield 'edge_probability', np.where(np.arange(len(p)) == 3, np.nan, p)
    yield 'edge_probability', np.where(np.arange(len(p)) == 3, -0.1, p)
    yield 'edge_probability', p[:, None]
    yield 'edge_probability', p.astype(complex)
    yield 'edge_probability', np.array(['x'] * len(p))
    yield 'ambush_probability', q * 2.0
    yield 'ambush_probability', np.full(len(q), np.inf)
    yield 'ambush_probability', np.roll(q, 1)
    yield 'edges', edges[:-1]
    yield 'edges', edges[::-1]
    yield 'edges', np.where(edges == 1, 10**9, edges)
    yield 'edges', edges.astype(float)
    yield 'edges', np.zeros((0, 2), int)
    yield 'points', arrays['points'][:-1]
    yield 'points', arrays['points'] * np.nan
    yield 'points', arrays['points'] * 2.0
    yield 'alpha', arrays['alpha'] + 1.0
    yield 'alpha', arrays['alpha'] * 2.0
    yield 'source', np.array(10**6)
    yield 'source', np.array([0, 1])
    yield 'source', np.array(0.5)
    yield 'source', arrays['target']
    yield 'start', np.ones(3)
    yield 'start', -np.ones(len(q) + 2)
    yield 'value', np.array(np.nan)
    yield 'value', np.array(0.0)
    yield 'value', np.array([1.0])
    yield 'value', np.array('much')
    yield 'lower_bound', np.array(arrays['value'] * 0.9)
    yield 'length_budget', np.array(np.nan)
    yield 'length_price', np.array(np.inf)
    yield 'expected_length', np.array(1.0)
    yield 'edge_entropy', np.array(1.0)
    yield 'route_entropy', np.array(-1.0)
    yield 'edge_probability', np.array([None] * len(p), dtype=object)


def test_strategies_that_are_none_are_refused(a_plan):
    arrays = strategy_arrays(a_plan.strategy)
    options = GameOptions(secured_radius=40.0)
    assert strategy_from_file(npz(arrays), options).value == pytest.approx(a_plan.strategy.value)
    for name, value in bad_strategies(arrays):
        with pytest.raises(BadAttachment):
            strategy_from_file(npz(arrays | {name: value}), options)
    for name in arrays:
        with pytest.raises(BadAttachment, match=name):
            strategy_from_file(npz({n: a for n, a in arrays.items() if n != name}), options)


def test_an_archive_that_claims_too_much_is_not_unpacked(a_plan):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, 'w') as archive:
        archive.writestr('points.npy', b'')
        archive.infolist()[0].file_size = 1025 * 2**20  # as the list of contents states it
    with pytest.raises(BadAttachment, match='claims to hold'):
        strategy_from_file(stream.getvalue(), GameOptions())


def with_entry(arrays, name, header_of, data):
    """The file with an array whose header is another one's."""
    stream = io.BytesIO()
    np.save(stream, header_of)
    header = stream.getvalue()[:-header_of.nbytes]
    stream = io.BytesIO(npz({n: a for n, a in arrays.items() if n != name}))
    with zipfile.ZipFile(stream, 'a') as archive:
        archive.writestr(f'{name}.npy', header + data)
    return stream.getvalue()


def test_sizes_are_checked_before_arrays_are_made(a_plan, monkeypatch):
    arrays = strategy_arrays(a_plan.strategy)
    many = np.zeros((len(arrays['points']) * 9, 2), np.int64)
    files = {
        'as many bytes': with_entry(arrays, 'alpha', np.zeros(10**6), bytes(80)),
        'must be of the shape': npz(arrays | {'alpha': np.zeros(10**6)}),
        "1 arrays 'note', not 0": npz(arrays | {'note': np.zeros(3)}),
    }
    edges = npz(arrays | {'edges': many, 'edge_probability': many[:, 0] * 0.5})
    with pytest.raises(BadAttachment, match='cannot have'):
        strategy_from_file(edges, GameOptions())
    monkeypatch.setattr(np, 'load', lambda *_, **__: pytest.fail('an array was made'))
    for reason, data in files.items():
        with pytest.raises(BadAttachment, match=reason):
            strategy_from_file(data, GameOptions())


@pytest.mark.parametrize('hide', [
    lambda data: b'hidden' + data, lambda data: data + b'hidden',
    lambda data: data[:-2] + b'\6\0hidden',
    lambda data: data.replace(b'PK\1\2', b'hiddenPK\1\2', 1),
], ids=['before', 'behind', 'a comment', 'between'])
def test_nothing_can_be_hidden_beside_the_arrays(a_plan, hide):
    data = npz(strategy_arrays(a_plan.strategy))
    strategy_from_file(data, GameOptions(secured_radius=40.0))
    with pytest.raises(BadAttachment, match='beside its arrays|is damaged'):
        strategy_from_file(hide(data), GameOptions(secured_radius=40.0))


@settings(max_examples=100, deadline=None, derandomize=True, database=None,
          suppress_health_check=list(HealthCheck))
@given(st.data())
def test_bytes_that_were_a_strategy_are_refused_or_the_same(a_plan, data):
    good = bytearray(npz(strategy_arrays(a_plan.strategy)))
    for _ in range(data.draw(st.integers(1, 4))):
        good[data.draw(st.integers(0, len(good) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    end = data.draw(st.one_of(st.none(), st.integers(0, len(good))))
    try:
        strategy = strategy_from_file(bytes(good[:end]), GameOptions(secured_radius=40.0))
    except BadAttachment:
        return
    assert strategy.value == pytest.approx(a_plan.strategy.value)
