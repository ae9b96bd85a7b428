r"""Linear-quadratic regulator: continuous, sampled, with integral action.

In the error coordinates of `Deviation`, ``de/dt = A e + B v`` with v the command beyond the feedforward, the law
:math:`v = -K e - K_i \zeta` minimises

.. math:: \int e^T Q e + v^T R v + 2 e^T N v + \zeta^T Q_i \zeta \; dt, \qquad \dot\zeta = C e .

``dt=None`` gives the gain of the continuous problem. With dt, plant and cost are sampled exactly for a command held
over dt, and :math:`\zeta_{k+1} = \zeta_k + dt\, C e_k`, which is what the law sums.

Anti-windup: with limits, the memory is set back so that it is consistent with the command that the actuators can give,
:math:`\zeta_{k+1} = \zeta_k + dt\, C e_k + K_i^+ (v - \mathrm{sat}\, v)` (Hanus' conditioning).

References
----------
G. F. Franklin, J. D. Powell, M. Workman, Digital Control of Dynamic Systems, 3rd ed. (1998), chapter 9.
R. Hanus, M. Kinnaert, J.-L. Henrotte, Conditioning technique, a general anti-windup and bumpless transfer method,
Automatica 23 (1987).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import expect, read_positive
from gnc_opt.control.controller import Controller, first_memory, law
from gnc_opt.control.deviation import Deviation
from gnc_opt.control.explanation import Explanation, Fact
from gnc_opt.control.linear.margins import margins
from gnc_opt.control.linear.riccati import Steady, require_stabilizable, steady
from gnc_opt.control.linear.weights import Weight, read_weight, require_definite, require_semidefinite
from gnc_opt.control.reference import Reference
from gnc_opt.control.sampling import sample
from gnc_opt.control.schedule import (
    ReferenceSchedule,
    feedforward_reserve,
    reference_signals,
    reference_times,
)
from gnc_opt.errors import ArgumentError, DesignError, unknown_name
from gnc_opt.model.layout import Array, Layout, Variable, as_vector
from gnc_opt.model.model import Model

Limits = tuple[ArrayLike, ArrayLike]
"""Lower and upper limits of the controls, (n_controls,) each or one number for all."""

_STEADY = 1e-8
"""A and B that change less than this along a reference, relative to their size, count as constant."""
_CHECKS = 25


def design_lqr(
    model: Model,
    reference: Reference | ArrayLike,
    *,
    Q: Weight,
    R: Weight,
    N: ArrayLike | None = None,
    dt: float | None = None,
    integral: Mapping[str, ArrayLike] | None = None,
    limits: Limits | None = None,
    name: str = "LQR",
) -> Controller:
    """Design a linear-quadratic regulator about a reference.

    Parameters
    ----------
    model : Model
    reference : Reference or array (n_states,)
        A state to rest at (the control that keeps it there is found), or a reference along which the errors move by
        constant A and B; `design_tvlqr` is for the others.
    Q, R : weight
        Of the errors (n_errors, n_errors) and of the controls: matrices, diagonals, or entries by name, see `bryson`.
    N : array (n_errors, n_controls), optional
        Weight of products.
    dt : float, optional
        Control step, s: the gain for commands held that long. Without it, the continuous gain (any step).
    integral : mapping, optional
        Names of states or outputs whose error is to vanish under constant disturbances, each with the weight of its
        integral, ``1 / (largest acceptable integral)^2``.
    limits : (lower, upper), optional
        Of the controls, for the anti-windup and the statement of the reserve. Commands are not clipped.
    name : str
        For messages and reports.

    Returns
    -------
    Controller
        Signals ``<state>_ref``, ``<control>_ff``; memory ``integral_<name>``.

    Raises
    ------
    DesignError
        Not stabilisable or not detectable (with the mode), weights not (semi)definite, A or B not constant.
    """
    expect(model, Model, "the plant of design_lqr()", "give the Model to control")
    if not isinstance(reference, Reference):
        reference = Reference.constant(model, reference)
    deviation = Deviation(model)
    a, b = constant_linearization(deviation, reference)
    q, r, n = read_cost(model, Q, R, N)
    integrals = _integrals(deviation, reference, integral)
    solution, plant = _solve(deviation, a, b, q, r, n, integrals, dt)
    bounds = read_limits(model, limits)
    step, start, memory = _law(model, deviation, solution.gain, integrals, bounds)
    signals = reference_signals(reference, *([Variable("step", 1, "s")] if integrals.size else []))
    facts = [*_facts(solution, plant, model.controls, dt), *reserve_facts(reference, bounds)]
    return Controller(
        name=name,
        step=step,
        start=start,
        states=model.states,
        commands=model.controls,
        signals=signals,
        memory=memory,
        schedule=_WithStep(ReferenceSchedule(reference)) if integrals.size else ReferenceSchedule(reference),
        dt=dt,
        span=(reference.initial_time, reference.final_time),
        explanation=Explanation(f"{name} of '{model.name}'", tuple(facts)),
    )


@dataclass(frozen=True, eq=False)
class _Integrals:
    """Integrated errors: their layout, ``C`` to first order (size, n_errors) and weights."""

    memory: Layout
    names: tuple[str, ...]
    matrix: Array
    weight: Array

    @property
    def size(self) -> int:
        return self.memory.size


@dataclass(frozen=True, eq=False)
class _WithStep:
    """A schedule that also tells the law the length of its step."""

    schedule: ReferenceSchedule

    def __call__(self, times: Array, dt: float) -> Array:
        return np.vstack([self.schedule(times, dt), np.full((1, np.size(times)), dt)])


def read_cost(model: Model, q: Weight, r: Weight, n: ArrayLike | None) -> tuple[Array, Array, Array]:
    """Return Q, R, N as matrices; refuse costs that reward errors or controls."""
    errors, controls = model.errors, model.controls
    weight, effort = read_weight(q, errors, "the weight Q"), read_weight(r, controls, "the weight R")
    require_semidefinite(weight, errors.labels, "the weight Q")
    require_definite(effort, controls.labels, "the weight R")
    shape = (errors.size, controls.size)
    cross = np.zeros(shape) if n is None else np.asarray(n, dtype=float)
    if cross.shape != shape or not np.all(np.isfinite(cross)):
        raise ArgumentError(
            f"the weight N has the shape {cross.shape}: give finite numbers of the shape {shape}."
        )
    if n is not None:
        both = np.block([[weight, cross], [cross.T, effort]])
        require_semidefinite(both, errors.labels + controls.labels, "the weight [[Q, N], [N', R]]")
    return weight, effort, cross


def read_limits(model: Model, limits: Limits | None) -> tuple[Array, Array] | None:
    """Return lower and upper limits (n_controls,), or ``None``."""
    if limits is None:
        return None
    if not isinstance(limits, tuple) or len(limits) != 2:
        raise ArgumentError(f"limits is {limits!r}: give (lower, upper), each a number or one per control.")
    lower, upper = (
        as_vector(v, model.controls.size, f"the {w} limits", ArgumentError)
        for v, w in zip(limits, ("lower", "upper"), strict=True)
    )
    bad = np.flatnonzero(~(lower < upper))
    if bad.size:
        raise DesignError(
            f"control '{model.controls.labels[bad[0]]}' has no authority: its limits are {lower[bad[0]]:g} and "
            f"{upper[bad[0]]:g}; give lower < upper."
        )
    return lower, upper


def reserve_facts(reference: Reference, limits: tuple[Array, Array] | None) -> list[Fact]:
    """Return the fact about what the feedforward leaves to the feedback."""
    if limits is None:
        return []
    reserve = feedforward_reserve(reference, *limits)
    half = 0.5 * (limits[1] - limits[0])
    remark = (
        "least distance of the feedforward to its limits, share of half their range; what feedback can use"
    )
    return [Fact("saturation reserve", reserve / half, "", remark)]


def constant_linearization(deviation: Deviation, reference: Reference) -> tuple[Array, Array]:
    """Return A and B if they are the same all along the reference, else raise `DesignError`."""
    times = reference_times(reference, _CHECKS)
    controls = reference.u(times)
    pairs = [deviation.linearize(t, reference.x(t), controls[:, k]) for k, t in enumerate(times)]
    a, b = pairs[-1]
    for t, pair in zip(times, pairs, strict=True):
        for what, found, last in (("A", pair[0], a), ("B", pair[1], b)):
            change = np.max(np.abs(found - last), initial=0.0)
            if not change <= _STEADY * np.max(np.abs(last), initial=0.0):
                raise DesignError(
                    f"{what} of '{deviation.model.name}' changes along the reference, by {change:.3g} between "
                    f"{t:g} s and {times[-1]:g} s: use design_tvlqr(), or a constant reference."
                )
    return a, b


def _integrals(
    deviation: Deviation, reference: Reference, integral: Mapping[str, ArrayLike] | None
) -> _Integrals:
    model = deviation.model
    variables, rows, weights = [], [], []
    for name, weight in (integral or {}).items():
        if name in model.errors:
            variable = model.errors[name]
            matrix = np.eye(model.errors.size)[model.errors.slice(name)]
        elif name in model.outputs:
            variable = model.outputs[name]
            matrix = deviation.linearize_output(
                name,
                reference.final_time,
                reference.x(reference.final_time),
                reference.u(reference.final_time),
            )
        else:
            raise unknown_name(
                "state or output", name, f"model '{model.name}'", [*model.errors.names, *model.outputs.names]
            )
        unit = f"{variable.unit} s" if variable.unit else "s"
        variables.append(Variable(f"integral_{name}", variable.size, unit))
        rows.append(matrix)
        weights.append(
            as_vector(weight, variable.size, f"the weight of the integral of '{name}'", ArgumentError)
        )
    memory = Layout("memory", tuple(variables), "the integral action")
    diagonal = np.concatenate(weights) if weights else np.zeros(0)
    require_definite(np.diag(diagonal), memory.labels, "the weight")
    matrix = np.vstack(rows) if rows else np.zeros((0, model.errors.size))
    return _Integrals(memory, tuple(integral or {}), matrix, np.diag(diagonal))


def _solve(
    deviation: Deviation,
    a: Array,
    b: Array,
    q: Array,
    r: Array,
    n: Array,
    integrals: _Integrals,
    dt: float | None,
) -> tuple[Steady, tuple[Array, Array]]:
    """Return the regulator and the (sampled) plant with the integrals as states."""
    labels = deviation.errors.labels + integrals.memory.labels
    k, c = integrals.size, integrals.matrix
    if dt is None:
        one, per_step = np.zeros((k, k)), 1.0
    else:
        per_step = read_positive(dt, "the control step dt")
        require_stabilizable(
            a, b, deviation.errors.labels
        )  # before sampling: the mode's own eigenvalue is told
        held = sample(a, b, q, r, n, per_step)
        a, b, q, r, n = held.a, held.b, held.q, held.r, held.n
        one = np.eye(k)
    m = b.shape[1]
    wide_a = np.block([[a, np.zeros((a.shape[0], k))], [per_step * c, one]])
    wide_b = np.vstack([b, np.zeros((k, m))])
    wide_q = np.block(
        [[q, np.zeros((a.shape[0], k))], [np.zeros((k, a.shape[0])), per_step * integrals.weight]]
    )
    wide_n = np.vstack([n, np.zeros((k, m))])
    return steady(wide_a, wide_b, wide_q, r, wide_n, labels, sampled=dt is not None), (wide_a, wide_b)


def _law(
    model: Model, deviation: Deviation, gain: Array, integrals: _Integrals, limits: tuple[Array, Array] | None
) -> tuple[object, object, Layout]:
    states, controls = model.states.size, model.controls.size
    t, x = ca.SX.sym("t"), ca.SX.sym("x", states)
    r = ca.SX.sym("r", states + controls + (1 if integrals.size else 0))
    z = ca.SX.sym("z", integrals.size)
    x_ref, u_ff = r[:states], r[states : states + controls]
    e = deviation.expression(x, x_ref)
    k_e, k_i = gain[:, : e.shape[0]], gain[:, e.shape[0] :]
    u, z_next = u_ff - ca.DM(k_e) @ e, z
    if integrals.size:
        u = u - ca.DM(k_i) @ z
        z_next = z + r[-1] * _integrand(deviation, integrals, t, x, x_ref, e)
        if limits is not None:
            clipped = ca.fmin(ca.fmax(u, limits[0]), limits[1])
            z_next += ca.DM(np.linalg.pinv(k_i)) @ (u - clipped)
    return law(t, x, r, z, u, z_next), first_memory(t, x, r, ca.SX.zeros(integrals.size)), integrals.memory


def _integrand(
    deviation: Deviation, integrals: _Integrals, t: ca.SX, x: ca.SX, x_ref: ca.SX, e: ca.SX
) -> ca.SX:
    model = deviation.model
    parts = []
    for name in integrals.names:
        if name in model.errors:
            parts.append(e[model.errors.slice(name)])
        else:
            parts.append(deviation.output(name, t, x) - deviation.output(name, t, x_ref))
    return ca.vertcat(*parts)


def _facts(solution: Steady, plant: tuple[Array, Array], controls: Layout, dt: float | None) -> list[Fact]:
    poles = solution.poles if dt is None else np.log(solution.poles.astype(complex)) / dt
    rates = "1/s"
    facts = [Fact("gain", solution.gain, "", "K in u = u_ff - K e, rows: " + ", ".join(controls.labels))]
    if dt is not None:
        facts.append(Fact("sampled poles", solution.poles, "", "z"))
    facts += [
        Fact("closed-loop poles", poles, rates, "slowest first" if dt is None else "ln(z)/dt, slowest first"),
        Fact("damping", -poles.real / np.abs(poles), "", "of each pole"),
    ]
    return [*facts, *margin_facts(*plant, solution.gain, dt), residual_fact(solution.residual)]


def margin_facts(a: Array, b: Array, gain: Array, dt: float | None) -> list[Fact]:
    """Return the facts about the margins at the plant's input."""
    found = margins(a, b, gain, dt)
    alpha = found.disk
    both = f"all gains at once by a factor {max(2 - alpha, 0) / (2 + alpha):.3g} to its inverse"
    return [
        Fact("gain margin up", found.gain_up, "", "per control, the others closed"),
        Fact("gain margin down", found.gain_down, "", "per control, the others closed"),
        Fact("phase margin", np.degrees(found.phase), "deg", "per control, the others closed"),
        Fact("delay margin", found.delay, "s", "per control, the others closed"),
        Fact("disk margin", alpha, "", both),
    ]


def residual_fact(value: float) -> Fact:
    """Return the fact about the Riccati equation's residual."""
    return Fact("Riccati residual", value, "", "left side over its largest term, computed from P alone")
