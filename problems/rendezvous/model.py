r"""Minimum-time rendezvous of a chaser with its target on a circular orbit: data, dynamics and problem.

The target is on a circular orbit 580 km above the Earth. Its frame L has z towards the Earth's centre, x along the
velocity and y opposite to the orbit normal. Torques and forces act along the chaser's body axes B, so that rotation
and translation are coupled.

States: ``omega``, the rate of B relative to L in B (rad/s); ``sigma``, the modified Rodrigues parameters of B
relative to L; ``v_L`` and ``r_L``, velocity and position relative to the target in L (m/s, m). Controls: torque
``T_B`` (N m) and force ``F_B`` (N), both in B.

.. math::
   \text{exact:}\quad   J \dot\omega &= T - (\omega + w) \times J (\omega + w) + J (\omega \times w) \\
   \text{printed:}\quad J \dot\omega &= T - \omega \times J \omega - w \times J (\omega + w) \\
   \dot\sigma &= \tfrac14 [(1 - \sigma^2) I + 2 [\sigma\times] + 2 \sigma \sigma^T] \omega \\
   \dot v &= C_{BL}^T F / m - M v - N r, \qquad \dot r = v \quad
   \text{(w: orbital rate in B; M, N: Hill's equations)}

The default is equation (13) of the source below, as printed there. It lacks two terms of the exact equation; the
minimum time differs by 4e-4 to 6e-4 s. See `gnc_opt.spacecraft`.

The limits of ``sigma`` exclude the singularity of the parameters at one full turn. Without them, a coarse mesh has
spurious optima that IPOPT reports as solved: between two nodes, ``sigma`` passes through infinity to the parameters of
the opposite turn, which collocation does not detect.

Source of data and cases: Mousavi and Esmailifar, "Time-optimal control of spacecraft rotational and
translational dynamics in orbital rendezvous maneuver", J. Space Science, Technology and Applications 1 (2),
147-166, 2022.
"""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

import numpy as np

import gnc_opt as go
from gnc_opt.errors import suggest_similar_name
from gnc_opt.plot import View
from gnc_opt.spacecraft import (
    RADIUS_EARTH,
    angular_momentum,
    apply,
    cross,
    divide_by_inertia,
    hill_acceleration,
    lvlh_rate,
    mean_motion,
    mrp_difference,
    mrp_from_axis_angle,
    mrp_rate,
    mrp_retraction,
    mrp_to_dcm,
    relative_angular_acceleration,
    transpose,
)

Equation: TypeAlias = Literal["printed", "exact"]

EQUATIONS: tuple[Equation, ...] = ("printed", "exact")

INERTIA = (5621.0, 4547.0, 2364.0)
"""Principal moments, kg m^2."""
MASS = 3200.0
"""kg."""
MAX_TORQUE, MAX_FORCE = 50.0, 320.0
"""N m and N, each axis."""
ALTITUDE = 580e3
"""Of the target's circular orbit, m."""
FINAL_SIGMA = mrp_from_axis_angle([0.0, 1.0, 0.0], np.pi / 2)
"""+90 degrees about y (the paper's tan(90/2) is a misprint; its number, 0.4142, is tan(22.5 degrees))."""
FINAL_POSITION = (0.0, 0.0, -10.0)

CASES: dict[int, tuple[float, float, float]] = {
    1: (20.0, 0.0, 0.0),
    2: (20.0, 4.0, 0.0),
    3: (20.0, 4.0, 4.0),
    4: (20.0, 4.0, -5.0),
    5: (25.0, -5.0, -5.0),
}
"""Initial position r_L, m."""

PAPER_MESH = go.Mesh.uniform(20, 3)
"""20 equal segments of 3 Legendre-Gauss points: 1333 variables and 960 constraints."""

MESH = PAPER_MESH
"""The mesh to use unless another one is asked for."""


VIEW = View(
    position="r_L",
    attitude="sigma",
    force="F_B",
    down=True,
    bodies={"target": (0.0, 0.0, 0.0)},
)
"""Chaser with its axes and plume, and the target; z points to the Earth."""


def chaser_model(equation: Equation = "printed") -> go.Model:
    """Return the dynamics of the chaser; inertia, mass and mean motion are parameters of the model."""
    _check_equation(equation)
    chaser = go.Model("chaser")
    omega_BL_B = chaser.state("omega", 3, unit="rad/s")
    sigma_BL = chaser.state("sigma", 3)
    v_L = chaser.state("v_L", 3, unit="m/s")
    r_L = chaser.state("r_L", 3, unit="m")
    torque_B = chaser.control("T_B", 3, unit="N m")
    force_B = chaser.control("F_B", 3, unit="N")
    inertia = chaser.parameter("inertia", INERTIA, unit="kg m^2")
    mass = chaser.parameter("mass", MASS, unit="kg")
    n = chaser.parameter("mean_motion", mean_motion(RADIUS_EARTH + ALTITUDE), unit="rad/s")
    dcm_BL = mrp_to_dcm(sigma_BL)
    omega_LI_B = apply(dcm_BL, lvlh_rate(n))
    acceleration = relative_angular_acceleration if equation == "exact" else printed_angular_acceleration
    chaser.ode(
        {
            omega_BL_B: acceleration(inertia, omega_BL_B, omega_LI_B, torque_B),
            sigma_BL: mrp_rate(sigma_BL, omega_BL_B),
            v_L: apply(transpose(dcm_BL), force_B) / mass + hill_acceleration(r_L, v_L, n),
            r_L: v_L,
        }
    )
    chaser.difference(sigma_BL, mrp_difference, retraction=mrp_retraction)
    return chaser


def printed_angular_acceleration(inertia: Any, omega_BL_B: Any, omega_LI_B: Any, torque_B: Any) -> Any:
    """Return the paper's equation (13) for the rate of ``omega_BL_B``, rad/s^2; it lacks two terms."""
    gyroscopic = cross(omega_BL_B, angular_momentum(inertia, omega_BL_B))
    orbital = cross(omega_LI_B, angular_momentum(inertia, omega_BL_B + omega_LI_B))
    return divide_by_inertia(inertia, torque_B - gyroscopic - orbital)


def build(case: int = 1, equation: Equation = "printed") -> go.Problem:
    """Return the minimum-time problem.

    Parameters
    ----------
    case : int
        Number of the initial position, 1 to 5 (`CASES`).
    equation : {"printed", "exact"}
        Equation of the rotation: "printed" omits two terms, as in the paper; "exact" contains them.

    Raises
    ------
    ProblemError
        There is no such case or equation.
    """
    check_case(case)
    problem = go.Problem("time-optimal rendezvous")
    approach = problem.phase("approach", chaser_model(equation))
    approach.time(initial=0.0, final=(1.0, 100.0))
    approach.initial(omega=0.0, sigma=0.0, v_L=0.0, r_L=list(CASES[case]))
    approach.final(omega=0.0, sigma=FINAL_SIGMA, v_L=0.0, r_L=list(FINAL_POSITION))
    approach.bounds(T_B=(-MAX_TORQUE, MAX_TORQUE), F_B=(-MAX_FORCE, MAX_FORCE), sigma=(-1.0, 1.0))
    problem.minimize(approach.final_time)
    return problem


def check_case(case: int) -> None:
    if case not in CASES:
        raise go.ProblemError(f"the rendezvous has no case {case!r}: choose one of {list(CASES)}.")


def _check_equation(equation: str) -> None:
    if equation not in EQUATIONS:
        raise go.ProblemError(
            f"the rendezvous has no equation {equation!r}: {suggest_similar_name(str(equation), EQUATIONS)}"
        )
