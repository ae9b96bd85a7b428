"""Bounds that are functions of time, tables of it, or of the fraction of the phase, against closed forms."""

import numpy as np
import pytest
from scipy.optimize import brentq
from testing.models import one_phase

import gnc_opt as go


def ride(name: str) -> tuple[go.Problem, object, object]:
    model = go.Model("cart")
    q, v, a = model.state("q", unit="m"), model.state("v", unit="m/s"), model.control("a", unit="m/s^2")
    model.ode({q: v, v: a})
    problem, leg = one_phase(name, model, 0.0, (0.1, 20.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    problem.minimize(leg.final_time)
    return problem, leg, a


@pytest.mark.parametrize("table", [False, True])
def test_bound_that_grows_with_time(table: bool) -> None:
    """With -1 <= a <= t: full power until s, then full brake; s + s^2 / 2 for s^3 / 6 + s^4 / 8 = 1."""
    problem, leg, _ = ride("growing limit")
    times = np.array([0.0, 5.0, 10.0, 20.0])
    leg.bounds(a=(-1.0, go.table(times, times) if table else lambda t: t))
    switch = brentq(lambda s: s**3 / 6.0 + s**4 / 8.0 - 1.0, 0.1, 3.0)
    found = go.solve(problem)
    assert found.objective == pytest.approx(switch + switch**2 / 2.0, rel=1e-8)
    assert go.verify(found).minimum


def test_bound_of_the_fraction_of_the_phase() -> None:
    """With q' = a <= t / T the way is T / 2."""
    model = go.Model("cart")
    q, a = model.state("q"), model.control("a")
    model.ode({q: a})
    problem, leg = one_phase("limit over the fraction", model, 0.0, (0.1, 20.0))
    leg.initial(q=0.0)
    leg.final(q=1.0)
    leg.bounds(a=(-1.0, leg.fraction))
    problem.minimize(leg.final_time)
    found = go.solve(problem)
    assert found.objective == pytest.approx(2.0, rel=1e-8)
    assert go.verify(found).minimum
    assert found.evaluate(leg.fraction, 0.5 * found.objective) == pytest.approx(0.5)


@pytest.mark.slow
def test_magnitude_of_a_vector_over_time() -> None:
    """A thrust of at most 1 + t moves a body along a line; the time is that of the scalar problem."""
    model = go.Model("body")
    r, v = model.state("r", 2), model.state("v", 2)
    thrust, _ = model.vector_control("T", 2)
    model.ode({r: v, v: thrust})
    problem, leg = one_phase("from rest to a place", model, 0.0, (0.1, 10.0))
    leg.initial(r=[0.0, 0.0], v=[0.0, 0.0])
    leg.final(r=[3.0, 4.0])
    leg.norm_bounds(T=(0.0, lambda t: 1.0 + t))
    problem.minimize(leg.final_time)
    expected = brentq(lambda t: t**2 / 2.0 + t**3 / 6.0 - 5.0, 0.1, 10.0)
    assert go.solve(problem, check=False).objective == pytest.approx(expected, rel=1e-7)


def test_later_ranges_replace_functions() -> None:
    problem, leg, a = ride("replaced")
    leg.bounds(a=(-1.0, lambda t: t))
    assert list(leg.paths) == ["upper bound of a"]
    leg.bounds(a=(-1.0, 2.0))
    assert not leg.paths
    frozen = problem.frozen()
    with pytest.raises(go.ProblemError, match="cannot be changed"):
        frozen.phases["leg"].bounds(a=(-1.0, a))


def test_wrong_uses_are_named() -> None:
    _, leg, _ = ride("wrong")
    with pytest.raises(go.ProblemError, match=r"one function: write \(lower, upper\)"):
        leg.bounds(a=lambda t: t)
    with pytest.raises(go.ProblemError, match=r"upper bound of 'a' .* 2 components: give 1"):
        leg.bounds(a=(-1.0, lambda t: [t, t]))
    with pytest.raises(go.ProblemError, match="end-point symbol"):
        leg.bounds(a=(-1.0, leg.duration))
    with pytest.raises(go.UnknownNameError, match="'b'"):
        leg.bounds(b=(-1.0, lambda t: t))


def test_a_bound_of_another_size_names_the_size_that_is_needed() -> None:
    model = go.Model("point")
    model.ode({model.state("q"): model.control("a")})
    leg = go.Problem("p").phase("leg", model)
    with pytest.raises(go.ProblemError, match=r"upper bound of 'a' .* has 2 components: give 1\.$"):
        leg.bounds(a=(0.0, lambda t: [1.0, 2.0]))
