"""Fronts and dispersed runs of the systems' pages, on problems with closed forms."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.simulation import Uniform
from problems.all import FLOWN, SYSTEMS
from problems.dispersed import Rivals, dispersed_rows
from problems.fronts import Front, Point, certified, front_figure, front_rows

HALVES = Front(
    "effort",
    "N m s^2",
    (Point(1.0, 8.0, True), Point(2.0, 4.0, True), Point(4.0, 2.0, True)),
    (2.0, 12.0),
    "law",
)


def push(duration: float) -> go.Problem:
    """One metre from rest to rest with the least integral of u^2: 12 / duration^3."""
    cart = go.Model("cart")
    x, v, u = cart.state("x"), cart.state("v"), cart.control("u")
    cart.ode({x: v, v: u})
    problem = go.Problem("push")
    leg = problem.phase("leg", cart)
    leg.time(initial=0.0, final=duration)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    problem.minimize(leg.integral(u**2, "effort"))
    return problem


def test_points_are_solved_judged_and_in_the_order_of_time() -> None:
    points = certified((2.0, 1.0), lambda t: go.solve(push(t)), lambda s: (s.phase().final_time, s.objective))
    assert [point.time for point in points] == [1.0, 2.0] and all(point.certified for point in points)
    assert [point.cost for point in points] == pytest.approx([12.0, 1.5], rel=1e-9)


def test_what_the_published_law_costs_over_the_front() -> None:
    """On a power law the front is met exactly between its points, too; beyond its ends the last one counts."""
    assert HALVES.excess == pytest.approx(3.0)
    for time, cost in ((2.5, 8 / 2.5), (8.0, 2.0), (0.5, 8.0)):
        assert Front("", "", HALVES.points, (time, cost), "").excess == pytest.approx(1.0)


def test_a_point_that_is_not_certified_or_a_front_that_rises_fails() -> None:
    assert all(row.passes for row in front_rows(HALVES)) and len(front_rows(HALVES)) == 5
    doubtful = Front("", "", (*HALVES.points[:2], Point(4.0, 2.0, False, "bounds")), (2.0, 12.0), "law")
    (row,) = (row for row in front_rows(doubtful) if not row.passes)
    assert row.quantity.startswith("front, 4 s") and row.note == "bounds"
    rising = Front("", "", (*HALVES.points, Point(5.0, 2.1, True)), (2.0, 12.0), "law")
    assert [row.passes for row in front_rows(rising)].count(False) == 1
    beaten = Front("", "", HALVES.points, (2.0, 3.9), "law")
    assert [row.passes for row in front_rows(beaten)].count(False) == 1


def test_front_is_drawn_with_the_published_point() -> None:
    (ax,) = front_figure(HALVES).axes
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["optimal", "law"]
    assert ax.get_xlabel() == "time (s)" and ax.get_ylabel() == "effort (N m s$^{2}$)"
    assert front_rows(HALVES)[0].quantity == "front, 1 s: effort (N m s^2)"


def test_front_is_logarithmic_where_it_spans_more_than_a_decade() -> None:
    """Within one, an axis of powers of ten has no tick that can be read."""
    (within,) = front_figure(HALVES).axes
    (beyond,) = front_figure(replace(HALVES, published=(2.0, 21.0))).axes
    assert (within.get_yscale(), beyond.get_yscale()) == ("linear", "log")


def still(gain: float) -> go.ClosedLoop:
    """x' = u with u = -gain x: after a second exp(-gain) of the start is left."""
    cart = go.Model("cart")
    x, u = cart.state("x", unit="m"), cart.control("u")
    cart.ode({x: -gain * x + u})
    return go.ClosedLoop(cart, go.feedforward(go.Reference.constant(cart, [0.0], [0.0])), dt=0.1)


def test_plans_and_law_fly_from_the_same_starts() -> None:
    rivals = Rivals(
        {"plan": (still(2.0), np.array([1.0])), "law": (still(1.0), np.array([1.0]))},
        1.0,
        {"initial.x": Uniform(-0.5, 0.5)},
        {"x": np.zeros(1)},
        {"x": ("left (cm)", 100.0)},
    )
    campaigns = rivals.fly(50, seed=3, executor="serial")
    row, failed = dispersed_rows(rivals, campaigns)
    plan, law = np.array(row.ours).reshape(2, 3)
    np.testing.assert_allclose(plan / law, np.exp(-1.0), rtol=1e-6)
    assert 100 * np.exp(-1) * 1.3 < law[2] < 100 * np.exp(-1) * 1.5 and law[0] < law[1] <= law[2]
    assert failed.passes and row.quantity == "50 runs, plan: left (cm), 50 %, 99 %, largest; law"


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_system_has_what_its_page_shows(name: str) -> None:
    assert callable(import_module(f"problems.{name}.report").front)
    assert callable(import_module(FLOWN[name]).rivals)
