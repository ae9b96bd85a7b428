"""Control rates and control polynomials against closed forms and an independent quadratic program."""

import numpy as np
import pytest
from testing.models import one_phase

import gnc_opt as go


def cart() -> tuple[go.Model, object]:
    model = go.Model("cart")
    q, v, a = model.state("q", unit="m"), model.state("v", unit="m/s"), model.control("a", unit="m/s^2")
    model.ode({q: v, v: a})
    return model, a


def ride(name: str, final_time: object, distance: float) -> tuple[go.Problem, object, object]:
    model, a = cart()
    problem, leg = one_phase(name, model, 0.0, final_time)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=distance, v=0.0)
    return problem, leg, a


@pytest.mark.slow
def test_fastest_ride_with_limited_acceleration_and_jerk() -> None:
    """At the limit of acceleration the ride takes j + sqrt(j^2 + 4 d / a), j the time from zero to that limit."""
    problem, leg, _ = ride("limited jerk", (0.1, 20.0), 8.0)
    leg.bounds(a=(-1.0, 1.0))
    leg.rates(a=(-1.0, 1.0))
    leg.initial(a=0.0)
    leg.final(a=0.0)
    problem.minimize(leg.final_time)
    found = go.solve(problem)
    assert found.objective == pytest.approx(1.0 + np.sqrt(33.0), rel=1e-9)
    assert go.verify(found).minimum
    assert found.control("a").unit == "m/s^2"
    times = np.linspace(0.0, 1.0, 5)
    assert found.control("a")(times) == pytest.approx(times, abs=1e-9)
    # dJ*/da(0) by finite differences of the closed form with another acceleration at the start
    other = go.solve(problem.with_initial(a=1e-3)).objective
    assert found.costate("a")(0.0) == pytest.approx((other - found.objective) / 1e-3, rel=2e-3)


@pytest.mark.parametrize("span", [2.0, 4000.0])
def test_polynomial_of_least_effort(span: float) -> None:
    """Against the quadratic program in the monomials of the acceleration, with a(0) = 0, for short and long phases."""
    problem, leg, a = ride("cubic", span, span**2)
    leg.polynomials(a=3)
    leg.initial(a=0.0)
    problem.minimize(leg.integral(a**2) / span)
    k = np.arange(1, 4)  # a(s) = sum c_k s^k, s = t / T
    gram = 1.0 / (k[:, None] + k[None, :] + 1.0)
    ends = np.array([1.0 / (k + 1.0), 1.0 / ((k + 1.0) * (k + 2.0))])  # v(T) / T = 0, q(T) / T^2 = 1
    weights = np.linalg.solve(ends @ np.linalg.solve(gram, ends.T), [0.0, 1.0])
    found = go.solve(problem)
    assert found.objective == pytest.approx(weights @ [0.0, 1.0], rel=1e-7)
    assert go.verify(found).ok


def test_straight_line_as_fastest_control() -> None:
    """a = 1 - 2 t / T moves the cart by T^2 / 6; the duration is free."""
    problem, leg, _ = ride("linear", (0.1, 100.0), 1.0)
    leg.bounds(a=(-1.0, 1.0))
    leg.polynomials(a=1)
    problem.minimize(leg.final_time)
    assert go.solve(problem, check=False).objective == pytest.approx(np.sqrt(6.0), rel=1e-8)


@pytest.mark.slow
def test_constant_control() -> None:
    problem, leg, _ = ride("constant", (0.1, 10.0), 2.0)
    leg.final(q=2.0, v=None)
    leg.bounds(a=(-1.0, 1.0))
    leg.polynomials(a=0)
    problem.minimize(leg.final_time)
    assert go.solve(problem, check=False).objective == pytest.approx(2.0, rel=1e-8)


def test_numbers_stated_before_stay_by_name() -> None:
    model = go.Model("two controls")
    x, first, second = model.state("x"), model.control("first"), model.control("second", 2)
    model.ode({x: first + second[0] - second[1]})
    leg = go.Problem("numbers").phase("leg", model)
    leg.bounds(x=(0.0, 5.0), first=(-1.0, 2.0), second=([3.0, 4.0], [5.0, 6.0]))
    leg.rates(first=(None, 7.0))
    assert list(leg.numbers.states.upper) == [5.0, 2.0]
    assert list(leg.numbers.controls.lower) == [3.0, 4.0, -np.inf]
    assert leg.numbers.controls.upper[2] == 7.0


def test_wrong_uses_are_named() -> None:
    model = go.Model("vector")
    x = model.state("x", 2)
    thrust, _ = model.vector_control("T", 2)
    a = model.control("a")
    model.control("b")
    model.output("b_rate", x[0])
    model.ode({x: thrust + a})
    leg = go.Problem("wrong").phase("leg", model)
    with pytest.raises(go.ProblemError, match=r"control 'a' .* may jump there: limit its rate before"):
        leg.initial(a=0.0)
    with pytest.raises(go.ProblemError, match="'x', which is a state"):
        leg.rates(x=1.0)
    with pytest.raises(go.ProblemError, match="'T' is made of several controls"):
        leg.rates(T=(-1.0, 1.0))
    with pytest.raises(go.ProblemError, match="needs the name 'b_rate', which its model has as output"):
        leg.rates(b=(-1.0, 1.0))
    with pytest.raises(go.UnknownNameError, match="'c'"):
        leg.polynomials(c=2)
    with pytest.raises(go.ProblemError, match=r"names no control: write rates\(u=\(-1, 1\)\)"):
        leg.rates()
    with pytest.raises(go.ProblemError, match=r"names no control: write polynomials\(u=3\)"):
        leg.polynomials()
    with pytest.raises(go.ProblemError, match="degree of control 'a'"):
        leg.polynomials(a=-1)
    leg.rates(a=(-1.0, 1.0))
    with pytest.raises(go.ProblemError, match="'a', which has rates or a degree already: state them once"):
        leg.polynomials(a=1)


@pytest.mark.parametrize(("degree", "effort"), [(0, 2.0), (1, 1.5)])
def test_polynomials_of_two_phases(degree: int, effort: float) -> None:
    """A constant per second takes a = 1, then -1; straight lines make the one of least effort, 12 / T^3."""
    model, a = cart()
    problem = go.Problem("two polynomials")
    legs = [problem.phase(name, model) for name in ("one", "two")]
    for k, leg in enumerate(legs):
        leg.time(float(k), k + 1.0)
        leg.polynomials(a=degree)
    problem.link(*legs)
    assert set(problem.constraints) == {"link_one_two_q", "link_one_two_v", "link_one_two_time"}
    legs[0].initial(q=0.0, v=0.0)
    legs[1].final(q=1.0, v=0.0)
    problem.minimize(sum(leg.integral(a**2) for leg in legs))
    assert go.solve(problem, check=False).objective == pytest.approx(effort, rel=1e-8)


@pytest.mark.slow
def test_polynomial_over_a_divided_phase() -> None:
    """It is one over both parts: the fraction and the coefficients are handed over."""
    problem, leg, a = ride("divided", 2.0, 1.0)
    leg.polynomials(a=2)
    leg.initial(a=0.0)
    parts = problem.divide(leg, fractions=[0.4])
    problem.minimize(sum(part.integral(a**2) for part in parts))
    whole, leg, a = ride("whole", 2.0, 1.0)
    leg.polynomials(a=2)
    leg.initial(a=0.0)
    whole.minimize(leg.integral(a**2))
    assert go.solve(problem, check=False).objective == pytest.approx(
        go.solve(whole, check=False).objective, rel=1e-8
    )


def test_rates_come_before_links() -> None:
    model, _ = cart()
    problem = go.Problem("late")
    legs = [problem.phase(name, model) for name in ("one", "two")]
    problem.link(*legs)
    with pytest.raises(go.ProblemError, match=r"is called after link\(\) or sequence\(\)"):
        legs[0].rates(a=(-1.0, 1.0))
