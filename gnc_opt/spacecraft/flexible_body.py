r"""Flexible spacecraft: coupled rotation and modal vibration of a rigid hub with appendages.

With the hub's rate :math:`\omega` (inertial, body components), modal coordinates :math:`\eta` of the clamped appendages
(frequencies :math:`\Lambda`, damping ratios :math:`\xi`), and their coupling C (3 rows, one column per mode),

.. math::
   J \dot\omega + C \ddot\eta + \omega \times (J \omega + C \dot\eta) &= T \\
   \ddot\eta + 2 \xi \Lambda \dot\eta + \Lambda^2 \eta + C^T \dot\omega &= 0 .

The mass matrix :math:`\begin{pmatrix} J & C \\ C^T & 1 \end{pmatrix}` is positive definite if and only if
:math:`J - C C^T` is. Energy and momentum,

.. math::
   E = \tfrac12 \omega^T J \omega + \omega^T C \dot\eta + \tfrac12 |\dot\eta|^2 + \tfrac12 |\Lambda \eta|^2,
   \qquad H = J \omega + C \dot\eta,

obey :math:`\dot E = \omega^T T - 2 \dot\eta^T \xi \Lambda \dot\eta` and :math:`\dot H + \omega \times H = T`.

Modal coordinates have the unit kg^0.5 m, C has kg^0.5 m. Vectors are CasADi columns or arrays (n,) and (n, n_times).

References
----------
S. Di Gennaro, Output stabilization of flexible spacecraft with active vibration suppression, IEEE Trans.
Aerospace and Electronic Systems 39 (2003).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.array_types import Array
from gnc_opt.errors import ModelError
from gnc_opt.spacecraft.rigid_body import angular_momentum
from gnc_opt.spacecraft.vector_algebra import Vector, cross, is_symbolic


@dataclass(frozen=True, eq=False)
class FlexibleBody:
    """Data of a hub and appendages with N modes.

    Attributes
    ----------
    inertia : array (3, 3)
        Inertia of the whole undeformed body, kg m^2; principal moments (3,) define a diagonal matrix.
    coupling : array (3, N)
        kg^0.5 m.
    frequencies : array (N,)
        Natural frequencies of the clamped appendages, rad/s.
    damping : array (N,)
        Damping ratios, >= 0.

    Raises
    ------
    ModelError
        Inconsistent sizes, frequencies <= 0, or appendages with more inertia than the whole body.

    Examples
    --------
    >>> panel = FlexibleBody([100.0, 90.0, 80.0], [[6.0], [0.0], [0.0]], [1.2], [0.005])
    >>> print(np.round(panel.free_frequencies(), 6))  # 1.2 / sqrt(1 - 6^2 / 100)
    [1.5]
    """

    inertia: Array
    coupling: Array
    frequencies: Array
    damping: Array

    def __post_init__(self) -> None:
        inertia = np.asarray(self.inertia, dtype=float)
        object.__setattr__(self, "inertia", np.diag(inertia) if inertia.ndim == 1 else inertia)
        for name in ("coupling", "frequencies", "damping"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))
        n = self.frequencies.size
        if (self.inertia.shape, self.coupling.shape, self.damping.shape) != ((3, 3), (3, n), (n,)):
            raise ModelError(
                f"a flexible body with {n} frequencies needs an inertia (3, 3), a coupling (3, {n}) and {n} "
                f"damping ratios; the shapes are {self.inertia.shape}, {self.coupling.shape}, {self.damping.shape}."
            )
        if not (np.all(self.frequencies > 0) and np.all(self.damping >= 0)):
            raise ModelError(
                "the frequencies of a flexible body must be > 0 and its damping ratios >= 0: correct them."
            )
        smallest = float(np.linalg.eigvalsh(self.rigid_inertia)[0])
        if smallest <= 0:
            raise ModelError(
                f"the appendages carry more inertia than the whole body (J - C C^T has the eigenvalue "
                f"{smallest:.4g} kg m^2): reduce the coupling."
            )

    @property
    def rigid_inertia(self) -> Array:
        """J - C C^T (3, 3), the effective inertia for fast torques, kg m^2."""
        return np.asarray(self.inertia - self.coupling @ self.coupling.T)

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix [[J, C], [C^T, 1]] (3 + N, 3 + N)."""
        n = self.frequencies.size
        return np.block([[self.inertia, self.coupling], [self.coupling.T, np.eye(n)]])

    def accelerations(
        self, omega: Vector, eta: Vector, eta_rate: Vector, torque: Vector
    ) -> tuple[Vector, Vector]:
        """Return the rates of ``omega`` (rad/s^2) and of ``eta_rate`` (kg^0.5 m/s^2).

        Parameters
        ----------
        omega, torque : casadi (3, 1), array (3,) or (3, n_times)
            Inertial rate (rad/s) and torque on the hub (N m), body components.
        eta, eta_rate : casadi (N, 1), array (N,) or (N, n_times)
        """
        gyroscopic = cross(omega, self.momentum(omega, eta_rate))
        spring = self._multiply_rows_by_factors(self.frequencies**2, eta)
        damper = self._multiply_rows_by_factors(2 * self.damping * self.frequencies, eta_rate)
        if is_symbolic(omega, eta, eta_rate, torque):
            force = ca.vertcat(torque - gyroscopic, -(spring + damper))
            both = ca.mtimes(ca.DM(np.linalg.inv(self.mass_matrix)), force)
        else:
            force = np.concatenate([np.asarray(torque) - gyroscopic, -(spring + damper)])
            both = np.linalg.solve(self.mass_matrix, force)
        return both[:3], both[3:]

    def momentum(self, omega: Vector, eta_rate: Vector) -> Vector:
        """Return H in body components, N m s."""
        if is_symbolic(omega, eta_rate):
            return ca.mtimes(ca.DM(self.inertia), omega) + ca.mtimes(ca.DM(self.coupling), eta_rate)
        return np.asarray(angular_momentum(self.inertia, omega) + self.coupling @ np.asarray(eta_rate))

    def energy(self, omega: Array, eta: Array, eta_rate: Array) -> Any:
        """Return E, J; numeric, of arrays omega, eta and eta_rate, (n,) or (n, n_times) each."""
        kinetic = 0.5 * np.sum(omega * (self.inertia @ omega), axis=0)
        mixed = np.sum(omega * (self.coupling @ eta_rate), axis=0)
        return kinetic + mixed + self.modal_energy(eta, eta_rate)

    def modal_energy(self, eta: Array, eta_rate: Array) -> Any:
        """Return the vibration energy relative to the hub, J; numeric."""
        strain = self._multiply_rows_by_factors(self.frequencies, eta)
        return 0.5 * (np.sum(np.square(eta_rate), axis=0) + np.sum(np.square(strain), axis=0))

    def free_frequencies(self) -> Array:
        """Return the undamped natural frequencies of the free body (N,), rad/s, in ascending order."""
        n = self.frequencies.size
        stiffness = np.zeros((3 + n, 3 + n))
        stiffness[3:, 3:] = np.diag(self.frequencies**2)
        squares = scipy.linalg.eigh(stiffness, self.mass_matrix, eigvals_only=True)[3:]
        return np.asarray(np.sqrt(squares))

    def free_damping(self) -> Array:
        """Return the damping ratios of the free body (N,), in order of ascending frequency."""
        n = self.frequencies.size
        inverse = np.linalg.inv(self.mass_matrix)[3:, 3:]
        stiff, viscous = np.diag(self.frequencies**2), np.diag(2 * self.damping * self.frequencies)
        state = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiff, -inverse @ viscous]])
        poles = scipy.linalg.eigvals(state)
        upper = sorted((p for p in poles if p.imag > 0), key=abs)
        return np.array([-p.real / abs(p) for p in upper])

    def _multiply_rows_by_factors(self, factors: Array, values: Any) -> Any:
        if is_symbolic(values):
            return ca.DM(factors) * values
        return (factors * np.asarray(values).T).T
