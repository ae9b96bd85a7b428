r"""Penicillin fermentor: the feed of a batch reactor for the most product.

The final time is free. This example shows a stiff problem with a singular arc: the substrate is consumed within
minutes and stays at a small value for days, where the rates change on a scale of 1e-4. The reference is known to
2e-4.

States: biomass ``X``, product ``P``, substrate ``S`` (g/l), volume ``V`` (l). Control: feed ``u`` (g/h).

.. math::
   \dot X = \mu X - \frac{u X}{500 V}, \quad \dot P = \rho X - 0.01 P - \frac{u P}{500 V}, \quad
   \dot V = \frac{u}{500}

.. math::
   \dot S = -\Big( \frac{\mu}{0.47} + \frac{\rho}{1.2} + \frac{0.029 S}{0.0001 + S} \Big) X
   + \frac{u}{V} \Big( 1 - \frac{S}{500} \Big)

.. math::
   \mu = \frac{0.11 S}{0.006 X + S}, \qquad \rho = \frac{0.0055 S}{0.0001 + S (1 + 10 S)}, \qquad
   \max P(t_f) V(t_f)

Source: J. E. Cuthrell and L. T. Biegler, Simultaneous optimization and solution methods for batch reactor control
profiles, Computers and Chemical Engineering 13 (1989) 49-62, who give 87.69; the example ``BatchFermentor`` of ICLOCS2.
"""

from __future__ import annotations

import gnc_opt as go
from problems._example import Reference, example_main

FEED = 500.0
"""Substrate in the feed, g/l."""


def build() -> go.Problem:
    """Return the problem."""
    reactor = go.Model("fermentor")
    X, P, S = (reactor.state(name, unit="g/l") for name in "XPS")
    V = reactor.state("V", unit="l")
    u = reactor.control("u", unit="g/h")
    growth = 0.11 * S / (0.006 * X + S)
    production = 0.0055 * S / (0.0001 + S * (1 + 10 * S))
    maintenance = 0.029 * S / (0.0001 + S)
    dilution = u / (FEED * V)
    reactor.ode(
        {
            X: growth * X - dilution * X,
            P: production * X - 0.01 * P - dilution * P,
            S: -(growth / 0.47 + production / 1.2 + maintenance) * X + u / V * (1 - S / FEED),
            V: u / FEED,
        }
    )

    problem = go.Problem("penicillin fermentor", time_unit="h")
    batch = problem.phase("batch", reactor)
    batch.time(initial=0.0, final=(72.0, 200.0))
    batch.initial(X=1.5, P=0.0, S=0.0, V=7.0)
    batch.bounds(X=(0.0, 40.0), P=(0.0, 50.0), S=(0.0, 100.0), V=(0.0, 10.0), u=(0.0, 50.0))
    batch.guess([0.0, 130.0], X=(1.5, 30.0), P=(0.0, 8.5), S=(0.5, 0.1), V=(7.0, 10.0), u=10.0)
    problem.maximize(batch.final_state("P") * batch.final_state("V"), unit="g")
    return problem


REFERENCE = Reference(88.0, "independent Radau collocation, meshes differ by 0.2", 0.2, "g")


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
