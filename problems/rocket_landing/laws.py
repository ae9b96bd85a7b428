r"""The regulator about a plan, and a published law that needs none.

**Regulator.** :math:`T = T_{ref} + m \, (k_1 (r_{ref} - r) + k_2 (v_{ref} - v))`: the errors of a point mass decay with
two poles.

**ZEM/ZEV.** With :math:`t_{go}` left, the miss and the error of velocity that a flight without thrust would end
with,

.. math:: a = \frac{6}{t_{go}^2} \mathrm{ZEM} - \frac{2}{t_{go}} \mathrm{ZEV},

is the acceleration of least :math:`\int a^2 dt` where nothing limits it (Guo, Hawkins and Wie, Applications of
generalized zero-effort-miss/zero-effort-velocity feedback guidance algorithm, J. Guidance, Control, and Dynamics 36
(3), 2013): the criterion of the plan. It is given the plan's time; from `HELD` before that on, its gains stay.

Both cut the size of the thrust to what the engines can.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from gnc_opt.control import Controller, Explanation, Fact, Reference, bridge_dropouts, first_memory, law
from gnc_opt.control.feedforward import ReferenceSchedule, reference_signals
from gnc_opt.model.variables import Layout
from problems.landing.mars_landing import FULL, GRAVITY
from problems.rocket_landing.model import ENGINES, SETTLING, UP, norm

DT = 0.1
"""Control step, s."""
POLES = 0.8, 0.8
"""Of the regulator, 1/s."""
HELD = 2.0
"""s."""


def regulator(reference: Reference) -> Controller:
    """Return the regulator about a plan."""
    k_1, k_2 = POLES[0] * POLES[1], sum(POLES)

    def thrust(t: ca.SX, r: ca.SX, v: ca.SX, m: ca.SX, row: ca.SX) -> ca.SX:
        return row[7:] + m * (k_1 * (row[:3] - r) + k_2 * (row[3:6] - v))

    facts = (Fact("gain of position", k_1, "1/s^2"), Fact("gain of velocity", k_2, "1/s"))
    return _controller("regulator", reference, facts, thrust)


def zem_zev(reference: Reference, final_time: float) -> Controller:
    """Return the published law that is at the ground at a time (s); the reference is to compare with."""
    gravity, target = -GRAVITY * UP, -SETTLING * UP

    def thrust(t: ca.SX, r: ca.SX, v: ca.SX, m: ca.SX, row: ca.SX) -> ca.SX:
        left = ca.fmax(final_time - t, HELD)
        goal = target * (t + left - final_time)  # the ground, and where the settling lander will be after it
        zem = goal - (r + left * v + 0.5 * left**2 * gravity)
        zev = target - (v + left * gravity)
        return m * (6 / left**2 * zem - 2 / left * zev)

    return _controller("ZEM/ZEV", reference, (Fact("end", final_time, "s"),), thrust)


def _controller(
    name: str, reference: Reference, facts: tuple[Fact, ...], thrust: Callable[..., ca.SX]
) -> Controller:
    model, signals = reference.model, reference_signals(reference)
    t, x, row, z = ca.SX.sym("t"), ca.SX.sym("x", 7), ca.SX.sym("row", signals.size), ca.SX.sym("z", 0)
    wanted = thrust(t, x[:3], x[3:6], x[6], row)
    least, most = (share * FULL for share in ENGINES)
    u = wanted * ca.fmin(ca.fmax(norm(wanted), least), most) / norm(wanted)
    return bridge_dropouts(
        Controller(
            name=name,
            step=law(t, x, row, z, u, z),
            start=first_memory(t, x, row, z),
            states=model.states,
            commands=model.controls,
            signals=signals,
            memory=Layout("memory"),
            schedule=ReferenceSchedule(reference),
            dt=DT,
            explanation=Explanation(f"{name} of '{model.name}'", facts),
        )
    )
