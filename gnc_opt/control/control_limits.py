"""Limits of controls and of states, and the control authority margin that a reference leaves to the feedback."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arrays import Array
from gnc_opt.control.design_report import ReportEntry
from gnc_opt.control.feedforward import reference_times
from gnc_opt.control.reference import Reference
from gnc_opt.errors import ArgumentError, DesignError, warn_user
from gnc_opt.model.model import Model
from gnc_opt.model.variables import as_vector
from gnc_opt.tolerances import AT_LIMIT

Limits: TypeAlias = tuple[ArrayLike, ArrayLike]
"""Lower and upper limits of the controls, (n_controls,) each or one number for all."""

Authority: TypeAlias = tuple[Array, Array]
"""The same, read: lower and upper limits, (n_controls,) each."""


def read_limits(model: Model, limits: Limits | None) -> Authority | None:
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


def clip(value: Any, lower: Any, upper: Any) -> Any:
    """Return the value between its limits, SX or MX."""
    return ca.fmax(lower, ca.fmin(upper, value))


def saturated(u: Any, limits: Authority | None) -> Any:
    """Return a command saturated at these limits, SX."""
    return u if limits is None else clip(u, *limits)


def reserve_shares(reference: Reference, limits: Authority | None) -> list[ReportEntry]:
    """Return the fact about the share of the limits that the feedforward leaves, one number per control."""
    if limits is None:
        return []
    u = reference.u(reference_times(reference, 400))
    if reference.tail_control is not None:
        u = np.hstack([u, reference.tail_control[:, None]])
    half = 0.5 * (limits[1] - limits[0])
    remark = (
        "least distance of the feedforward to its limits, share of half their range; what feedback can use"
    )
    return [ReportEntry("control authority margin", _distance(u, limits).min(axis=1) / half, "", remark)]


def require_reserve(
    reference: Reference,
    limits: Authority | None,
    times: Array,
    *,
    gain: Array | None = None,
    dt: float | None = None,
) -> list[ReportEntry]:
    """Return the fact about the least authority that is left at ``times`` (s), in the unit of its control.

    Parameters
    ----------
    gain : array (n_controls, n_times), optional
        Switching gain of a law in addition to the feedforward; `DesignError` if both exceed the limits.
    dt : float, optional
        Length of the steps (s) over which the feedforward is held; without it, it follows the reference.
    """
    if limits is None:
        return []
    if dt is not None and reference.duration > 0:
        if reference.tail_control is None:  # nothing is known of a step that goes beyond the end
            times = np.minimum(times, max(reference.final_time - dt, reference.initial_time))
        u = reference.mean_control(times, dt)
    else:
        u = reference.u(times)
    left = _distance(u, limits) - (0.0 if gain is None else gain)
    row, column = np.unravel_index(int(np.argmin(left)), left.shape)
    label, unit = reference.controls.labels[row], reference.controls.units[row]
    where = f"at t = {times[column]:.6g} s"
    if left[row, column] < 0:
        what, asks = "the reference", "needs"
        if gain is not None:
            what, asks = "the switching gain", f"needs {gain[row, column]:.6g} besides its feedforward"
        raise DesignError(
            f"{what} is beyond the authority: control '{label}' {asks} {u[row, column]:.6g} {where}, but its limits "
            f"are {limits[0][row]:.6g} and {limits[1][row]:.6g}; "
            f"{'' if gain is None else 'lower the gain, or '}plan with more reserve."
        )
    beside = "beside the feedforward" if gain is None else "least of all, beside feedforward and gain"
    return [
        ReportEntry(
            "control authority margin", float(left[row, column]), unit, f"control '{label}' {where}, {beside}"
        )
    ]


def _distance(u: Array, limits: Authority) -> Array:
    """Return the distance of controls (n_controls, n) to the nearer of their limits; < 0 is beyond it."""
    return np.asarray(np.minimum(limits[1][:, None] - u, u - limits[0][:, None]))


def reference_beyond(
    reference: Reference, places: Sequence[int], lower: Array, upper: Array
) -> list[ReportEntry]:
    """Return and warn of how far the reference exceeds limits (n_limited,) of states at ``places``."""
    times, facts = reference_times(reference), []
    for place, low, high in zip(places, lower, upper, strict=True):
        x, label = reference.x(times)[place], reference.states.labels[place]
        over = np.maximum(low - x, x - high)
        k = int(np.argmax(over))
        if over[k] > AT_LIMIT * np.max(np.abs([*x, *(v for v in (low, high) if np.isfinite(v))])):
            name, unit = f"reference beyond the limits of {label}", reference.states.units[place]
            facts.append(
                ReportEntry(name, float(over[k]), unit, f"at t = {times[k]:.6g} s; it is not followed there")
            )
    if facts:
        warn_user("; ".join(map(str, facts)))
    return facts
