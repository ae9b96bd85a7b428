r"""Two craft joined by a straight taut tether, in the plane of their orbit; the leader has the thruster.

**Coordinates.** Leader at the radius r and argument of latitude :math:`\alpha`, :math:`e_r` radial outward,
:math:`e_t` along the motion. The unit vector from leader to follower is
:math:`u = \sin\theta\, e_r - \cos\theta\, e_t`: the follower trails at :math:`\theta = 0` and is above for
:math:`\theta > 0`; :math:`n = \partial u / \partial \theta`. The tether turns at
:math:`\dot\beta = \dot\alpha + \dot\theta`. The thrust F acts on the leader at the angle :math:`\gamma`
above :math:`e_t`. The tether is uniform, straight and of constant length d.

**Masses** m_p (leader), m_d (follower), m_t (tether), with

.. math::
   m = m_p + m_d + m_t, \qquad \kappa = \frac{m_d + m_t/2}{m}, \qquad
   m^* = \frac{(m_p + m_t/2)(m_d + m_t/2)}{m} - \frac{m_t}{6} ,

:math:`m^*` being the exact reduced mass: :math:`K = \tfrac12 m |V_{cm}|^2 + \tfrac12 m^* d^2 \dot\beta^2`,
:math:`r_{cm} = r\, e_r + \kappa d\, u`.

**Gravity to first order in d/r**, with :math:`W = \mu / r^3`:

.. math::
   \ddot\beta &= -\frac{\kappa F}{m^* d} \sin(\theta + \gamma) + 3 W \sin\theta \cos\theta \\
   \ddot r &= r \dot\alpha^2 - W r + \frac{F}{m} \sin\gamma + 2 W \kappa d \sin\theta
      - \kappa d (\ddot\beta \cos\theta - \dot\beta^2 \sin\theta) \\
   r \ddot\alpha &= -2 \dot r \dot\alpha + \frac{F}{m} \cos\gamma + W \kappa d \cos\theta
      - \kappa d (\ddot\beta \sin\theta + \dot\beta^2 \cos\theta) \\
   T &= \kappa F \cos(\theta + \gamma) + m^* d \dot\beta^2 + W m^* d (3 \sin^2\theta - 1) .

**Truth**: exact central gravity on leader, follower and three Gauss points of the tether, at distances
:math:`s_i d` from the leader with masses :math:`m_i`; the centre of mass moves by the sum of the forces,
the tether turns by their moment about it.

SI units. Every argument is a CasADi scalar, a float or an array over time.

References
----------
Derived by Koenig's theorem and Lagrange's equations; the system is that of Jia C., Meng Z., Orbit
cooperative control for tethered satellite formation system via attitude maneuvering, J. Astronautics 43
(2022) 1361-1367.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.polynomial.legendre import leggauss

from gnc_opt.argument_checks import read_positive_number
from gnc_opt.errors import ModelError
from gnc_opt.spacecraft.gravity import MU_EARTH
from gnc_opt.spacecraft.vector_algebra import is_symbolic


class TetherMotion(NamedTuple):
    """Where a tethered pair is and how it moves, in the coordinates of this module.

    Radius of the leader (m) and its rate (m/s), orbital rate (rad/s), swing angle (rad) and its rate (rad/s).
    """

    r: Any
    r_rate: Any
    alpha_rate: Any
    theta: Any
    theta_rate: Any


class TetherAccelerations(NamedTuple):
    """Second derivatives of the coordinates of a tethered pair: m/s^2, rad/s^2 and rad/s^2."""

    r: Any
    alpha: Any
    theta: Any


@dataclass(frozen=True)
class TetheredPair:
    """Data and dynamics of a tethered pair.

    Attributes
    ----------
    leader_mass, follower_mass, tether_mass : float
        kg; the tether may weigh nothing.
    length : float
        m.
    mu : float
        Gravitational parameter, m^3/s^2.

    Raises
    ------
    ModelError
        A mass or the length is not positive.
    """

    leader_mass: float
    follower_mass: float
    tether_mass: float
    length: float
    mu: float = MU_EARTH

    def __post_init__(self) -> None:
        for name in ("leader_mass", "follower_mass", "length", "mu"):
            read_positive_number(getattr(self, name), f"the {name} of a tethered pair", ModelError)
        read_positive_number(self.tether_mass, "the tether_mass of a tethered pair", ModelError, or_zero=True)

    @property
    def mass(self) -> float:
        """Of all three, kg."""
        return self.leader_mass + self.follower_mass + self.tether_mass

    @property
    def kappa(self) -> float:
        """Distance of the centre of mass from the leader, in lengths."""
        return (self.follower_mass + self.tether_mass / 2) / self.mass

    @property
    def reduced_mass(self) -> float:
        """m*, kg."""
        half = self.tether_mass / 2
        return (self.leader_mass + half) * (self.follower_mass + half) / self.mass - self.tether_mass / 6

    def accelerations(self, motion: TetherMotion, force: Any, gamma: Any) -> TetherAccelerations:
        """Return the accelerations, gravity to first order, under a thrust (N) at an angle above the motion (rad)."""
        sin, cos = _functions(*motion, force, gamma)
        r, r_rate, alpha_rate, theta, theta_rate = motion
        w, arm = self.mu / r**3, self.kappa * self.length
        beta_rate = alpha_rate + theta_rate
        swing = -self.kappa * force * sin(theta + gamma) / (self.reduced_mass * self.length)
        beta = swing + 3 * w * sin(theta) * cos(theta)
        push = force / self.mass
        radial = push * sin(gamma) + 2 * w * arm * sin(theta)
        along = push * cos(gamma) + w * arm * cos(theta)
        r_acc = r * alpha_rate**2 - w * r + radial - arm * (beta * cos(theta) - beta_rate**2 * sin(theta))
        along -= arm * (beta * sin(theta) + beta_rate**2 * cos(theta))
        alpha_acc = (-2 * r_rate * alpha_rate + along) / r
        return TetherAccelerations(r_acc, alpha_acc, beta - alpha_acc)

    def tension(self, motion: TetherMotion, force: Any, gamma: Any) -> Any:
        """Return the tension at the leader's end as far as it drives the length, N; it must stay positive.

        Arguments as in `accelerations`.
        """
        sin, cos = _functions(*motion, force, gamma)
        r, _, alpha_rate, theta, theta_rate = motion
        inertia = self.reduced_mass * self.length
        gradient = self.mu / r**3 * (3 * sin(theta) ** 2 - 1)
        return self.kappa * force * cos(theta + gamma) + inertia * ((alpha_rate + theta_rate) ** 2 + gradient)

    def true_accelerations(self, motion: TetherMotion, force: Any, gamma: Any) -> TetherAccelerations:
        """Return the accelerations with exact central gravity; arguments as in `accelerations`."""
        sin, cos = _functions(*motion, force, gamma)
        r, r_rate, alpha_rate, theta, theta_rate = motion
        beta_rate = alpha_rate + theta_rate
        u, n = (sin(theta), -cos(theta)), (cos(theta), sin(theta))
        thrust = (force * sin(gamma), force * cos(gamma))
        total, moment = [thrust[0], thrust[1]], -self.kappa * (n[0] * thrust[0] + n[1] * thrust[1])
        for share, mass in self._lumps():
            pull = self._pull(r, u, share, mass)
            total = [total[0] + pull[0], total[1] + pull[1]]
            moment = moment + (share - self.kappa) * (n[0] * pull[0] + n[1] * pull[1])
        beta = moment / (self.reduced_mass * self.length)
        arm = self.kappa * self.length
        leader = [total[i] / self.mass - arm * (beta * n[i] - beta_rate**2 * u[i]) for i in range(2)]
        alpha_acc = (leader[1] - 2 * r_rate * alpha_rate) / r
        return TetherAccelerations(leader[0] + r * alpha_rate**2, alpha_acc, beta - alpha_acc)

    def energy(self, motion: TetherMotion) -> Any:
        """Return kinetic plus exact potential energy, J: constant without thrust under `true_accelerations`."""
        r, _, alpha_rate, theta, theta_rate = motion
        u = (np.sin(theta), -np.cos(theta))
        velocity = self._centre_velocity(motion)
        turning = self.reduced_mass * (self.length * (alpha_rate + theta_rate)) ** 2
        kinetic = 0.5 * (self.mass * (velocity[0] ** 2 + velocity[1] ** 2) + turning)
        return kinetic - sum(
            self.mu * mass / np.hypot(r + share * self.length * u[0], share * self.length * u[1])
            for share, mass in self._lumps()
        )

    def angular_momentum(self, motion: TetherMotion) -> Any:
        """Return the angular momentum about the planet, kg m^2/s, constant like the energy."""
        r, _, alpha_rate, theta, theta_rate = motion
        arm = self.kappa * self.length
        centre = (r + arm * np.sin(theta), -arm * np.cos(theta))
        velocity = self._centre_velocity(motion)
        orbital = self.mass * (centre[0] * velocity[1] - centre[1] * velocity[0])
        return orbital + self.reduced_mass * self.length**2 * (alpha_rate + theta_rate)

    def _centre_velocity(self, motion: TetherMotion) -> tuple[Any, Any]:
        r, r_rate, alpha_rate, theta, theta_rate = motion
        swing = self.kappa * self.length * (alpha_rate + theta_rate)
        return r_rate + swing * np.cos(theta), r * alpha_rate + swing * np.sin(theta)

    def _lumps(self) -> list[tuple[float, float]]:
        """Return (distance from the leader in lengths, mass) of all points on which gravity acts."""
        tau, weights = leggauss(3)
        tether = [(0.5 * (1 + s), 0.5 * w * self.tether_mass) for s, w in zip(tau, weights, strict=True)]
        ends = [(0.0, self.leader_mass), (1.0, self.follower_mass)]
        return [*ends, *((float(s), float(w)) for s, w in tether)]

    def _pull(self, r: Any, u: tuple[Any, Any], share: float, mass: float) -> tuple[Any, Any]:
        """Return the central force on a point of the tether, radial and along, N."""
        x, y = r + share * self.length * u[0], share * self.length * u[1]
        square = x * x + y * y
        factor = -self.mu * mass / (square * square**0.5)
        return factor * x, factor * y


def _functions(*values: Any) -> tuple[Any, Any]:
    """Return sine and cosine for symbols or for numbers."""
    return (ca.sin, ca.cos) if is_symbolic(*values) else (np.sin, np.cos)
