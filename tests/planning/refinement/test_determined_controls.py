"""Controls that state constraints determine, and bangs shorter than a mesh shows: closed forms from coarse meshes."""

from __future__ import annotations

import numpy as np
import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go


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


def test_a_jerk_limited_lift() -> None:
    """With both limits reached it takes D / V + V / A + A / J; the jerk is between its limits on three arcs.

    Kinematics: the mean speed of an S-shaped rise of the speed, which lasts V / A + A / J, is V / 2.
    """
    distance, speed, acceleration, jerk = 6.0, 1.0, 0.5, 2.0
    solution = go.solve(lift(distance, speed, acceleration, jerk))
    assert solution.converged and go.verify(solution).ok
    rise, ramp = speed / acceleration + acceleration / jerk, acceleration / jerk
    duration = distance / speed + rise
    assert solution.objective == pytest.approx(duration, rel=1e-10)
    arcs = [(a.start, a.end) for a in solution.structure if a.channel == "j" and not a.kind.is_at_limit]
    half = [(ramp, rise - ramp), (rise, duration - rise), (duration - rise + ramp, duration - ramp)]
    np.testing.assert_allclose(arcs, half, atol=1e-8)


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
