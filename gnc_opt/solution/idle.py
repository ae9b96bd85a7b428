"""Controls that do nothing: the steering angle of an engine that is off."""

from __future__ import annotations

import numpy as np

from gnc_opt.arrays import Array, Mask
from gnc_opt.problem.functions import PhaseFunctions
from gnc_opt.problem.interval import Interval
from gnc_opt.tolerances import AT_LIMIT

SHARES = 0.37, -0.61
"""Steps of a control, in shares of its scale: one that changes nothing at either is idle, and no angle has both as
turns."""


def without_effect(
    functions: PhaseFunctions, bounds: Interval, t: Array, x: Array, u: Array, scale: Array
) -> Mask:
    """Return where a control changes neither rates nor paths nor integrands while others are on their bounds.

    Whatever those do that are between theirs; relative to what it changes elsewhere along the phase.

    Parameters
    ----------
    functions : PhaseFunctions
    bounds : Interval
        Of the controls (m,).
    t, x, u : array (N,), (n, N), (m, N)
    scale : array (m,)
        Of the controls.

    Returns
    -------
    bool array (m, N)
    """
    idle = np.zeros(u.shape, dtype=bool)
    coupled = np.flatnonzero(~functions.separable_controls)
    lower, upper = bounds.near(u, AT_LIMIT * scale)
    bound = lower | upper
    if coupled.size < 2 or not np.any(bound[coupled]):
        return idle
    bases = u, np.where(bound, u, u + SHARES[0] * scale[:, None])
    effects = [functions.effects(t, x, base) for base in bases]
    for i in coupled:
        changes = [
            np.abs(functions.effects(t, x, _moved(base, int(i), share * scale[i])) - before)
            for base, before in zip(bases, effects, strict=True)
            for share in SHARES
        ]
        largest = np.nanmax(changes, axis=(0, 2), initial=0.0)
        idle[i] = np.all(np.asarray(changes) <= AT_LIMIT * largest[:, None], axis=(0, 1)) & ~bound[i]
    return idle


def _moved(u: Array, i: int, by: float) -> Array:
    other = u.copy()
    other[i] += by
    return other
