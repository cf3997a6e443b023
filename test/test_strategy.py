"""Laws of every published strategy, by independent answers; one value by all solvers; errors."""

from __future__ import annotations

import numpy as np
import pytest
from games import (
    NASTY,
    PLAIN,
    connected_flow,
    exact_value,
    examples,
    is_acyclic,
    least_weight,
    networks,
    paper_example,
    quiet_network,
    terrain_network,
    terrain_networks,
    value_range,
)
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import (
    BudgetInfeasible,
    GameOptions,
    InvalidOption,
    NoRoute,
    StrategyOptions,
    TimeLimit,
    solve,
)

SOLVERS = ("max_entropy", "interior_point", "simplex")
DETOURS = (1.0, 1.01, 1.05, 1.2, 1.5, np.inf)


def check_laws(strategy, max_detour: float, solver: str = "max_entropy") -> None:
    """What holds for every strategy in a game with ambush radius 0 and nothing secured."""
    network, p, q = strategy.network, strategy.edge_probability, strategy.ambush_probability
    check_flow(network, p, solver)
    visits = np.bincount(network.heads, weights=p, minlength=len(q))
    visits[network.source] = 1.0
    assert strategy.visit_probability == pytest.approx(visits, abs=1e-12)
    assert q.min() >= 0.0 and q.sum() == pytest.approx(1.0, abs=1e-9)
    assert strategy.value == pytest.approx((network.alpha * visits).max(), rel=1e-12)
    assert strategy.gap == strategy.value - strategy.lower_bound >= 0.0
    check_bound(strategy)
    assert strategy.expected_length == pytest.approx(p @ network.lengths, rel=1e-12)
    shortest = least_weight(network, network.lengths)
    assert strategy.shortest_length == pytest.approx(shortest, rel=1e-12)
    assert strategy.expected_length <= max_detour * shortest * (1 + 1e-6)
    check_entropies(strategy)


def check_flow(network, p, solver: str) -> None:
    """One unit from source to target; without cycles from the default solver."""
    assert p.min() >= 0.0
    balance = np.bincount(network.tails, weights=p, minlength=len(network.points))
    balance -= np.bincount(network.heads, weights=p, minlength=len(network.points))
    balance[[network.source, network.target]] -= (1.0, -1.0)
    assert np.abs(balance).max() < 1e-8
    assert connected_flow(network, p) == pytest.approx(1.0, abs=1e-7)
    if solver == "max_entropy":
        assert is_acyclic(network, p)
        assert p.max() <= 1.0 + 1e-12


def check_bound(strategy) -> None:
    """Weak duality by a plain Dijkstra: q and the price of length prove the lower bound."""
    network, price = strategy.network, strategy.length_price
    weights = (strategy.ambush_probability * network.alpha)[network.heads]
    least = least_weight(network, weights + price * network.lengths)
    bound = least - (price * strategy.length_budget if price else 0.0)
    assert strategy.lower_bound <= bound + 1e-9 * max(strategy.value, least)
    assert price >= 0.0


def check_value(strategy, max_detour: float) -> None:
    """The value is the linear program's."""
    network = strategy.network
    least, most = value_range(network, max_detour * least_weight(network, network.lengths))
    assert least <= strategy.value <= most


def check_entropies(strategy) -> None:
    p, tails = strategy.edge_probability, strategy.network.tails
    used = p > 0.0
    leaving = np.bincount(tails, weights=p)[tails]
    edge = -(p[used] * np.log(p[used])).sum()
    route = -(p[used] * np.log(p[used] / leaving[used])).sum()
    assert strategy.edge_entropy == pytest.approx(edge, rel=1e-9, abs=1e-9)
    assert strategy.route_entropy == pytest.approx(route, rel=1e-9, abs=1e-9)


@examples(300)
@given(networks(), st.sampled_from(DETOURS))
def test_default_solver_on_any_network(network, max_detour):
    strategy = solve(network, options=StrategyOptions(max_detour=max_detour))
    check_laws(strategy, max_detour)
    check_value(strategy, max_detour)


@examples(200)
@given(networks(alphas=NASTY))
def test_default_solver_with_losses_from_1e_9_to_1e9(network):
    strategy = solve(network, options=StrategyOptions(max_detour=np.inf))
    check_laws(strategy, np.inf)
    top = network.alpha.max()
    assert strategy.value == pytest.approx(float(exact_value(network)), rel=1e-6, abs=1e-12 * top)


@examples(100)
@given(networks(alphas=NASTY), st.sampled_from(DETOURS))
def test_budgets_with_losses_from_1e_9_to_1e9(network, max_detour):
    check_laws(solve(network, options=StrategyOptions(max_detour=max_detour)), max_detour)


@examples(200)
@given(networks(), st.sampled_from(DETOURS), st.sampled_from(SOLVERS[1:]))
def test_linear_programs_on_any_network(network, max_detour, solver):
    strategy = solve(network, options=StrategyOptions(solver, max_detour))
    check_laws(strategy, max_detour, solver)
    check_value(strategy, max_detour)


@examples(60)
@given(terrain_networks, st.sampled_from(DETOURS))
def test_all_solvers_find_one_value_on_terrain(network, max_detour):
    for solver in SOLVERS:
        strategy = solve(network, options=StrategyOptions(solver, max_detour))
        check_laws(strategy, max_detour, solver)
        check_value(strategy, max_detour)


@examples(60)
@given(networks(alphas=PLAIN), st.sampled_from((0.01, 0.1, 1.0)), st.sampled_from(DETOURS))
def test_risk_slack_buys_entropy_and_costs_no_more_than_it_says(network, slack, max_detour):
    strict = solve(network, options=StrategyOptions(max_detour=max_detour))
    loose = solve(network, options=StrategyOptions(max_detour=max_detour, risk_slack=slack))
    check_laws(loose, max_detour)
    assert loose.value <= (1 + slack) * strict.value * (1 + 1e-6) + 1e-9
    assert loose.lower_bound <= strict.value


@examples(60)
@given(terrain_networks)
def test_the_value_falls_as_the_budget_grows(network):
    values = [solve(network, options=StrategyOptions(max_detour=d)).value for d in DETOURS]
    for tight, loose in zip(values[:-1], values[1:], strict=True):
        assert loose <= tight * (1 + 1e-6) + 1e-9


def test_equal_inputs_give_equal_strategies():
    one, two = (solve(terrain_network(3)) for _ in range(2))
    assert np.array_equal(one.edge_probability, two.edge_probability)


def test_published_arrays_are_read_only():
    strategy = solve(paper_example())
    for name in ("edge_probability", "visit_probability", "ambush_probability"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(strategy, name)[0] = 0.5


def test_mean_direction_is_the_mean_of_the_next_steps():
    network = quiet_network(
        [[0, 0], [3, 4], [3, -4], [6, 0]], [0, 1, 1, 0], [(0, 1), (0, 2), (1, 3), (2, 3)], 0, 3
    )
    direction = solve(network).mean_direction()
    expected = [[0.6, 0.0], [0.6, -0.8], [0.6, 0.8], [0.0, 0.0]]
    assert direction == pytest.approx(np.array(expected), abs=1e-6)


def test_a_budget_that_binds_by_hand():
    # Straight: length 2, loss 4. Round: length 4, loss 4. Half and half needs 1.5 times the
    # shortest; with 1.25 a quarter may go round: the straight node is met 3 / 4 of the time.
    height = np.sqrt(3.0)
    network = quiet_network(
        [[0, 0], [1, 0], [1, height], [2, 0]], [0, 4, 4, 0], [(0, 1), (0, 2), (1, 3), (2, 3)], 0, 3
    )
    for solver in SOLVERS:
        values = [
            solve(network, options=StrategyOptions(solver, detour)).value
            for detour in (1.0, 1.25, 1.5, np.inf)
        ]
        assert values == pytest.approx([4.0, 3.0, 2.0, 2.0], rel=1e-5)


@pytest.mark.parametrize("solver", SOLVERS)
def test_no_time_at_all_is_a_time_limit(solver):
    network = terrain_network(1, cells=40)
    with pytest.raises(TimeLimit, match="time is up"):
        solve(network, options=StrategyOptions(solver, time_limit=1e-6))


@pytest.mark.parametrize("solver", SOLVERS)
def test_no_route(solver):
    network = quiet_network([[0, 0], [1, 0], [2, 0]], [0, 1, 0], [(0, 1)], 0, 2)
    with pytest.raises(NoRoute, match=r"from \(0.000, 0.000\) to \(2.000, 0.000\)"):
        solve(network, options=StrategyOptions(solver))


@pytest.mark.parametrize("solver", SOLVERS)
def test_no_edges_at_all_is_no_route(solver):
    with pytest.raises(NoRoute):
        solve(quiet_network([[0, 0], [1, 0]], [0, 0], [], 0, 1), options=StrategyOptions(solver))


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_forbidden_shortest_route_makes_a_tight_budget_infeasible(solver):
    network = quiet_network(
        [[0, 0], [1, 0], [1, 2], [2, 0]], [0, 9, 1, 0], [(0, 1), (0, 2), (1, 3), (2, 3)], 0, 3
    )
    with pytest.raises(BudgetInfeasible, match=r"budget of 2\.400 m"):
        solve(network, GameOptions(alpha_threshold=5.0), StrategyOptions(solver, 1.2))


@pytest.mark.parametrize(
    "name, value",
    [
        ("solver", "magic"),
        ("solver", None),
        ("max_detour", 0.99),
        ("max_detour", np.nan),
        ("max_detour", -np.inf),
        ("risk_slack", -0.1),
        ("risk_slack", np.nan),
        ("risk_slack", np.inf),
        ("length_weight", -0.1),
        ("length_weight", 1.0),
        ("length_weight", np.nan),
        ("time_limit", 0.0),
        ("time_limit", -1.0),
        ("time_limit", np.nan),
    ],
)
def test_options_out_of_range_are_named(name, value):
    with pytest.raises(InvalidOption, match=name) as caught:
        StrategyOptions(**{name: value})
    assert str(value) in str(caught.value)


def test_options_that_do_not_go_together_are_named():
    with pytest.raises(InvalidOption, match=r"length_weight 0\.1 .* max_detour"):
        StrategyOptions(length_weight=0.1)
    with pytest.raises(InvalidOption, match="risk_slack .* simplex"):
        StrategyOptions("simplex", risk_slack=0.1)
