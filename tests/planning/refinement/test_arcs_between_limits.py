"""From a state limit of second order to a bound of the control: along an interior arc that may be short.

A cart rests on the limit q >= 0 and takes off as late as it can, from t_e on with a = (t - t_e) / tau up to a = 1.
Least effort, with a price on the speed at the end that makes this the optimum: the arc lasts tau, the cart comes to
q = 1/2 + tau^2 / 24 at 2 s, hence t_e = 1 - tau / 2, and by H = a^2 / 2 + ... the costs are
J = (1 - tau / 6) / 2 - (1 + tau / 2) / tau.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from testing.internals import PhaseStructure, Plan, Resolution, optimise_switches

import gnc_opt as go
from gnc_opt import ArcKind
from gnc_opt.planning.refinement.arcs.loop import structures_of
from gnc_opt.planning.refinement.arcs.pressed_bounds import unpinned

TAU = 0.1
FREE, LOW, HIGH = ArcKind.INTERIOR, ArcKind.LOWER, ArcKind.UPPER
HELD, SHORT, BOUND = (FREE, LOW, FREE), (FREE, FREE, FREE), (HIGH, FREE, FREE)


@pytest.fixture(scope="module")
def coarse() -> go.Solution:
    cart = go.Model("cart")
    q, v, a = cart.state("q", unit="m"), cart.state("v", unit="m/s"), cart.control("a", unit="m/s^2")
    cart.ode({q: v, v: a})
    ocp = go.Problem("take-off")
    leg = ocp.phase("leg", cart)
    leg.time(initial=0.0, final=2.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=0.5 + TAU**2 / 24)
    leg.bounds(a=(-1.0, 1.0), q=(0.0, 10.0))
    ocp.minimize(leg.integral(0.5 * a**2) - (1 + TAU / 2) / TAU * leg.final_state("v"))
    return go.solve(ocp, mesh="20x4", tol=None)


def structure(coarse: go.Solution, times: tuple[float, ...], *kinds: tuple[ArcKind, ...]) -> PhaseStructure:
    return replace(structures_of(coarse)["leg"], times=times, kinds=kinds, touches=((),) * len(times))


def test_an_interior_arc_that_is_missing_between_them_is_added(coarse: go.Solution) -> None:
    begun = structure(coarse, (0.0, 0.97, 2.0), HELD, BOUND)
    found, history = optimise_switches(coarse, structures={"leg": begun})
    assert history.converged and go.verify(found).ok
    assert found.objective == pytest.approx((1 - TAU / 6) / 2 - (1 + TAU / 2) / TAU, abs=1e-9)
    (short,) = (arc for arc in found.structure if arc.channel == "a" and arc.kind is FREE)
    assert (short.start, short.end) == pytest.approx((1 - TAU / 2, 1 + TAU / 2), abs=1e-6)


def test_nothing_can_hold_the_limit_with_the_control_on_its_bound(coarse: go.Solution) -> None:
    with_short = structure(coarse, (0.0, 0.95, 1.05, 2.0), HELD, SHORT, BOUND)
    assert with_short.swapped(1) is None
    without_holder = replace(with_short, holders=((), (), ()))
    assert without_holder.swapped(1) is not None
    assert structure(coarse, (0.0, 0.95, 2.0), HELD, BOUND).jumped_to(1) == [0]
    assert with_short.jumped_to(1) == with_short.jumped_to(2) == []


def test_an_interior_arc_whose_control_stays_on_its_bound_is_none(coarse: go.Solution) -> None:
    times = (0.0, 0.9, 1.1, 2.0)
    (samples,) = coarse.samples().values()
    resolutions = tuple(Resolution(segments, 4) for segments in (9, 2, 9))
    found, action = unpinned(samples, Plan(structure(coarse, times, HELD, SHORT, SHORT), resolutions), set())
    assert found is not None and action == "a on its bound from 1.1 s"
    assert found.kinds == (HELD, SHORT, BOUND)
    assert unpinned(samples, Plan(structure(coarse, times, HELD, SHORT, BOUND), resolutions), set()) == (
        None,
        "",
    )
    np.testing.assert_array_equal(found.times, times)
    left = {("leg", found.at(()))}
    assert unpinned(samples, Plan(structure(coarse, times, HELD, SHORT, SHORT), resolutions), left) == (
        None,
        "",
    )
