r"""The two laws of Imani and Bahrami for the formation, and the runs that compare them.

With e = r - r_d:

* **sliding mode** (equation 14): :math:`s = \dot e + \lambda e`,
  :math:`u = C v + N(r) + \ddot r_d - \lambda \dot e - k\, \mathrm{sat}(s / \epsilon)`;
* **optimal sliding mode** (equations 22-31): :math:`u = -K E - \eta\, \mathrm{sat}(s / \varphi)`, E = (e, e'), K the
  regulator of Hill's equations for Q and R, and
  :math:`s = G (E - E_0) - G \int (A - B K) E\,dt`, G = B^T.

Neither knows of the oblateness. Delta-V is the sum over the axes of the integral of \|u\| (equation 39).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

import gnc_opt as go
from gnc_opt.arrays import Array
from gnc_opt.control import (
    ConstantRate,
    Controller,
    Reference,
    SaturationLayer,
    Sign,
    design_integral_sliding_mode,
    design_lqr,
    design_sliding_mode,
)
from gnc_opt.control.reaching_laws import Boundary
from gnc_opt.simulation import Block, ClosedLoop, Disturbance, Run
from problems.formation_flying.model import (
    PERIOD,
    START,
    build_model,
    formation,
    hill_model,
)
from problems.kept import kept

SLOPE, GAIN, LAYER = 1e-3, 0.96, 10.0
"""lambda (1/s), k (m/s^2) and eps (m/s) of the sliding mode."""
WEIGHTS = {"r": 0.2, "v": 1e5}
CONTROL_WEIGHT = 1e10
ETA, PHI = 5e-4, 1e-3
"""Gain (m/s^2) and layer (m/s) of the optimal sliding mode."""
DISTURBANCE_BOUND = 1e-5
"""m/s^2; the largest of an orbit is 3.6e-6."""

STEPS = 24000
"""Control steps in a period: 0.25 s, for the nominal runs. The publication's laws are continuous; held for a
step h, the sliding mode's Delta-V grows by 2.2e-3 h."""
FEW_STEPS = 3000
"""The same for sweeps over the phase: 2 s."""


@dataclass(frozen=True)
class Outcome:
    """What a period is worth: position error at its end (m) and Delta-V (m/s)."""

    miss: float
    delta_v: float

    @classmethod
    def of(cls, run: Run) -> Outcome:
        """Read a run."""
        return cls(run.miss("r"), delta_v(run))


def delta_v(run: Run) -> float:
    """Return the sum over the axes of the integral of \\|a\\|, m/s (equation 39)."""
    return float(np.sum(run.control_effort("a")))


def step_of(steps: int) -> float:
    """Return the control step (s) of so many steps in a period."""
    return PERIOD / steps


@kept
def sliding_mode(
    dt: float, *, slope: float = SLOPE, gain: float = GAIN, layer: float | None = LAYER
) -> Controller:
    """Return the publication's sliding mode; ``layer=None`` is ideal switching."""
    model = build_model().with_parameters(J2=0.0)
    return design_sliding_mode(
        model,
        formation(model),
        outputs="r",
        slopes=slope,
        reaching=ConstantRate(gain),
        boundary=_boundary(layer),
        bound=DISTURBANCE_BOUND,
        dt=dt,
    )


@cache
def regulator() -> Array:
    """Return K (3, 6): weights on the errors of position and rate, on Hill's equations."""
    lqr = design_lqr(hill_model(), np.zeros(6), Q=WEIGHTS, R=CONTROL_WEIGHT)
    return np.asarray(lqr.explain()["gain"], dtype=float).reshape(3, 6)


@kept
def optimal_sliding_mode(dt: float, *, gain: float = ETA, layer: float | None = PHI) -> Controller:
    """Return the publication's optimal sliding mode around the circle; ``layer=None`` is ideal switching."""
    model = hill_model()
    return integral_law(model, formation(model, feedforward=False), dt, gain=gain, layer=layer)


def integral_law(
    model: go.Model,
    reference: Reference,
    dt: float,
    *,
    gain: float = ETA,
    layer: float | None = PHI,
    limits: tuple[float, float] | None = None,
) -> Controller:
    """Return the optimal sliding mode along any reference; ``limits`` (m/s^2) are those of the thrust."""
    return design_integral_sliding_mode(
        model,
        reference,
        nominal=regulator(),
        reaching=ConstantRate(gain),
        boundary=_boundary(layer),
        dt=dt,
        bound=DISTURBANCE_BOUND,
        projection="transpose",
        limits=limits,
        name="optimal sliding mode",
    )


@cache
def linear_quadratic(dt: float) -> Controller:
    """Return the regulator alone, eta = 0."""
    model = hill_model()
    return design_lqr(model, formation(model, feedforward=False), Q=WEIGHTS, R=CONTROL_WEIGHT, name="LQ")


def fly(
    controller: Controller,
    plant: go.Model,
    *,
    x0: Array = START,
    phase_shift: float = 0.0,
    steps: int = STEPS,
    disturbances: Sequence[Disturbance] = (),
    actuators: Sequence[Block] = (),
) -> Run:
    """Fly one period.

    Parameters
    ----------
    controller : Controller
    plant : Model
    x0 : array (n_states,)
    phase_shift : float
        Added to `PHASE`, rad, 0 to 2 pi: nothing but the circle depends on time, so that it starts later on it.
    steps : int
        Control steps in the period.
    disturbances, actuators : sequence of blocks
    """
    return fly_loop(closed_loop(controller, plant, steps, disturbances, actuators), x0, phase_shift)


def closed_loop(
    controller: Controller,
    plant: go.Model,
    steps: int = STEPS,
    disturbances: Sequence[Disturbance] = (),
    actuators: Sequence[Block] = (),
) -> ClosedLoop:
    """Return the loop; the plant is a thousand times slower than a control step: one integration step will do."""
    return ClosedLoop(
        plant,
        controller,
        actuators=actuators,
        disturbances=disturbances,
        dt=step_of(steps),
        substeps=1,
    )


def fly_loop(loop: ClosedLoop, x0: Array = START, phase_shift: float = 0.0) -> Run:
    """Fly one period of a loop, begun where the circle has the given phase."""
    t0 = phase_shift / (2 * np.pi) * PERIOD
    return loop.simulate(x0, t0=t0, tf=t0 + PERIOD)


def _boundary(layer: float | None) -> Boundary:
    return Sign() if layer is None else SaturationLayer(layer)
