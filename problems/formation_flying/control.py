r"""Controllers of the formation: the two of Imani and Bahrami, and the second of them along a plan.

With e = r - r_d:

* **sliding mode** (equation 14): :math:`s = \dot e + \lambda e`,
  :math:`u = C v + N(r) + \ddot r_d - \lambda \dot e - k\, \mathrm{sat}(s / \epsilon)`;
* **optimal sliding mode** (equations 22-31): :math:`u = -K E - \eta\, \mathrm{sat}(s / \varphi)`, E = (e, e'), K the
  regulator of Hill's equations for Q and R, and
  :math:`s = G (E - E_0) - G \int (A - B K) E\,dt`, G = B^T.

Both neglect the oblateness. Delta-V is the sum over the axes of the integral of \|u\| (equation 39).
"""

from __future__ import annotations

from functools import cache

import numpy as np

import gnc_opt as go
from gnc_opt.array_types import Array
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
from gnc_opt.simulation import Run
from problems.formation_flying.model import PERIOD, build_model, formation, hill_model
from problems.formation_flying.optimal import Plan

SLOPE, GAIN, LAYER = 1e-3, 0.96, 10.0
"""lambda (1/s), k (m/s^2) and eps (m/s) of the sliding mode."""
WEIGHTS = {"r": 0.2, "v": 1e5}
CONTROL_WEIGHT = 1e10
ETA, PHI = 5e-4, 1e-3
"""Gain (m/s^2) and layer (m/s) of the optimal sliding mode."""
DISTURBANCE_BOUND = 1e-5
"""m/s^2; the largest of an orbit is 3.6e-6."""


def delta_v(run: Run) -> float:
    """Return the sum over the axes of the integral of \\|a\\|, m/s (equation 39)."""
    return float(np.sum(run.control_effort("a")))


@cache
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


@cache
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


def follow_plan(plan: Plan, dt: float, limits: tuple[float, float], duration: float = PERIOD) -> Controller:
    """Return the optimal sliding mode along a plan, and along the circle after its end, up to ``duration`` (s)."""
    model, end = build_model().with_parameters(J2=0.0), plan.final_time
    circling = formation(model, max(duration, end))

    def states(t: Array) -> Array:
        return np.where(t <= end, plan.states(np.minimum(t, end)), circling.x(t))

    def thrust(t: Array) -> Array:
        return np.where(t <= end, plan.thrust(np.minimum(t, end)), circling.u(t))

    jumps = [float(t) for t in plan.solution.phase().breaks if 0 < t < end]
    reference = Reference.from_functions(
        model, states, thrust, 0.0, max(duration, end), jumps=[*jumps, end], vectorized=True
    )
    return integral_law(model, reference, dt, limits=limits)


def _boundary(layer: float | None) -> Boundary:
    return Sign() if layer is None else SaturationLayer(layer)
