"""Controls that state constraints determine, and bangs shorter than a mesh shows: closed forms from coarse meshes."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning import ArcKind


def lift(distance: float, speed: float, acceleration: float, jerk: float) -> go.Problem:
    """Least time from rest to rest with limits on speed, acceleration and jerk."""
    model = go.Model("lift")
    x, v, a = (model.state(name) for name in "xva")
    j = model.control("j")
    model.ode({x: v, v: a, a: j})
    problem, leg = one_phase("lift", model, initial=0.0, final=(0.5, 60.0))
    leg.initial(x=0.0, v=0.0, a=0.0)
    leg.final(x=distance, v=0.0, a=0.0)
    leg.bounds(j=(-jerk, jerk), a=(-acceleration, acceleration), v=(-speed, speed))
    problem.minimize(leg.final_time)
    return problem


@pytest.mark.parametrize(
    ("numbers", "mesh"), [((6.0, 1.0, 0.5, 2.0), "20x4"), ((6.0, 1.0, 1.0, 2.0), "11x5")]
)
def test_a_jerk_limited_lift(numbers: tuple[float, float, float, float], mesh: str) -> None:
    """With both limits reached it takes D / V + V / A + A / J; the jerk is between its limits on three arcs.

    Kinematics: the mean speed of an S-shaped rise of the speed, which lasts V / A + A / J, is V / 2.
    """
    distance, speed, acceleration, jerk = numbers
    solution = go.solve(lift(*numbers), mesh=mesh)
    assert solution.converged and go.verify(solution).ok
    rise, ramp = speed / acceleration + acceleration / jerk, acceleration / jerk
    duration = distance / speed + rise
    assert solution.objective == pytest.approx(duration, rel=1e-10)
    arcs = [(a.start, a.end) for a in solution.structure if a.channel == "j" and not a.kind.is_at_limit]
    half = [(ramp, rise - ramp), (rise, duration - rise), (duration - rise + ramp, duration - ramp)]
    np.testing.assert_allclose(arcs, half, atol=1e-8)
    held = {(a.channel, a.kind) for a in solution.structure if a.channel in "va"}
    assert held == {("a", ArcKind.LOWER), ("a", ArcKind.UPPER), ("v", ArcKind.UPPER)}


def test_a_speed_limit_holds_across_a_waypoint() -> None:
    """D / V + V / A from rest to rest; a waypoint that is passed at top speed costs nothing and no costate jumps."""
    cart, *_ = dynamics("cart", "x v", "a", lambda x, v, a: {x: v, v: a})
    problem = go.Problem("waypoint")
    first, second = problem.phase("first", cart), problem.phase("second", cart)
    for leg in (first, second):
        leg.bounds(a=(-1.0, 1.0), v=(-2.0, 2.0))
    problem.sequence(first, second)
    first.initial(x=0.0, v=0.0)
    first.final(x=4.0)
    second.final(x=10.0, v=0.0)
    problem.minimize(second.final_time)
    solution = go.solve(problem)
    assert solution.converged and go.verify(solution).ok
    assert solution.objective == pytest.approx(10 / 2 + 2 / 1, rel=1e-9)
    waypoint = solution.phase("first").final_time
    assert waypoint == pytest.approx(3.0, rel=1e-9)
    for name, slope in (("v", 0.0), ("x", -0.5)):
        costates = [solution.phase(p).costate(name)(waypoint) for p in ("first", "second")]
        np.testing.assert_allclose(costates, slope, atol=1e-8)


@pytest.mark.slow
def test_gates_for_a_car_whose_speed_is_limited() -> None:
    """At top speed the car turns as fast as it can or not at all, on both sides of a gate that it passes in a turn.

    Its rate of turn is singular where its acceleration is determined by the speed: each has to be told for itself.
    """
    car = go.Model("car")
    x, y, heading, v = (car.state(name) for name in ("x", "y", "heading", "v"))
    a, w = car.control("a"), car.control("w")
    car.ode({x: v * ca.cos(heading), y: v * ca.sin(heading), heading: w, v: a})
    problem = go.Problem("gates")
    first, second = problem.phase("first", car), problem.phase("second", car)
    for leg in (first, second):
        leg.bounds(a=(-1.0, 1.0), w=(-0.8, 0.8), v=(0.0, 3.0))
    first.time(initial=0.0, final=(0.5, 30.0))
    second.time(initial=(0.5, 30.0), final=(1.0, 60.0))
    first.initial(x=0.0, y=0.0, heading=0.0, v=0.0)
    first.final(x=10.0, y=5.0)
    problem.link(first, second)
    second.final(x=0.0, y=10.0, v=0.0)
    problem.minimize(second.final_time)
    solution = go.solve(problem, mesh="10x4")
    assert solution.converged and go.verify(solution).ok
    turn = {arc.kind for arc in solution.structure if arc.channel == "w"}
    assert turn == {ArcKind.SINGULAR, ArcKind.UPPER}
    for name in ("first", "second"):
        leg = solution.phase(name)
        held = [arc for arc in solution.structure if arc.phase == name and arc.channel == "v"]
        (arc,) = held
        times = np.linspace(arc.start, arc.end, 7)[1:-1]
        np.testing.assert_allclose(leg.costate("v")(times), 0.0, atol=1e-8)
        np.testing.assert_allclose(leg.state("v")(times), 3.0, atol=1e-10)
