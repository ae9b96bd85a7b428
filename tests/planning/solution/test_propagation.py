"""Propagation of the applied control, saturated at its bounds, and diagnosis of failed solves."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad
from testing.internals import (
    SCHEMES,
    Interval,
    PiecewisePolynomial,
    Scheme,
    Statistics,
    compile_phase_functions,
    get_collocation_rule,
)
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.model import ode_integration
from gnc_opt.planning.solution.constraint_violation_diagnosis import _find_unbounded_variables
from gnc_opt.planning.solution.defects_and_violations import (
    Propagation,
    compute_propagation_errors,
    integrate_dynamics,
)
from gnc_opt.planning.solution.piecewise_polynomial import SaturatedControl

# Propagation ends, whatever the dynamics are like, and says where and why.


def fall(rate_of_v: Any = lambda x, v, u: u) -> go.Problem:
    """x'' = u from rest at 0 to -1 in 1 s: x is below zero at once."""
    model, _x, _v, u = dynamics("fall", "x v", "u", lambda x, v, u: {x: v, v: rate_of_v(x, v, u)})
    problem, leg = one_phase("fall", model, 0.0, 1.0)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=-1.0)
    problem.minimize(leg.integral(u**2))
    return problem


@pytest.fixture(scope="module")
def solution() -> go.Solution:
    return go.solve(fall(), mesh="4x4", tol=None)


def flown_with(solution: go.Solution, rate_of_v: Any) -> Propagation:
    """The solution's control, flown with other dynamics."""
    empty = np.zeros(0)
    return integrate_dynamics(
        solution.phase(), compile_phase_functions(fall(rate_of_v), "leg", empty, empty, np.ones(1))
    )


def test_it_arrives(solution: go.Solution) -> None:
    run = solution.propagate()
    assert run.ended == "" and np.max(np.abs(run.error)) < 1e-9


def test_the_edge_of_the_domain_does_not_hang_it(solution: go.Solution) -> None:
    """Rates are NaN below x = 0, where the flight begins: ever shorter steps are accepted, 1e-160 s and less."""
    run = flown_with(solution, lambda x, v, u: ca.if_else(x < 0, ca.log(-1 - x**2), -1.0))
    assert run.ended == "the rate of state 'v' is nan at t = 0 s"
    assert np.all(np.isinf(run.error))
    assert np.all(np.isnan(run.states[:, 1:])) and np.all(run.states[:, 0] == 0)


def test_a_domain_left_on_the_way_is_placed_in_time(solution: go.Solution) -> None:
    """The minimum effort answer is x = -(3 t^2 - t^3) / 2: it passes -0.5 at t = 0.6527."""
    run = flown_with(solution, lambda x, v, u: u + ca.if_else(x < -0.5, ca.log(x), 0.0))
    at = float(run.ended.split("t = ")[1].split()[0])
    assert "rate of state 'v' is nan" in run.ended and at == pytest.approx(0.6527, abs=0.05)
    assert np.all(np.isfinite(run.states[:, run.times < 0.6]))


def test_stiff_dynamics_do_not_hang_it(solution: go.Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ode_integration, "MAX_RATES", 2000)
    run = flown_with(solution, lambda x, v, u: -1e9 * (v + 1))
    assert run.ended.startswith("2,000 evaluations of the dynamics reached only t = ")
    assert np.all(np.isinf(run.error))


def test_divergence_is_placed_in_time(solution: go.Solution) -> None:
    """v' = u - 1e3 v^2 explodes soon after the start."""
    run = flown_with(solution, lambda x, v, u: u - 1e3 * v**2)
    assert "t = 0." in run.ended and np.all(np.isinf(run.error))


# The control as it can be flown: within its bounds everywhere, with the impulse of the collocation
# polynomial.


BREAKS = np.array([0.0, 1.0, 3.0])


def flown(values: list[list[float]], lower: float, upper: float) -> SaturatedControl:
    """One channel on two segments of three Gauss points."""
    rules = (get_collocation_rule("LG", 3),) * 2
    nodal = tuple(np.array([v]) for v in values)
    polynomial = PiecewisePolynomial(BREAKS, tuple(r.points for r in rules), nodal)
    return SaturatedControl(polynomial, Interval(np.array([lower]), np.array([upper])), rules)


def impulse(signal: SaturatedControl, k: int) -> float:
    left, right = BREAKS[k], BREAKS[k + 1]
    inside = [t for t in signal.jump_times if left < t < right]
    return float(quad(lambda t: signal(t)[0], left, right, points=inside or None, epsabs=1e-13)[0])


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("other", [3.0, np.inf])
def test_overshoot_and_undershoot_are_held_alike(sign: float, other: float) -> None:
    """Nodes 0, 0, 1 of a control that must not be negative, and their mirror image: a dip between the nodes."""
    values = [[0.0, 0.0, sign], [0.5 * sign, 0.6 * sign, 0.7 * sign]]
    signal = flown(values, *sorted([0.0, sign * other]))
    times = np.linspace(0.0, 3.0, 601)
    assert np.min(sign * signal.polynomial(times)) < -0.05  # or the test tests nothing
    assert signal.is_piecewise_constant.tolist() == [[True, False]]
    assert np.min(sign * signal(times)) == 0.0
    for k, mean in enumerate((sign * 5 / 18, sign * 0.6)):  # Gauss weights 5, 8, 5 of 18
        assert impulse(signal, k) == pytest.approx(mean * (BREAKS[k + 1] - BREAKS[k]), abs=1e-12)


def test_cells_are_as_long_as_the_weights_and_the_side_decides_on_their_edges() -> None:
    signal = flown([[0.0, 1.0, 0.0], [0.5, 0.5, 0.5]], 0.0, 1.0)
    edges = np.array([0.0, 5 / 18, 13 / 18, 1.0])
    assert signal.jump_times == pytest.approx([*edges, 3.0], abs=1e-14)
    middles = 0.5 * (edges[1:] + edges[:-1])
    assert signal(middles)[0] == pytest.approx([0.0, 1.0, 0.0], abs=0)
    inner = signal.jump_times[1:4]
    assert signal(inner, "left")[0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-14)
    assert signal(inner, "right")[0] == pytest.approx([1.0, 0.0, 0.5], abs=1e-14)
    assert signal(3.0)[0] == pytest.approx(0.5)


@pytest.mark.parametrize("first", [True, False])
def test_a_jump_at_a_boundary_counts_for_the_segment_on_its_side(first: bool) -> None:
    """Nodes 0, 0, 1 end above 1 and 1, 0, 0 begin there; the other segment, at 1/2, is flown as it is."""
    over = [0.0, 0.0, 1.0] if first else [1.0, 0.0, 0.0]
    pieces = [over, [0.5] * 3] if first else [[0.5] * 3, over]
    signal = flown(pieces, -1.0, 1.0)
    assert signal.polynomial(1.0, "left" if first else "right")[0] > 1.2
    assert signal.is_piecewise_constant.tolist() == [[first, not first]]


def test_rounding_beyond_a_bound_is_clipped_and_not_held() -> None:
    signal = flown([[1.0 + 1e-9, 1.0, 1.0], [-1e-9, 0.0, 0.0]], 0.0, 1.0)
    assert not signal.is_piecewise_constant.any()
    assert np.max(signal(np.linspace(0.0, 1.0, 50))) == 1.0
    assert np.min(signal(np.linspace(1.0, 3.0, 50), "left")) == 0.0


@pytest.mark.parametrize("value", [0.0, 0.7, -3e5])
def test_rounding_of_a_fixed_control_is_no_overshoot(value: float) -> None:
    """A control with equal bounds has no range that its rounding could be a share of."""
    off = 1e-15 * max(abs(value), 1.0)
    signal = flown([[value, value + off, value], [value - off, value, value]], value, value)
    assert not signal.is_piecewise_constant.any()
    assert signal(np.linspace(0.0, 3.0, 31)) == pytest.approx(value, abs=0)
    missed = flown([[value, value + 1e-3 * max(abs(value), 1.0), value], [value] * 3], value, value)
    assert missed.is_piecewise_constant.tolist() == [[True, False]]


def test_each_channel_is_held_by_itself() -> None:
    """The first one overshoots at 1 in the first segment, the second one at -2 in the last, the third one nowhere."""
    rules = (get_collocation_rule("LG", 3),) * 2
    nodal = (
        np.array([[0.0, 0.0, 1.0], [0.5, 0.4, 0.3], [0.1, 0.2, 0.3]]),
        np.array([[0.5, 0.6, 0.7], [-2.0, 0.0, 0.0], [0.3, 0.2, 0.1]]),
    )
    polynomial = PiecewisePolynomial(BREAKS, tuple(r.points for r in rules), nodal)
    bounds = Interval(np.array([0.0, -2.0, -np.inf]), np.array([1.0, 2.0, np.inf]))
    signal = SaturatedControl(polynomial, bounds, rules)
    assert signal.is_piecewise_constant.tolist() == [[True, False], [False, True], [False, False]]
    cells = np.array([0.0, 5 / 18, 13 / 18, 1.0])
    assert signal.jump_times == pytest.approx([*cells, *(1 + 2 * cells[1:])], abs=1e-14)
    middles = np.array([*(0.5 * (cells[1:] + cells[:-1])), *(1 + cells[1:] + cells[:-1])])
    found, free = signal(middles), polynomial(middles)
    assert found[0] == pytest.approx([0.0, 0.0, 1.0, *free[0, 3:]])
    assert found[1] == pytest.approx([*free[1, :3], -2.0, 0.0, 0.0])
    assert found[2] == pytest.approx(free[2])
    shuffled = np.array([4, 0, 5, 3, 1, 2])
    assert signal(middles[shuffled]) == pytest.approx(found[:, shuffled])


def test_at_a_jump_the_right_hand_value_is_meant() -> None:
    signal = flown([[0.25] * 3, [0.75] * 3], 0.0, 0.5)
    assert signal(1.0).tolist() == [0.5] == signal.evaluate_clipped_polynomial(1.0).tolist()
    before = pytest.approx([0.25], rel=1e-15)
    assert signal(1.0, "left") == before == signal.evaluate_clipped_polynomial(1.0, "left")


# Small parts of a solution: what tries cost together, named integrals.


def test_costs_of_tries_add_up() -> None:
    first = Statistics(iterations=3, build_s=0.5, solve_s=2.0, function_s=0.25, linear_solver_s=1.0)
    second = Statistics(
        iterations=10, build_s=0.0, solve_s=4.0, function_s=0.5, linear_solver_s=3.0, compiled_before=True
    )
    assert second.add_earlier(first) == Statistics(13, 0.5, 6.0, 0.75, 4.0, True)
    assert not first.compiled_before and not first.add_earlier(second).compiled_before


def test_integrals_by_name() -> None:
    """x' = u = 1 / 2 from 0 to 1 in 2 s: the integral of u^2 is 1 / 2, that of x is 1."""
    model, x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("two integrals", model, 0.0, 2.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    leg.integral(x, name="area")
    problem.minimize(leg.integral(u**2, name="effort"))
    phase = go.solve(problem, mesh="2x4", tol=None).phase()
    assert (phase.integral("area"), phase.integral("effort")) == pytest.approx((1.0, 0.5), rel=1e-8)
    with pytest.raises(go.UnknownNameError, match="did you mean 'effort'"):
        phase.integral("efort")
    with pytest.raises(go.UnknownNameError, match="no integral"):
        phase.integral(1)  # type: ignore[arg-type]


def test_numbers_are_numbers_and_vectors_are_vectors() -> None:
    """Two parameters of one component and of two, and constraints likewise: (p - 1)^2 + |q - (2, 3)|^2, q held at 1."""
    model, _x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem = go.Problem("parameters")
    p, q = problem.parameter("p"), problem.parameter("q", 2)
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    problem.constrain("both", q, equals=[1.0, 1.0])
    problem.constrain("one", p, upper=5.0)
    problem.minimize(leg.integral(u**2) + (p - 1) ** 2 + (q[0] - 2) ** 2 + (q[1] - 3) ** 2)
    solution = go.solve(problem, mesh="1x4", tol=None)
    assert isinstance(solution.parameter("p"), float) and isinstance(solution.multiplier("one"), float)
    assert solution.parameter("p") == pytest.approx(1.0, abs=1e-7)
    assert solution.parameter("q") == pytest.approx([1.0, 1.0], abs=1e-9)
    assert solution.multiplier("both") == pytest.approx([2.0, 4.0], rel=1e-6)
    assert solution.multiplier("one") == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(go.UnknownNameError, match="did you mean 'both'"):
        solution.multiplier("bth")


@pytest.mark.parametrize("scheme", SCHEMES)
def test_costs_at_both_ends(scheme: Scheme) -> None:
    """(x_0 - 1)^2 + 3 (x_f - 2)^2 + int u^2 over 1 s with x' = u is least, 3/7, from 10/7 to 13/7.

    A constraint that does not bind says what it is: x_0 x_f - 2 t_f.
    """
    model, _x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("both ends", model, 0.0, 1.0)
    first, last = leg.initial_state("x"), leg.final_state("x")
    problem.constrain("product", first * last - 2 * leg.final_time, upper=5.0)
    problem.minimize((first - 1) ** 2 + 3 * (last - 2) ** 2 + leg.integral(u**2))
    solution = go.solve(problem, mesh="3x2", scheme=scheme, tol=None)
    assert solution.objective == pytest.approx(3 / 7, rel=1e-7)
    assert solution.phase().x([0.0, 1.0])[0] == pytest.approx([10 / 7, 13 / 7], rel=1e-6)
    assert solution.constraint_values == pytest.approx([130 / 49 - 2.0], rel=1e-5)
    assert solution.phase().lam(0.0) == pytest.approx(
        [-6 / 7], rel=1e-5
    )  # dJ*/dx_0 of what follows: -2 (x_0 - 1)


def test_what_runs_off_is_named_once_where_it_is_largest_and_first() -> None:
    names = [f"{name}, t = {i}" for i in range(40) for name in ("x", "y", "z")]
    scaled = np.full(120, -2e6)
    scaled[3 * 7 + 1], scaled[2::3] = 3e6, 9e5
    found = _find_unbounded_variables(SimpleNamespace(variable_labels=names), scaled)  # type: ignore[arg-type]
    assert [(v.name, v.amount) for v in found] == [("y, t = 7 diverges", 3e6), ("x, t = 0 diverges", 2e6)]


def test_segments_share_a_limit_of_evaluations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stiff dynamics must not cost the limit once per segment."""
    solution = go.solve(fall(), mesh="10x3", tol=None)
    (samples,) = solution.samples().values()
    leg, segments = samples.phase, np.arange(10)
    assert np.max(np.abs(compute_propagation_errors(leg, samples.functions, segments))) < 1e-8
    monkeypatch.setattr(ode_integration, "MAX_RATES", 200)
    errors = compute_propagation_errors(leg, samples.functions, segments)
    assert np.all(np.isfinite(errors[:, 0])) and np.all(np.isinf(errors[:, -1]))
