r"""Time-optimal rendezvous of a rigid spacecraft in translation and rotation (6 degrees of freedom).

A chaser comes to rest 10 m above its target on a circular orbit and turns by 90 degrees about y, as fast as
its torques and forces allow. All of these act in body axes, so the turn and the path depend on each other.

States: ``omega`` = omega_BL_B, the rate of the chaser's axes B relative to the target's LVLH frame L in B
components (rad/s); ``sigma`` = sigma_BL, the modified Rodrigues parameters of B relative to L; ``v_L`` and
``r_L``, velocity and position relative to the target in L (m/s, m). Controls: torque ``T_B`` (N m) and force
``F_B`` (N), both in B. With w = dcm_BL omega_LI_L, the orbital rate in B:

.. math::
   \text{exact:}\quad   J \dot\omega &= T - (\omega + w) \times J (\omega + w) + J (\omega \times w) \\
   \text{printed:}\quad J \dot\omega &= T - \omega \times J \omega - w \times J (\omega + w) \\
   \dot\sigma &= \tfrac14 [(1 - \sigma^2) I + 2 [\sigma\times] + 2 \sigma \sigma^T] \omega \\
   \dot v &= C_{BL}^T F / m - M v - N r, \qquad \dot r = v .

The paper's equation (13), "printed", lacks two terms of the exact one; the minimum time differs by 4e-4 to
6e-4 s. Frames, kinematics and Hill's equations (M, N): `gnc_opt.spacecraft`.

The bound on sigma keeps the optimiser off the singularity of the parameters at one full turn. Without it a
coarse mesh has spurious optima that IPOPT reports as solved: sigma passes "through infinity" to its shadow
set between two nodes, which the collocation does not see and no spacecraft can do.

Source of data and cases: Mousavi and Esmailifar, "Time-optimal control of spacecraft rotational and
translational dynamics in orbital rendezvous maneuver", J. Space Science, Technology and Applications 1 (2),
147-166, 2022.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

import gnc_opt as go
from gnc_opt.errors import did_you_mean
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


# --- reference values -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Reference:
    """A known minimum time.

    Attributes
    ----------
    value : float
        s.
    tolerance : float
        How closely a correct solution on the same footing must agree, s.
    source : str
    """

    value: float
    tolerance: float
    source: str


def _references() -> dict[tuple[int, Equation], dict[str, Reference]]:
    on_mesh: dict[Equation, tuple[float, ...]] = {
        "printed": (25.872707, 25.789173, 25.935949, 25.660546, 28.279790),
        "exact": (25.873064, 25.789525, 25.936542, 25.660937, 28.280283),
    }
    by_switch_times: dict[Equation, tuple[float, ...]] = {
        "printed": (25.8699620765, 25.7871807680, 25.9323677271, 25.6589517308, 28.2784271292),
        "exact": (25.8703529462, 25.7875628033, 25.9329944836, 25.6593186424, 28.2789359679),
    }
    gpm, gpops = (25.8727, 26.1674, 25.9360, 25.6607, 28.7185), (25.87, 26.0336, 26.1652, 25.8986, 28.2784)
    table: dict[tuple[int, Equation], dict[str, Reference]] = {}
    for equation in EQUATIONS:
        for i, case in enumerate(CASES):
            table[case, equation] = {
                "20x3": Reference(on_mesh[equation][i], 2e-4, "independent collocation, 20 x 3 LG points"),
                "exact": Reference(by_switch_times[equation][i], 1e-8, "independent, switch times optimised"),
            }
            if equation == "printed":
                table[case, equation]["paper GPM"] = Reference(
                    gpm[i], 2e-4, "the paper, table 4, 20 x 3 LG points"
                )
                table[case, equation]["paper GPOPS"] = Reference(gpops[i], 1e-2, "the paper, table 4, GPOPS")
    return table


REFERENCE = _references()
"""By (case, equation): minimum times on the paper's mesh ("20x3"), with optimal switch times ("exact", best
known), and as published ("paper GPM", "paper GPOPS"). Of the published ones, GPM 2 and 5 and GPOPS 2, 3 and 4
are other local minima, up to 0.44 s slower than the best."""


@dataclass(frozen=True)
class Channel:
    """The bang-bang structure of one control: its sign at the start and the times (s) at which it changes."""

    initial_sign: int
    switch_times: tuple[float, ...]


def _channels(*rows: tuple[int, tuple[float, ...]]) -> dict[str, Channel]:
    labels = [f"{name}[{i}]" for name in ("T_B", "F_B") for i in range(3)]
    return {label: Channel(*row) for label, row in zip(labels, rows, strict=True)}


SWITCHES: dict[int, dict[str, Channel]] = {
    1: _channels(
        (-1, (5.563493, 6.649508, 7.080075, 18.551166)),
        (+1, (8.851215, 13.081496, 16.392395)),
        (+1, (5.490388, 15.096468, 22.315605)),
        (-1, (13.592304, 20.713493)),
        (-1, (1.892381, 12.478192, 22.298079)),
        (-1, (0.363928, 0.930261, 11.192783)),
    ),
    2: _channels(
        (+1, (5.015306, 6.436348, 7.504666, 18.638841)),
        (+1, (9.005886, 13.049221, 16.296257)),
        (-1, (5.377361, 14.844080, 22.151364)),
        (-1, (13.554639, 20.776492)),
        (+1, (0.982735, 12.450702, 23.132659)),
        (-1, (0.376265, 0.940078, 11.171878)),
    ),
    3: _channels(
        (+1, (6.146040, 19.018058)),
        (+1, (11.510661, 24.779260)),
        (-1, (5.103003, 13.852381, 21.639787)),
        (-1, (12.816076, 18.640924)),
        (+1, (0.918488, 12.274986, 23.489345)),
        (-1, (11.709127,)),
    ),
    4: _channels(
        (+1, (4.240161, 6.579451, 8.310947, 18.521655)),
        (+1, (9.162451, 13.036463, 16.009541)),
        (-1, (5.513475, 15.387877, 22.429593)),
        (-1, (13.348285, 21.502540)),
        (+1, (1.007522, 12.591349, 22.991177)),
        (+1, (1.973302, 11.455614)),
    ),
    5: _channels(
        (-1, (3.323138, 6.393915, 10.450251, 21.136521)),
        (+1, (8.769126, 14.168439, 19.082897)),
        (+1, (5.852281, 16.738143, 24.750816)),
        (-1, (14.641626, 24.454912)),
        (-1, (0.890946, 13.998180, 25.393987)),
        (+1, (2.010162, 12.678186)),
    ),
}
"""Structure of the best known solutions, printed equation, by case and control component. Case 1 also exists
mirrored at the orbital plane (signs of T_B[0], T_B[2] and F_B[1] reversed). Some arcs are shallow: in case 1
the switching function of T_B[0] between 6.65 and 7.08 s is 6e-5 of its peak."""


def switch_mesh(case: int = 1, degree: int = 8, *, movable: bool = False) -> go.Mesh:
    """Return a mesh with a segment boundary at every switch of the best known solution (printed equation).

    Parameters
    ----------
    case : int
    degree : int
        Collocation points per segment.
    movable : bool
        Let the solver move the boundaries. With the controls held as in `switch_arcs`, the switch times are
        then what is optimised.
    """
    _check_case(case)
    t_f = REFERENCE[case, "printed"]["exact"].value
    return go.Mesh.at_times([0.0, *_all_switches(case), t_f], degree, movable=movable)


def switch_arcs(case: int = 1) -> NDArray[np.int64]:
    """Return the sign of every control (6) in every segment of `switch_mesh`, for ``Problem.with_arcs``."""
    _check_case(case)
    edges = np.array([0.0, *_all_switches(case)])
    rows = [
        channel.initial_sign * (-1) ** np.searchsorted(channel.switch_times, edges, side="right")
        for channel in SWITCHES[case].values()
    ]
    return np.array(rows, dtype=np.int64)


def _all_switches(case: int) -> list[float]:
    return sorted(t for channel in SWITCHES[case].values() for t in channel.switch_times)


# --- the problem ----------------------------------------------------------------------------------------


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
    chaser.difference(sigma_BL, mrp_difference)
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
        1 to 5: the initial position, see `CASES`.
    equation : {"printed", "exact"}
        Rotational dynamics as in the paper, or complete.

    Raises
    ------
    ProblemError
        There is no such case or equation.
    """
    _check_case(case)
    problem = go.Problem("time-optimal rendezvous")
    approach = problem.phase("approach", chaser_model(equation))
    approach.time(initial=0.0, final=(1.0, 100.0))
    approach.initial(omega=0.0, sigma=0.0, v_L=0.0, r_L=list(CASES[case]))
    approach.final(omega=0.0, sigma=FINAL_SIGMA, v_L=0.0, r_L=list(FINAL_POSITION))
    approach.bounds(T_B=(-MAX_TORQUE, MAX_TORQUE), F_B=(-MAX_FORCE, MAX_FORCE), sigma=(-1.0, 1.0))
    problem.minimize(approach.final_time)
    return problem


def _check_case(case: int) -> None:
    if case not in CASES:
        raise go.ProblemError(f"the rendezvous has no case {case!r}: choose one of {list(CASES)}.")


def _check_equation(equation: str) -> None:
    if equation not in EQUATIONS:
        raise go.ProblemError(
            f"the rendezvous has no equation {equation!r}: {did_you_mean(str(equation), EQUATIONS)}"
        )


# --- report ---------------------------------------------------------------------------------------------


def figures(solution: go.Solution, directory: str | Path | None = None) -> Mapping[str, Any]:
    """Return the paper's figures 3 to 15 by file stem; the caller writes them, into ``directory`` or not."""
    from problems.rendezvous.plots import paper_figures

    return paper_figures(solution)


def main(arguments: Sequence[str] | None = None) -> int:
    """Solve, compare with the paper, verify and draw; see ``python -m problems.rendezvous --help``."""
    from problems.rendezvous import report

    return report.main(arguments)
