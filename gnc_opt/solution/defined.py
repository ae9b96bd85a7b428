"""What a phase's functions are along controls that leave their bounds between nodes.

A polynomial through controls on their bounds swings past them, a lift below zero, say, of which the dynamics take the
root. What has no value there has one on the bound. (How far the control is beyond it is an error of its own.)
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.problem.interval import Interval


def defined(
    function: Callable[[Array, Array, Array], Array], times: Array, x: Array, u: Array, bounds: Interval
) -> Array:
    """Return a function's values (n, n_times), of controls within their bounds where others have none."""
    values = function(times, x, u)
    lost = np.any(np.isnan(values), axis=0)
    if np.any(lost):
        inside = np.clip(u[:, lost], bounds.lower[:, None], bounds.upper[:, None])
        values = values.copy()
        values[:, lost] = function(times[lost], x[:, lost], inside)
    return values
