r"""Balanced field: the shortest runway for take-off or abort after an engine failure.

This example shows phases that branch. An engine fails at the speed V1; one branch brakes, the other accelerates,
rotates and climbs to 35 ft on the other engine. Both end at the same position. The rate of rotation is a parameter.

States: ``r`` (m), ``v`` (m/s); while rotating ``alpha`` (rad); in the air ``h`` (m), ``gamma`` (rad). Control:
``alpha`` in the air.

.. math::
   \dot v = \frac{T \cos\alpha - D - \mu (m g - L \cos\alpha - T \sin\alpha)}{m} \text{ on the runway}, \qquad
   \dot\gamma = \frac{T \sin\alpha + L}{m v} - \frac{g \cos\gamma}{v} \text{ in the air}

Induced drag has the ground effect of McCormick.

Source: the example ``balanced_field`` of the Dymos documentation, with the rate of rotation as a parameter.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from problems._example import Reference, example_main

POUND, POUND_FORCE, FOOT = 0.45359237, 4.4482216152605, 0.3048
"""kg, N, m."""
DEGREE = np.pi / 180
MASS, THRUST, GRAVITY = 174200 * POUND, 54000 * POUND_FORCE, 9.80665
"""kg; of both engines, N; m/s^2."""
DENSITY, AREA, ASPECT_RATIO, SPAN, OSWALD, WING_HEIGHT = 1.225, 124.7, 9.45, 35.7, 0.801, 1.0
"""kg/m^3, m^2, -, m, -, m."""
ROLLING, BRAKING = 0.03, 0.3
"""Friction."""
STALL_LIFT = 2.0
STALL_SPEED = float(np.sqrt(2 * MASS * GRAVITY / (DENSITY * AREA * STALL_LIFT)))
"""m/s."""
OBSTACLE, CLIMB = 35 * FOOT, 5 * DEGREE
"""Height at the end (m) and slope there (rad)."""


def lift_and_drag(v: Any, h: Any, alpha: Any) -> tuple[Any, Any]:
    """Return lift and drag near the ground, N."""
    c_l = 0.5 + 1.5 * alpha / (10 * DEGREE)
    height = 33 * ((h + WING_HEIGHT) / (SPAN / 2)) ** 1.5
    induced = height / (1 + height) / (np.pi * ASPECT_RATIO * OSWALD)
    pressure_area = 0.5 * DENSITY * AREA * v**2
    return pressure_area * c_l, pressure_area * (0.03 + induced * c_l**2)


def wheel_force(v: Any, alpha: Any, thrust: float) -> Any:
    """Return the force on the wheels, N."""
    lift, _ = lift_and_drag(v, 0.0, alpha)
    return MASS * GRAVITY - lift * ca.cos(alpha) - thrust * ca.sin(alpha)


def on_runway(name: str, thrust: float, friction: float, *, rotating: bool = False) -> go.Model:
    """Return the model of a phase on the runway."""
    model = go.Model(name)
    r, v = model.state("r", unit="m"), model.state("v", unit="m/s")
    alpha = model.state("alpha", unit="rad") if rotating else 0.0
    _, drag = lift_and_drag(v, 0.0, alpha)
    braking = friction * wheel_force(v, alpha, thrust)
    rates = {r: v, v: (thrust * ca.cos(alpha) - drag - braking) / MASS}
    if rotating:
        rates[alpha] = model.parameter("rate", 2 * DEGREE, unit="rad/s")
    model.ode(rates)
    return model


def in_the_air(thrust: float) -> go.Model:
    """Return the model of the climb."""
    model = go.Model("climb")
    r, v = model.state("r", unit="m"), model.state("v", unit="m/s")
    h, gamma = model.state("h", unit="m"), model.state("gamma", unit="rad")
    alpha = model.control("alpha", unit="rad")
    lift, drag = lift_and_drag(v, h, alpha)
    model.ode(
        {
            r: v * ca.cos(gamma),
            v: (thrust * ca.cos(alpha) - drag) / MASS - GRAVITY * ca.sin(gamma),
            h: v * ca.sin(gamma),
            gamma: (thrust * ca.sin(alpha) + lift) / (MASS * v) - GRAVITY * ca.cos(gamma) / v,
        }
    )
    return model


def build() -> go.Problem:
    """Return the problem."""
    problem = go.Problem("balanced field")
    problem.parameter("rate", lower=0.0, upper=10 * DEGREE, guess=2 * DEGREE, unit="rad/s")
    roll = problem.phase("roll", on_runway("roll", THRUST, ROLLING))
    stop = problem.phase("stop", on_runway("stop", 0.0, BRAKING))
    go_on = problem.phase("go_on", on_runway("go_on", THRUST / 2, ROLLING))
    rotate = problem.phase("rotate", on_runway("rotate", THRUST / 2, ROLLING, rotating=True))
    climb = problem.phase("climb", in_the_air(THRUST / 2))
    durations = dict.fromkeys(("roll", "go_on", "climb"), (1.0, 100.0)) | {"rotate": (1.0, 5.0)}
    problem.sequence(roll, go_on, rotate, climb, durations=durations)
    stop.time(initial=None, duration=(1.0, 100.0))
    problem.link(roll, stop)

    for leg in (roll, stop, go_on, rotate, climb):
        leg.bounds(r=(0.0, 5000.0), v=(0.0, 150.0))
    rotate.bounds(alpha=(0.0, 10 * DEGREE))
    climb.bounds(alpha=(-10 * DEGREE, 15 * DEGREE), gamma=(0.0, CLIMB), h=(0.0, 20.0))
    roll.initial(r=0.0, v=0.0)
    stop.final(v=0.0)
    go_on.final(v=(1.2 * STALL_SPEED, None))
    rotate.initial(alpha=0.0)
    climb.initial(h=0.0, gamma=0.0)
    climb.final(h=OBSTACLE, gamma=CLIMB, v=(1.25 * STALL_SPEED, None))
    load = wheel_force(rotate.final_state("v"), rotate.final_state("alpha"), THRUST / 2)
    problem.constrain("lift-off", load / (MASS * GRAVITY), equals=0.0)
    problem.constrain("same length", climb.final_state("r") - stop.final_state("r"), equals=0.0)
    problem.minimize(stop.final_state("r"))
    return problem


REFERENCE = Reference(2196.6958, "independent Radau collocation, two meshes agree", 4.4e-3, "m")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
