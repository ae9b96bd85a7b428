r"""Dielectrophoretic particle: an electric field moves a neutral particle in minimum time.

This example shows a control that enters quadratically and linearly: between its bounds the optimum is smooth although
time is minimised.

States: ``x`` (position), ``y`` (induced dipole). Control: voltage ``u``.

.. math:: \dot x = y u - \tfrac34 u^2, \qquad \dot y = -y + u, \qquad -1 \le u \le 1

Source: D. E. Chang, N. Petit and P. Rouchon, Time-optimal control of a particle in a dielectrophoretic system, IEEE
Trans. Automatic Control 51 (2006) 1100-1114; the problem of the same name of OptimalControlProblems.jl.
"""

from __future__ import annotations

import gnc_opt as go
from problems._example import Reference, example_main


def build() -> go.Problem:
    """Return the problem."""
    particle = go.Model("particle")
    x, y, u = particle.state("x"), particle.state("y"), particle.control("u")
    particle.ode({x: y * u - 0.75 * u**2, y: u - y})

    problem = go.Problem("dielectrophoretic particle")
    move = problem.phase("move", particle)
    move.time(initial=0.0, final=(0.1, 50.0))
    move.initial(x=1.0, y=0.0)
    move.final(x=2.0)
    move.bounds(u=(-1.0, 1.0))
    problem.minimize(move.final_time)
    return problem


REFERENCE = Reference(7.8113113, "independent Radau collocation, two meshes agree", 7e-6)


main = example_main(build, REFERENCE, tol=1e-6)

if __name__ == "__main__":
    raise SystemExit(main())
