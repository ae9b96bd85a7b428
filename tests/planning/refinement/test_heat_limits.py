r"""Heat that grows with the square of a control, limited: H is convex in it only while heat is worth something.

Least time to :math:`x = X` with :math:`\dot x = u`, :math:`\dot T = u^2 - T`, :math:`T \le 1`, :math:`u \le 3/2`.
While T is below its limit its costate grows like :math:`e^t`, so that u falls like :math:`e^{-t}`; on the limit u is 1.
So u leaves its bound at :math:`\ln 3/2`; T reaches its limit at :math:`2\ln 3/2`, where
:math:`x = (3\ln 3/2 + 1)/2`.

A limit :math:`u \le 5/2 - x/2` takes over at x = 3. From there on T falls and is worth nothing, H is linear in u, and
:math:`5 - x` falls like :math:`e^{-t/2}`.
"""

from __future__ import annotations

import numpy as np
import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go

KINK, WARM = np.log(1.5), 2 * np.log(1.5)
TAKEN_OVER = WARM + 3.0 - (1.5 * np.log(1.5) + 0.5)


def heated(distance: float, falling: bool) -> go.Problem:
    model, x, _heat, u = dynamics("charging", "x heat", "u", lambda x, heat, u: {x: u, heat: u**2 - heat})
    problem, leg = one_phase("heat limit", model, initial=0.0, final=(0.5, 20.0))
    leg.initial(x=0.0, heat=0.0)
    leg.final(x=distance)
    leg.bounds(u=(0.0, 1.5), heat=(None, 1.0))
    if falling:
        leg.path("falling", u + 0.5 * x, upper=2.5)
    problem.minimize(leg.final_time)
    return problem


@pytest.fixture(scope="module")
def charged() -> go.Solution:
    return go.solve(heated(4.5, falling=True), tol=1e-6)


def test_a_limit_that_takes_over_from_heat_ends_its_arc(charged: go.Solution) -> None:
    assert charged.objective == pytest.approx(TAKEN_OVER + 2 * np.log(4.0), abs=1e-8)
    assert charged.history is not None and charged.history.converged and go.verify(charged).ok


@pytest.mark.xfail(
    strict=True, reason="two limits of one control in one segment: hp refinement, without arcs"
)
def test_arcs_end_where_another_limit_takes_over_from_heat(charged: go.Solution) -> None:
    ends = {arc.channel: (arc.start, arc.end) for arc in charged.structure if arc.kind.is_at_limit}
    assert ends["u"] == pytest.approx((0.0, KINK), abs=1e-6)
    assert ends["heat"] == pytest.approx((WARM, TAKEN_OVER), abs=1e-6)
    assert ends["falling"] == pytest.approx((TAKEN_OVER, charged.objective), abs=1e-6)


def test_heat_is_worth_nothing_after_its_limit(charged: go.Solution) -> None:
    """Before it dH/du = 0 says lambda_T = -lambda_x / 2 at u = 1; the costate jumps to zero."""
    leg = charged.phases["leg"]
    after = leg.lam(np.linspace(TAKEN_OVER + 0.01, charged.objective, 7))[1]
    assert after == pytest.approx(np.zeros(7), abs=1e-6)
    before = leg.lam(np.array([WARM + 0.1, TAKEN_OVER - 0.1]))
    assert before[1] == pytest.approx(-0.5 * before[0], abs=1e-6)
