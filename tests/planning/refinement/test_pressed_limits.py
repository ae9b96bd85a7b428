"""Controls that H bends in either way and that have no use for less than their bound and path constraint allow."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from testing.models import one_phase

import gnc_opt as go

G, DRAG, INDUCED, LIFT, MOST = 9.81, 2e-4, 4e3, 1.1e-4, 6.0


def hard_turn(speed: float, angle: float) -> go.Problem:
    """A turn in the least time, slowed down by lift: the load factor is at most 6, and at most 1.1e-4 v^2.

    Below the corner speed slower is worse, and H convex in the load factor; above it is better, and H concave, in so
    far as the turn is over soon.
    """
    model = go.Model("aircraft")
    v, psi = model.state("v", unit="m/s"), model.state("psi", unit="rad")
    n = model.control("n")
    model.ode({v: -DRAG * v**2 - INDUCED * n**2 / v**2, psi: G * n / v})
    problem, turn = one_phase("hard turn", model, initial=0.0, final=(1.0, 60.0), name="turn")
    turn.initial(v=speed, psi=0.0)
    turn.final(psi=angle)
    turn.bounds(n=(0.0, MOST), v=(50.0, 500.0))
    turn.path("lift", n - LIFT * v**2, upper=0.0)
    problem.minimize(turn.final_time)
    return problem


def hardest(speed: float, angle: float) -> tuple[float, float]:
    """Time of the turn flown at the most, and when it comes through the corner speed."""

    def rates(t: float, x: np.ndarray) -> list[float]:
        n = min(MOST, LIFT * x[0] ** 2)
        return [-DRAG * x[0] ** 2 - INDUCED * n**2 / x[0] ** 2, G * n / x[0]]

    events = [lambda t, x: x[0] ** 2 - MOST / LIFT, lambda t, x: x[1] - angle]
    flown = solve_ivp(rates, (0.0, 60.0), [speed, 0.0], events=events, rtol=1e-10, atol=1e-12, max_step=0.05)
    return float(flown.t_events[1][0]), float(flown.t_events[0][0])


def test_a_turn_hands_over_from_the_load_factor_to_lift_at_the_corner_speed() -> None:
    speed, angle = 300.0, np.pi / 3
    least, corner = hardest(speed, angle)
    assert 0.1 * least < corner < 0.9 * least, "both limits are met"
    solution = go.solve(hard_turn(speed, angle))
    assert solution.objective == pytest.approx(least, rel=1e-7)
    assert go.verify(solution).ok
    arcs = [(a.channel, a.kind.value) for a in solution.structure if a.channel == "n"]
    assert arcs == [("n", "upper"), ("n", "constrained")]
    assert solution.structure[0].end == pytest.approx(corner, abs=1e-5)
