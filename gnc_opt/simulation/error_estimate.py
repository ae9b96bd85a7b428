r"""Beside: a second flight of a run, with integration steps half as long, that shows what its errors are.

Both flights get the same parameters, random numbers and plans; the second halves every integration step, rounds each
the other way, and goes through its own measurements, commands and events. What they are apart at the end is what the
run is off by, as it has made its errors grow or forgotten them, but for the errors of the second flight: those are a
share :math:`2^{-p}` of it, p the order that the steps reach (5 along smooth rates and held inputs, 2 at kinks of a
rate),

.. math:: |x - x^*| \le \frac{|x - \hat x|}{1 - 2^{-p}} .

A relay or a quantum that turns the other way in one of them sets both apart, however near they were. The second flight
is nearer to the truth, so that it mostly turns as the truth does; one that turns in the truth alone is not seen.

What a run has forgotten by its end its local errors tell, where they are more: the number is one for the whole run.

Source of the estimate: Richardson, "The deferred approach to the limit", Phil. Trans. R. Soc. A 226, 1927.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.simulation.signals import Places

_WHOLE = 4 / 3
"""The error over what halving the steps changes, at order 2 and more."""


def estimates(places: Places, final: Array, others: Array, growth: float, end: float) -> tuple[Array, Array]:
    """Return the estimated errors of runs whose kernels' states ended so.

    Parameters
    ----------
    places : Places
        Of the columns that follow.
    final : array (n_state, n)
        Ends of the runs.
    others : array (n_state, n)
        Ends of the flights beside them; ``final`` itself without any: then the growth of the nominal run tells.
    growth : float
        By which local errors have grown until the end of the nominal run.
    end : float
        Of the flight, s: when runs end that no event does.

    Returns
    -------
    errors : array (n,)
        Those of single steps and what resets at wrong instants add to them, grown, and what averaging adds.
    instants : array (n,)
        What the instants of events, and the ends there, are off by beyond that.
    """
    parts, none = places.split(final), np.zeros(final.shape[1])
    local, blur = parts["error"][0], parts["blur"][0]
    resets, late, stop = (parts[k][0] if k in parts else none for k in ("resets", "instants", "stop"))
    errors, instants = growth * (local + resets) + blur, growth * late
    if others is final:
        return errors, instants
    seen, ended = _WHOLE * apart(places, final, others, end) + blur, stop > 0
    return (
        np.where(ended, errors, np.maximum(errors, seen)),
        np.where(ended, np.maximum(instants, seen - errors), instants),
    )


def apart(places: Places, final: Array, other: Array, end: float) -> Array:
    """Return what two flights are apart at their ends (n,), relative to max(1, \\|x\\|), from their kernels' states.

    Where events end runs, also their instants count; others end at ``end`` (s), where an event may be that only one
    of the flights has met.
    """
    one, two = (_ends(places.split(columns), end) for columns in (final, other))
    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.max(np.abs(one - two) / np.maximum(1.0, np.abs(one)), axis=0)
    # a second flight that has left the finite numbers is as far as can be
    return np.asarray(np.where(np.isnan(distance) & np.isfinite(one).all(axis=0), np.inf, distance))


def _ends(parts: dict[str, Any], end: float) -> Array:
    instants = [np.where(parts["stop"] > 0, parts["stop time"], end)] if "stop" in parts else []
    return np.vstack([parts["plant"], *instants])
