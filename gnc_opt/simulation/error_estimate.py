r"""The error of a run, from a companion run with integration steps half as long.

Both runs get the same parameters, random numbers and plans; the companion goes through its own measurements, commands
and events. Its error is a share :math:`2^{-p}` of that of the run, p the order that the steps reach (5 along smooth
rates and held inputs, 2 at kinks of a rate), so that the final states x and :math:`\hat x` of both show the error

.. math:: |x - x^*| \le \frac{|x - \hat x|}{1 - 2^{-p}} .

A relay or a quantum that turns the other way in one of them sets both apart, however near they were. Errors that the
run has forgotten at its end are not in the number.

Source of the estimate: Richardson, "The deferred approach to the limit", Phil. Trans. R. Soc. A 226, 1927.
"""

from __future__ import annotations

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.simulation.signals import Places

RICHARDSON_FACTOR = 4 / 3
"""The error over what halving the steps changes, at order 2 and more."""


def integration_errors(places: Places, final: Array, companions: Array, end: float) -> tuple[Array, Array]:
    """Return the estimated errors of runs, relative to max(1, \\|x\\|).

    Parameters
    ----------
    places : Places
        Of the columns that follow.
    final : array (n_state, n)
        Kernels' states at the ends of the runs.
    companions : array (n_state, n)
        The same of the companion runs.
    end : float
        Of the span, s: when runs end that no event does.

    Returns
    -------
    errors : array (n,)
        Of the final states, and of the instants of events that end runs; where only one of both is ended by an event,
        the other ends at ``end``.
    at_one_time : array (n,)
        Of the states alone, those of the companion taken to the instant of the run along their rates. Of it accuracy is
        asked: a soft touchdown is a touch, whose instant has half the digits of the states.
    """
    one, two = places.split(final), places.split(companions)
    x, other = one["plant"], two["plant"]
    if "stop" not in one:
        errors = RICHARDSON_FACTOR * _apart(x, other)
        return errors, errors
    t, late = (np.where(parts["stop"] > 0, parts["stop time"], end) for parts in (one, two))
    moved = np.where(one["stop"] > 0, two["stop rate"] * (late - t), 0.0)
    errors = RICHARDSON_FACTOR * _apart(np.vstack([x, t]), np.vstack([other, late]))
    return errors, np.fmin(errors, RICHARDSON_FACTOR * _apart(x, other - moved))


def _apart(one: Array, two: Array) -> Array:
    """Return how far columns are apart (n,); infinitely where only the second is not finite."""
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.max(np.abs(one - two) / np.maximum(1.0, np.abs(one)), axis=0)
    return np.asarray(np.where(np.isnan(apart) & np.isfinite(one).all(axis=0), np.inf, apart))
