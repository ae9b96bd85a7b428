r"""Controllers of the tethered pair: the published structure, and tracking of a plan.

The structure consists of a hierarchical surface, an observer and a reaching law.

Errors of swing, height and lead make a weighted surface S; with the rate v of the thrust angle as the command,

.. math:: S = s_\theta + k_4 s_h + k_5 s_\alpha, \quad s_i = k_i e_i + \dot e_i, \qquad
   \sigma = k_6 S + \dot S, \qquad \dot\sigma = k_6 \dot S + \Gamma + G v .

S, its rate and G come from the model by `output_errors`. :math:`\Gamma` does as well, but the published
law does not use it: a super-twisting observer estimates it (k_7, k_8). `PredictiveReaching`, or one of two other
reaching laws, drives the scalar :math:`\sigma` to zero within the limits of angle and rate.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, TypeAlias

import casadi as ca
import numpy as np

import gnc_opt as go
from gnc_opt.control import DesignReport, ReportEntry, SuperTwistingObserver, lie_derivative, output_errors
from gnc_opt.control.decoupling_matrix_inverse import (
    DETERMINANT_MIN_SHARE,
    GuardedLaw,
    MemoryEntry,
    build_guarded_decoupling_inverse,
    build_singularity_guarded_controller,
)
from gnc_opt.control.input_output_linearization import OutputErrors, zero_dynamics
from problems._example import Array
from problems.tethered_formation.model import DURATION, MAX_ANGLE, MAX_RATE, RADIUS, Orbit, tether_model
from problems.tethered_formation.predictive_reaching import PredictiveReaching

Unknown: TypeAlias = Literal["observed", "ignored", "modelled"]

STEP = 0.1
"""Control step, s."""
OUTPUTS = ("theta", "height", "lead")


class Reaching(Protocol):
    """What brings the sliding variable s to zero where ds/dt = drift + effect * v; arguments and result are SX."""

    def command(self, s: Any, drift: Any, effect: Any, position: Any) -> Any:
        """Return v; the law limits it."""


@dataclass(frozen=True)
class Linear:
    """ds/dt = -gain * s: inside the boundary layer of a sliding mode; gain in 1/s."""

    gain: float = 0.5

    def command(self, s: Any, drift: Any, effect: Any, position: Any) -> Any:
        """Return v."""
        return -(drift + self.gain * s) / effect


@dataclass(frozen=True)
class Switching:
    """ds/dt = -gain * sign(s); gain in 1/s^3, as dS_v/dt."""

    gain: float = 0.01

    def command(self, s: Any, drift: Any, effect: Any, position: Any) -> Any:
        """Return v."""
        return -(drift + self.gain * ca.sign(s)) / effect


def predictive(steps: int = 20, effort: float = 1e-4, dt: float = STEP) -> PredictiveReaching:
    """Return the published reaching law: N_p, R, and Q = 1."""
    return PredictiveReaching(steps=steps, dt=dt, weight=1.0, effort=effort, rate=MAX_RATE, travel=MAX_ANGLE)


@dataclass(frozen=True)
class Gains:
    """Of the surface and the observer (k_7 and k_8).

    k1, k2, k3 are slopes of the surfaces of swing, height and lead, 1/s; k4 weighs that of the height (rad/m; negative,
    or the zero dynamics are unstable), k5 that of the argument of latitude; k6 is the slope of the second level, 1/s.
    """

    k1: float = 0.35
    k2: float = 0.01
    k3: float = 0.01
    k4: float = -0.06
    k5: float = 500.0
    k6: float = 1.0
    observer: SuperTwistingObserver = field(default_factory=lambda: SuperTwistingObserver(0.01, 5e-5))


def surface(reference: go.Reference, gains: Gains | None = None) -> OutputErrors:
    """Return S with its rate, the drift of the rate (Gamma) and G."""
    k, model, total = gains or Gains(), reference.model, ca.SX(0)
    for name, slope, weight in zip(OUTPUTS, (k.k1, k.k2, k.k3), (1.0, k.k4, k.k5 / RADIUS), strict=True):
        output = model.symbol(name)
        total += weight * (slope * output + lie_derivative(model, output))
    return output_errors(model, reference, {"S": total})


def design_swing_law(
    reference: go.Reference,
    reaching: Reaching | None = None,
    *,
    gains: Gains | None = None,
    unknown: Unknown = "observed",
    dt: float = STEP,
    guard: float = DETERMINANT_MIN_SHARE,
) -> go.Controller:
    """Return the controller of the thrust angle's rate; its commands respect both limits.

    Parameters
    ----------
    reference : Reference
        Of a `tether_model`, which the law believes.
    reaching : Reaching
        Default `predictive`.
    gains : Gains
    unknown : {"observed", "ignored", "modelled"}
        Gamma by the observer, as published; zero; or from the model.
    dt : float
        Control step, s.
    guard : float
        Smallest G, relative to the reference's, with which the law works; below it the angle stands still.
    """
    k, reaching = gains or Gains(), reaching or predictive(dt=dt)
    errors = surface(reference, k)
    inverse = build_guarded_decoupling_inverse(errors, reference, guard)
    pair, limits = errors.pair, predictive(dt=dt)
    slow, rate = errors.chains[0][0], errors.chains[0][1]
    sigma, effect = k.k6 * slow + rate, inverse.matrix[0]
    s_hat, q, old = (ca.SX.sym(name) for name in ("sigma_hat", "q", "estimate"))
    gamma_hat = {
        "observed": k.observer.estimate(sigma, s_hat, q),
        "ignored": ca.SX(0),
        "modelled": errors.drift[0],
    }[unknown]
    angle = pair.x[pair.model.states.slice("gamma")]
    v = limits.limit(reaching.command(sigma, k.k6 * rate + gamma_hat, effect, angle), angle)
    s_next, q_next = k.observer.update(sigma, s_hat, q, k.k6 * rate + effect * v, dt)
    memory = (
        MemoryEntry("sigma", ca.SX.sym("sigma"), sigma, sigma),
        MemoryEntry("estimate", old, ca.SX(0), gamma_hat),
        MemoryEntry("sigma_hat", s_hat, sigma, s_next),
        MemoryEntry("q", q, ca.SX(0), q_next),
    )
    return build_singularity_guarded_controller(
        f"swing control by {type(reaching).__name__}",
        pair,
        reference,
        GuardedLaw(v, inverse.regular, memory, fallback=ca.SX(0)),
        dt=dt,
        explanation=_explain(errors, reference, reaching),
    )


def _explain(errors: OutputErrors, reference: go.Reference, reaching: Reaching) -> DesignReport:
    t = reference.final_time
    x, u = reference.x(t), reference.u(t)
    effect = float(
        errors.pair.evaluate_expression_on_reference(reference, np.array([t]), errors.decoupling)[0][0, 0]
    )
    zeros = zero_dynamics(errors, t, x, u).eigenvalues
    facts = [
        ReportEntry("G at the end of the reference", effect),
        ReportEntry("eigenvalues on S = 0", zeros, "1/s"),
    ]
    if isinstance(reaching, PredictiveReaching):
        facts.append(ReportEntry("gain away from the limits", reaching.gain(effect), remark="-v / sigma"))
    return DesignReport("hierarchical sliding mode with predictive reaching", tuple(facts))


# --- following a plan -------------------------------------------------------------------------------------


def held(solution: go.Solution, duration: float = DURATION) -> go.Reference:
    """Return a plan, and after its end the orbit on which the pair is pulled without swing from where the plan ends.

    The first reference would not do then: deflected thrust is missing along the orbit, and with that deficit swing and
    height cannot both be on it, so that the swing would drift off again.
    """
    leg = solution.phase()
    end = leg.final_time
    after = Orbit.of(duration=max(duration - end, 1.0), start=leg.x(end)[:4])

    def states(t: Array) -> Array:
        return np.where(t <= end, leg.x(np.minimum(t, end)), after.state(np.maximum(t - end, 0.0)))

    def control(t: Array) -> Array:
        return np.where(t <= end, leg.saturated_control("gamma_rate")(np.minimum(t, end)), 0.0).reshape(1, -1)

    jumps = [float(t) for t in leg.breaks if 0 < t < end]
    return go.Reference.from_functions(
        tether_model(), states, control, 0.0, max(duration, end), jumps=[*jumps, end], vectorized=True
    )


def design_tracker(reference: go.Reference) -> go.Controller:
    """Return a time-varying LQR about a planned manoeuvre.

    The place along the orbit cannot be steered, so the LQR does not weigh it.
    """
    states = reference.model.states
    weights = go.bryson(
        states, height=2.0, climb=0.2, lead=300.0, drift=30.0, theta=0.02, theta_rate=2e-3, gamma=0.1
    )
    limits = (-MAX_RATE, MAX_RATE)
    return go.design_tvlqr(
        reference.model, reference, Q=weights, R={"gamma_rate": 2e4}, terminal=weights, dt=STEP, limits=limits
    )
