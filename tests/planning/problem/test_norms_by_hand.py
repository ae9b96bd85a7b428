"""Norms of controls written by hand are those of vector controls, absolute values those of split ones."""

from __future__ import annotations

import warnings
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from testing.constructed_solutions import interval
from testing.internals import build_phase_guess, reformulate_problem
from testing.models import one_phase

import gnc_opt as go
from gnc_opt.planning.problem.reformulation.vector_norm_reformulation import read_norm_limits

DURATION = 3.0
FUEL = DURATION - np.sqrt(DURATION**2 - 4)
"""Of one unit, rest to rest, acceleration at most 1: two burns of half of it (problems.classics.minimum_fuel)."""


def by_hand(limit: Any, kind: str = "vector") -> go.Problem:
    """A unit of travel with a thrust (T_x, T_y) and another control d in [0, 1], that costs unless a cost is returned.

    The thrust is one control, or two.
    """
    model = go.Model("cart")
    r, v = model.state("r", 2), model.state("v", 2)
    if kind == "vector":
        T: Any = model.control("T", 2, unit="N")
    else:
        T = ca.vertcat(model.control("T_x", unit="N"), model.control("T_y", unit="N"))
    d = model.control("d")
    model.ode({r: v, v: T})
    problem, leg = one_phase("p", model, 0.0, DURATION)
    leg.initial(r=[0.0, 0.0], v=[0.0, 0.0])
    leg.final(r=[0.6, -0.8], v=[0.0, 0.0])
    leg.bounds(d=(0.0, 1.0))
    cost = limit(leg, T, d)
    problem.minimize(leg.integral(d if cost is None else cost))
    return problem


def leg_of(limit: Any, kind: str = "vector") -> Any:
    """The phase that is solved."""
    return reformulate_problem(by_hand(limit, kind)).phases["leg"]


SLACK = {
    "squared": lambda leg, T, d: leg.path("n", T.T @ T - d**2, upper=0.0),
    "four times": lambda leg, T, d: leg.path("n", 4 * d**2 - 4 * ca.dot(T, T), lower=0.0),
    "root": lambda leg, T, d: leg.path("n", ca.norm_2(T) - d, upper=0.0),
    "hypot": lambda leg, T, d: leg.path("n", 2 * d - 2 * ca.hypot(T[0], T[1]), lower=0.0),
}
RANGE = {
    "squared": lambda leg, T, d: (
        leg.path("n", 2 * ca.sumsqr(T) + 1, lower=9.0, upper=33.0) or d + ca.norm_2(T)
    ),
    "root": lambda leg, T, d: leg.path("n", 5 - ca.norm_2(T), lower=1.0, upper=3.0) or d,
    "twice": lambda leg, T, d: (
        leg.path("low", ca.norm_2(T) / 2, lower=1.0) or leg.path("high", T.T @ T, upper=16.0) or d
    ),
}


@pytest.mark.parametrize("kind", ["vector", "scalars"])
@pytest.mark.parametrize("limit", SLACK.values(), ids=SLACK)
def test_a_control_that_limits_the_norm_becomes_the_magnitude(limit: Any, kind: str) -> None:
    leg = leg_of(limit, kind)
    (vector,) = leg.vector_controls
    assert vector.magnitude == "d"
    assert list(leg.paths) == [vector.direction_norm_constraint_name]
    assert not leg.has_unit_direction(vector)
    place = leg.model.controls.slice("d")
    assert (leg.numbers.controls.lower[place], leg.numbers.controls.upper[place]) == (0.0, 1.0)


@pytest.mark.parametrize("kind", ["vector", "scalars"])
@pytest.mark.parametrize("limit", RANGE.values(), ids=RANGE)
def test_limits_of_a_norm_become_those_of_the_magnitude(limit: Any, kind: str) -> None:
    leg = leg_of(limit, kind)
    (vector,) = leg.vector_controls
    place = leg.model.controls.slice(vector.magnitude)
    assert leg.numbers.controls.lower[place] == pytest.approx(2.0, rel=1e-15)
    assert leg.numbers.controls.upper[place] == pytest.approx(4.0, rel=1e-15)
    assert list(leg.paths) == [vector.direction_norm_constraint_name]
    assert leg.has_unit_direction(vector)  # a hole


@pytest.mark.parametrize(
    ("sign", "lower", "upper", "excludes_shorter"),
    [(1, None, 8.0, False), (-1, -8.0, None, False), (1, 1.0, None, True), (-1, None, -1.0, True)],
)
def test_a_direction_has_unit_length_if_a_limit_excludes_shorter_vectors(
    sign: int, lower: Any, upper: Any, excludes_shorter: bool
) -> None:
    leg = leg_of(
        lambda leg, T, d: (
            leg.path("n", sign * ca.norm_2(T) ** 3, lower=lower, upper=upper) or ca.norm_2(T) + d
        )
    )
    assert leg.has_unit_direction(leg.vector_controls[0]) is excludes_shorter


@pytest.mark.parametrize("kind", ["vector", "scalars"])
def test_the_restated_phase_is_the_same_function(kind: str) -> None:
    """At controls that both know, dynamics, constraints and integrands are equal."""
    problem = by_hand(
        lambda leg, T, d: (
            leg.path("mass", ca.norm_2(T) - 1 - leg.model.symbol("r")[0] ** 2, upper=0.0)
            or leg.path("side", T[1] - 0.3 * T[0], upper=2.0)
            or ca.norm_2(T) ** 3 + ca.sqrt(T.T @ T + 2) + 2 * T.T @ T
        ),
        kind,
    )
    stated, solved = problem.phases["leg"], reformulate_problem(problem).phases["leg"]
    (vector,) = solved.vector_controls
    size, angle = 1.7, 0.4
    n = np.array([np.cos(angle), np.sin(angle)])
    new = {vector.magnitude: size, vector.direction: n, "d": 0.3}
    T = size * n
    old = {"T": T} if kind == "vector" else {"T_x": T[0], "T_y": T[1]}
    r = np.array([0.2, 0.4, 0.5, 0.6])

    def values(leg: Any, controls: dict[str, Any]) -> np.ndarray:
        _, x, u, _ = leg.model.symbolic_arguments()
        lengths = {v.direction_norm_constraint_name for v in leg.vector_controls}
        rows = [c.expression for name, c in leg.paths.items() if name not in lengths]
        function = ca.Function(
            "all", [x, u], [ca.vertcat(leg.model.state_derivative(), leg.integrand_expression(), *rows)]
        )
        return np.asarray(function(r, leg.model.controls.stack(controls))).ravel()

    np.testing.assert_allclose(values(solved, new), values(stated, {**old, "d": 0.3}), rtol=1e-14)


def test_cones_about_a_direction_are_limits_of_the_direction() -> None:
    leg = leg_of(lambda leg, T, d: leg.path("cone", T[1] - 0.3 * ca.norm_2(T), lower=0.0) or ca.norm_2(T) + d)
    n = leg.model.symbol("T_direction")
    assert ca.is_equal(leg.paths["cone"].expression, n[1] - 0.3, 5)


def test_bounds_of_components_within_the_norm_are_gone_and_others_are_kept() -> None:
    def limit(leg: Any, T: Any, d: Any) -> None:
        leg.path("n", ca.norm_2(T) - d, upper=0.0)
        leg.bounds(T_x=(-1.0, 0.5), T_y=(0.0, 2.0))

    leg = leg_of(limit, "scalars")
    (vector,) = leg.vector_controls
    assert set(leg.paths) == {"bounds of T_x", "bounds of T_y", vector.direction_norm_constraint_name}
    box = leg.paths["bounds of T_x"].interval
    assert (box.lower[0], box.upper[0]) == (-np.inf, 0.5)
    assert not ca.depends_on(leg.paths["bounds of T_y"].expression, leg.model.symbol("d"))


@pytest.mark.parametrize(
    "limit",
    [
        lambda leg, T, d: leg.path("n", ca.dot(T, T), upper=1.0),  # smooth, and inactive at zero
        lambda leg, T, d: leg.path("n", T[0] - d, upper=0.0),
        lambda leg, T, d: leg.path("n", T[0] ** 2 + 2 * T[1] ** 2, upper=1.0),
        lambda leg, T, d: leg.path("n", ca.norm_2(leg.model.symbol("r")) - d, upper=5.0),
    ],
)
def test_what_needs_no_restatement_stays_as_it_is(limit: Any) -> None:
    problem = by_hand(limit)
    assert reformulate_problem(problem) is problem


@pytest.mark.parametrize(
    "limit",
    [
        lambda leg, T, d: leg.path("n", T[0] ** 2 + 2 * T[1] ** 2, lower=1.0),  # an ellipse
        lambda leg, T, d: leg.path("n", ca.sqrt(T[0] ** 2 + 2 * T[1] ** 2) - d, upper=0.0),
        lambda leg, T, d: leg.path("n", T.T @ T, lower=4.0, upper=16.0),
    ],
)
def test_what_is_not_known_as_a_norm_is_warned_of(limit: Any) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        by_hand(limit).check()
    assert any("vector_control()" in str(w.message) for w in caught)


def test_what_is_restated_is_not_warned_of() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        by_hand(SLACK["root"]).check()


@cache
def flown() -> go.Solution:
    return go.solve(by_hand(SLACK["root"], "scalars"), mesh="10x3")


@pytest.mark.slow
def test_fuel_by_hand_meets_its_closed_form_in_the_users_names() -> None:
    solution = flown()
    assert solution.converged
    assert solution.objective == pytest.approx(FUEL, rel=1e-9)
    burn = FUEL / 2
    at = np.array([0.5 * burn, 1.5, DURATION - 0.5 * burn])
    np.testing.assert_allclose(solution.saturated_control("T_x")(at), [0.6, 0.0, -0.6], atol=1e-7)
    np.testing.assert_allclose(solution.saturated_control("T_y")(at), [-0.8, 0.0, 0.8], atol=1e-7)
    assert "whose magnitude 'n' limits" in str(solution)
    pytest.importorskip("pandas")
    assert "T_x" in solution.to_pandas().columns


def test_the_stated_symbols_evaluate_along_a_restated_solution(tmp_path: Path) -> None:
    problem = by_hand(SLACK["root"], "scalars")
    solution = go.solve(problem, mesh="4x3", tol=None)
    model = problem.phases["leg"].model
    size = ca.hypot(model.symbol("T_x"), model.symbol("T_y"))
    known = np.hypot(solution.control("T_x")(0.1), solution.control("T_y")(0.1))
    assert solution.evaluate(size, 0.1) == pytest.approx(known, rel=1e-12)
    assert solution.evaluate("T_x", 0.1) == pytest.approx(solution.control("T_x")(0.1))
    assert "[T_x, T_y] is replaced by d * T_direction" in str(solution)
    path = solution.save(tmp_path / "s.npz")
    again = go.load(path, by_hand(SLACK["root"], "scalars"))
    assert again.evaluate("T_y", 0.1) == pytest.approx(solution.evaluate("T_y", 0.1))


def test_guesses_and_scales_of_components_are_those_of_the_vector() -> None:
    problem = by_hand(SLACK["root"], "scalars")
    leg = problem.phases["leg"]
    leg.guess(T_x=3.0, T_y=(0.0, -8.0))
    leg.scale(T_x=2.0, T_y=7.0)
    solved = reformulate_problem(problem).phases["leg"]
    start = build_phase_guess(solved, np.array([0.0, 0.5, 1.0]), perturbed=False)
    layout = solved.model.controls
    (vector,) = solved.vector_controls
    np.testing.assert_allclose(start.controls[layout.slice("d")][0], [3.0, 5.0, np.hypot(3, 8)])
    np.testing.assert_allclose(start.controls[layout.slice(vector.direction)][:, 1], [0.6, -0.8])


def with_absolute(cost: Any) -> go.Problem:
    """A unit of travel, rest to rest, with an acceleration u within 1."""
    model = go.Model("cart")
    x, v, u = model.state("x"), model.state("v"), model.control("u")
    model.ode({x: v, v: u})
    problem, leg = one_phase("p", model, 0.0, DURATION)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(cost(u)))
    return problem


ABSOLUTE = {
    "fabs": ca.fabs,
    "in other units": lambda u: 2 * ca.fabs(u / 2),
    "root": lambda u: ca.sqrt(u**2),
    "fmax": lambda u: ca.fmax(u, -u),
}


@pytest.mark.parametrize("cost", ABSOLUTE.values(), ids=ABSOLUTE)
def test_absolute_values_that_cost_are_split(cost: Any) -> None:
    leg = reformulate_problem(with_absolute(cost)).phases["leg"]
    assert leg.model.controls.names == ("u_plus", "u_minus")
    np.testing.assert_array_equal(leg.numbers.controls.lower, 0.0)
    np.testing.assert_array_equal(leg.numbers.controls.upper, 1.0)
    _, x, u, _ = leg.model.symbolic_arguments()
    value = ca.Function("all", [x, u], [leg.model.state_derivative(), leg.integrand_expression()])
    rates, costs = value([0.0, 0.5], [0.3, 0.7])
    np.testing.assert_allclose(rates.full()[:, 0], [0.5, 0.3 - 0.7])
    assert float(costs) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "problem",
    [
        lambda: with_absolute(lambda u: -ca.fabs(u)),  # both parts at once would be better than they are
        lambda: with_absolute(lambda u: 1.0 / (0.1 + ca.fabs(u))),
        lambda: with_absolute(lambda u: u**2),
        lambda: with_absolute(lambda u: ca.fabs(u) ** 3),  # no kink
    ],
)
def test_absolute_values_of_which_more_may_be_better_stay(problem: Any) -> None:
    stated = problem()
    assert reformulate_problem(stated) is stated


def test_fuel_of_opposed_thrusters_meets_its_closed_form() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # of the kink
        solution = go.solve(with_absolute(ca.fabs), mesh="10x3")
    assert solution.converged
    assert solution.objective == pytest.approx(FUEL, rel=1e-9)
    at = np.array([0.25 * FUEL, 1.5, DURATION - 0.25 * FUEL])
    np.testing.assert_allclose(solution.saturated_control("u")(at), [1.0, 0.0, -1.0], atol=1e-7)
    assert "u is replaced by u_plus - u_minus" in str(solution)


finite = st.floats(-4.0, 4.0).map(lambda v: round(v, 3))


@given(
    power=st.sampled_from([1, 2]),
    offset=finite,
    factor=finite.filter(lambda v: abs(v) > 0.1),
    ends=st.tuples(finite, finite),
)
@example(power=1, offset=0.0, factor=1.0, ends=(-1.0, 0.0))
@settings(max_examples=40, deadline=None)
def test_limits_of_a_norm_are_those_that_its_expression_allows(
    power: int, offset: float, factor: float, ends: tuple[float, float]
) -> None:
    """low <= a + b r^n <= high for r in the range and for no other r >= 0."""
    r, (low, high) = ca.SX.sym("r"), sorted(ends)
    found = read_norm_limits(offset + factor * r**power, r, interval(low, high))
    sizes = np.linspace(0.0, 10.0, 501)
    values = offset + factor * sizes**power
    allowed = (values >= low - 1e-9) & (values <= high + 1e-9)
    if found is None:
        assert not np.any(allowed)
    else:
        np.testing.assert_array_equal((sizes >= found[0] - 1e-9) & (sizes <= found[1] + 1e-9), allowed)
    assert read_norm_limits(offset + factor * (r**power + r**3), r, interval(low, high)) is None


def at_rest(limit: Any) -> go.Problem:
    """Two units of travel from rest to rest, as fast as |a_i| <= 1 and a limit allow."""
    model = go.Model("cart")
    r, v, a = model.state("r", 2), model.state("v", 2), model.control("a", 2)
    model.ode({r: v, v: a})
    problem = go.Problem("p")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=(1.0, 9.0))
    leg.initial(r=[0.0, 0.0], v=[0.0, 0.0])
    leg.final(r=[2.0, 2.0], v=[0.0, 0.0])
    leg.bounds(a=([-1.0, -1.0], [1.0, 1.0]))
    leg.path("speed", limit(v))
    problem.minimize(leg.final_time)
    return problem


SPEED = {
    "norm": (np.sqrt(2.0), lambda v: ca.norm_2(v) <= np.sqrt(2.0)),
    "reversed": (np.sqrt(2.0), lambda v: 3 - 2 * ca.hypot(v[0], v[1]) >= 3 - 2 * np.sqrt(2.0)),
    "small": (0.2, lambda v: 5 * ca.norm_2(v) + 1 <= 2.0),
}


@pytest.mark.parametrize(("radius", "limit"), SPEED.values(), ids=SPEED)
def test_a_limit_of_a_root_has_the_same_value_and_slope_at_the_limit(radius: float, limit: Any) -> None:
    problem = at_rest(limit)
    stated = problem.phases["leg"]
    solved = reformulate_problem(problem).phases["leg"]
    v = stated.model.symbol("v")
    at_limit = radius * np.array([0.6, -0.8])
    for of in (lambda e: e, lambda e: ca.jacobian(e, v)):
        old, new = (
            ca.Function("f", [v], [of(leg.paths["speed"].expression)])(at_limit).full()
            for leg in (stated, solved)
        )
        np.testing.assert_allclose(new, old, rtol=1e-14)
    slope = ca.Function("f", [v], [ca.jacobian(solved.paths["speed"].expression, v)])([0.0, 0.0])
    np.testing.assert_array_equal(slope.full(), 0.0)


@pytest.mark.parametrize(
    ("function", "lower", "upper"),
    [
        (ca.norm_2, 0.5, 2.0),  # a ring
        (ca.norm_2, 0.5, np.inf),
        (ca.norm_2, -np.inf, 0.0),
        (lambda v: ca.sqrt(ca.sumsqr(v) + 0.25), -np.inf, 2.0),
        (lambda v: ca.norm_2(v) ** 3, -np.inf, 2.0),
    ],
)
def test_roots_without_a_disc_as_their_limit_stay(function: Any, lower: float, upper: float) -> None:
    problem = at_rest(SPEED["norm"][1])
    leg = problem.phases["leg"]
    leg.path("root", function(leg.model.symbol("v")), lower=lower, upper=upper)
    row = leg.paths["root"].expression
    assert ca.is_equal(reformulate_problem(problem).phases["leg"].paths["root"].expression, row, 9)


def test_speed_limits_by_hand_hold_from_rest() -> None:
    """Up to speed 1 each way in 1 s, 1 s at it, and down again: 3 s, which a root at rest used to refuse."""
    solution = go.solve(at_rest(SPEED["norm"][1]), mesh="6x3", tol=None)
    assert solution.objective == pytest.approx(3.0, rel=1e-2)


def by_mass(limit: Any) -> go.Problem:
    """A unit of travel, rest to rest, at least propellant: m' = -|T|, with a limit of T by mass."""
    model = go.Model("cart")
    r, v, m = model.state("r", 2), model.state("v", 2), model.state("m")
    T = model.control("T", 2)
    model.ode({r: v, v: T / m, m: -0.05 * ca.norm_2(T)})
    problem, leg = one_phase("p", model, 0.0, DURATION)
    leg.initial(r=[0.0, 0.0], v=[0.0, 0.0], m=40.0)
    leg.final(r=[0.6, -0.8], v=[0.0, 0.0])
    leg.bounds(m=(1.0, 40.0))
    leg.path("limit", limit(T, m))
    problem.maximize(leg.final_state("m"))
    return problem


def test_an_acceleration_limit_by_hand_is_solved_without_bounds_of_the_thrust() -> None:
    r"""|a| <= 1 in 3 s takes the \Delta v of `FUEL`, and m = m_0 exp(-0.05 \Delta v), as m' / m = -0.05 |a|."""
    solution = go.solve(by_mass(lambda T, m: ca.sumsqr(3 * T / m) <= 9.0), mesh="16x4", tol=None)
    assert solution.objective == pytest.approx(40 * np.exp(-0.05 * FUEL), rel=2e-4)


@pytest.mark.slow
def test_the_least_effort_below_a_norm_passes_through_zero_in_the_stated_components() -> None:
    r"""Rest to rest over 1 m in 1 s for \int a^2, |a| <= 5: on the limit but for 2 s, s^2 = 3/4 - 3/5, about half-way.

    A limit is the same as one of the square; the cost has no norm, and no direction is optimised.
    """
    model = go.Model("cart")
    r, v, a = model.state("r", 2), model.state("v", 2), model.control("a", 2)
    model.ode({r: v, v: a})
    problem = go.Problem("effort")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(r=0.0, v=0.0)
    leg.final(r=[1.0, 0.0], v=0.0)
    leg.path("limit", ca.norm_2(a) <= 5.0)
    problem.minimize(leg.integral(ca.sumsqr(a)))
    solution = go.solve(problem, mesh="10x4")
    assert [v.name for v in reformulate_problem(problem).phases["leg"].model.controls.variables] == ["a"]
    assert solution.objective == pytest.approx(25 - 100 / 3 * np.sqrt(0.15), abs=1e-8)
    assert go.verify(solution).minimum


def landing(most: float | None, limit: str = "square") -> go.Problem:
    """A lander in the plane, its thrust as magnitude times direction, each component of which is at most ``most``."""
    model = go.Model("lander")
    r, w = model.state("r", 2), model.state("w", 2)
    thrust, d = model.control("thrust"), model.control("d", 2)
    model.ode({r: w, w: thrust * d - ca.vertcat(0.0, 1.62)})
    problem = go.Problem("landing")
    leg = problem.phase("fall", model)
    leg.time(initial=0.0, final=(10.0, 100.0))
    leg.initial(r=[300.0, 500.0], w=[0.0, -30.0])
    leg.final(r=[0.0, 0.0], w=[0.0, 0.0])
    leg.bounds(thrust=(1.0, 6.0))
    if most is not None:
        leg.bounds(d=([-most, -most], [most, most]))
    lengths = {"square": d.T @ d, "weighted": d[0] ** 2 + 2 * d[1] ** 2, "shifted": ca.sumsqr(d - 0.1)}
    leg.path("unit direction", lengths[limit], equals=1.0)
    leg.guess([0.0, 40.0], d=([0.0, 1.0], [0.0, 1.0]), thrust=2.0)
    problem.minimize(leg.integral(thrust))
    return problem


@pytest.mark.parametrize(
    ("most", "limit", "left"),
    [
        (1.0, "square", np.inf),
        (1.5, "square", np.inf),
        (0.9, "square", 0.9),
        (1.0, "weighted", 1.0),
        (1.0, "shifted", 1.0),
    ],
)
def test_bounds_that_the_length_of_a_direction_implies_are_dropped(
    most: float, limit: str, left: float
) -> None:
    bounds = reformulate_problem(landing(most, limit)).phases["fall"].numbers.controls
    assert bounds.upper.tolist() == [6.0, left, left] and bounds.lower.tolist() == [1.0, -left, -left]
