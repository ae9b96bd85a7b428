"""Rehearsal: the sampled law flown on its own model from a given start, its commands cut to the limits.

What a design promises of a start (a reaching time, a way clear of singularities, decaying errors) holds for the command
that actuators can give, not for the one that the law asks for. So a start and limits are judged together, undisturbed,
by classical Runge-Kutta between the control steps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arrays import Array
from gnc_opt.control.control_limits import Authority, saturated
from gnc_opt.control.controller import Controller
from gnc_opt.control.design_report import Fact
from gnc_opt.control.error_dynamics import evaluate_columns
from gnc_opt.control.input_output_linearization import OutputErrors
from gnc_opt.control.reference import TRIM_TOLERANCE, Reference
from gnc_opt.errors import DesignError
from gnc_opt.model.variables import as_point
from gnc_opt.tolerances import PLAUSIBLE, ROUNDING, STEP_SLACK

Rehearsal: TypeAlias = Callable[[Controller], list[Fact]]
"""Flies a finished law; returns what that shows, or raises `DesignError`."""

FINENESS = 0.02
"""Control step of the rehearsal of a law for any step, in time constants of its fastest pole."""
_FAST = 0.1
"""Step of the integration, in time constants of the plant's fastest mode on the reference."""
_MOST_INNER = 50
"""Integration steps per control step at most."""
_MOST_STEPS = 20_000
"""Control steps of one act at most."""
_ACTS = 12
"""Where limits hold the errors up, or what no output sees moves away, the rehearsal goes on for so many acts."""
_AWAY = 1e-6
"""A state moves away if its deviation grows by more than this share from each quarter of the way to the next."""
_SETTLED = 0.1
"""Share of its largest size to which an output error has to come down for good where limits acted."""


@dataclass(frozen=True, eq=False)
class Path:
    """The rehearsed way.

    Attributes
    ----------
    times : array (n + 1,)
        s.
    x : array (n_states, n + 1)
    wanted : array (n_commands, n)
        What the law asked for.
    memory : array (n_memory, n + 1)
        Of the law.
    outputs : array (n_outputs, n + 1)
        Output errors.
    """

    times: Array
    x: Array
    wanted: Array
    memory: Array
    outputs: Array

    def cut(self, limits: Authority | None) -> Array:
        """Return whether limits acted at each step, bool (n,)."""
        if limits is None:
            return np.zeros(self.wanted.shape[1], dtype=bool)
        room = ROUNDING * (limits[1] - limits[0])[:, None]
        below, above = limits[0][:, None] - room, limits[1][:, None] + room
        return np.asarray(np.any((self.wanted < below) | (self.wanted > above), axis=0))


@dataclass(frozen=True, eq=False)
class Trial:
    """What a law is to show.

    Attributes
    ----------
    errors : OutputErrors
    reference : Reference
    start : array (n_states,)
    limits : Authority or None
    dt : float
        Control step, s.
    span : float
        How long, s.
    """

    errors: OutputErrors
    reference: Reference
    start: ArrayLike
    limits: Authority | None
    dt: float
    span: float


def rehearse(controller: Controller, trial: Trial, watch: Callable[[Path], object]) -> Path:
    """Fly a law from the start for the span of a trial, longer where limits hold the errors up.

    ``watch`` is shown the path as it grows, and may refuse it.

    Raises
    ------
    DesignError
        The state leaves all bounds, or the limits keep the output errors from coming down.

    Notes
    -----
    Where the reference does not rest at its end (a vehicle on its way, or no tail), the rehearsal ends with it.
    Zero dynamics with an eigenvalue of zero may decay, rest or escape, and take longer the nearer they are to their
    equilibrium: as long as they move away the rehearsal goes on, with acts that are twice as long each time.
    """
    errors, reference, limits, dt = trial.errors, trial.reference, trial.limits, trial.dt
    x = as_point(trial.start, errors.pair.x.numel(), "the state at the start", DesignError)
    t = reference.initial_time
    most = _steps_at_most(reference, dt)
    count = min(int(np.clip(np.ceil(trial.span / dt), 100, _MOST_STEPS)), most)
    step = _step(controller, errors, reference, limits, dt, x)
    act = step.mapaccum(count)
    state = np.concatenate([x, controller.initial_memory(t, x, dt)])
    values = evaluate_columns(_outputs(errors), [t], x[:, None], reference.x([t]))
    path = Path(
        np.array([t]), x[:, None], np.empty((controller.commands.size, 0)), state[x.size :, None], values
    )
    for _ in range(_ACTS):
        times = path.times[-1] + dt * np.arange(count + 1)
        found, wanted, outputs = act(
            state, times[:-1], controller.schedule(times[:-1], dt), reference.x(times[1:])
        )
        states = np.asarray(found.full())
        path = Path(
            np.append(path.times, times[1:]),
            np.hstack([path.x, states[: x.size]]),
            np.hstack([path.wanted, wanted.full()]),
            np.hstack([path.memory, states[x.size :]]),
            np.hstack([path.outputs, outputs.full()]),
        )
        watch(path)
        _require_bounded(path, errors)
        held = path.cut(limits).any() and np.any(_left(path, count) > _SETTLED)
        most -= count
        if not held:
            if path.times.size > _MOST_STEPS or not np.any(_moving_away(path, errors, reference)):
                return path
            count = min(2 * count, _MOST_STEPS)
        if not most:
            break
        count = min(count, most)
        act = step.mapaccum(count)
        state = states[:, -1]
    if not held:
        return path
    assert limits is not None
    raise DesignError(_stuck(path, errors, limits, count))


def _steps_at_most(reference: Reference, dt: float) -> int:
    """Return the control steps for which a reference says what is wanted; without end where it rests at its end."""
    end, u = reference.final_time, reference.tail_control
    if u is not None:
        x = reference.x(end)
        still = TRIM_TOLERANCE * max(float(np.max(np.abs(x), initial=0.0)), 1.0)
        if reference.duration <= 0 or np.all(np.abs(reference.model.f(end, x, u)) <= still):
            return (_ACTS + 1) * _MOST_STEPS
    return max(1, int((end - reference.initial_time) / dt + STEP_SLACK))


def limit_facts(path: Path, limits: Authority | None, dt: float) -> list[Fact]:
    """Return the fact about how long limits act on the way."""
    if limits is None:
        return []
    spent = float(np.sum(path.cut(limits)) * dt)
    return [Fact("limits act for", spent, "s", "rehearsed from the given start, undisturbed")]


def drift_facts(path: Path, errors: OutputErrors, reference: Reference) -> list[Fact]:
    """Return the fact about the state that no output sees and that moves away to the end of the way, if one does."""
    away = np.flatnonzero(_moving_away(path, errors, reference))
    if not away.size:
        return []
    i = int(away[0])
    state, unit = errors.pair.model.states.labels[i], errors.pair.model.states.units[i]
    off = float(path.x[i, -1] - reference.x(path.times[-1:])[i, 0])
    remark = f"state '{state}', its deviation at t = {path.times[-1]:.4g} s, and growing: no output sees it"
    return [Fact("still moving away", off, unit, remark)]


def _moving_away(path: Path, errors: OutputErrors, reference: Reference) -> Array:
    """Return for each state whether it moves away from the reference on and on, bool (n_states,); without zero
    dynamics none does.
    """
    size = path.x.shape[0]
    if sum(errors.degrees) >= size:
        return np.zeros(size, dtype=bool)
    off = np.abs(path.x - reference.x(path.times))
    peaks = np.stack([np.max(part, axis=1) for part in np.array_split(off, 4, axis=1)])
    seen = peaks[-1] > ROUNDING * (1 + np.max(np.abs(path.x), axis=1))
    return np.asarray(seen & np.all(peaks[1:] > (1 + _AWAY) * peaks[:-1], axis=0))


def _left(path: Path, count: int) -> Array:
    """Return the share of its largest size that each output error still has in the last tenth of an act."""
    size = np.abs(path.outputs)
    largest = np.max(size, axis=1)
    return np.asarray(np.max(size[:, -max(count // 10, 1) :], axis=1) / np.where(largest > 0, largest, 1.0))


def _require_bounded(path: Path, errors: OutputErrors) -> None:
    lost = ~(np.abs(path.x) <= PLAUSIBLE)
    if not lost.any():
        return
    column = int(np.argmax(lost.any(axis=0)))
    label = errors.pair.model.states.labels[int(np.argmax(lost[:, column]))]
    raise DesignError(
        f"from this start the loop runs away: '{label}' leaves all bounds at t = {path.times[column]:.4g} s, whatever "
        f"becomes of {', '.join(errors.labels)}; choose other outputs, a nearer start or wider limits."
    )


def _stuck(path: Path, errors: OutputErrors, limits: Authority, count: int) -> str:
    output = int(np.argmax(_left(path, count)))
    step = int(np.argmax(path.cut(limits)))
    excess = np.maximum(path.wanted[:, step] - limits[1], limits[0] - path.wanted[:, step])
    k = int(np.argmax(excess))
    control, asked = errors.pair.model.controls.labels[k], path.wanted[k, step]
    left = path.outputs[output, -1]
    return (
        f"from this start the limits keep {errors.labels[output]} from coming down: the law asks control "
        f"'{control}' for {asked:.4g} at t = {path.times[step]:.4g} s, where its limits are {limits[0][k]:g} and "
        f"{limits[1][k]:g}, and the error is still {left:.4g} at t = {path.times[-1]:.4g} s; "
        "give wider limits, a nearer start or slower dynamics."
    )


def _outputs(errors: OutputErrors) -> ca.Function:
    pair = errors.pair
    return ca.Function(
        "e", [pair.t, pair.x, pair.x_ref], [ca.vertcat(*[chain[0] for chain in errors.chains])]
    )


def _step(
    controller: Controller,
    errors: OutputErrors,
    reference: Reference,
    limits: Authority | None,
    dt: float,
    first: Array,
) -> ca.Function:
    """Return ``(x and z, t, r, x_ref at the end) -> (x and z, wanted command, output errors at the end)``."""
    pair = errors.pair
    n, size = pair.x.numel(), controller.memory.size
    inner = _inner_steps(errors, reference, dt, first)
    f = ca.Function("f", [pair.t, pair.x, pair.u], [pair.f])
    state, t, r = ca.SX.sym("state", n + size), ca.SX.sym("t"), ca.SX.sym("r", controller.signals.size)
    x, h = state[:n], dt / inner
    wanted, z = controller.step(t, x, r, state[n:])
    u = saturated(wanted, limits)
    for j in range(inner):
        now = t + j * h
        k1 = f(now, x, u)
        k2 = f(now + h / 2, x + h / 2 * k1, u)
        k3 = f(now + h / 2, x + h / 2 * k2, u)
        k4 = f(now + h, x + h * k3, u)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    x_ref = ca.SX.sym("x_ref", n)
    outputs = _outputs(errors)(t + dt, x, x_ref)
    return ca.Function("act", [state, t, r, x_ref], [ca.vertcat(x, z), wanted, outputs])


def _inner_steps(errors: OutputErrors, reference: Reference, dt: float, first: Array) -> int:
    """Return the integration steps per control step that the fastest mode needs, on the reference or at the start."""
    pair, t = errors.pair, reference.initial_time
    a = ca.Function("a", [pair.t, pair.x, pair.u], [ca.jacobian(pair.f, pair.x)])
    fastest = 0.0
    for x in (reference.x(t), first):
        slopes = np.asarray(a(t, x, reference.u(t)).full())
        if np.all(np.isfinite(slopes)):
            fastest = max(fastest, float(np.max(np.abs(np.linalg.eigvals(slopes)))))
    return int(np.clip(np.ceil(fastest * dt / _FAST), 2, _MOST_INNER))
