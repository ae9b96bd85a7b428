r"""Delta III: launch to a geostationary transfer orbit with maximum mass, in four phases.

This example shows several phases with vector states. Each stage has its own thrust and mass flow; where boosters or a
stage drop off, the mass jumps by a known amount, stated in the linkage. The target orbit is stated by its angular
momentum and eccentricity vectors, which are smooth. Steering is a unit vector, as in the orbit raising problem.

States: ``r`` (m), ``v`` (m/s) in an inertial frame at the Earth's centre, ``m`` (kg). Control: ``direction``, the unit
vector of the thrust. Drag acts against the velocity relative to the turning atmosphere,
:math:`w = v - \Omega \times r`:

.. math::
   \dot r = v, \qquad
   \dot v = -\frac{\mu r}{|r|^3} + \frac{T}{m} u - \frac{\rho S C_D |w|}{2 m} w, \qquad \dot m = -\dot m_T

Phases: six boosters and the first stage (75.2 s), three boosters and the first stage (to 150.4 s), first stage alone
(to 261 s), second stage (free duration).

Source: Benson, PhD thesis, MIT, 2004; Betts, Practical Methods for Optimal Control, 2010 (7529.712 kg).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt.plot import View
from gnc_opt.spacecraft.vector_algebra import cross
from problems._example import Array, Reference, example_main

MU = 3.986012e14
"""m^3/s^2."""
RADIUS = 6378145.0
"""Of the Earth, m."""
EARTH_RATE = np.array([0.0, 0.0, 7.29211585e-5])
"""Omega, rad/s."""
DENSITY, SCALE_HEIGHT = 1.225, 7200.0
"""At sea level, kg/m^3, and m."""
AREA, DRAG_COEFFICIENT = 4 * np.pi, 0.5
"""m^2."""
LATITUDE = np.radians(28.5)
"""Of the launch site."""
LIFT_OFF_MASS = 9 * 19290.0 + 104380.0 + 19300.0 + 4164.0
"""Nine boosters, two stages and the payload, kg."""


@dataclass(frozen=True)
class Engine:
    """Thrust (N), propellant (kg), burn time (s), and what is dropped after it (kg)."""

    thrust: float
    propellant: float
    burn_time: float
    dry_mass: float

    @property
    def flow(self) -> float:
        """kg/s."""
        return self.propellant / self.burn_time


BOOSTER = Engine(628500.0, 17010.0, 75.2, 19290.0 - 17010.0)
FIRST_STAGE = Engine(1083100.0, 95550.0, 261.0, 104380.0 - 95550.0)
SECOND_STAGE = Engine(110094.0, 16820.0, 700.0, 19300.0 - 16820.0)


@dataclass(frozen=True)
class Leg:
    """A phase: its engines with their numbers, its times (s), and the mass dropped before it (kg)."""

    name: str
    engines: tuple[tuple[int, Engine], ...]
    start: float
    end: float
    dropped: float = 0.0

    @property
    def thrust(self) -> float:
        """N."""
        return sum(number * engine.thrust for number, engine in self.engines)

    @property
    def flow(self) -> float:
        """kg/s."""
        return sum(number * engine.flow for number, engine in self.engines)

    @property
    def burnt(self) -> float:
        """Propellant of the whole phase, kg."""
        return self.flow * (self.end - self.start)


LEGS = (
    Leg("six_boosters", ((6, BOOSTER), (1, FIRST_STAGE)), 0.0, 75.2),
    Leg("three_boosters", ((3, BOOSTER), (1, FIRST_STAGE)), 75.2, 150.4, 6 * BOOSTER.dry_mass),
    Leg("first_stage", ((1, FIRST_STAGE),), 150.4, 261.0, 3 * BOOSTER.dry_mass),
    Leg("second_stage", ((1, SECOND_STAGE),), 261.0, 961.0, FIRST_STAGE.dry_mass),
)
"""The last one ends when the orbit is reached, at burn-out at the latest."""


def target_vectors() -> tuple[Array, Array]:
    """Return angular momentum (m^2/s) and eccentricity vector of the transfer orbit."""
    a, e = 24361140.0, 0.7308
    inclination, node, perigee = np.radians([28.5, 269.8, 130.5])
    pole = np.array(
        [np.sin(inclination) * np.sin(node), -np.sin(inclination) * np.cos(node), np.cos(inclination)]
    )
    ascending = np.array([np.cos(node), np.sin(node), 0.0])
    to_perigee = np.cos(perigee) * ascending + np.sin(perigee) * np.cross(pole, ascending)
    return np.sqrt(MU * a * (1 - e**2)) * pole, e * to_perigee


def launcher_model(leg: Leg) -> go.Model:
    """Return the dynamics of one phase."""
    rocket = go.Model(f"Delta III, {leg.name}")
    r = rocket.state("r", 3, unit="m")
    v = rocket.state("v", 3, unit="m/s")
    m = rocket.state("m", unit="kg")
    direction = rocket.control("direction", 3)
    gravity = -MU * r / ca.norm_2(r) ** 3
    rocket.ode({r: v, v: gravity + (leg.thrust * direction + drag(r, v)) / m, m: -leg.flow})
    return rocket


def drag(r: Any, v: Any) -> Any:
    """Return the drag, N, at position r (m) and velocity v (m/s)."""
    w = v - cross(EARTH_RATE, r)
    # At lift-off the rocket rests in the air; the square root needs a slope there.
    airspeed = ca.sqrt(ca.sumsqr(w) + 1e-12)
    rho = DENSITY * ca.exp(-(ca.norm_2(r) - RADIUS) / SCALE_HEIGHT)
    return -rho * AREA * DRAG_COEFFICIENT * airspeed / 2 * w


def build() -> go.Problem:
    """Return the problem."""
    problem = go.Problem("Delta III launch")
    masses = _masses()
    phases = [_add_leg(problem, leg, masses[leg.name]) for leg in LEGS]
    site = RADIUS * np.array([np.cos(LATITUDE), 0.0, np.sin(LATITUDE)])
    phases[0].initial(r=site, v=np.cross(EARTH_RATE, site), m=LIFT_OFF_MASS)
    for first, second, leg in zip(phases, phases[1:], LEGS[1:], strict=False):
        problem.link(first, second, time=False, jump={"m": -leg.dropped})  # the times are given

    last = phases[-1]
    r, v = last.final_state("r"), last.final_state("v")
    momentum, eccentricity = target_vectors()
    size = float(np.linalg.norm(momentum))
    h = cross(r, v)
    problem.constrain("angular momentum", (h - momentum) / size, equals=0.0)
    # Perpendicular to h, so two components say it all.
    reached = cross(v, h) / MU - r / ca.norm_2(r)
    problem.constrain("eccentricity", (reached - eccentricity)[:2], equals=0.0)
    problem.maximize(last.final_state("m"))
    return problem


def _add_leg(problem: go.Problem, leg: Leg, masses: tuple[float, float]) -> go.Phase:
    phase = problem.phase(leg.name, launcher_model(leg))
    last = leg is LEGS[-1]
    phase.time(initial=leg.start, final=(300.0, leg.end) if last else leg.end)
    phase.path("unit direction", ca.sumsqr(phase.model.symbol("direction")), equals=1.0)
    phase.path("above ground", ca.norm_2(phase.model.symbol("r")) / RADIUS, lower=1.0)
    early = leg in LEGS[:2]
    phase.guess(
        r=[5605e3, 0.0, 3043e3] if early else [400e3, 6000e3, 2200e3],
        v=[0.0, 409.0, 0.0] if early else [-8000.0, 1500.0, -500.0],
        m=masses,
        direction=[1.0, 0.0, 0.0] if early else [0.0, 1.0, 0.0],
    )
    return phase


def _masses() -> dict[str, tuple[float, float]]:
    """Return the mass at both ends of every phase, kg, if each lasts to its end."""
    masses, mass = {}, LIFT_OFF_MASS
    for leg in LEGS:
        mass -= leg.dropped
        masses[leg.name] = (mass, mass - leg.burnt)
        mass -= leg.burnt
    return masses


REFERENCE = Reference(7529.712295973, "independent collocation, two meshes agree", 1e-4, "kg")

VIEW = View("r", force="direction", keep_out={"Earth": ((0.0, 0.0, 0.0), RADIUS)})
"""What a report shows moving."""


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
