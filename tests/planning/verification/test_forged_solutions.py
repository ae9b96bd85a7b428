"""The trajectory is judged against the problem: nothing that the solution says about the problem is believed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.internals import Interval, PiecewisePolynomial
from testing.models import dynamics, one_phase
from testing.wrong_solutions import (
    added,
    bang_bang,
    double_integrator,
    energy,
    failed,
    forged,
    nothing_to_gain,
    scaled,
    shifted,
)

import gnc_opt as go

Q, V, A = 0, 1, 0


def cart(mass: float) -> go.Problem:
    """Minimum time over 1 m with a force of 1 N: t_f = 2 sqrt(mass)."""
    model = go.Model("cart")
    q, v, force = model.state("q"), model.state("v"), model.control("force")
    model.ode({q: v, v: force / model.parameter("mass", mass)})
    problem, leg = one_phase("cart", model, 0.0, (0.1, 10.0))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(force=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    return problem


def test_solution_for_another_mass_fails_even_with_the_right_fingerprint(tmp_path: Any) -> None:
    mesh = go.Mesh.at_times([0.0, 0.9, 2.0], 5, movable=True)
    heavy = go.solve(cart(1.1).with_fixed_arcs(arcs=[[-1, 1]]), mesh=mesh, tol=None)
    assert go.verify(heavy).minimum
    print_of_light = {**heavy.provenance, "fingerprint": cart(1.0).fingerprint()}
    file = replace(heavy, provenance=print_of_light).save(tmp_path / "cart.npz")
    assert {"dynamics", "cost"} <= failed(go.load(file, problem=cart(1.0)))


@cache
def two_integrals(first: float) -> go.Solution:
    """x' = u from 1 to 2 within 1 s at least first * (integral of x^2) + (integral of u^2)."""
    model, x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("two integrals", model, 0.0, 1.0)
    leg.initial(x=1.0)
    leg.final(x=2.0)
    problem.minimize(first * leg.integral(x**2, "J1") + leg.integral(u**2, "J2"))
    return go.solve(problem, mesh="6x6", tol=None)


def test_optimum_of_another_weighting_fails() -> None:
    """The optimum of 4 J1 + J2 is no optimum of J1 + J2, whatever it says about the weights."""
    other, own = two_integrals(4.0), two_integrals(1.0)
    assert go.verify(own).minimum and go.verify(other).minimum
    wrong = replace(other, problem=own.problem, objective=float(np.sum(other.phase().integrals)))
    assert {"cost", "stationarity"} <= failed(wrong)


def test_multiplier_of_an_integral_constraint_is_checked_by_its_limit() -> None:
    """nu of an energy budget that is not used up: the weight of the energy follows from it, not from the solution."""
    model = double_integrator()
    problem, leg = one_phase("budget", model, 0.0, (0.1, 10.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    spent = leg.integral(model.symbol("a") ** 2, "energy")
    problem.constrain("budget", spent, upper=12.0)
    problem.minimize(leg.final_time)
    right = go.solve(problem, mesh="4x5", tol=None)
    assert go.verify(right).minimum, go.verify(right).explain()
    assert right.objective == pytest.approx(1.0, rel=1e-7)  # energy 12 / t_f^3
    assert right.phase().integral_weights[0] == pytest.approx(1 / 36, rel=1e-5)
    half = 0.5 * right.constraint_multipliers
    assert {"cost", "stationarity"} <= failed(replace(right, constraint_multipliers=half))
    leg_half = forged(right, integral_weights=half)
    assert {"stationarity"} <= failed(replace(leg_half, constraint_multipliers=half))


def test_free_parameter_is_what_the_dynamics_are_checked_with() -> None:
    """A mass that is optimised: the value kept with the phase is a copy, which must not be believed."""
    base = cart(1.0)
    problem = go.Problem("chosen mass")
    mass = problem.parameter("mass", lower=1.0, upper=4.0, guess=1.5)
    model = base.get_phase().model
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.5, v=0.0)
    problem.minimize(leg.integral(model.symbol("force") ** 2) - mass)
    right = go.solve(problem, mesh="4x5", tol=None)
    assert right.phase().parameters == pytest.approx(right.parameter_values)
    off = 1.01 * right.parameter_values
    assert failed(forged(right, parameters=off)) == {"cost"}
    assert "dynamics" in failed(replace(right, parameter_values=off))


def wide(box: Interval) -> Interval:
    return Interval(box.lower - 100.0, box.upper + 100.0)


BREACHES: dict[str, tuple[str, Callable[[], go.Solution]]] = {
    "state_bounds": ("limits", lambda: replace(energy(), problem=stated().with_bounds(v=(-5.0, 1.4)))),
    "control_bounds": ("limits", lambda: replace(energy(), problem=stated().with_bounds(a=(-5.0, 5.0)))),
    "initial_bounds": (
        "boundary conditions",
        lambda: replace(energy(), problem=stated().with_initial(q=0.1)),
    ),
    "final_bounds": ("boundary conditions", lambda: replace(energy(), problem=stated().with_final(q=1.1))),
    "initial_time_bounds": (
        "boundary conditions",
        lambda: replace(energy(), problem=stated().with_time(initial=-0.1)),
    ),
    "final_time_bounds": (
        "boundary conditions",
        lambda: replace(energy(), problem=stated().with_time(final=1.1)),
    ),
    "duration_bounds": (
        "boundary conditions",
        lambda: replace(energy(), problem=stated().with_time(duration=(1.2, 2.0))),
    ),
}


def stated() -> go.Problem:
    return energy().need_problem("vary")


@pytest.mark.parametrize("field", BREACHES)
def test_wider_limits_of_the_solution_excuse_nothing(field: str) -> None:
    """The trajectory breaks a limit of the problem; the solution says that there is none."""
    condition, wrong = BREACHES[field]
    assert condition in failed(wrong())
    solution = wrong()
    assert condition in failed(forged(solution, **{field: wide(getattr(solution.phase(), field))}))


def test_path_limit_is_that_of_the_problem() -> None:
    right = energy()
    assert failed(forged(right, path_bounds=shifted(right.phase().path_bounds, -4.0))) == {"cost"}


@pytest.mark.parametrize("field", [*BREACHES, "path_bounds"])
def test_limits_that_are_not_those_of_the_problem_are_reported(field: str) -> None:
    solution = energy()
    verdict = go.verify(forged(solution, **{field: wide(getattr(solution.phase(), field))}))
    assert not verdict.ok
    if field != "path_bounds":  # endless below, wherever it is moved to
        assert verdict["cost"].where.endswith(f"phase leg, {field}")


def test_another_start_than_the_problem_has_fails() -> None:
    wrong = added(energy(), "x", Q, 0.1)
    start = shifted(wrong.phase().initial_bounds, 0.1)
    assert "boundary conditions" in failed(forged(wrong, initial_bounds=start, final_bounds=start))


def test_solution_of_other_sizes_is_refused() -> None:
    with pytest.raises(go.ProblemError, match=r"does not fit problem 'cart': .* check it with the problem"):
        go.verify(replace(two_integrals(1.0), problem=cart(1.0)))
    with pytest.raises(go.ProblemError, match="phases are"):
        go.verify(replace(energy(), phases={"lag": energy().phase()}))


def spoiled(value: Any, everywhere: bool) -> Any:
    """The same with NaN in the middle of it, or all over."""
    if isinstance(value, float):
        return float("nan")
    if isinstance(value, Interval):
        return Interval(spoiled(value.lower, everywhere), value.upper)
    if isinstance(value, PiecewisePolynomial):
        last = len(value.values) // 2
        pieces = tuple(
            spoiled(v, everywhere) if everywhere or k == last else v for k, v in enumerate(value.values)
        )
        return PiecewisePolynomial(value.breaks, value.nodes, pieces)
    result = np.array(value, dtype=float)
    result.flat[slice(None) if everywhere else result.size // 2] = np.nan
    return result


def numeric(owner: Any) -> list[str]:
    """Fields that hold numbers."""
    kinds = (float, np.ndarray, Interval, PiecewisePolynomial)
    found = {f.name: getattr(owner, f.name) for f in dataclasses.fields(owner)}
    sizes = {name: np.size(v.lower if isinstance(v, Interval) else v) for name, v in found.items()}
    return [name for name, value in found.items() if isinstance(value, kinds) and sizes[name]]


@pytest.mark.slow
@pytest.mark.parametrize(("correct", "everywhere"), [(energy, False), (bang_bang, True)])
def test_nan_in_any_number_of_the_phase_is_never_ok(
    correct: Callable[[], go.Solution], everywhere: bool
) -> None:
    solution = correct()
    for field in numeric(solution.phase()):
        verdict = go.verify(
            forged(solution, **{field: spoiled(getattr(solution.phase(), field), everywhere)})
        )
        assert not verdict.ok and not verdict.minimum, field
        assert not str(verdict).endswith("verdict: ok"), field
        for c in verdict.conditions:
            assert c.result is not go.ConditionResult.PASS or np.isfinite(c.value), (field, c)


def test_nan_in_any_number_of_the_solution_is_never_ok() -> None:
    for field in numeric(energy()):
        assert not go.verify(replace(energy(), **{field: spoiled(getattr(energy(), field), False)})).ok, field


SEES = {
    "x": {"dynamics", "limits"},
    "u": {"dynamics", "cost", "stationarity", "minimum principle"},
    "lam": {"stationarity", "minimum principle"},
}
"""What cannot be right where the speed, the control or its costate is missing."""


@pytest.mark.parametrize("piece", SEES)
def test_a_missing_number_fails_at_its_place(piece: Any) -> None:
    """One node of segment 3 of 4: t in [0.5, 0.75] s."""
    verdict = go.verify(added(energy(), piece, A if piece == "u" else V, np.nan, 2, 1))
    for name in SEES[piece]:
        assert verdict[name].result is go.ConditionResult.FAIL, name
    for condition in verdict.conditions[8:]:  # of the second order
        assert condition.result is not go.ConditionResult.PASS, condition
    place = "phase leg, segment 3 (from t = 0.5), "
    missing = "objective = 6, recomputed nan" if piece == "u" else f"{place}{piece} is not finite"
    assert verdict["cost"].where.endswith(missing)


@pytest.mark.parametrize(
    "wrong",
    [lambda: scaled(energy(), "lam", np.nan), lambda: scaled(bang_bang(), "lam", 0.0)],
    ids=["NaN", "zero"],
)
def test_without_costates_nothing_is_ok(wrong: Callable[[], go.Solution]) -> None:
    verdict = go.verify(wrong())
    assert not verdict.failed and not verdict.ok and not verdict.minimum
    assert verdict["stationarity"].result is go.ConditionResult.INCONCLUSIVE
    assert verdict["dynamics"].result is go.ConditionResult.PASS
    assert verdict.explain().splitlines()[0].endswith(": not checked: no costates.")
    assert str(verdict).splitlines()[-1] == "verdict: not checked: no costates"


def test_a_missing_costate_of_several_controls_fails() -> None:
    """Three controls, coupled states: no eigenvalue of a missing matrix is asked for."""
    model = go.Model("spinning body")
    w, a = model.state("w", 3), model.control("a", 3)
    model.ode({w: ca.vertcat(0.8 * w[1] * w[2], -0.5 * w[0] * w[2], 0.2 * w[0] * w[1]) + a})
    problem, leg = one_phase("stop", model, 0.0, 2.0)
    leg.initial(w=[1.0, 0.6, -0.4])
    leg.final(w=0.0)
    problem.minimize(leg.integral(ca.sumsqr(a)))
    solution = go.solve(problem, mesh="4x4", tol=None)
    for everywhere in (False, True):
        lam = spoiled(solution.phase().lam, everywhere)
        assert not go.verify(forged(solution, lam=lam)).ok


def test_zero_costates_of_an_integral_cost_fail() -> None:
    verdict = go.verify(scaled(energy(), "lam", 0.0))
    assert verdict["stationarity"].result is go.ConditionResult.FAIL
    assert not verdict.ok and str(verdict).endswith("verdict: NOT ok")


def test_costates_that_rightly_vanish_are_costates() -> None:
    """x_f^2 at x_f = 0: every multiplier is zero, and the minimum principle holds."""
    right = nothing_to_gain()
    nothing = replace(right, phases={"leg": replace(right.phase(), x=ending_at_zero(right.phase().x))})
    verdict = go.verify(scaled(nothing, "lam", 0.0))
    assert verdict.ok, verdict.explain()
    assert "search" not in verdict["minimum principle"].meaning  # H is convex and quadratic


def ending_at_zero(x: PiecewisePolynomial) -> PiecewisePolynomial:
    """The states less what is left of them at the end, which is rounding."""
    rest = x(x.breaks[-1], "left")[:, None]
    assert np.max(np.abs(rest)) < 1e-6
    return PiecewisePolynomial(x.breaks, x.nodes, tuple(v - rest for v in x.values))


@pytest.mark.parametrize("name", ["lam_start", "lam_end"])
def test_costates_at_the_ends_of_segments_are_those_of_the_polynomials(name: str) -> None:
    """They say which arcs are constrained, and whoever reads them takes them for the costates."""
    solution = energy()
    leg = solution.phase()
    off = {**solution.phases, leg.name: replace(leg, **{name: 1.001 * getattr(leg, name)})}
    assert failed(replace(solution, phases=off)) == {"cost"}
    assert failed(solution) == set()


def test_a_minimum_that_calls_itself_a_maximum() -> None:
    assert failed(replace(energy(), maximised=True)) == {"cost"}


@cache
def limited(scheme: str = "LG") -> go.Solution:
    """A move within a duration, with limits on times, speed, acceleration and both: every multiplier has its say."""
    model = double_integrator()
    v, a = model.symbol("v"), model.symbol("a")
    problem, leg = one_phase("limited", model, initial=(0.0, 0.5), final=(0.1, 1.4))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-3.8, 9.0), v=(-0.95, 9.0))
    leg.path("both", v + 0.2 * a, upper=0.65)
    problem.minimize(leg.integral(a**2))
    return go.solve(problem, scheme=scheme)  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["LGL"])
def test_multipliers_of_times_are_what_h_is_worth(scheme: str) -> None:
    solution = limited(scheme)
    leg = solution.phase()
    assert go.verify(solution).ok and np.min(np.abs(leg.time_multipliers)) > 1.0
    for change in (np.array([0.0, 0.01]), np.array([0.01, 0.0])):
        assert "stationarity" in failed(
            forged(solution, time_multipliers=leg.time_multipliers * (1 + change))
        )


@pytest.mark.parametrize(
    "name",
    [
        "lam_start",
        "lam_end",
        "point_costates",
        "path_multipliers",
        "state_multipliers",
        "control_multipliers",
        "state_impulses",
        "time_multipliers",
        "duration_multiplier",
        "integrals",
        "integral_weights",
    ],
)
def test_no_number_of_a_solution_is_left_unread(name: str) -> None:
    value = np.asarray(getattr(limited().phase(), name))
    changed: Any = 1.05 * value + 0.02 * (1 + np.max(np.abs(value)))
    assert failed(forged(limited(), **{name: float(changed) if changed.ndim == 0 else changed}))
