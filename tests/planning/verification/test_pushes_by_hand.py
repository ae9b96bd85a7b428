"""State constraints that push within a segment, and multipliers of a trajectory without any, by hand."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from testing import constructed_solutions as by_hand
from testing.internals import (
    Interval,
    PureStateConstraints,
    SampledPhase,
    estimate_multipliers,
    fit_trajectory_polynomials,
    transcribe_problem,
)
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.numerical_tolerances import ACTIVE

Array = NDArray[np.float64]
MATRIX = np.array([[0.2, 1.0], [-0.5, 0.4]])
LEVEL = np.array([0.7, -0.3])
"""Of the running cost's gradient: the costates are driven by it."""
PURE = np.array([2.0, -3.0])


def linear(paths: bool = False) -> go.Problem:
    """x' = A x + (0, u) at the cost of LEVEL x + 0 u^2; perhaps paths 2 x_0 - 3 x_1 and x_0 + u."""
    model = go.Model("linear")
    x, u = model.state("x", 2), model.control("u")
    model.ode({x: ca.mtimes(ca.DM(MATRIX), x) + ca.vertcat(0, u)})
    problem, leg = one_phase("linear", model, 0.0, 2.0)
    if paths:
        leg.path("mixed", x[0] + u + x[1] ** 2, upper=100.0)
        leg.path("pure", ca.dot(ca.DM(PURE), x) + x[0] * x[1], upper=100.0)
    problem.minimize(leg.integral(ca.dot(ca.DM(LEVEL), x)))
    return problem


def test_gradients_and_sides_of_paths() -> None:
    """Of (x_0 + u + x_1^2, 2 x_0 - 3 x_1 + x_0 x_1); only the second is free of controls."""
    problem = linear(paths=True)
    problem.get_phase()
    box = by_hand.interval([-99.0, -99.0], [1e9, 99.0])
    s = by_hand.samples(
        problem,
        lambda t, k: np.array([1 + t, 2 - t**2]),
        lambda t, k: np.array([-0.3 + 0 * t]),
        lambda t, k: np.array([1 + t, 1 + t]),
        weights=(1.0,),
        breaks=(0.0, 0.5, 2.0),
        state_bounds=box,
        path_bounds=by_hand.interval([-99.0, -2.0], [0.0, 9.0]),
    )
    times = np.array([0.0, 1.0])
    x, u = s.phase.x(times), s.phase.applied(times)
    _, found, by_parameter = s.functions.path_gradients(times, x, u)
    assert by_parameter.shape == (0, 2, 2)
    np.testing.assert_allclose(found[:, 0], [[1.0, 1.0], [4.0, 2.0]])
    np.testing.assert_allclose(found[:, 1], [[4.0, 3.0], [-2.0, -1.0]])
    pushers = PureStateConstraints.from_states(s, s.phase.state_bounds, times, x, u)
    np.testing.assert_allclose(pushers.directions[:, 2], found[:, 1])
    np.testing.assert_allclose(pushers.directions[:, 5], -found[:, 1])
    # 2 - 6 + 2 = -2 is at the lower limit, 4 - 3 + 2 = 3 is not.
    assert pushers.active.shape == (6, 2)
    np.testing.assert_array_equal(pushers.active[5], [True, False])
    assert not np.any(pushers.active[:5])


def cart(unit: float, distance: float = 1.0) -> go.Problem:
    """From rest over 1 m in 1 s with the least energy; the distance is a limit, in its own unit."""
    model, _q, _v, a = dynamics("cart", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("cart", model, 0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(v=0.0)
    problem.constrain("far enough", -unit * leg.final_state("q"), upper=-unit * distance)
    problem.minimize(0.5 * leg.integral(a**2))
    return problem


@pytest.mark.parametrize(("unit", "distance"), [(1.0, 1.0), (1e3, 1.0), (1e-3, 1.0), (1.0, 1e3), (1.0, 1e-3)])
@pytest.mark.parametrize(("off", "pushes_back"), [(0.0, True), (0.8 * ACTIVE, True), (1.3 * ACTIVE, False)])
def test_multipliers_that_explain_a_trajectory(
    unit: float, distance: float, off: float, pushes_back: bool
) -> None:
    """Costates -12 and 12 t - 6; the limit's is 12 per metre, if it is reached to a hundred-thousandth of the way."""
    problem, t = cart(unit, distance), np.linspace(0.0, 1.0, 7)
    way = distance * (1 + off)
    samples = SampledPhase(
        t, way * np.array([3 * t**2 - 2 * t**3, 6 * t - 6 * t**2]), way * (6 - 12 * t)[None]
    )
    fitted = {"leg": fit_trajectory_polynomials(samples, lambda t, x, u: np.array([x[1], u[0]]))}
    transcription = transcribe_problem(problem, {"leg": fitted["leg"].mesh}, "LG")
    found = estimate_multipliers(transcription, problem, fitted, np.zeros(0))
    (nu,) = found.lam_g[transcription.constraint_rows]
    # Where it does not push, nothing holds the end, and least squares leave what they cannot explain.
    assert nu == (pytest.approx(12 * way / unit, rel=1e-6) if pushes_back else 0.0)
    part = transcription.parts["leg"].collocation
    np.testing.assert_allclose(
        found.x[part.point_controls[0]], way * (6 - 12 * part.normalised_point_times), atol=1e-9 * way
    )
    at_ends = found.lam_x[part.boundary_states[:, [0, -1]]]
    if pushes_back:
        # Given ends take what the costates leave: -lam(0) at the start and lam(1) at the end, here of v.
        np.testing.assert_allclose(at_ends[:, 0], way * np.array([12.0, 6.0]), rtol=1e-5)
        assert at_ends[1, 1] == pytest.approx(6.0 * way, rel=1e-5)
    free = np.setdiff1d(np.arange(found.x.size), part.boundary_states[:, [0, -1]])
    assert not np.any(found.lam_x[free])


def test_the_side_of_a_limit_is_that_on_which_the_trajectory_is() -> None:
    box = Interval(np.array([-1.0]), np.array([-1.0]))
    assert box.is_fixed[0]
    problem, t = cart(1.0), np.linspace(0.0, 1.0, 7)
    # 1 % farther than asked for: nothing is active, and the end's costate of q has no explanation.
    samples = SampledPhase(
        t, 1.01 * np.array([3 * t**2 - 2 * t**3, 6 * t - 6 * t**2]), 1.01 * (6 - 12 * t)[None]
    )
    fitted = {"leg": fit_trajectory_polynomials(samples, lambda t, x, u: np.array([x[1], u[0]]))}
    transcription = transcribe_problem(problem, {"leg": fitted["leg"].mesh}, "LG")
    found = estimate_multipliers(transcription, problem, fitted, np.zeros(0))
    assert found.lam_g[transcription.constraint_rows] == [0.0]


def test_a_parameter_of_the_cost_alone_is_in_no_row() -> None:
    """(k - 2)^2 at k = 2.5: nothing holds it, and its derivative of 1 is left to no limit."""
    model, t = cart(1.0).get_phase().model, np.linspace(0.0, 1.0, 7)
    other = go.Problem("with a parameter")
    k = other.parameter("k", lower=0.0, upper=5.0)
    leg = other.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    other.minimize(0.5 * leg.integral(model.symbol("a") ** 2) + (k - 2) ** 2)
    samples = SampledPhase(t, np.array([3 * t**2 - 2 * t**3, 6 * t - 6 * t**2]), (6 - 12 * t)[None])
    fitted = {"leg": fit_trajectory_polynomials(samples, lambda t, x, u: np.array([x[1], u[0]]))}
    transcription = transcribe_problem(other, {"leg": fitted["leg"].mesh}, "LG")
    found = estimate_multipliers(transcription, other, fitted, np.array([2.5]))
    assert found.lam_x[transcription.parameter_indices] == [0.0]
    assert found.x[transcription.parameter_indices] == [2.5]
    held = estimate_multipliers(transcription, other, fitted, np.array([5.0]))
    assert held.lam_x[transcription.parameter_indices] == pytest.approx([-6.0])


@pytest.mark.parametrize("rate", [1.0, 12.0, -12.0])
def test_costates_that_grow_are_those_of_the_controls(rate: float) -> None:
    """x' = k x + u from 0 with u = exp(-k t) at the cost of u^2: the costate is -2 u, which both ends take."""
    model, *_ = dynamics("one", "x", "u", lambda x, u: {x: rate * x + u})
    problem, leg = one_phase("unstable", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=float(np.sinh(rate) / rate))
    problem.minimize(leg.integral(model.symbol("u") ** 2))
    t = np.linspace(0.0, 1.0, 400)
    samples = SampledPhase(t, np.sinh(rate * t)[None] / rate, np.exp(-rate * t)[None])
    fitted = {"leg": fit_trajectory_polynomials(samples, lambda t, x, u: rate * x + u)}
    transcription = transcribe_problem(problem, {"leg": fitted["leg"].mesh}, "LG")
    found = estimate_multipliers(transcription, problem, fitted, np.zeros(0))
    at_ends = found.lam_x[transcription.parts["leg"].collocation.boundary_states[0, [0, -1]]]
    np.testing.assert_allclose(at_ends, [2.0, -2.0 * np.exp(-rate)], rtol=1e-4)
