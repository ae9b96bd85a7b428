r"""The lander, its plan, and the plant.

**Plan.** The lander starts 2.4 km above and 2 km to the side of the target and reaches the ground with 1 m/s downward.
The plan minimises the integral of the squared acceleration by the engines, with free final time and a throttle of 33
to 77 %. The engines permit 30 to 80 %; the margin is for the regulator. A minimum-propellant plan saves 17 kg, but uses
the engines at their limit from the middle of the flight on, so that no authority remains against disturbances. The
norm of the thrust is rounded by 1 N, so that it has derivatives everywhere.

.. math:: \dot r = v, \quad \dot v = \frac{T}{m} - g e_1, \quad \dot m = -\alpha \|T\|

**Plant.** An atmosphere with wind,

.. math:: \dot v = \frac{T}{m} - g e_1 - \tfrac12 \rho C_D A \, \|v - w\| \, \frac{v - w}{m} .

The lander, its engines and the gravity of Mars are those of `problems.landing.mars_landing`, from Acikmese and Ploen,
Convex programming approach to powered descent guidance for Mars landing, J. Guidance, Control, and Dynamics 30 (5),
2007.
"""

from __future__ import annotations

import warnings
from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt.array_types import Array
from gnc_opt.control import Reference
from problems.landing.mars_landing import FULL, GRAVITY, MASS_RATE

START: dict[str, Any] = {"r": [2400.0, 300.0, -2000.0], "v": [-75.0, -20.0, 80.0], "mass": 1905.0}
"""Up, east and north, m and m/s; kg."""
SETTLING = 1.0
"""Speed downward at the end of the plan, m/s."""
PLANNED, ENGINES = (0.33, 0.77), (0.3, 0.8)
"""Throttle of the plan, and what the engines are commanded at least and at most."""
AIR, DRAG_AREA = 0.02, 4.0
"""Density (kg/m^3) and drag area (m^2)."""
MESH = "12x3"
UP = np.array([1.0, 0.0, 0.0])
_ROUNDING = 1.0
"""Of the norm of the thrust, N."""
_AFTER = 60.0
"""How long the lander may go on settling after the plan, s."""


def norm(thrust: Any) -> Any:
    """Return the size of a thrust (SX, N), rounded where it vanishes."""
    return ca.sqrt(ca.sumsqr(thrust) + _ROUNDING**2)


def planned_model() -> go.Model:
    """Return the lander as the plan sees it."""
    lander = go.Model("lander")
    r, v = lander.state("r", 3, unit="m"), lander.state("v", 3, unit="m/s")
    mass, T = lander.state("mass", unit="kg"), lander.control("T", 3, unit="N")
    lander.ode({r: v, v: T / mass - GRAVITY * UP, mass: -MASS_RATE * norm(T)})
    return lander


def build(cost: str = "acceleration") -> go.Problem:
    """Return the problem of the plan.

    Parameters
    ----------
    cost : {"acceleration", "propellant"}
        The integral of the squared acceleration by the engines, or what they burn.
    """
    lander = planned_model()
    problem = go.Problem("rocket landing")
    descent = problem.phase("descent", lander)
    descent.time(initial=0.0, final=(20.0, 120.0))
    descent.initial(**START)
    descent.final(r=np.zeros(3), v=-SETTLING * UP)
    descent.bounds(mass=(1305.0, 1955.0), T=(-FULL, FULL))
    thrust = lander.symbol("T")
    descent.path("throttle", ca.sumsqr(thrust / FULL), lower=PLANNED[0] ** 2, upper=PLANNED[1] ** 2)
    descent.guess(T=0.5 * FULL * UP)
    if cost == "propellant":
        problem.maximize(descent.final_state("mass"))
    else:
        problem.minimize(descent.integral(ca.sumsqr(thrust / lander.symbol("mass"))))
    return problem


def plant() -> go.Model:
    """Return the lander as it flies."""
    lander = go.Model("lander in the wind")
    r, v = lander.state("r", 3, unit="m"), lander.state("v", 3, unit="m/s")
    mass, T = lander.state("mass", unit="kg"), lander.control("T", 3, unit="N")
    area = lander.parameter("drag_area", DRAG_AREA, unit="m^2")
    wind = lander.parameter("wind", np.zeros(3), unit="m/s")
    through = v - wind
    drag = 0.5 * AIR * area * norm(through) * through
    lander.ode({r: v, v: (T - drag) / mass - GRAVITY * UP, mass: -MASS_RATE * norm(T)})
    return lander


def descent(plan: go.Solution) -> Reference:
    """Return the plan, and after it the way on downward with the weight held."""
    leg = plan.phase()
    end, last = leg.final_time, leg.x(leg.final_time)
    onward = np.concatenate([last[3:6], np.zeros(4)])
    weight, thrust = last[6] * GRAVITY * UP, leg.saturated_control("T")

    def x(times: Array) -> Array:
        return leg.x(np.minimum(times, end)) + np.outer(onward, np.maximum(times - end, 0.0))

    def u(times: Array) -> Array:
        return np.where(times > end, weight[:, None], thrust(np.minimum(times, end)))

    jumps = leg.applied.jump_times[leg.applied.jump_times > leg.initial_time]
    with warnings.catch_warnings():  # after the plan the mass is held: no law follows it
        warnings.simplefilter("ignore", go.ProblemWarning)
        return Reference.from_functions(
            planned_model(), x, u, leg.initial_time, end + _AFTER, jumps=jumps, vectorized=True
        )
