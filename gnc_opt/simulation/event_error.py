r"""Instant: what an error of the integrated way does to the instant of an event, and to the states after it.

A way that is off by :math:`\varepsilon` meets the row y of an event later by :math:`\delta`, where

.. math:: |\dot y\, \delta + \tfrac12 \ddot y\, \delta^2| = |\nabla y^T \varepsilon| ,

and with the reset g, the rates before and after it :math:`f^-, f^+`, the states after it are off by

.. math:: \left( \nabla g + (f^+ - \nabla g\, f^-) \frac{\nabla y^T}{\dot y} \right) \varepsilon .

Where the event ends the run nothing follows, :math:`f^+ = 0` and g is the identity: the states are those at its own
instant. Of a row that was met before, only what the way has been off by since then counts: what it was off by before is
a shift in time of all that follows. Sizes of errors are relative to max(1, \|x\|), that of an instant t to
max(1, \|t\|).

Source: M. di Bernardo, C. Budd, A. Champneys, P. Kowalczyk, Piecewise-smooth Dynamical Systems (2008), section 2.5: the
saltation matrix. Of second order in :math:`\delta` here, for rows that are met all but at rest.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from gnc_opt.simulation.events import Events

_LEAST = 1e-300
"""Added to what is divided by."""


def instant_error(events: Events, n_states: int) -> Any:
    """Return what events add to the error of the integration.

    Parameters
    ----------
    events : Events
    n_states : int

    Returns
    -------
    casadi.Function
        ``(errors, t, x, x_after, fired, rates, bend, reset, ended, p) -> (states, instants)``: relative error of the
        states since each row was met, states before and after the events, the rows that have fired, rates of the states
        before and after in columns (n_states, 2), second derivatives of the rows, slope of the reset (n_states,
        n_states), whether the run has ended, the plant's parameters. By how much the error of the states grows where
        the run goes on; and by how much that of the instant, or of the states where the run ends, is larger still.
    """
    t, ended = ca.SX.sym("t"), ca.SX.sym("ended")
    x, x_after = (ca.SX.sym(name, n_states) for name in ("x", "x_after"))
    errors, fired, bend = (ca.SX.sym(name, len(events.owners)) for name in ("errors", "fired", "bend"))
    rates, reset = ca.SX.sym("rates", n_states, 2), ca.SX.sym("reset", n_states, n_states)
    p = ca.SX.sym("p", events.effects.size1_in(2))
    before, after = ca.horzsplit(rates)
    y, slope = events.rows(t, x, before, p)
    gradient = ca.densify(ca.jacobian(y, x))
    size, size_after = (ca.fmax(1.0, ca.fabs(v)) for v in (x, x_after))
    # of the row whose instant is least certain
    late, error, steepness = ca.SX(0), ca.SX(0), ca.SX.zeros(1, n_states)
    for j in range(len(events.owners)):
        off = errors[j] * (ca.fabs(gradient[j, :]) @ size)
        speed = 0.5 * (ca.fabs(slope[j]) + ca.sqrt(slope[j] ** 2 + 2 * ca.fabs(bend[j]) * off)) + _LEAST
        later = ca.logic_and(fired[j], off / speed >= late)
        late = ca.if_else(later, off / speed, late)
        error = ca.if_else(later, errors[j], error)
        steepness = ca.if_else(later, -gradient[j, :] / speed, steepness)  # a row falls through zero
    leap = ca.if_else(ended, -before, after - reset @ before)
    slopes = ca.if_else(ended, ca.SX.eye(n_states), reset) + leap @ steepness
    states = ca.mmax(error * (ca.fabs(slopes) @ size) / size_after)
    more = ca.fmax(ca.fmax(states, late / ca.fmax(1.0, ca.fabs(t))) - error, 0)
    flown = ca.if_else(ended, 0, ca.fmax(states - error, 0))
    inputs = [errors, t, x, x_after, fired, rates, bend, reset, ended, p]
    return ca.Function("instant", inputs, [flown, more - flown])
