"""Solving again with other numbers: the closed forms of the double integrator, and what is refused."""

from __future__ import annotations

from typing import Any

import pytest

import gnc_opt as go
from gnc_opt.resolve import Resolver, Way


def cart(cost: str = "time") -> go.Problem:
    """A cart of acceleration gain * u to rest at the origin."""
    m = go.Model("cart")
    q, v = m.state("q"), m.state("v")
    u, gain = m.control("u"), m.parameter("gain", 1.0)
    m.ode({q: v, v: gain * u})
    p = go.Problem("cart")
    leg = p.phase("leg", m)
    if cost == "time":
        leg.time(initial=0.0, final=(0.1, 20.0))
        p.minimize(leg.final_time)
    else:
        leg.time(initial=0.0, final=1.0)
        p.minimize(leg.integral(u**2))
    leg.bounds(u=(-1.0, 1.0) if cost == "time" else (-50.0, 50.0))
    leg.initial(q=-1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    return p


@pytest.fixture(scope="module")
def fast() -> Resolver:
    return Resolver(go.solve(cart(), mesh="6x3", tol=1e-8))


@pytest.mark.parametrize("distance", [1.0, 1.01, 1.4, 0.5])
def test_switch_times_are_those_of_the_closed_form(fast: Resolver, distance: float) -> None:
    """Half of 2 sqrt(d) forwards, half backwards; costates -(1, sqrt(d) - t) / sqrt(d)."""
    problem = fast.solution.need_problem("").with_initial(q=-distance)
    found = fast.solve(problem)
    assert found.provenance["way"] == Way.SWITCH_TIMES.value
    assert found.objective == pytest.approx(2 * distance**0.5, rel=1e-9)
    switches = [arc.end for arc in found.structure[:-1]]
    assert switches == pytest.approx([distance**0.5], rel=1e-7)
    leg = found.phase()
    assert leg.x(0.0) == pytest.approx([-distance, 0.0], abs=1e-12)
    assert leg.lam(0.0) == pytest.approx([-1 / distance**0.5, -1.0], rel=1e-6)
    assert go.verify(found).minimum


def test_parameters_change_the_flight(fast: Resolver) -> None:
    found = fast.solve(fast.solution.need_problem("").with_parameters(gain=4.0))
    assert found.provenance["way"] == Way.SWITCH_TIMES.value
    assert found.objective == pytest.approx(1.0, rel=1e-9)


def test_a_limit_that_the_flight_would_exceed_is_kept(fast: Resolver) -> None:
    """At most 0.8 m/s: 0.8 s up and down each, and (1 - 0.64) / 0.8 = 0.45 s between."""
    found = Resolver(fast.solution, tol=1e-4).solve(fast.solution.need_problem("").with_bounds(v=(-1.0, 0.8)))
    assert found.provenance["way"] == Way.COLD.value
    assert found.objective == pytest.approx(2.05, abs=1e-4)


def test_a_smooth_solution_is_solved_again_on_its_mesh() -> None:
    """Least integral of u^2 in 1 s: 12 d^2."""
    first = go.solve(cart("effort"), mesh="4x3", tol=None)
    found = Resolver(first).solve(first.need_problem("").with_initial(q=-2.0))
    assert found.provenance["way"] == Way.WARM.value
    assert found.objective == pytest.approx(48.0, rel=1e-8)


def test_what_is_no_variation_is_refused(fast: Resolver) -> None:
    with pytest.raises(go.ProblemError, match="no variation of the one"):
        fast.solve(cart())


@pytest.mark.parametrize("given", [None, "cart", 3])
def test_what_is_no_problem_or_solution_is_refused(fast: Resolver, given: Any) -> None:
    with pytest.raises(go.GncOptError, match=r"Resolver.solve\(\) got"):
        fast.solve(given)
    with pytest.raises(go.GncOptError, match=r"Resolver\(\) got"):
        Resolver(given)


def test_what_is_not_solved_is_refused(fast: Resolver) -> None:
    problem = fast.solution.need_problem("").with_initial(q=-3.0)
    options = go.SolverOptions(max_iterations=0)
    unsolved = go.solve(problem, mesh="2x2", tol=None, options=options, throw=False)
    with pytest.raises(go.ProblemError, match="solve again from one that is solved"):
        Resolver(unsolved)
    with pytest.raises(go.GncOptError, match="tolerance of Resolver"):
        Resolver(fast.solution, tol=-1.0)


def test_a_guess_of_a_variation_is_solved_by_its_switch_times(fast: Resolver) -> None:
    """Unless a mesh, a tolerance or options are given, which ask for a collocated solution; all say how."""
    known = fast.solution
    problem = known.need_problem("").with_initial(q=-1.44)
    found = go.solve(problem, guess=known)
    assert found.provenance["way"] == Way.SWITCH_TIMES.value
    assert found.objective == pytest.approx(2.4, rel=1e-9)
    again = go.solve(problem.with_initial(q=-1.69), guess=found)
    assert again.provenance["way"] == Way.SWITCH_TIMES.value and again.objective == pytest.approx(
        2.6, rel=1e-9
    )
    for asked in (
        {"mesh": "6x3"},
        {"tol": 1e-6},
        {"tol": None},
        {"options": go.SolverOptions()},
        {"structure": "none"},
    ):
        other = go.solve(problem, guess=known, **asked)
        assert other.provenance["way"] == Way.WARM.value and other.objective == pytest.approx(2.4, rel=1e-3)
    assert "way" not in go.solve(problem, mesh="6x3", tol=None).provenance


def test_a_guess_of_another_problem_or_beyond_a_limit_is_a_start(fast: Resolver) -> None:
    assert go.solve(cart(), guess=fast.solution).provenance["way"] == Way.WARM.value
    limited = fast.solution.need_problem("").with_bounds(v=(-1.0, 0.8))
    found = go.solve(limited, guess=fast.solution)
    assert found.provenance["way"] == Way.WARM.value and found.objective == pytest.approx(2.05, abs=1e-2)


def test_what_two_flights_have_in_common_does_not_depend_on_the_way(fast: Resolver) -> None:
    """Forty variations: each by the known matrices and by matrices of its own, equal to the closed form."""
    problem = fast.solution.need_problem("")
    for k in range(40):
        distance = 0.3 * 1.08**k
        assert fast.solve(problem.with_initial(q=-distance)).objective == pytest.approx(
            2 * distance**0.5, rel=1e-9
        )
