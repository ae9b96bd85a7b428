r"""Overpowered: the alarm of a sliding mode whose gain a disturbance exceeds, from what s does.

**Relays.** Where the law works with its full gain, a weaker disturbance cannot drive s away: not from where sliding has
begun, whose edge it may cross by one control step, and before that s comes nearer at every step. Where another law goes
on beneath, what it commands and actuators give late may throw s out of its layer; s comes nearer again then, too.

**Super-twisting** has its gain against the *rate* of the disturbance d, and overshoots by itself. On one side of s = 0
let :math:`\varphi = z + d` be what drives \|s\| away against :math:`k_1 |s|^{1/2}`; then

.. math:: \dot\varphi = \dot d - k_2, \qquad
   \Phi(t) = \int \varphi \, dt = |s(t)| - |s(0)| + \int k_1 |s|^{1/2} \, dt .

:math:`\Phi` is concave as long as d grows more slowly than k_2, whatever the overshoot: in the second half of a window
it gains less than in the first. Windows begin with 2 `PATIENCE` control steps on one side and double. If the second
half of one gains more by what sampling cannot explain, `SAMPLED` steps' worth of k_2, and that of the next does, too,
it is an alarm. A disturbance that jumps bends one window only, and noise stays while windows grow.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca

from gnc_opt.control.guard import Memory

OVERPOWERED = "overpowered"
"""The alarm."""

PATIENCE = 10
"""Control steps in a row outside the boundary layer after which that is no noise."""

SAMPLED = 5.0
"""Control steps for which a command that is held may let d seem to grow as fast as k_2."""

_BENT = 2
"""Windows in a row that an alarm takes."""


def gain_exceeded(s: Any, first: Any, edge: float, *, stays: bool) -> list[Memory]:
    """Return the memory of the alarm for a relay that works with its full gain where \\|s\\| is beyond ``edge``.

    Without an edge there is none: a law whose gain grows with s is exceeded by nothing. ``first`` is s at the start.
    Unless s ``stays`` inside once sliding has begun, it is an alarm only if s grows.
    """
    if edge <= 0:
        return []
    n = s.shape[0]
    away, flag = ca.SX.sym("away", n), ca.SX.sym(OVERPOWERED)
    distance = ca.SX.sym("distance", n)
    begun, outside, size = away > -0.5, ca.fabs(s) > edge, ca.fabs(s)
    # steps in a row outside; before sliding begins those on which s has grown, from -1 downward
    growing = ca.if_else(size > distance, away - 1, -1)
    after = ca.if_else(outside, ca.if_else(begun, away + 1, growing), 0 if stays else -1)
    raised = ca.fmax(flag, ca.mmax(ca.fmax(after, -1 - after)) > PATIENCE - 0.5)
    return [
        Memory("away", away, -ca.SX.ones(n), after),
        Memory("distance", distance, ca.fabs(first), size),
        Memory(OVERPOWERED, flag, ca.SX(0), raised, alarm=True),
    ]


def twist_outrun(
    s: Any, first: Any, rate: Callable[[Any], Any], gain: float, edge: float, dt: float
) -> list[Memory]:
    """Return the memory of the alarm for super-twisting.

    Parameters
    ----------
    s, first : casadi SX (n, 1)
        Now and at the start.
    rate : callable
        Of \\|s\\|: by how much the law lets it fall without its memory, unit of s per second.
    gain : float
        k_2, unit of s per second squared.
    edge : float
        Beyond which the law's memory moves at its full rate.
    dt : float
        Control step, s.
    """
    n, flag = s.shape[0], ca.SX.sym(OVERPOWERED)
    before, away, mark, driven, half, bent = (
        ca.SX.sym(name, n) for name in ("before", "away", "mark", "driven", "driven_half", "bent")
    )
    beside = ca.logic_and(ca.fabs(s) > edge, s * before > 0)
    steps = ca.if_else(beside, away + 1, 0)
    whole = ca.if_else(beside, driven + ca.fabs(s) - ca.fabs(before) + dt * rate(ca.fabs(before)), 0)
    over, at_half = steps > 2 * mark - 0.5, ca.fabs(steps - mark) < 0.5
    count = ca.if_else(whole - 2 * half > SAMPLED * gain * mark * dt**2, bent + 1, 0)
    after = ca.if_else(over, count, ca.if_else(beside, bent, 0))
    raised = ca.fmax(flag, ca.mmax(after) > _BENT - 0.5)
    first, nothing = PATIENCE * ca.SX.ones(n), ca.SX.zeros(n)
    return [
        Memory("before", before, first, s),
        Memory("away", away, nothing, ca.if_else(over, 0, steps)),
        Memory("mark", mark, first, ca.if_else(over, 2 * mark, ca.if_else(beside, mark, first))),
        Memory("driven", driven, nothing, ca.if_else(over, 0, whole)),
        Memory("driven_half", half, nothing, ca.if_else(at_half, whole, half)),
        Memory("bent", bent, nothing, after),
        Memory(OVERPOWERED, flag, ca.SX(0), raised, alarm=True),
    ]
