"""What refuses a sliding mode: steps too long, zero dynamics that grow, gains beyond the authority."""

from __future__ import annotations

from typing import Any

import numpy as np

from gnc_opt.arguments import read_positive
from gnc_opt.control.explanation import Fact
from gnc_opt.control.lie import OutputErrors, sample_times, zero_dynamics
from gnc_opt.control.reference import Reference
from gnc_opt.control.sliding.reaching import Boundary, Law, SaturationLayer, Sign, SuperTwisting, TanhLayer
from gnc_opt.errors import DesignError
from gnc_opt.model.layout import Array


def check_step(reaching: Law, boundary: Boundary, dt: float | None, *, needed: bool) -> float | None:
    """Return dt; raise `DesignError` where it is missing or too long for the slope of the boundary layer.

    Inside the layer the sampled surface obeys s+ = (1 - dt * slope) s: it grows from step to step for
    dt * slope > 2, and chatters at 2.
    """
    if not isinstance(boundary, (Sign, SaturationLayer, TanhLayer)):
        raise DesignError(
            f"the boundary is {boundary!r}: give Sign(), SaturationLayer(phi) or TanhLayer(phi)."
        )
    if dt is None:
        if needed or isinstance(reaching, SuperTwisting):
            raise DesignError("a law with memory is designed for one length of control steps: give dt, in s.")
        return None
    dt = read_positive(dt, "the control step dt", DesignError)
    slope = reaching.slope(boundary)
    if np.isfinite(slope) and slope * dt >= 2:
        raise DesignError(
            f"control steps of {dt:g} s are too long for the switching gain: gain * dt / phi = {slope * dt:.4g} "
            f"is not below 2; give dt < {2 / slope:.4g} s, a wider boundary layer or a smaller gain."
        )
    return dt


def check_zero_dynamics(errors: OutputErrors, reference: Reference, growth: float) -> list[Fact]:
    """Return the facts of the zero dynamics at the end of the reference; raise `DesignError` if they grow."""
    t = reference.final_time
    zeros = zero_dynamics(errors, t, reference.x(t), reference.u(t))
    if zeros.growth > growth:
        worst = zeros.eigenvalues[int(np.argmax(zeros.eigenvalues.real))]
        raise DesignError(
            f"the zero dynamics of outputs {', '.join(errors.labels)} are unstable: eigenvalue {worst:.6g} 1/s "
            f"of {zeros.dimension} at the end of the reference; steer other outputs or another mix of them."
        )
    facts = [Fact("dimension of the zero dynamics", zeros.dimension)]
    if zeros.dimension:
        remark = "frozen at the end of the reference"
        facts.append(Fact("eigenvalues of the zero dynamics", zeros.eigenvalues, "1/s", remark))
    return facts


def reserve_facts(
    errors: OutputErrors,
    reference: Reference,
    limits: tuple[Array, Array] | None,
    reaching: Law,
    s: Any,
    dt: float | None,
) -> list[Fact]:
    """Return the authority that is left on the reference beyond the switching gain.

    Raises
    ------
    DesignError
        The feedforward and the gain together ask for more than the limits.
    """
    if limits is None or not np.isfinite(reaching.gain):
        return []
    pair, times = errors.pair, sample_times(reference)
    matrices = pair.along(reference, times, errors.decoupling)
    gain = reaching.gain if not isinstance(reaching, SuperTwisting) else 0.0
    need = np.stack([np.sum(np.abs(np.linalg.pinv(m)), axis=1) * gain for m in matrices], axis=1)
    if dt is not None:
        feedforward = reference.mean_control(times, dt) if reference.duration else reference.u(times)
    else:
        feedforward = reference.u(times)
    left = np.minimum(limits[1][:, None] - feedforward, feedforward - limits[0][:, None]) - need
    row, column = np.unravel_index(int(np.argmin(left)), left.shape)
    label = pair.model.controls.labels[row]
    if left[row, column] < 0:
        raise DesignError(
            f"the switching gain is beyond the authority: control '{label}' needs {need[row, column]:.6g} besides its "
            f"feedforward {feedforward[row, column]:.6g} at t = {times[column]:.6g} s, but its limits are "
            f"{limits[0][row]:.6g} and {limits[1][row]:.6g}; lower the gain, or plan with more reserve."
        )
    remark = f"control '{label}' at t = {times[column]:.6g} s, least of all, beside feedforward and gain"
    return [Fact("saturation reserve", float(left[row, column]), pair.model.controls.units[row], remark)]
