r"""The formation of Imani and Bahrami: data, models and the circle to be flown.

A follower is near a leader on a circular equatorial orbit. The origin of the axes R is the leader: x radial outward,
y along its motion, z along the orbit normal. States: ``r`` (m) and ``v`` (m/s), the follower relative to the leader,
in R; control: ``a`` (m/s^2), its thrust acceleration in R.

.. math::
   \dot r = v, \qquad \dot v = a - C v - N(r) + D(r)

with the gravity of the point mass exact, as in `gnc_opt.spacecraft.relative_acceleration`, and D the oblateness'
acceleration of the follower minus that of the leader, `gnc_opt.spacecraft.differential_j2`; the leader itself stays on
its Kepler orbit.

The formation is a circle of 1 km radius in the plane :math:`z = \sqrt3 x`, a free motion of Hill's equations:

.. math::
   r_d = (500 \sin(nt + \psi),\; 1000 \cos(nt + \psi),\; 500 \sqrt3 \sin(nt + \psi)).

Source: A. Imani, M. Bahrami, "Robust control of spacecraft formation flying using optimal sliding mode" (in Persian),
equations 1-5 and 32-34. Phase and initial rate are not printed there; those below reproduce its table 1.
"""

from __future__ import annotations

import warnings
from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt.array_types import Array
from gnc_opt.control import Reference
from gnc_opt.spacecraft import differential_j2, relative_acceleration

MU = 398600e9
"""m^3/s^2, as printed."""
LEADER_RADIUS = 7171e3
"""m."""
J2 = 0.0010826
EARTH_RADIUS = 6378.137e3
"""m."""
RATE = float(np.sqrt(MU / LEADER_RADIUS**3))
"""Mean motion of the leader, rad/s."""
PERIOD = 2 * np.pi / RATE
"""s."""
START = np.array([300.0, -200.0, 500.0, 0.0, 0.0, 0.0])
"""r (m) and v (m/s): at rest in R; the publication prints the position only."""
PHASE = 0.5 * np.pi
"""psi, rad; not printed."""
FORMATION_RADIUS = 1000.0
"""m."""

_SHAPE = np.array([0.5, 1.0, 0.5 * np.sqrt(3.0)])


def build_model(*, one_sided: bool = False) -> go.Model:
    """Return the dynamics: 6 states, 3 controls, parameter ``J2`` (0 switches the oblateness off).

    Parameters
    ----------
    one_sided : bool
        Split the control into ``push`` - ``pull``, a thruster each way on every axis: the thrust that is spent is then
        smooth in the controls.
    """
    model = go.Model("formation flying")
    r, v = model.state("r", 3, unit="m"), model.state("v", 3, unit="m/s")
    if one_sided:
        a = model.control("push", 3, unit="m/s^2") - model.control("pull", 3, unit="m/s^2")
    else:
        a = model.control("a", 3, unit="m/s^2")
    j2 = model.parameter("J2", J2)
    model.ode({r: v, v: free_acceleration(r, v, j2) + a})
    return model


def free_acceleration(r: Any, v: Any, j2: Any = J2) -> Any:
    """Return dv/dt without thrust (m/s^2), (3, 1) or (3, n_times), of symbols or numbers."""
    gravity = relative_acceleration(r, v, LEADER_RADIUS, RATE, MU)
    return gravity + differential_oblateness(r, j2)


def differential_oblateness(r: Any, j2: Any = J2) -> Any:
    """Return D (m/s^2): the leader is equatorial, so any of its places serves for all."""
    return differential_j2(r, LEADER_RADIUS, np.eye(3), MU, j2, EARTH_RADIUS)


def hill_model() -> go.Model:
    """Return the linearisation of `build_model` at the leader without oblateness: Hill's equations."""
    a, b = build_model().with_parameters(J2=0.0).linearize(0.0, np.zeros(6), np.zeros(3))
    model = go.Model("formation flying, linear")
    r, v = model.state("r", 3, unit="m"), model.state("v", 3, unit="m/s")
    thrust = model.control("a", 3, unit="m/s^2")
    rate = ca.DM(a) @ ca.vertcat(r, v) + ca.DM(b) @ thrust
    model.ode({r: rate[:3], v: rate[3:]})
    return model


def circle(t: Any, phase: float = PHASE) -> tuple[Any, Any, Any]:
    """Return position (m), velocity (m/s) and acceleration (m/s^2) on the circle at times t (s).

    Arrays (3,) at one time, (3, n_times) at many; CasADi columns (3, 1) for a symbol.
    """
    functions, join = (ca, ca.vertcat) if isinstance(t, ca.SX) else (np, lambda *rows: np.stack(rows))
    sine, cosine = functions.sin(RATE * t + phase), functions.cos(RATE * t + phase)
    scale = [FORMATION_RADIUS * s for s in _SHAPE.tolist()]
    position = join(scale[0] * sine, scale[1] * cosine, scale[2] * sine)
    velocity = RATE * join(scale[0] * cosine, -scale[1] * sine, scale[2] * cosine)
    return position, velocity, -(RATE**2) * position


def circle_state(t: Any, phase: float = PHASE) -> Array:
    """Return r and v on the circle, (6,) or (6, n_times)."""
    return np.concatenate(circle(t, phase)[:2])


def circle_control(t: Any, phase: float = PHASE, j2: float = 0.0) -> Array:
    """Return the thrust (m/s^2) that keeps the circle in the nonlinear field, (3,) or (3, n_times)."""
    position, velocity, acceleration = circle(t, phase)
    return np.asarray(acceleration - free_acceleration(position, velocity, j2))


def formation(model: go.Model, end: float = 2 * PERIOD, *, feedforward: bool = True) -> Reference:
    """Return the circle as a reference from t = 0 to ``end`` (s).

    Parameters
    ----------
    model : Model
        With the states and control of `build_model`.
    end : float
    feedforward : bool
        With the thrust that keeps the circle on `build_model` without oblateness; otherwise with none, as Hill's
        equations ask for.
    """
    control = circle_control if feedforward else lambda t: np.zeros((3, t.size))
    with warnings.catch_warnings():  # oblateness is what the feedforward leaves to the law
        warnings.simplefilter("ignore", go.ProblemWarning)
        return Reference.from_functions(model, circle_state, control, 0.0, end, vectorized=True)
