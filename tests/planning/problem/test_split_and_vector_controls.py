"""Controls that are stated as one and optimised as two: closed forms of fuel, invariance, what is reported."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.internals import build_phase_guess
from testing.models import one_phase

import gnc_opt as go

DURATION, LEAST = 3.0, 0.5
FUEL = DURATION - np.sqrt(DURATION**2 - 4)
"""Of one unit, rest to rest, acceleration at most 1: two burns of half of it (problems.classics.minimum_fuel)."""


def cart(size: int = 2) -> tuple[go.Model, Any]:
    model = go.Model("cart")
    r, v = model.state("r", size), model.state("v", size)
    a, norm = model.vector_control("a", size, unit="m/s^2")
    model.ode({r: v, v: a})
    return model, norm


def move(direction: Any) -> go.Problem:
    """One unit along a direction, rest to rest, with the least integral of the norm of the acceleration."""
    model, norm = cart(len(direction))
    problem, leg = one_phase("move", model, initial=0.0, final=DURATION)
    zero = np.zeros(len(direction))
    leg.initial(r=zero, v=zero)
    leg.final(r=np.asarray(direction) / np.linalg.norm(direction), v=zero)
    leg.norm_bounds(a=(None, 1.0))
    problem.minimize(leg.integral(norm))
    return problem


@cache
def moved() -> go.Solution:
    return go.solve(move([3.0, -4.0]), mesh="10x3", tol=1e-8)


@cache
def landed() -> go.Solution:
    """A fall stopped at the ground by thrust that cannot be less than `LEAST`."""
    model = go.Model("lander")
    r, v = model.state("r", 2), model.state("v", 2)
    thrust, norm = model.vector_control("thrust", 2)
    model.ode({r: v, v: thrust - np.array([0.0, 1.0])})
    problem, leg = one_phase("annulus", model, initial=0.0, final=(1.0, 10.0), name="fall")
    leg.initial(r=[0.0, 2.0], v=[0.0, 0.0])
    leg.final(r=[0.0, 0.0], v=[0.0, 0.0])
    leg.norm_bounds(thrust=(LEAST, 3.0))
    problem.minimize(leg.integral(norm))
    return go.solve(problem, mesh="10x3", tol=1e-8)


@pytest.mark.slow
def test_least_fuel_in_the_plane_is_that_along_a_line() -> None:
    solution = moved()
    assert solution.converged
    assert solution.objective == pytest.approx(FUEL, abs=1e-9)
    arcs = [
        (arc.kind.value, arc.start, arc.end) for arc in solution.structure if arc.channel == "a_magnitude"
    ]
    assert [kind for kind, *_ in arcs] == ["upper", "lower", "upper"]
    np.testing.assert_allclose(
        [end for *_, end in arcs], [FUEL / 2, DURATION - FUEL / 2, DURATION], atol=1e-8
    )


def test_vector_is_reported_as_declared() -> None:
    solution, t = moved(), np.array([0.1, 1.5, 2.9])
    wanted = np.outer([0.6, -0.8], [1.0, 0.0, -1.0])
    for signal in (solution.control("a"), solution.saturated_control("a")):
        np.testing.assert_allclose(signal(t), wanted, atol=1e-8)
        assert signal.labels == ("a[0]", "a[1]")
        assert signal.unit == "m/s^2"
    np.testing.assert_allclose(solution.evaluate("a", t), wanted, atol=1e-8)
    np.testing.assert_allclose(solution.control("a_magnitude")(t), [1.0, 0.0, 1.0], atol=1e-9)


def test_primer_points_against_the_thrust_and_is_one_at_the_switches() -> None:
    """The costate of v, dJ/dv, is what Lawden's primer vector is but for its sign."""
    solution = moved()
    primer = -np.asarray(solution.costate("v")(np.array([0.05, FUEL / 2, DURATION - FUEL / 2])))
    np.testing.assert_allclose(np.linalg.norm(primer, axis=0)[1:], 1.0, atol=1e-7)
    np.testing.assert_allclose(primer[:, 0] / np.linalg.norm(primer[:, 0]), [0.6, -0.8], atol=1e-7)
    assert np.linalg.norm(primer[:, 0]) > 1


def test_multiplier_of_the_upper_limit_is_what_a_larger_one_saves() -> None:
    """dJ/d(limit): J = T - sqrt(T^2 - 4 / limit) times the limit, for a distance of one."""
    leg = moved().phase()
    density = leg.control_multiplier(leg.point_times)[leg.controls.slice("a_magnitude")][0]
    weights = np.concatenate(
        [
            rule.weights * width / 2
            for rule, width in zip(leg.collocation_rules, np.diff(leg.breaks), strict=True)
        ]
    )

    def fuel(limit: float) -> float:
        return float(limit * (DURATION - np.sqrt(DURATION**2 - 4 / limit)))

    upper = density > 0
    saved = -(fuel(1 + 1e-5) - fuel(1 - 1e-5)) / 2e-5
    assert np.sum((density * weights)[upper]) == pytest.approx(saved, rel=1e-6)


@pytest.mark.slow
def test_annulus_pushes_down_before_it_brakes() -> None:
    """What must be burnt anyway shortens the fall: least thrust downwards, least upwards, then most.

    The direction turns over in an instant. Of three arcs with accelerations -1.5, -0.5 and 2 the last follows from rest
    at the end, the second from the height, and the first is the best one.
    """

    def arcs(down: float) -> tuple[float, float, float]:
        roots = np.roots([5 / 16, 1.875 * down, 1.3125 * down**2 - 2.0])  # of the height, in the second arc
        second = float(np.max(roots.real))
        return down, second, 0.75 * down + 0.25 * second

    def fuel(down: float) -> float:
        first, second, last = arcs(down)
        return LEAST * (first + second) + 3.0 * last

    best = scipy.optimize.minimize_scalar(fuel, bounds=(0.0, 1.2), options={"xatol": 1e-10})
    first, second, last = arcs(best.x)
    solution = landed()
    assert solution.converged
    assert solution.objective == pytest.approx(best.fun, abs=1e-8)
    t = (np.arange(40) + 0.5) / 40 * (first + second + last)
    thrust = np.asarray(solution.control("thrust")(t))
    wanted = np.select([t < first, t < first + second], [-LEAST, LEAST], 3.0)
    np.testing.assert_allclose(thrust, [np.zeros(t.size), wanted], atol=1e-6)


def test_direction_is_relaxed_only_where_that_loses_nothing() -> None:
    model, norm = cart()
    leg = go.Problem("p").phase("leg", model)
    (vector,) = leg.vector_controls
    assert not leg.has_unit_direction(vector)
    assert leg.get_path_bounds().lower[0] == -np.inf
    leg.integral(norm**2)
    leg.path("forwards", model.output_expression("a")[0] - 0.5 * norm, lower=0.0)
    assert not leg.has_unit_direction(vector)
    leg.norm_bounds(a=(0.1, 1.0))
    assert leg.has_unit_direction(vector)
    np.testing.assert_array_equal(
        [leg.get_path_bounds().lower[0], leg.get_path_bounds().upper[0]], [1.0, 1.0]
    )
    leg.norm_bounds(a=(0.0, 1.0))
    leg.path("curved", ca.sumsqr(model.output_expression("a")), upper=0.5)
    assert leg.has_unit_direction(vector)


def test_guess_of_the_vector_is_one_of_its_parts() -> None:
    problem = move([1.0, 0.0])
    times = np.linspace(0.0, DURATION, 5)
    leg = problem.get_phase()
    leg.guess(time=times, a=np.outer([0.0, 0.5], [1.0, 1.0, 0.0, -1.0, -1.0]))
    start = build_phase_guess(leg, times / DURATION, perturbed=False)
    np.testing.assert_allclose(start.controls[0], [0.5, 0.5, 0.0, 0.5, 0.5])
    np.testing.assert_allclose(start.controls[2], [1.0, 1.0, 0.0, -1.0, -1.0])


@pytest.mark.slow
def test_composed_controls_are_saved_and_exported(tmp_path: Path) -> None:
    solution = moved()
    again = go.load(solution.save(tmp_path / "move"))
    np.testing.assert_array_equal(again.control("a")(0.1), solution.control("a")(0.1))
    figure = go.plot.plot_controls(solution, names=["a"])
    np.testing.assert_allclose(figure.axes[0].lines[1].get_ydata()[0], -0.8, atol=1e-8)
    pytest.importorskip("pandas")
    frame = solution.to_pandas(times=[0.1, 2.9])
    np.testing.assert_allclose(frame[["a[0]", "a[1]"]], [[0.6, -0.8], [-0.6, 0.8]], atol=1e-8)
    assert frame.attrs["units"]["a[1]"] == "m/s^2"


def test_split_control_is_reported_as_declared() -> None:
    model = go.Model("cart")
    x, v = model.state("x"), model.state("v")
    a, size = model.split_control("a")
    model.ode({x: v, v: a})
    problem, leg = one_phase("line", model, initial=0.0, final=DURATION)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    leg.guess(a=(1.0, -1.0))
    problem.minimize(leg.integral(size))
    solution = go.solve(problem, mesh="10x3", tol=1e-8)
    np.testing.assert_allclose(solution.control("a")([0.1, 1.5, 2.9]), [1.0, 0.0, -1.0], atol=1e-8)


@pytest.mark.parametrize(
    ("mistake", "message"),
    [
        (lambda model, leg: model.vector_control("b", 1), "size of vector control 'b'"),
        (lambda model, leg: leg.bounds(a=(0.0, 1.0)), r"give norm_bounds\(a=...\)"),
        (lambda model, leg: leg.norm_bounds(a=(-2.0, -1.0)), "at most -1: give a limit >= 0"),
        (lambda model, leg: leg.norm_bounds(b=1.0), "'b'"),
        (lambda model, leg: leg.norm_bounds(a_magnitude=1.0), "declare 'a_magnitude' with vector_control"),
        (lambda model, leg: leg.norm_bounds(a=(2.0, 1.0)), "norm of 'a'"),
        (lambda model, leg: leg.guess(a=[1.0, 2.0, 3.0]), "guess of 'a'"),
    ],
)
def test_mistakes_are_named(mistake: Any, message: str) -> None:
    model, _ = cart()
    leg = go.Problem("p").phase("leg", model)
    with pytest.raises(go.GncOptError, match=message):
        mistake(model, leg)


def test_a_pair_that_was_not_unpacked_says_so() -> None:
    model = go.Model("rocket")
    r = model.state("r", 3)
    pair = model.vector_control("T", 3)
    unpack = r"the pair that vector_control\('T', \.\.\.\) returns: unpack it, T, magnitude = "
    with pytest.raises(go.ModelError, match=f"time derivative of state 'r' .* {unpack}"):
        model.ode({r: pair})
    for operation in (
        lambda: pair / 2.0,
        lambda: 2.0 * pair,
        lambda: r + pair,
        lambda: -pair,
        lambda: pair @ r,
    ):
        with pytest.raises(go.ModelError, match=unpack):
            operation()
