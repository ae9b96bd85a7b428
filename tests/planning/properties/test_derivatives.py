"""The program's sparse derivatives equal CasADi's own, on a problem with everything in it."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from testing.internals import PointFunction, PointTerm, SeparableProgram, Transcription, transcribe_problem
from testing.nonlinear_problems import SCHEMES

import gnc_opt as go

MESHES = {
    "first": go.Mesh((0.0, 0.3, 0.5, 1.0), (2, 4, 3)),
    "second": go.Mesh((0.0, 0.6, 1.0), (3, 2), movable=(1,)),
}


def everything() -> go.Problem:
    """Two phases and models; free times, parameters, path constraints, integrals of both kinds; maximised."""
    rover = go.Model("rover")
    position, speed = rover.state("position", 2), rover.state("speed")
    heading, thrust = rover.control("heading"), rover.control("thrust")
    drag, gain = rover.parameter("drag", 0.3), rover.parameter("gain", 1.2)
    t = rover.time
    rover.ode(
        {
            position: speed * ca.vertcat(ca.cos(heading), ca.sin(heading)) + 0.1 * ca.sin(t) * position,
            speed: gain * thrust - drag * speed**2 + 0.05 * t,
        }
    )
    hopper = go.Model("hopper")
    height, speed_2, push = hopper.state("height"), hopper.state("speed"), hopper.control("push")
    mass = hopper.parameter("mass", 2.0)
    hopper.ode({height: speed_2 * ca.exp(-height), speed_2: push / (mass + height**2) - ca.cos(hopper.time)})
    problem = go.Problem("everything")
    first, second = problem.phase("first", rover), problem.phase("second", hopper)
    first.time(initial=(-1.0, 1.0), final=(1.0, 4.0), duration=(0.5, 3.0))
    second.time(initial=(1.0, 4.0), final=(2.0, 9.0))
    first.initial(position=[0.0, 0.0], speed=1.0)
    first.bounds(speed=(0.1, 5.0), thrust=(-1.0, 1.0))
    first.path("circle", (position[0] - 1) ** 2 + position[1] ** 2 + 0.1 * thrust * t, lower=0.01)
    first.path("pair", ca.vertcat(heading * gain, speed * thrust), lower=[-9.0, -9.0], upper=[9.0, 9.0])
    second.path("power", push * speed_2 - mass, upper=30.0)
    gain_free = problem.parameter("gain", lower=0.5, upper=2.0, guess=1.1)
    shape = problem.parameter("shape", 2, lower=[-1.0, -1.0], upper=[1.0, 1.0], guess=[0.1, 0.2])
    effort = first.integral(thrust**2 * speed + t * heading**2, name="effort")  # linear in cost: direct
    dust = first.integral(speed**2 * gain, name="dust")  # nonlinear in a constraint: a variable
    work = second.integral(push**2 / mass + height, name="work")  # nonlinear in the cost: a variable
    problem.link(first, second, states=["speed"])
    problem.constrain("budget", dust**2 + ca.sin(work) * shape[0] + effort, upper=50.0)
    problem.constrain(
        "turn", first.final_state("position") * gain_free - shape, lower=[-9.0, -9.0], upper=[9.0, 9.0]
    )
    problem.maximize(
        second.final_state("height") * gain_free
        - 0.5 * effort
        - ca.sqrt(1 + work**2)
        - shape[0] ** 2 * second.duration
        - first.initial_time * ca.exp(shape[1])
    )
    return problem


@pytest.fixture(scope="module", params=SCHEMES)
def case(request: pytest.FixtureRequest) -> tuple[Transcription, np.ndarray, np.ndarray, np.ndarray]:
    """A transcription, a random point, its parameters with random scales, and random multipliers."""
    problem = everything()
    transcription = transcribe_problem(problem, MESHES, request.param)
    rng = np.random.default_rng(3)
    n, m = transcription.n_variables, transcription.n_constraints
    scales = [10.0 ** rng.uniform(-1, 1, size) for size in (n, m)]
    p = transcription.build_parameter_vector(problem, *scales, 0.37)
    return transcription, rng.uniform(0.2, 1.2, n) / scales[0], p, rng.normal(size=m)


def assert_equal(ours: ca.DM, theirs: ca.DM) -> None:
    """Fail beyond rounding: 1e-12 of the largest entry; NaN fails too."""
    a, b = ours.full(), theirs.full()
    assert np.all(np.isfinite(b))
    np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-12 * np.max(np.abs(b)))


def test_the_case_has_everything(case: tuple) -> None:
    """Both kinds of integrals, free times, a movable boundary and parameters are variables."""
    transcription = case[0]
    labels = " | ".join(transcription.variable_labels)
    for part in (
        "initial time",
        "final time",
        "boundary 1 time",
        "parameter gain",
        "shape[1]",
        "integral work",
    ):
        assert part in labels
    assert "integral effort" not in labels
    assert len(set(transcription.variable_labels)) == transcription.n_variables
    assert len(set(transcription.constraint_row_labels)) == transcription.n_constraints


def test_gradient(case: tuple) -> None:
    """grad_f, and the value of f that comes with it."""
    transcription, x, p, _ = case
    nlp = transcription.nlp
    exact = ca.Function("exact", [nlp.x, nlp.p], [nlp.f, ca.gradient(nlp.f, nlp.x)])
    for ours, theirs in zip(nlp.grad_f(x, p), exact(x, p), strict=True):
        assert_equal(ours, theirs)


def test_jacobian(case: tuple) -> None:
    """jac_g, its value of g, and a pattern that is no larger than CasADi's."""
    transcription, x, p, _ = case
    nlp = transcription.nlp
    exact = ca.Function("exact", [nlp.x, nlp.p], [nlp.g, ca.jacobian(nlp.g, nlp.x)])
    for ours, theirs in zip(nlp.jac_g(x, p), exact(x, p), strict=True):
        assert_equal(ours, theirs)
    assert nlp.jac_g.nnz_out(1) <= exact.nnz_out(1)


@pytest.mark.parametrize("sigma", [0.0, 1.7])
def test_hessian(case: tuple, sigma: float) -> None:
    """hess_lag: the upper triangle of the Hessian of sigma f + lam . g."""
    transcription, x, p, lam = case
    nlp = transcription.nlp
    s, m = ca.MX.sym("s"), ca.MX.sym("m", nlp.n_constraints)
    hessian = ca.hessian(s * nlp.f + ca.dot(m, nlp.g), nlp.x)[0]
    exact = ca.Function("exact", [nlp.x, nlp.p, s, m], [ca.triu(hessian)])
    assert_equal(nlp.hess_lag(x, p, sigma, lam), exact(x, p, sigma, lam))
    assert nlp.hess_lag.nnz_out(0) <= exact.nnz_out(0)


@settings(max_examples=12, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1))
def test_random_separable_programs(seed: int) -> None:
    """Random index maps: arguments may share a variable or be constants, which transcriptions hardly have."""
    rng = np.random.default_rng(seed)
    n_variables, n_constants, n_rows, n_points = 4, 2, 3, 5
    z, d = ca.SX.sym("z", 3), ca.SX.sym("d")
    expression = ca.vertcat(z[0] * z[1] * d + ca.sin(z[2]), z[0] ** 2 * z[2] + z[1])
    block = PointTerm(
        PointFunction.from_expression("random", z, d, expression),
        rng.integers(0, n_variables + n_constants, (3, n_points)),
        ca.MX(ca.DM(rng.normal(size=(1, n_points)))),
        sp.csc_array(rng.normal(size=(n_rows, 2 * n_points)) * rng.integers(0, 2, (n_rows, 2 * n_points))),
    )
    linear = sp.coo_array(rng.normal(size=(n_rows, n_variables)) * rng.integers(0, 2, (n_rows, n_variables)))
    program = SeparableProgram(linear, (block,))
    x, c, m = ca.MX.sym("x", n_variables), ca.MX.sym("c", n_constants), ca.MX.sym("m", n_rows)
    values, nonzeros = program.evaluate_constraints_and_jacobian(x, c)
    ours = ca.Function("ours", [x, c, m], [values, nonzeros, program.evaluate_hessian(x, c, m)])
    rows = program.evaluate_constraint_rows(x, c)
    lagrangian = ca.dot(m, rows)
    jacobian, hessian = ca.jacobian(rows, x), ca.hessian(lagrangian, x)[0]
    theirs = ca.Function("theirs", [x, c, m], [rows, jacobian, ca.triu(hessian)])
    point = rng.normal(size=n_variables), rng.normal(size=n_constants), rng.normal(size=n_rows)
    found, exact = ours(*point), [value.full() for value in theirs(*point)]
    np.testing.assert_allclose(found[0].full(), exact[0], atol=1e-12)
    for pattern, entries, wanted in (
        (program.jacobian_pattern, found[1], exact[1]),
        (program.hessian_pattern, found[2], exact[2]),
    ):
        matrix = np.zeros_like(wanted)
        matrix[pattern] = entries.full().ravel()
        np.testing.assert_allclose(matrix, wanted, atol=1e-12)
