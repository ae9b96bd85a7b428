"""Kinks within thin layers at the ends of a long phase: structures begin with the segments that resolve these."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from testing.models import dynamics, one_phase

import gnc_opt as go

MOST = 1.2
"""Upper bound on the control, which a free flight to the end would exceed."""


def along_bound() -> float:
    """Return the least cost of a long flight from x = 1.5 by way of x = 0 to x = 1.

    H vanishes along it, which tells the costate at every x, and the cost of getting from one x to another is minus the
    integral of the costate over x. Away from the bound H is least with u = -lam / 2.
    """

    def free(x: float, sign: float) -> float:
        return 2 * (np.sqrt(x**6 + x**2) + sign * x**3)

    met = scipy.optimize.brentq(lambda x: free(x, 1.0) / 2 - MOST, 0.1, 1.0)
    parts = (
        (lambda x: free(x, -1.0), 0.0, 1.5),
        (lambda x: free(x, 1.0), 0.0, met),
        (lambda x: (x**2 + MOST**2) / (MOST - x**3), met, 1.0),
    )
    return float(sum(scipy.integrate.quad(*part, epsabs=1e-13, epsrel=1e-13)[0] for part in parts))


@pytest.mark.slow
def test_a_kink_in_a_layer_at_the_end_of_a_long_phase() -> None:
    """Segments of equal length along the free arc would be three hundred time constants long."""
    model, x, u = dynamics("cubic", "x", "u", lambda x, u: {x: -(x**3) + u})
    problem, leg = one_phase("bounded", model, initial=0.0, final=3000.0)
    leg.initial(x=1.5)
    leg.final(x=1.0)
    leg.bounds(u=(-1.0, MOST))
    problem.minimize(leg.integral(x**2 + u**2))
    refined = go.refine(go.solve(problem, tol=None))
    assert refined.history is not None and refined.history.converged
    assert go.verify(refined).minimum
    assert refined.objective == pytest.approx(along_bound(), rel=1e-9)
