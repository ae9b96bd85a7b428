"""Actuators with dead zones and saturation, in the dynamics as their users write them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize

import gnc_opt as go
from gnc_opt.planning.problem.reformulation import restated

Law = Callable[[Any], Any]

EDGE, DURATION = 0.2, 3.0


def clipped(a: Any) -> Any:
    return ca.fmax(ca.fmin(a, 1.0), -1.0)


DEAD: dict[str, Law] = {
    "by parts": lambda a: ca.fmax(a - EDGE, 0) + ca.fmin(a + EDGE, 0),
    "by its sign": lambda a: ca.sign(a) * ca.fmax(ca.fabs(a) - EDGE, 0),
    "by a choice": lambda a: ca.if_else(ca.fabs(a) > EDGE, a - EDGE * ca.sign(a), 0),
}


def cart(act: Law, cost: Law = lambda a: a**2, duration: float = DURATION, **bounds: Any) -> go.Problem:
    """A unit of travel from rest to rest, by an actuator that does not do what it is told."""
    model = go.Model("cart")
    x, v, a = model.state("x"), model.state("v"), model.control("a")
    model.ode({x: v, v: act(a)})
    problem = go.Problem("cart")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=duration)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    leg.bounds(**bounds)
    problem.minimize(leg.integral(cost(a)))
    return problem


def least_cost(
    told: Callable[[Any], Any], done: Callable[[Any], Any], duration: float
) -> tuple[float, float]:
    """Least cost, and the slope of the costate of v, which is linear and odd about half time and tells the control."""
    t = np.linspace(0.0, 0.5 * duration, 400_001)

    def travels(slope: float) -> float:
        acceleration = done(told(slope * (0.5 * duration - t)))
        return float(2 * scipy.integrate.trapezoid((0.5 * duration - t) * acceleration, t)) - 1.0

    slope = float(scipy.optimize.brentq(travels, 0.1, 20.0))
    return float(2 * scipy.integrate.trapezoid(told(slope * (0.5 * duration - t)) ** 2, t)), slope


def jumping(half: Any) -> Any:
    """The least of a^2 - 2 half done(a): beyond the edge by as much as the edge, or nothing."""
    return np.where(half > 2 * EDGE, half, 0.0)


@pytest.fixture(scope="module")
def solved() -> go.Solution:
    return go.solve(cart(DEAD["by parts"]))


@pytest.mark.parametrize("write", DEAD)
def test_a_dead_zone_is_a_share_that_is_off_or_on(write: str) -> None:
    """What costs in the dead zone buys nothing; both sides move the cart as was stated."""
    stated = cart(DEAD[write], a=(-0.9, 2.0))
    leg = restated(stated).phases["leg"]
    act = ca.Function("act", [a := ca.SX.sym("a")], [DEAD[write](a)])
    (control,) = leg.model.composed_controls.values()
    rate = ca.Function(
        "rate", list(leg.model.arguments()), [leg.model.derivative(), leg.integrand_expression()]
    )
    for told in (-0.9, -0.21, 0.0, 0.3, 2.0):
        parts = [np.nan_to_num(p) for p in control.decompose(np.array([[told]]))]
        dx, cost = rate(0.0, [0.0, 0.5], np.concatenate(parts)[:, 0], [])
        np.testing.assert_allclose(dx.full().ravel(), [0.5, float(act(told))], atol=1e-15)
        assert float(cost) == pytest.approx(told**2, abs=1e-15)
        assert control.compose(*parts)[0, 0] == pytest.approx(told, abs=1e-15)
    np.testing.assert_allclose(np.sort(leg.numbers.controls.upper), [0.7, 1.0, 1.0, 1.8])


def test_least_effort_out_of_a_dead_zone_meets_its_closed_form(solved: go.Solution) -> None:
    """The control jumps from nothing to twice the edge, where the costate of the speed is four times it."""
    least, slope = least_cost(jumping, lambda a: np.maximum(a - EDGE, 0.0), DURATION)
    assert solved.converged
    assert go.verify(solved).ok
    assert solved.objective == pytest.approx(
        least, rel=1e-5
    )  # of the reference, by its quadrature over the jump
    switch = 0.5 * DURATION - 2 * EDGE / slope
    for t in (0.0, 0.5 * switch, switch - 1e-3):
        assert solved.evaluate("a", t) == pytest.approx(slope * (0.5 * DURATION - t), abs=1e-4)
    assert solved.evaluate("a", switch + 1e-3) == pytest.approx(0.0, abs=1e-9)


def test_a_minimum_throttle_meets_its_closed_form() -> None:
    """Off, or at least at 30 %: the least that is on is the best while the costate is small."""

    def least(half: Any) -> Any:
        return np.where(half > 0.15, np.maximum(half, 0.3), 0.0)

    duration = 4.0
    solution = go.solve(cart(lambda a: ca.if_else(ca.fabs(a) > 0.3, a, 0), duration=duration, a=(-3.0, 3.0)))
    assert solution.converged
    assert go.verify(solution).ok
    expected, _ = least_cost(least, lambda a: a, duration)
    assert solution.objective == pytest.approx(expected, rel=1e-5)


def test_a_saturated_actuator_is_told_no_more_than_it_can_do() -> None:
    solution = go.solve(cart(clipped, duration=2.1))
    expected, _ = least_cost(lambda half: np.minimum(half, 1.0), lambda a: a, 2.1)
    assert go.verify(solution).minimum
    assert solution.objective == pytest.approx(expected, rel=1e-6)
    assert restated(cart(clipped)).phases["leg"].numbers.controls.upper[0] == 1.0


def test_components_have_dead_zones_of_their_own() -> None:
    """Two axes that do not know of each other, with what one of them costs alone."""
    model = go.Model("two axes")
    r, v, a = model.state("r", 2), model.state("v", 2), model.control("a", 2)
    act = DEAD["by parts"]
    model.ode({r: v, v: ca.vertcat(act(a[0]), act(2 * a[1]))})
    problem = go.Problem("two axes")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=DURATION)
    leg.initial(r=[0.0, 0.0], v=[0.0, 0.0])
    leg.final(r=[1.0, 1.0], v=[0.0, 0.0])
    problem.minimize(leg.integral(a[0] ** 2 + 4 * a[1] ** 2))
    solution = go.solve(problem)
    least, _ = least_cost(jumping, lambda u: np.maximum(u - EDGE, 0.0), DURATION)
    assert solution.objective == pytest.approx(2 * least, rel=1e-5)


def test_what_only_chattering_achieves_is_not_ok() -> None:
    """A slow ramp of speed is less than the least that the actuator does: being on in part is not as stated."""
    model = go.Model("ramp")
    v, a = model.state("v"), model.control("a")
    model.ode({v: ca.if_else(a > 0.5, a, 0)})
    problem = go.Problem("ramp")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=2.0)
    leg.initial(v=0.0)
    leg.bounds(a=(0.0, 1.0))
    problem.minimize(leg.integral(a + 100 * (v - 0.1 * model.time) ** 2))
    verdict = go.verify(go.solve(problem))
    assert not verdict.ok
    assert any(c.name == "dynamics" and "at once" in c.where for c in verdict.failed)


KEPT: dict[str, tuple[Law, Law]] = {
    "no dead zone": (lambda a: ca.fmax(a, 0.5 * a), lambda a: a**2),
    "nothing costs": (DEAD["by parts"], lambda a: 0.0 * a),
    "it pays to be in it": (DEAD["by parts"], lambda a: -ca.fabs(a)),
    "both sides do the same": (lambda a: ca.fmax(ca.fabs(a) - EDGE, 0), lambda a: a**2),
}


@pytest.mark.parametrize("case", KEPT.values(), ids=KEPT)
def test_other_kinks_are_left_alone(case: Any) -> None:
    stated = cart(*case)
    assert restated(stated) is stated


def test_solutions_with_dead_zones_are_kept_on_disk(solved: go.Solution, tmp_path: Any) -> None:
    solved.save(tmp_path / "cart.json")
    again = go.load(tmp_path / "cart.json", cart(DEAD["by parts"]))
    assert again.evaluate("a", 0.3) == solved.evaluate("a", 0.3)
