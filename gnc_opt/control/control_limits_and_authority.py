"""Limits of controls and states, and the control authority margin along a reference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.array_types import Array
from gnc_opt.control.design_report import ReportEntry
from gnc_opt.control.feedforward_and_reference_schedule import choose_reference_sample_times
from gnc_opt.control.reference_trajectory import Reference
from gnc_opt.errors import ArgumentError, DesignError, warn_user
from gnc_opt.model.model_variables import read_vector
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.numerical_tolerances import AT_LIMIT

Limits: TypeAlias = tuple[ArrayLike, ArrayLike]
"""Lower and upper limits of the controls, (n_controls,) each or one number for all."""

Authority: TypeAlias = tuple[Array, Array]
"""Lower and upper limits of the controls as arrays, (n_controls,) each."""


def read_control_limits(model: Model, limits: Limits | None) -> Authority | None:
    """Return lower and upper limits (n_controls,), or ``None``."""
    if limits is None:
        return None
    if not isinstance(limits, tuple) or len(limits) != 2:
        raise ArgumentError(f"limits is {limits!r}: give (lower, upper), each a number or one per control.")
    lower, upper = (
        read_vector(v, model.controls.size, f"the {w} limits", ArgumentError)
        for v, w in zip(limits, ("lower", "upper"), strict=True)
    )
    bad = np.flatnonzero(~(lower < upper))
    if bad.size:
        raise DesignError(
            f"control '{model.controls.labels[bad[0]]}' has no authority: its limits are {lower[bad[0]]:g} and "
            f"{upper[bad[0]]:g}; give lower < upper."
        )
    return lower, upper


def clip_to_limits(value: Any, lower: Any, upper: Any) -> Any:
    """Return the value between its limits, SX or MX."""
    return ca.fmax(lower, ca.fmin(upper, value))


def saturate_command(u: Any, limits: Authority | None) -> Any:
    """Return a command saturated at the limits, SX; unchanged without limits."""
    return u if limits is None else clip_to_limits(u, *limits)


def report_control_authority(
    reference: Reference,
    limits: Authority | None,
    *,
    gain: Callable[[Array], Array] | None = None,
    dt: float | None = None,
    required: bool = False,
) -> list[ReportEntry]:
    """Return the smallest control authority margin along the reference, as a share of half the control range.

    Parameters
    ----------
    gain : callable, optional
        Switching gain (n_controls, n_times) at times (s), added to the feedforward.
    dt : float, optional
        Length of the steps (s) over which the feedforward is constant; default: continuous feedforward.
    required : bool
        Whether a negative margin raises `DesignError`.
    """
    if limits is None:
        return []
    times = choose_reference_sample_times(reference)
    u = reference.u(times)
    if dt is not None and reference.duration > 0:
        u = reference.mean_control(times, dt)
    extra = np.zeros_like(u) if gain is None else gain(times)
    times, u = (
        np.append(times, reference.final_time),
        np.column_stack([u, reference.control_after_final_time]),
    )
    extra = np.column_stack([extra, extra[:, -1]])
    lower, upper = (limit[:, None] for limit in limits)
    margin = np.minimum(upper - u, u - lower) - extra
    row, column = np.unravel_index(int(np.argmin(margin)), margin.shape)
    label, where = reference.controls.labels[row], f"at t = {times[column]:.6g} s"
    if required and margin[row, column] < 0:
        besides = "" if gain is None else f"{extra[row, column]:.6g} besides its feedforward "
        raise DesignError(
            f"{'the reference' if gain is None else 'the switching gain'} is beyond the authority: control '{label}' "
            f"needs {besides}{u[row, column]:.6g} {where}, but its limits are {limits[0][row]:.6g} and "
            f"{limits[1][row]:.6g}; {'' if gain is None else 'lower the gain, or '}plan with a larger margin."
        )
    shares = 2 * margin.min(axis=1) / (limits[1] - limits[0])
    subtracted = "feedforward" if gain is None else "feedforward and gain"
    remark = f"remaining share of half the range after {subtracted}; smallest for '{label}' {where}"
    return [ReportEntry("control authority margin", shares, "", remark)]


def report_reference_limit_violation(
    reference: Reference, rows: Sequence[int], lower: Array, upper: Array
) -> list[ReportEntry]:
    """Return the largest violation of state limits (n_limited,) by the reference at rows ``rows``, and warn."""
    times, facts = choose_reference_sample_times(reference), []
    for row, low, high in zip(rows, lower, upper, strict=True):
        x, label = reference.x(times)[row], reference.states.labels[row]
        over = np.maximum(low - x, x - high)
        k = int(np.argmax(over))
        if over[k] > AT_LIMIT * np.max(np.abs([*x, *(v for v in (low, high) if np.isfinite(v))])):
            name, unit = f"reference beyond the limits of {label}", reference.states.units[row]
            facts.append(
                ReportEntry(name, float(over[k]), unit, f"at t = {times[k]:.6g} s; not tracked there")
            )
    if facts:
        warn_user("; ".join(map(str, facts)))
    return facts
