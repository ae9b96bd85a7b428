"""Nonlinear problems that the property tests share; small, smooth, without a known solution."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

import gnc_opt as go
from testing.models import one_phase

SCHEMES = ("LG", "LGR", "LGL")


def van_der_pol(*, unit: float = 1.0, start: float = 0.0) -> go.Problem:
    """Regulate a van der Pol oscillator over 4 s from (x, y) = (0, 1); x is counted in ``1 / unit``."""
    model = go.Model("van der Pol")
    x, y, u = model.state("x"), model.state("y"), model.control("u")
    mu = model.parameter("mu", 1.0)
    model.ode({x: unit * (mu * (1 - y**2) * (x / unit) - y + u), y: x / unit})
    problem, leg = one_phase("van der Pol regulator", model, initial=start, final=start + 4.0)
    leg.initial(x=0.0, y=1.0)
    problem.minimize(leg.integral((x / unit) ** 2 + y**2 + u**2) + leg.final_state("y") ** 4)
    return problem


def orbit_raising(*, weight: float = 1.0, circular: float = 1.0) -> go.Problem:
    """Largest circular orbit in 3.32 time units with constant thrust (Bryson & Ho 1975, sec. 2.5).

    ``weight`` multiplies the payoff; ``circular`` is vt sqrt(r) at the end, 1 on a circle.
    """
    model = go.Model("orbit raising")
    r, vr, vt = model.state("r"), model.state("vr"), model.state("vt")
    angle = model.control("angle")
    thrust = 0.1405 / (1 - 0.0749 * model.time)
    model.ode(
        {r: vr, vr: vt**2 / r - 1 / r**2 + thrust * ca.sin(angle), vt: -vr * vt / r + thrust * ca.cos(angle)}
    )
    problem, leg = one_phase("orbit raising", model, initial=0.0, final=3.32)
    leg.initial(r=1.0, vr=0.0, vt=1.0)
    leg.final(vr=0.0)
    leg.guess(r=(1.0, 1.5), vt=(1.0, 0.8), angle=lambda t: 0.6 + t if t < 1.66 else t - 3.8)
    problem.constrain("circular", leg.final_state("vt") * ca.sqrt(leg.final_state("r")), equals=circular)
    problem.maximize(weight * leg.final_state("r"))
    return problem


def reorientation() -> go.Problem:
    """Turn a rigid body (modified Rodrigues parameters) with least effort: vector-valued variables."""
    inertia = ca.DM([1.0, 1.4, 0.7])
    body = go.Model("rigid body")
    sigma, omega = body.state("sigma", 3), body.state("omega", 3)
    torque = body.control("torque", 3)
    square = ca.dot(sigma, sigma)
    turning = ((1 - square) * omega + 2 * ca.cross(sigma, omega) + 2 * sigma * ca.dot(sigma, omega)) / 4
    body.ode({sigma: turning, omega: (torque - ca.cross(omega, inertia * omega)) / inertia})
    problem, leg = one_phase("reorientation", body, initial=0.0, final=3.0)
    leg.initial(sigma=[0.4, -0.2, 0.1], omega=[0.1, 0.2, -0.3])
    leg.final(sigma=[0.0, 0.0, 0.0], omega=[0.0, 0.0, 0.0])
    problem.minimize(leg.integral(ca.dot(torque, torque) / 2))
    return problem


PROBLEMS: dict[str, tuple[Callable[[], go.Problem], go.Mesh]] = {
    "van der Pol": (van_der_pol, go.Mesh.uniform(6, 5)),
    "orbit raising": (orbit_raising, go.Mesh.uniform(8, 5)),
    "reorientation": (reorientation, go.Mesh.uniform(4, 5)),
}
"""With meshes that get the costs right to 1e-5; the properties hold for the discrete problems themselves."""


def solve(
    problem: go.Problem, mesh: go.Mesh, scheme: str = "LG", guess: go.Solution | None = None
) -> go.Solution:
    """Solve to 1e-10."""
    options = go.SolverOptions(tolerance=1e-10)
    return go.solve(problem, mesh=mesh, scheme=scheme, guess=guess, options=options, tol=None)


def initial_costates(solution: go.Solution) -> np.ndarray:
    """All costates at the start, (n_states,), from the polynomials."""
    leg = solution.phase()
    return leg.lam(leg.initial_time)


def relative_difference(found: np.ndarray, wanted: np.ndarray) -> float:
    """Largest difference relative to the largest entry."""
    return float(np.max(np.abs(found - wanted)) / np.max(np.abs(wanted)))
