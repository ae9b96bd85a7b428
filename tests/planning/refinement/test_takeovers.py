r"""A car on a hill gives its speed limit up where full power no longer holds it: the costate of speed jumps there.

Least :math:`\int u^2\,dt` to x = 10 with :math:`\dot x = v`, :math:`\dot v = u - s(x)`, :math:`v \le 1`,
:math:`u \le 0.9`. With :math:`s = e^{-(x-5)^2/2.25}` the arc on the speed limit, u = s, ends where s = 0.9. Here it is
found anew by shooting: on both sides of the limits u = -lambda_v / 2.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.models import one_phase

import gnc_opt as go
from gnc_opt.array_types import Array

MOST, END, WIDTH = 0.9, 14.0, 2.25
GIVEN_UP = 5.0 - np.sqrt(WIDTH * np.log(1.0 / MOST))


@pytest.fixture(scope="module")
def driven() -> go.Solution:
    model = go.Model("car")
    x, v, u = model.state("x"), model.state("v"), model.control("u")
    model.ode({x: v, v: u - ca.exp(-((x - 5.0) ** 2) / WIDTH)})
    problem, leg = one_phase("hill", model, initial=0.0, final=END, name="drive")
    leg.initial(x=0.0, v=0.0)
    leg.final(x=10.0, v=0.0)
    leg.bounds(u=(-MOST, MOST), v=(None, 1.0))
    problem.minimize(leg.integral(u**2))
    return go.solve(problem, tol=1e-8, structure="none")


def slope(x: float) -> float:
    return float(np.exp(-((x - 5.0) ** 2) / WIDTH))


def flown(start: Array, times: tuple[float, float], power: float | None = None) -> Array:
    """State, costate and cost after a time without the limit on speed, with u as H has it least, or given."""

    def rates(_: float, y: Array) -> list[float]:
        x, v, lam_x, lam_v, _ = y
        u = -0.5 * lam_v if power is None else power
        slant = -2.0 * (x - 5.0) / WIDTH * slope(x)
        return [v, u - slope(x), lam_v * slant, -lam_x, u**2]

    return np.asarray(
        scipy.integrate.solve_ivp(rates, times, start, "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    )


def shot(unknown: Array) -> tuple[Array, float]:
    """What entry and end miss, and the cost: of costates at the start, entry, jump, and end of full power."""
    lam_x, lam_v, entry, jump, relief = unknown
    y = flown(np.array([0.0, 0.0, lam_x, lam_v, 0.0]), (0.0, entry))
    missed = [y[1] - 1.0, y[3] + 2.0 * slope(y[0])]
    on_limit = GIVEN_UP - y[0]  # at speed 1
    cost = scipy.integrate.quad(lambda x: slope(x) ** 2, y[0], GIVEN_UP, epsabs=1e-12)[0]
    lam_x = y[2] - (MOST**2 - slope(y[0]) ** 2)  # its rate is that of -u^2
    given_up = entry + on_limit
    y = flown(np.array([GIVEN_UP, 1.0, lam_x, -2.0 * MOST - jump, y[4] + cost]), (given_up, relief), MOST)
    missed.append(y[3] + 2.0 * MOST)
    y = flown(y, (relief, END))
    return np.array([*missed, y[0] - 10.0, y[1]]), float(y[4])


@pytest.mark.slow
def test_limit_of_speed_is_given_up_where_shooting_says(driven: go.Solution) -> None:
    leg = driven.phases["drive"]
    times = np.linspace(0.0, END, 4001)
    fastest, fullest = times[leg.x(times)[1] > 1.0 - 1e-6], times[leg.u(times)[0] > MOST - 1e-6]
    entry, given_up, relief = fastest[0], fastest[-1], fullest[-1]
    jump = leg.lam(entry - 0.01)[1] - leg.lam(given_up + 0.01)[1]
    exact = scipy.optimize.fsolve(lambda z: shot(z)[0], [*leg.lam(0.0), entry, jump, relief], xtol=1e-12)
    assert leg.lam(0.0) == pytest.approx(exact[:2], abs=1e-4)
    assert exact[2] == pytest.approx(entry, abs=1e-2) and exact[3] > 0.1
    assert driven.objective == pytest.approx(shot(exact)[1], rel=1e-9)


def test_verdict_passes_with_the_jump(driven: go.Solution) -> None:
    """Without the condition that both limits are met at one time the cost would fall with that time."""
    assert driven.history is not None and driven.history.converged
    assert go.verify(driven).ok


def test_least_time_over_the_hill_is_full_power_the_limit_of_speed_and_full_brakes() -> None:
    """H is affine in power: flown here at full power up to the limit, along it while power lasts, and then braked."""
    model = go.Model("car")
    x, v, u = model.state("x"), model.state("v"), model.control("u")
    model.ode({x: v, v: u - ca.exp(-((x - 5.0) ** 2) / WIDTH)})
    problem, leg = one_phase("hill in the least time", model, initial=0.0, final=(2.0, 40.0), name="drive")
    leg.initial(x=0.0, v=0.0)
    leg.final(x=10.0, v=0.0)
    leg.bounds(u=(-MOST, MOST), v=(None, 1.0))
    problem.minimize(leg.final_time)
    solution = go.solve(problem)
    assert go.verify(solution).ok
    powered = [(a.start, a.end) for a in solution.structure if (a.channel, a.kind.value) == ("u", "upper")]
    entry, start = driven_until_limit(0.0, 0.0)
    over, on = driven_until_limit(GIVEN_UP, 1.0)
    given_up = entry + GIVEN_UP - start
    assert powered == [
        pytest.approx((0.0, entry), abs=1e-8),
        pytest.approx((given_up, given_up + over), abs=1e-8),
    ]
    braking, place = driven_until_limit(10.0, 0.0, power=-MOST)
    assert solution.objective == pytest.approx(given_up + over + place - on + braking, rel=1e-9)


def driven_until_limit(x: float, v: float, power: float = MOST) -> tuple[float, float]:
    """Time and place at which full power has brought the car to the limit of speed; with brakes backwards in time."""
    way = np.sign(power)

    def limit(_: float, y: Array) -> float:
        return float(y[1] - 1.0)

    def rates(_: float, y: Array) -> list[float]:
        return [way * y[1], way * (power - slope(y[0]))]

    limit.terminal, limit.direction = True, 1.0  # type: ignore[attr-defined]
    run = scipy.integrate.solve_ivp(
        rates, (0.0, 5.0), [x, v], "DOP853", events=limit, rtol=1e-12, atol=1e-13, max_step=0.1
    )
    return float(run.t_events[0][0]), float(run.y_events[0][0][0])
