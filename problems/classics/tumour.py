r"""Tumour anti-angiogenesis: a limited dose of a drug that starves a tumour of its vessels.

This example shows two ways to state a limit on an integral: a boundary constraint of ``integral(u)``, and the bound
of a state that can only increase, which is enforced at the end. Each has one multiplier. The optimum gives the whole
dose at the start and ends when the tumour is smallest; the final time is free.

States: ``p``, ``q`` (mm^3), volume of the tumour and what its vessels carry. Control: ``u``, 0 to 75 (per day); its
integral is at most 15. Time in days.

.. math::
   \dot p = -\xi p \ln\frac{p}{q}, \qquad \dot q = q\,(b - \mu - d\,p^{2/3} - G u)

Source: Ledzewicz and Schaettler, Analysis of optimal controls for a mathematical model of tumour anti-angiogenesis,
Optimal Control Applications and Methods 29, 2008; Betts, 2010, example 4.11 (7571.6712).
"""

from __future__ import annotations

import casadi as ca

import gnc_opt as go
from problems._example import Reference, example_main

XI, B, D, G, MU = 0.084, 5.85, 0.00873, 0.15, 0.02
"""Per day; D per day and mm^2, G per dose."""
LARGEST = ((B - MU) / D) ** 1.5
"""Volume at which the tumour stops growing, mm^3."""
RATE, DOSE = 75.0, 15.0


def build(as_state: bool = False) -> go.Problem:
    """Return the problem.

    Parameters
    ----------
    as_state : bool
        Whether the dose is a bounded state instead of a bounded integral.
    """
    tumour = go.Model("tumour and its vessels")
    p = tumour.state("p", unit="mm^3")
    q = tumour.state("q", unit="mm^3")
    u = tumour.control("u")
    rates = {p: -XI * p * ca.log(p / q), q: q * (B - MU - D * p ** (2 / 3) - G * u)}
    if as_state:
        rates[tumour.state("dose")] = u
    tumour.ode(rates)

    problem = go.Problem("tumour anti-angiogenesis", time_unit="days")
    therapy = problem.phase("therapy", tumour)
    therapy.time(initial=0.0, final=(0.1, 5.0))
    therapy.initial(p=LARGEST / 2, q=LARGEST / 4)
    therapy.bounds(p=(0.01, LARGEST), q=(0.01, LARGEST), u=(0.0, RATE))
    if as_state:
        therapy.initial(dose=0.0)
        therapy.bounds(dose=(0.0, DOSE))
    else:
        problem.constrain("dose", therapy.integral(u), upper=DOSE)
    problem.minimize(therapy.final_state("p"))
    return problem


REFERENCE = Reference(7571.670038, "integrated: all at once, then none until p is least", 1e-5, "mm^3")
VARIANTS = {"dose as a state": ({"as_state": True}, REFERENCE)}
"""Other data, with their references."""


main = example_main(build, REFERENCE)

if __name__ == "__main__":
    raise SystemExit(main())
