"""References: from solutions, functions and constants; their means, jumps and tails."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad
from testing.models import cart_with_units as cart
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.control import Reference, trim
from gnc_opt.errors import ArgumentError


def fastest(bound: float = 1.0) -> go.Solution:
    """Rest to rest over 1 m in least time 2 / sqrt(bound), with one switch in the middle."""
    ocp, leg = one_phase("rest to rest", cart(), initial=0.0, final=(0.1, 10.0))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-bound, bound))
    ocp.minimize(leg.final_time)
    return go.solve(ocp, tol=None)


@pytest.fixture(scope="module")
def solution() -> go.Solution:
    return fastest()


def test_follows_the_solution_and_rests_after_it(solution):
    reference = Reference(solution)
    assert reference.final_time == pytest.approx(2.0, abs=1e-2)
    times = np.linspace(0, reference.final_time, 7)
    assert np.allclose(reference.x(times), solution.phases["leg"].x(times))
    assert np.allclose(reference.u(times), solution.phases["leg"].applied(times))
    assert np.allclose(reference.x(50.0), 0, atol=1e-8)
    assert np.allclose(reference.u(50.0), 0, atol=1e-8)
    assert reference.x(1.0).shape == (2,)
    assert reference.x(np.zeros(5)).shape == (2, 5)


def test_mean_control_has_the_impulse_of_the_reference(solution):
    reference = Reference(solution)
    dt = 0.23  # no multiple fits: steps straddle the switch and the end
    times = dt * np.arange(12)
    means = reference.mean_control(times, dt)
    v_end = reference.x(0.0)[1] + dt * means[0].sum()
    assert v_end == pytest.approx(0.0, abs=1e-7)
    k = 4  # the step with the switch near 1 s
    marks = [float(t) for t in reference.jumps if times[k] < t < times[k] + dt]
    exact = quad(lambda t: reference.u(t)[0], times[k], times[k] + dt, points=marks, limit=400)[0] / dt
    assert means[0, k] == pytest.approx(exact, abs=1e-6)


def test_mean_control_of_functions_is_exact_across_jumps_and_the_end():
    reference = Reference.from_functions(
        cart(), lambda t: [0, 0], lambda t: [t**3 if t < 1 else 2.0], 0, 1.5, jumps=[1.0], tail="hold"
    )
    assert reference.mean_control([0.6], 0.8)[0, 0] == pytest.approx(
        ((1 - 0.6**4) / 4 + 2 * 0.4) / 0.8, rel=1e-14
    )
    assert reference.mean_control([1.4, 7.0], 0.2)[0] == pytest.approx([2.0, 2.0], rel=1e-14)
    trimmed = Reference.from_functions(cart(), lambda t: [0, 0], lambda t: [3.0], 0, 1.0, tail="trim")
    assert trimmed.mean_control([0.9], 0.4)[0, 0] == pytest.approx(0.75, rel=1e-14)


def test_vectorized_functions_are_the_reference_that_they_are_time_by_time():
    def x(t):
        return [np.sin(t), np.cos(t)]

    def u(t):
        return [np.where(t < 1.0, t**3, 2.0)]

    options = {"jumps": [1.0], "tail": "hold"}
    one = Reference.from_functions(cart(), x, u, 0, 1.5, **options)
    many = Reference.from_functions(cart(), x, u, 0, 1.5, vectorized=True, **options)
    times = np.array([0.0, 0.3, 1.0, 1.4, 2.0])
    np.testing.assert_array_equal(many.x(times), one.x(times))
    np.testing.assert_allclose(many.u(times), one.u(times), rtol=1e-14)
    np.testing.assert_allclose(many.mean_control(times, 0.4), one.mean_control(times, 0.4), rtol=1e-14)
    np.testing.assert_array_equal(many.x(0.3), one.x(0.3))


def test_vectorized_functions_that_return_no_columns_are_refused():
    with pytest.raises(
        go.ArgumentError, match=r"states .* shape \(2,\) at 24 times, not \(2, 24\): return a column"
    ):
        Reference.from_functions(cart(), lambda t: [0, 0], lambda t: [0 * t], 0, 1, vectorized=True).x(0.5)
    with pytest.raises(go.ArgumentError, match=r"controls of a reference are not finite at 0\.5 s"):
        Reference.from_functions(
            cart(), lambda t: [t, t], lambda t: [np.where(t == 0.5, np.nan, t)], 0, 1, vectorized=True
        ).u([0.1, 0.5])


def test_functions_that_return_no_numbers_are_refused_where_they_do():
    with pytest.raises(go.ArgumentError, match=r"states of a reference are not finite at 0\.75 s"):
        Reference.from_functions(
            cart(), lambda t: [1.0, np.nan if t == 0.75 else 0.0], lambda t: [0.0], 0, 1
        ).x([0.5, 0.75])
    whatever = [
        [1, 2.5], (1, 2.5), np.array([1, 2.5]), [np.array(1), 2.5], [1.0, np.float32(2.5)], [True, 2.5],
    ]  # fmt: skip
    for row in whatever:
        reference = Reference.from_functions(cart(), lambda t, row=row: row, lambda t: 0.0, 0, 0)
        np.testing.assert_array_equal(reference.x([0.0, 0.0]).T, [[1, 2.5], [1, 2.5]])
    for row, said in (
        ([1.0, 0.0, 0.0], "is given 3 values"),
        ([1.0, 10**400], "not a number"),
        ([1.0, "2"], "not a number"),
    ):
        with pytest.raises(go.GncOptError, match=said):
            Reference.from_functions(cart(), lambda t, row=row: row, lambda t: 0.0, 0, 0).x(0.0)


def test_phases_are_followed_one_after_the_other():
    ocp = go.Problem("two legs")
    first, second = ocp.phase("first", cart()), ocp.phase("second", cart())
    for leg, start, end in ((first, 0.0, 1.0), (second, 1.0, 3.0)):
        leg.time(initial=start, final=end)
        leg.bounds(a=(-9, 9))
    first.initial(q=0.0, v=0.0)
    first.final(q=1.0, v=0.5)
    second.initial(q=1.0, v=0.5)
    second.final(q=0.0, v=0.0)
    ocp.minimize(_effort(first) + _effort(second))
    solution = go.solve(ocp, tol=None)
    reference = Reference(solution)
    assert (reference.initial_time, reference.final_time) == (0.0, 3.0)
    assert np.allclose(reference.x(1.0), [1.0, 0.5], atol=1e-7)
    # least squares: on each leg the control is linear in time
    u = reference.u(np.array([0.2, 0.5, 0.8, 1.4, 2.0, 2.6]))[0]
    assert u[1] - u[0] == pytest.approx(u[2] - u[1], abs=1e-6)
    assert u[4] - u[3] == pytest.approx(u[5] - u[4], abs=1e-6)


def _effort(leg):
    return leg.integral(leg.model.symbol("a") ** 2)


def test_tails(solution):
    held = Reference(solution, tail="hold")
    assert held.u(9.0) == pytest.approx(held.u(held.final_time))
    with pytest.raises(ArgumentError, match="no tail 'trimm': did you mean 'trim'"):
        Reference(solution, tail="trimm")
    with pytest.raises(ArgumentError, match=r"not at -1\.0 s"):
        held.x(-1.0)


def test_trim_finds_the_control_that_holds_a_state():
    model, *_ = dynamics("pendulum", "q v", "a", lambda q, v, a: {q: v, v: a + 0.1 * a**3 - ca.sin(q)})
    u = trim(model, 0.0, [0.5, 0.0])
    assert u[0] + 0.1 * u[0] ** 3 == pytest.approx(np.sin(0.5), abs=1e-14)
    assert Reference.constant(model, [0.5, 0.0]).u(3.0) == pytest.approx(u)
    with pytest.raises(ArgumentError, match=r"no control keeps.*'q' still moves at 0.2"):
        trim(model, 0.0, [0.5, 0.2])
    with pytest.raises(ArgumentError, match="no control keeps"):
        Reference.from_functions(model, lambda t: [t, 1], lambda t: [0], 0, 1, tail="trim")


def test_a_solution_that_is_not_solved_is_refused():
    ocp, leg = one_phase("too far", cart(), initial=0.0, final=1.0)
    leg.initial(q=100.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1, 1))
    ocp.minimize(_effort(leg))
    failed = go.solve(ocp, throw=False, tol=None)
    with pytest.raises(ArgumentError, match=r"cannot follow the solution of 'too far', which ended as \w+"):
        Reference(failed)


def test_bad_references_are_refused():
    with pytest.raises(ArgumentError, match="Trajectory"):
        Reference("solution")
    with pytest.raises(ArgumentError, match=r"no time span from 2\.0 s to 1\.0 s"):
        Reference.from_functions(cart(), lambda t: [0, 0], lambda t: [0], 2, 1)
    with pytest.raises(ArgumentError, match="3 values"):
        Reference.constant(cart(), [1, 2, 3])


NAN, INF = np.nan, np.inf


@pytest.mark.parametrize(("start", "end"), [(2.0, 1.0), (NAN, 1.0), (0.0, INF)])
def test_a_reference_between_times_that_are_none_is_refused(start, end):
    with pytest.raises(ArgumentError, match="give increasing times"):
        Reference.from_functions(cart(), lambda t: [0, 0], lambda t: [0], start, end)
