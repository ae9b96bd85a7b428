"""State constraints of first and third order through the default call, against independent programs.

Of second order: Bryson and Denham's problem (`test_contacts`) and the lift (`test_determined_controls`).
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve
from testing.models import dynamics, one_phase

import gnc_opt as go

LIMIT = -0.25


def van_der_pol_rates(t: float, z: np.ndarray) -> list[float]:
    """States and costates of a free arc, u = -lam_x / 2."""
    x, y, p, q = z
    return [(1 - y**2) * x - y - p / 2, x, -2 * x - p * (1 - y**2) - q, -2 * y + p * (2 * x * y + 1)]


def held_control(y: float) -> float:
    """What keeps x on its limit."""
    return float(y - (1 - y**2) * LIMIT)


def flown(rates: object, z: list[float], span: tuple[float, float]) -> np.ndarray:
    found = solve_ivp(rates, span, z, method="DOP853", rtol=1e-12, atol=1e-13)
    return np.asarray(found.y[:, -1])


def van_der_pol_open(unknowns: np.ndarray) -> list[float]:
    """What is not met by two costates at the start, entry and exit: the arc is met smoothly, the end is free."""
    p, q, entry, leaving = unknowns
    x, y, p, q = flown(van_der_pol_rates, [0.0, 1.0, p, q], (0.0, entry))
    met = [x - LIMIT, p + 2 * held_control(y)]

    def along(t: float, z: np.ndarray) -> list[float]:
        return [LIMIT, -2 * z[0] - 2 * held_control(z[0]) * (2 * LIMIT * z[0] + 1)]

    y, q = flown(along, [y, q], (entry, leaving))
    end = flown(van_der_pol_rates, [LIMIT, y, -2 * held_control(y), q], (leaving, 10.0))
    return [*met, end[2], end[3]]


def test_vdp_state_of_first_order() -> None:
    """Least int x^2 + y^2 + u^2 over 10 s, x >= -1/4: an arc on the limit, by shooting at both of its ends."""
    model, x, y, u = dynamics("Van der Pol", "x y", "u", lambda x, y, u: {x: (1 - y**2) * x - y + u, y: x})
    problem, leg = one_phase("vdp_state", model, initial=0.0, final=10.0)
    leg.initial(x=0.0, y=1.0)
    leg.bounds(x=(LIMIT, None), u=(-1.0, 1.0))
    problem.minimize(leg.integral(x**2 + y**2 + u**2))
    solution = go.solve(problem)
    assert solution.converged and go.verify(solution).ok
    (arc,) = [a for a in solution.structure if a.channel == "x"]
    start = solution.phase().lam(0.0)
    exact = fsolve(van_der_pol_open, [0.828, 8.347, 0.364, 2.912], xtol=1e-12)
    np.testing.assert_allclose(van_der_pol_open(exact), 0.0, atol=1e-9)
    np.testing.assert_allclose([*start, arc.start, arc.end], exact, rtol=0, atol=1e-6)


def robbins(last: float) -> go.Problem:
    """Robbins (SIAM J. Control Optim. 18(4), 1980): least int 3 x + u^2 / 2, d3x/dt3 = u, x >= 0."""
    model, x, _v, _a, u = dynamics("third order", "x v a", "u", lambda x, v, a, u: {x: v, v: a, a: u})
    problem, leg = one_phase("Robbins", model, initial=0.0, final=last)
    leg.initial(x=1.0, v=-2.0, a=0.0)
    leg.bounds(x=(0.0, None))
    problem.minimize(leg.integral(3 * x + u**2 / 2, "effort"))
    return problem


def robbins_open(unknowns: np.ndarray) -> list[float]:
    """What is not met by u and its derivatives at the start, two touches and the jumps of u'' there, up to 4 s.

    u = -lam_a, so that u' = lam_v, u'' = -lam_x and u''' = 3 between the touches.
    """
    *u, first, second, jump, other = unknowns
    z = np.array([1.0, -2.0, 0.0, *u])
    left: list[float] = []
    for duration, push in ((first, jump), (second - first, other), (4.0 - second, 0.0)):
        z = after(z, duration)
        if push:
            left += [z[0], z[1]]
            z[5] += push
    return [*left, *z[3:]]


def after(z: np.ndarray, t: float) -> np.ndarray:
    """x, v, a, u, u', u'' after a time without a touch."""
    d = [*z, 3.0]  # derivatives of x; the sixth is 3
    powers = [t**k / np.prod(np.arange(1, k + 1)) for k in range(7)]
    return np.array([sum(d[i + k] * powers[k] for k in range(7 - i)) for i in range(6)])


@pytest.fixture(scope="module")
def four_seconds() -> go.Solution:
    """Two touches."""
    return go.solve(robbins(4.0))


def test_robbins_of_third_order(four_seconds: go.Solution) -> None:
    """Contacts are touches; the problem is convex, so that multipliers of the right signs make the optimum."""
    assert four_seconds.converged and go.verify(four_seconds).ok
    touches = [(arc.start, arc.end) for arc in four_seconds.structure if arc.channel == "x"]
    assert len(touches) == 2 and all(start == end for start, end in touches)
    exact = fsolve(robbins_open, [14.4, -43.9, 50.5, 0.975, 3.85, -60.0, -2.4], xtol=1e-13)
    np.testing.assert_allclose(robbins_open(exact), 0.0, atol=1e-9)
    assert exact[5] < 0 and exact[6] < 0  # the limit pushes: lam_x = -u'' falls by what it pushes
    np.testing.assert_allclose([start for start, _ in touches], exact[3:5], atol=1e-7)
    leg = four_seconds.phase()
    np.testing.assert_allclose(leg.lam(0.0), [-exact[2], exact[1], -exact[0]], rtol=1e-6)
