"""The vector control that a guess of states asks for: of a lander, thrust that carries its weight."""

from __future__ import annotations

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.model.composed import VectorControl
from gnc_opt.problem.phase import Phase


def balanced(
    leg: Phase, vector: VectorControl, time: float, x: Array, u: Array, rate: Array
) -> tuple[float, Array] | None:
    r"""Return magnitude and direction of the vector by which a state best follows a rate; None if none can be told.

    The least squares of :math:`f(x, 0) + B T - \dot x` over the rates that the vector moves, each in units of what it
    does to them, so that units of states do not matter.

    Parameters
    ----------
    leg : Phase
    vector : VectorControl
    time : float
    x, rate : array (n_states,)
    u : array (n_controls,)
        The other controls.
    """
    layout, size = leg.model.controls, vector.variable.size

    def rates(magnitude: float, direction: Array) -> Array:
        controls = u.copy()
        controls[layout.slice(vector.magnitude)], controls[layout.slice(vector.direction)] = (
            magnitude,
            direction,
        )
        return np.asarray(leg.model.f(time, x, controls))

    axes = np.eye(size)
    with np.errstate(all="ignore"):
        does = np.stack([0.5 * (rates(1.0, axis) - rates(1.0, -axis)) for axis in axes], axis=1)
        lacks = rate - rates(0.0, axes[0])
    moved = np.linalg.norm(does, axis=1)
    if not (np.all(np.isfinite(does)) and np.all(np.isfinite(lacks)) and np.any(moved > 0)):
        return None
    rows = moved > 0
    wanted = np.linalg.lstsq(does[rows] / moved[rows, None], lacks[rows] / moved[rows], rcond=None)[0]
    length = float(np.linalg.norm(wanted))
    return (length, wanted / length) if length > 0 else None
