r"""Controllers of the wheel pyramid: two published attitude controllers, and the regulator along an optimal slew.

The published ones command the body torque :math:`T_c`, which is allocated to the wheels by :math:`T = A^+ T_c`.

**Feedback linearisation** (FLC), output the vector part of the quaternion: with :math:`\ddot q_v = D + E T_c`,

.. math:: T_c = E^{-1} (v - D), \qquad v = -K_1 (q_v - q_v^d) - K_2 \dot q_v, \qquad
   \det E = q_0 / (8 J_x J_y J_z) .

**Quaternion LQR**, the paper's equation (60), error quaternion :math:`q_E = q^{-1} \otimes q_T`:

.. math:: T_c = 2 K_q\, q_{E,v}\, q_{E,0} - K_\omega\, \omega .

The gain of (60) on the attitude is, at small angles, twice the one that its Riccati equation gives; the printed
results need the factor.

The absolute output is singular where q_0 = 0: half a turn from the *reference frame*. The overshoot of the linear
errors (4.1 %) takes slews of more than 147.7 degrees there. `flc_output` therefore takes the error quaternion as
the output of large slews: it is singular half a turn from the *target* only, which no slew by the short way reaches.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, solve_continuous_are

import gnc_opt as go
from gnc_opt.control import DesignReport, ReportEntry, initial_state_function, law_function
from gnc_opt.control.feedforward_and_reference_schedule import (
    ReferenceSchedule,
    build_reference_signal_layout,
)
from gnc_opt.control.riccati import solve_algebraic_riccati
from gnc_opt.control.tracking_error_dynamics import ErrorDynamics
from gnc_opt.model.model_variables import Layout
from gnc_opt.spacecraft import quaternion_error
from problems._example import Array
from problems.reaction_wheels.model import NULL, REST, RPM, WHEEL_INERTIA, resting, wheel_model

Law: TypeAlias = Literal["FLC", "LQR"]
Output: TypeAlias = Literal["absolute", "error"]

PRINTED_FLC = (0.0316, 0.2535)
"""K1 (1/s^2) and K2 (1/s) as printed."""
PRINTED_LQR = (0.2608, (2.5091, 2.5091, 2.4566))
"""K_q (N m) and K_omega (N m s) about x, y, z, as printed."""
FLC_WEIGHTS = (0.1, 100.0)
"""Of the errors and of the effort, as printed."""
LQR_WEIGHTS = (13131.0, 170.0, 2500.0)
"""Of the rates, of the quaternion's vector part and of the body torque, as printed."""
SINGULAR = 0.05
"""Smallest scalar part of the output's quaternion with which feedback linearisation works."""
MARGIN = 0.5 * SINGULAR**2
"""Least distance of the vector part's length from one: the scalar part is then above `SINGULAR`."""


# --- gains ----------------------------------------------------------------------------------------------


def flc_gains(weight: float = FLC_WEIGHTS[0], effort: float = FLC_WEIGHTS[1]) -> tuple[float, float]:
    """Return K1 (1/s^2) and K2 (1/s) of the double integrator with weights ``weight * I`` and ``effort``."""
    a, b = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    p = solve_continuous_are(a, b, weight * np.eye(2), [[effort]])
    k = b.T @ p / effort
    return float(k[0, 0]), float(k[0, 1])


def lqr_gains(
    rate: float = LQR_WEIGHTS[0], attitude: float = LQR_WEIGHTS[1], effort: float = LQR_WEIGHTS[2]
) -> tuple[Array, Array]:
    """Return K_q and K_omega (3, 3) from the Riccati equation of the model at rest, for the body torque.

    Weights of the rates, of the quaternion's vector part and of the body torque, as in the paper. At rest the wheels'
    momenta neither move the body nor are they weighed; the errors of the model are *twice* the vector part.
    """
    a, b = ErrorDynamics(wheel_model(drive="body")).linearize(0.0, REST, np.zeros(3))
    labels = tuple(f"e[{i}]" for i in range(6))
    weights = np.diag([attitude / 4] * 3 + [rate] * 3)
    optimum = solve_algebraic_riccati(a[:6, :6], b[:6], weights, effort * np.eye(3), np.zeros((6, 3)), labels)
    return 2 * optimum.gain[:, :3], optimum.gain[:, 3:]


@dataclass(frozen=True)
class Linear:
    """The errors that two gains (1/s^2, 1/s) leave: e'' + K2 e' + K1 e = 0 from e = 1 at rest."""

    k1: float = PRINTED_FLC[0]
    k2: float = PRINTED_FLC[1]

    @property
    def frequency(self) -> float:
        """Undamped, rad/s."""
        return float(np.sqrt(self.k1))

    @property
    def damping(self) -> float:
        """Below one."""
        return self.k2 / (2 * self.frequency)

    @property
    def overshoot(self) -> float:
        """Largest error on the other side, relative to the first."""
        zeta = self.damping
        return float(np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2)))

    def left(self, t: ArrayLike) -> Array:
        """Return the error e at times t (s)."""
        times = np.asarray(t, dtype=float)
        zeta, wn = self.damping, self.frequency
        root = np.sqrt(1 - zeta**2)
        swing = np.cos(root * wn * times) + zeta / root * np.sin(root * wn * times)
        return np.asarray(np.exp(-zeta * wn * times) * swing)

    def angle(self, t: ArrayLike, first: float) -> Array:
        """Return the eigenaxis angle (rad) to the target of a slew through ``first`` (rad), absolute output.

        All three components of q_v move alike: q_v stays on a straight line, and the slew turns about one axis.
        """
        half = np.clip((1 - self.left(t)) * np.sin(first / 2), -1.0, 1.0)
        return np.asarray(np.abs(first - 2 * np.arcsin(half)))

    @property
    def largest_slew(self) -> float:
        """The slew (rad) from the reference frame whose overshoot just reaches the singularity."""
        return float(2 * np.arcsin(1 / (1 + self.overshoot)))


# --- controllers ----------------------------------------------------------------------------------------


def flc_output(target: ArrayLike, start: ArrayLike = REST[:4]) -> Output:
    """Return the output with which a slew stays clear of the singularity, the paper's if possible.

    From a start in the reference frame q_v goes straight to the target's and overshoots by 4.1 %; from elsewhere the
    ends of the line and the overshoot beyond it are looked at.
    """
    begin, end = (np.asarray(q, dtype=float)[1:] for q in (start, target))
    beyond = end + Linear().overshoot * (end - begin)
    furthest = max(float(np.linalg.norm(v)) for v in (begin, end, beyond))
    same_side = float(np.asarray(start, dtype=float)[0] * np.asarray(target, dtype=float)[0]) > 0
    return "absolute" if same_side and furthest < 1 - MARGIN else "error"


def design_flc(
    target: ArrayLike,
    *,
    output: Output = "absolute",
    gains: tuple[float, float] = PRINTED_FLC,
    singular: float = SINGULAR,
) -> go.Controller:
    """Return the published feedback linearisation, or the same with the error quaternion as its output.

    Parameters
    ----------
    target : array (4,)
        Scalar part first.
    output : {"absolute", "error"}
        The paper's, or the error quaternion's vector part; see `flc_output`.
    gains : (K1, K2)
    singular : float
        Smallest scalar part of the output's quaternion; below it the law raises the alarm ``singular`` and falls back
        on the quaternion feedback (60), which divides by nothing.
    """
    craft = wheel_model(drive="body")
    on_target = abs(float(np.asarray(target)[0])) if output == "absolute" else 1.0
    k_q, k_w = PRINTED_LQR
    # errors: twice the vector part of the attitude error, rates, momenta
    spare = np.hstack([k_q * np.eye(3), np.diag(k_w), np.zeros((3, 4))])
    return go.design_feedback_linearization(
        craft,
        go.Reference.constant(craft, resting(target), np.zeros(3)),
        outputs={"q_v": craft.symbol("q")[1:]} if output == "absolute" else "q",
        poles=np.roots([1.0, gains[1], gains[0]]).tolist(),
        guard=singular / on_target,
        fallback=spare,
        name="FLC",
    )


def design_quaternion_lqr(
    target: ArrayLike,
    *,
    gains: tuple[float, ArrayLike] = PRINTED_LQR,
    factor: Literal["scalar part", "sign"] = "scalar part",
) -> go.Controller:
    """Return the published law (60).

    Parameters
    ----------
    target : array (4,)
        Scalar part first.
    gains : (K_q, K_omega)
        N m, and N m s about each axis.
    factor : {"scalar part", "sign"}
        The factor q_E0 as printed, which makes half a turn an equilibrium; or its sign (+ at zero), which does not.
    """
    craft = wheel_model(drive="body")
    states, controls = craft.states, craft.controls
    reference = go.Reference.constant(craft, resting(target), np.zeros(3))
    signals = build_reference_signal_layout(reference)
    t, x, r, z = (ca.SX.sym(n, k) for n, k in (("t", 1), ("x", states.size), ("r", signals.size), ("z", 0)))
    # from the target to the body, scalar part >= 0: the other way round than q_E, so the vector part's sign differs
    error = quaternion_error(x[states.slice("q")], r[states.slice("q")])
    near: Any = error[0] if factor == "scalar part" else 1.0
    k_q, k_w = gains
    body = -2 * k_q * near * error[1:] - ca.DM(np.asarray(k_w, dtype=float)) * x[states.slice("omega")]
    facts = (ReportEntry("K_q", k_q, "N m"), ReportEntry("K_omega", np.asarray(k_w), "N m s"))
    return go.Controller(
        name="LQR",
        step=law_function(t, x, r, z, body, z),
        start=initial_state_function(t, x, r, z),
        states=states,
        commands=controls,
        signals=signals,
        memory=Layout("memory", (), "quaternion feedback"),
        schedule=ReferenceSchedule(reference),
        span=(0.0, 0.0),
        explanation=DesignReport("quaternion feedback, equation (60)", facts),
    )


# --- tracking -------------------------------------------------------------------------------------------

ATTITUDE_ERROR, RATE_ERROR, NULL_ERROR = np.radians(0.1), np.radians(0.1), 0.02
"""Acceptable errors by Bryson's rule: rad, rad/s, and N m s of momentum in the null direction."""
ACCEPTED_TORQUE = 0.02
"""Acceptable feedback torque of a wheel, N m."""
CONTROL_STEP = 0.05
"""s."""


def design_tracker(solution: go.Solution, reserve: float) -> go.Controller:
    """Return the time-varying linear-quadratic regulator along an optimal slew.

    All four wheels are commanded, so that their momentum in the null direction is tracked as well. The total momentum
    cannot be controlled and is not weighed; the terminal weight is the steady cost to go at rest. ``reserve`` is the
    torque limit of the wheels (N m), from which the statement computes the reserve of the feedback.
    """
    craft = wheel_model()
    reference = go.Reference(solution)
    effort = np.eye(4) / ACCEPTED_TORQUE**2
    body = np.diag([1 / ATTITUDE_ERROR**2] * 3 + [1 / RATE_ERROR**2] * 3)
    null = np.outer(NULL, NULL) / (2 * NULL_ERROR) ** 2  # of the component along the unit null vector
    a, b = ErrorDynamics(craft).linearize(0.0, resting(reference.x(reference.final_time)[:4]), np.zeros(4))
    labels = tuple(f"e[{i}]" for i in range(6))
    rest = solve_algebraic_riccati(a[:6, :6], b[:6], body, effort, np.zeros((6, 4)), labels)
    # of z' = -u with weights w and r the cost to go is (w r)^(1/2) z^2
    waiting = np.outer(NULL, NULL) / 4 / (NULL_ERROR * ACCEPTED_TORQUE)
    return go.design_tvlqr(
        craft,
        reference,
        Q=block_diag(body, null),
        R=effort,
        terminal=block_diag(rest.cost, waiting),
        limits=(-reserve, reserve),
    )


def peak_speed(run: go.Run) -> float:
    """Return the speed of the fastest wheel at the control steps of a run, rpm."""
    return float(np.max(np.abs(run.state("h").values))) / WHEEL_INERTIA / RPM
