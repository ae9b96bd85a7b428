r"""Beside: a second flight of a run, by the embedded solution of the integration, that shows how its errors have grown.

Both flights get the same parameters, random numbers and plans; the second carries on the fourth-order solution of every
integration step (`gnc_opt.simulation.integrate`), rounded the other way, through its own measurements, commands and
events. What they are apart at the end is the error of that solution, as the run itself has made it grow or forget,
whatever the nominal run does.

The fifth-order solution is better, by a factor that falls with the step: the nominal run tells it,
:math:`s_0` = its own estimated error over what its two flights are apart. Local errors :math:`e` that are larger mean
rates that are faster, :math:`e \sim (\lambda h)^5`, while the ratio of the orders goes with :math:`\lambda h`; so a run
is off by

.. math:: \min(1, s g)\, |x - \hat x|, \quad s = s_0 \max(1, e / e_0)^{1/5}, \quad
   g = \max\left(1, \frac{|x - \hat x| / e}{|x_0 - \hat x_0| / e_0}\right) ,

or by its local errors and the growth of the nominal run, if that is more. Where s exceeds 1 the steps are too long for
orders to tell one solution from the other, and the lesser of the two is added, in full from s = 2 on.

A relay or a quantum that turns the other way in the second flight sets both apart, however near they were: the truth
may have turned like it, and such a run is off by as much; the share is one of errors of steps alone. So flights that
are apart by more than the nominal one's and their local errors let expect count for more, by the factor g. What turns
in the truth and not in the second flight is not seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.simulation.places import Places


@dataclass(frozen=True)
class Companion:
    """What the nominal run tells of flights beside others.

    Attributes
    ----------
    share : float
        Its estimated error over what its flights are apart.
    local : float
        Sum of its local errors; without any, what flights are apart is added in full.
    side : int
        1 where the second flight makes the errors of steps, -1 for the opposite ones.
    apart : float
        What its flights are apart.
    """

    share: float = 1.0
    local: float = 0.0
    side: int = 1
    apart: float = np.inf

    @classmethod
    def of(cls, error: float, apart: float, local: float) -> Companion:
        """Return what a run with this error tells."""
        return cls(error / apart if 0 < error < apart < np.inf else 1.0, local, apart=apart)

    def error(self, apart: Array, known: Array, local: Array) -> Array:
        """Return the errors of runs (n,) by what their flights are apart, by the growth of the nominal run, and by
        their local errors."""
        faster = np.maximum(1.0, local / self.local) ** 0.2 if self.local > 0 else np.full_like(local, 2.0)
        share = self.share * faster
        with np.errstate(divide="ignore", invalid="ignore"):
            farther = np.fmax(1.0, apart * self.local / (self.apart * local))
        seen = apart * np.minimum(1.0, share * farther)
        return np.asarray(np.fmax(known, seen) + np.fmin(known, seen) * np.clip(share - 1.0, 0.0, 1.0))


def estimates(
    places: Places, final: Array, others: Array, growth: float, companion: Companion | None, end: float
) -> tuple[Array, Array]:
    """Return the estimated errors of runs whose kernels' states ended so.

    Parameters
    ----------
    places : Places
        Of the columns that follow.
    final : array (n_state, n)
        Ends of the runs.
    others : array (n_state, n)
        Ends of the flights beside them.
    growth : float
        By which local errors have grown until the end of the nominal run.
    companion : Companion or None
        What it tells of flights beside; None: only its growth.
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
    if companion is None:
        return errors, instants
    grown = companion.error(apart(places, final, others, end), errors - blur, local) + blur
    ended = stop > 0
    return (
        np.where(ended, errors, np.maximum(errors, grown)),
        np.where(ended, np.maximum(instants, grown - errors), instants),
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
