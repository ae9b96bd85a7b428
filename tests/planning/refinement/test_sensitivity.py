"""Sensitivities against central differences of problems solved anew, and against closed forms.

Differences with step h of solutions converged to 1e-11 have errors of h^2 and 1e-11 / h; with h = 1e-4 both are
below 1e-6 of derivatives of order one, and 1e-5 is asked for.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from testing.models import dynamics, one_phase
from testing.nonlinear_problems import orbit_raising, reorientation, van_der_pol

import gnc_opt as go
from gnc_opt.planning import refine
from problems.classics import bryson_denham

OPTIONS = go.SolverOptions(tolerance=1e-11)
STEP = 1e-4


def solve(
    problem: go.Problem, mesh: str, scheme: str = "LG", guess: go.Solution | None = None
) -> go.Solution:
    return go.solve(problem, mesh=mesh, scheme=scheme, guess=guess, options=OPTIONS, tol=None)


def differences(
    vary: Callable[[float], go.Problem], base: go.Solution
) -> Callable[[Callable[[go.Solution], object]], np.ndarray]:
    """Return a function that differentiates any reading of a solution."""
    leg = next(iter(base.phases.values()))
    meshes = {name: phase.mesh for name, phase in base.phases.items()}
    above, below = (
        go.solve(vary(h), mesh=meshes, scheme=leg.scheme, guess=base, options=OPTIONS) for h in (STEP, -STEP)
    )
    return lambda read: (np.asarray(read(above)) - np.asarray(read(below))) / (2 * STEP)


def assert_close(found: object, wanted: np.ndarray) -> None:
    size = max(float(np.max(np.abs(wanted))), 1e-3)
    np.testing.assert_allclose(np.asarray(found), wanted, rtol=0, atol=1e-5 * size)


def brachistochrone() -> go.Problem:
    bead = go.Model("bead")
    x, y, v = bead.state("x"), bead.state("y"), bead.state("v")
    angle = bead.control("angle")
    g, drag = bead.parameter("g", 9.81), bead.parameter("drag", 0.1)
    bead.ode({x: v * ca.sin(angle), y: v * ca.cos(angle), v: g * ca.cos(angle) - drag * v})
    problem, leg = one_phase("brachistochrone with drag", bead, initial=0.0, final=(0.1, 10.0))
    leg.initial(x=0.0, y=0.0, v=0.0)
    leg.final(x=1.0, y=1.0)
    leg.bounds(angle=(-0.5, 2.0))  # no whole turns
    leg.guess(angle=(0.1, 1.4), x=(0.0, 1.0), y=(0.0, 1.0), v=(0.0, 4.0))
    problem.minimize(leg.final_time)
    return problem


def tuned_spring() -> go.Problem:
    """Two phases and an optimised stiffness; the payoff of a long way costs effort and stiffness."""
    model = go.Model("spring")
    q, v, force = model.state("q"), model.state("v"), model.control("force")
    stiffness, drag = model.parameter("stiffness", 1.0), model.parameter("drag", 0.2)
    model.ode({q: v, v: force - stiffness * ca.sin(q) - drag * v * ca.fabs(v)})
    problem = go.Problem("tuned spring")
    first, second = problem.phase("first", model), problem.phase("second", model)
    first.time(initial=0.0, final=1.0)
    second.time(initial=1.0, final=(1.2, 5.0))
    first.initial(q=0.0, v=1.0)
    first.bounds(force=(-1.0, 0.25))
    second.final(v=0.5)
    k = problem.parameter("stiffness", lower=0.05, upper=5.0, guess=1.0)
    problem.link(first, second)
    problem.maximize(
        second.final_state("q")
        - first.integral(force**2)
        - second.integral(force**2 + 0.1 * q**2)
        - 0.05 / k
        - 0.1 * second.final_time**2
    )
    return problem


@pytest.mark.parametrize("scheme", ["LG", "LGL"])
@pytest.mark.parametrize("bounded", [False, True])
def test_parameter_state_and_control_with_and_without_active_bounds(scheme: str, bounded: bool) -> None:
    problem = van_der_pol().with_bounds(u=(-0.3, 0.6)) if bounded else van_der_pol()
    base = solve(problem, "6x5", scheme)
    if bounded:
        assert np.sum(np.abs(base.phase().control_multipliers) > 1e-3) > 5
    found = go.sensitivity(base, "mu")
    difference = differences(lambda h: problem.with_parameters(mu=1.0 + h), base)
    t = np.linspace(0.0, 4.0, 41)
    assert_close(found.objective, difference(lambda s: s.objective))
    for name in ("x", "y"):
        assert_close(found.state(name)(t), difference(lambda s, name=name: s.state(name)(t)))
    assert_close(found.control("u")(t), difference(lambda s: s.control("u")(t)))
    assert found.final_time == 0.0


@pytest.mark.parametrize("scheme", ["LG", "LGL"])
def test_fixed_times(scheme: str) -> None:
    problem = van_der_pol()
    base = solve(problem, "8x6", scheme)
    t = np.linspace(0.11, 3.87, 21)  # no sample at a boundary of segments, which moves
    for end, vary in (
        ("final", lambda h: problem.with_time(final=4.0 + h)),
        ("initial", lambda h: problem.with_time(initial=h)),
    ):
        found, difference = go.sensitivity(base, time=end), differences(vary, base)
        assert_close(found.objective, difference(lambda s: s.objective))
        assert_close(found.state("x")(t), difference(lambda s: s.state("x")(t)))
        assert_close(found.control("u")(t), difference(lambda s: s.control("u")(t)))
    # dJ/dt_f = H at the end (up to the mesh), = -dJ/dt_0 of a problem without explicit time.
    assert go.sensitivity(base, time="final").objective == pytest.approx(base.hamiltonian(4.0), abs=1e-6)
    assert go.sensitivity(base, time="initial").objective == pytest.approx(-base.hamiltonian(0.0), abs=1e-6)
    assert go.sensitivity(base, time="final").final_time == 1.0


def test_boundary_values_are_costates() -> None:
    base = solve(van_der_pol(), "6x5")
    for name in ("x", "y"):
        found = go.sensitivity(base, initial=name)
        assert found.objective == pytest.approx(base.costate(name)(0.0), rel=1e-10)
        assert found.state(name)(0.0) == pytest.approx(1.0, abs=1e-12)
    turn = solve(reorientation(), "4x5")
    found = go.sensitivity(turn, initial="sigma")
    np.testing.assert_allclose(found.objective, turn.costate("sigma")(0.0), rtol=1e-9)
    np.testing.assert_allclose(found.state("sigma")(0.0), np.eye(3), atol=1e-12)
    assert found.state("omega")(np.linspace(0, 3, 7)).shape == (3, 3, 7)
    end = go.sensitivity(turn, final="omega").objective
    np.testing.assert_allclose(end, -turn.costate("omega")(3.0), rtol=1e-9)


def test_free_final_time() -> None:
    problem = brachistochrone()
    base = solve(problem, "10x6")
    t = np.linspace(0.02, 0.55, 21)
    for name, value in (("g", 9.81), ("drag", 0.1)):
        found = go.sensitivity(base, name)

        def vary(h: float, name: str = name, value: float = value) -> go.Problem:
            return problem.with_parameters(**{name: value + h})

        difference = differences(vary, base)
        assert found.final_time == pytest.approx(found.objective, rel=1e-9)
        assert_close(found.objective, difference(lambda s: s.objective))
        assert_close(found.state("y")(t), difference(lambda s: s.state("y")(t)))
        assert_close(found.control("angle")(t), difference(lambda s: s.control("angle")(t)))
    found = go.sensitivity(base, final="x")
    assert found.objective == pytest.approx(-base.costate("x")(base.phase().final_time), rel=1e-8)


def test_maximisation_and_boundary_constraint() -> None:
    problem = orbit_raising()
    base = solve(problem, "8x5")
    found = go.sensitivity(base, constraint="circular")
    difference = differences(lambda h: orbit_raising(circular=1.0 + h), base)
    assert_close(found.objective, difference(lambda s: s.objective))
    assert found.objective == pytest.approx(base.multiplier("circular"), rel=1e-9)  # -nu of the minimised -r
    found = go.sensitivity(base, initial="vt")
    difference = differences(lambda h: problem.with_initial(vt=1.0 + h), base)
    assert_close(found.objective, difference(lambda s: s.objective))
    assert found.objective == pytest.approx(-base.costate("vt")(0.0), rel=1e-9)
    t = np.linspace(0.0, 3.32, 21)
    assert_close(found.control("angle")(t), difference(lambda s: s.control("angle")(t)))


def test_optimised_parameter_two_phases_and_a_free_time() -> None:
    problem = tuned_spring()
    base = solve(problem, "5x5")
    assert np.any(base.phase("first").control_multipliers > 1e-3)
    assert 0.06 < base.parameter("stiffness") < 4.9
    found = go.sensitivity(base, "drag")
    difference = differences(lambda h: problem.with_parameters(drag=0.2 + h), base)
    assert_close(found.objective, difference(lambda s: s.objective))
    assert_close(found.parameter("stiffness"), difference(lambda s: s.parameter("stiffness")))
    assert_close(found.phase("second").final_time, difference(lambda s: s.phase("second").final_time))
    t = np.linspace(1.01, base.phase("second").final_time - 0.01, 11)
    assert_close(found.state("q", "second")(t), difference(lambda s: s.state("q", "second")(t)))
    with pytest.raises(go.ProblemError, match=r"'stiffness'.*is optimised"):
        go.sensitivity(base, "stiffness")
    with pytest.raises(go.ProblemError, match="2 phases"):
        _ = found.final_time


def test_switch_time_of_a_bang_bang_solution() -> None:
    """t_f = v/c + 2 sqrt(q/c + v^2 / 2c^2) for thrust +-c from (q, v); the switch halves the rest."""
    model = go.Model("double integrator")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    c = model.parameter("c", 1.0)
    model.ode({q: v, v: c * a})
    problem, leg = one_phase("minimum time", model, initial=0.0, final=(0.1, 10.0))
    leg.initial(q=1.0, v=0.2)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    solution = refine(solve(problem, "20x4"), structure="bang-bang")
    root = np.sqrt(1.0 + 0.2**2 / 2)
    found = go.sensitivity(solution, initial="q")
    assert found.objective == pytest.approx(1 / root, rel=1e-8)
    assert found.phase().switching_times == pytest.approx([0.5 / root], rel=1e-8)
    assert go.sensitivity(solution, "c").objective == pytest.approx(-0.2 - (1.0 + 0.2**2) / root, rel=1e-8)


def wall(form: str, v0: float = 1.0) -> go.Problem:
    """Bryson and Denham's problem with its limit as a bound of the state or as a path constraint."""
    model, x, _v, a = dynamics("double integrator", "x v", "a", lambda x, v, a: {x: v, v: a})
    problem, leg = one_phase("wall", model, initial=0.0, final=1.0)
    leg.initial(x=0.0, v=v0)
    leg.final(x=0.0, v=-1.0)
    if form == "bound":
        leg.bounds(x=(None, bryson_denham.LIMIT))
    else:
        leg.path("wall", x, upper=bryson_denham.LIMIT)
    problem.minimize(leg.integral(a**2 / 2))
    return problem


@pytest.mark.slow
@pytest.mark.parametrize("form", ["path"])
@pytest.mark.filterwarnings("error")
def test_trajectory_before_an_arc_on_a_state_limit(form: str) -> None:
    """v = v0 (1 - t / t1)^2 up to t1 = 3 l / v0 and J = 2 (v0^3 + 1) / (9 l): the arc of order two begins earlier.

    The multipliers of the arc are impulses at its ends; that it is left nowhere else is for the structure to say.
    """
    found = go.sensitivity(go.solve(wall(form), tol=1e-8, check=False), initial="v")
    last = 3 * bryson_denham.LIMIT
    t = np.linspace(0.0, 1.0, 41)
    left = np.where(t < last, 1 - t / last, 0.0)
    assert found.objective == pytest.approx(2 / last, rel=1e-9)
    np.testing.assert_allclose(found.state("v")(t), left * (1 - 3 * t / last), rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.state("x")(t), t * left**2, rtol=0, atol=1e-9)
    moved = np.where(t < last, (6 * t / last - 4) / last, 0.0)
    np.testing.assert_allclose(found.control("a")(t), moved, rtol=0, atol=1e-6)


def regulator(*, weight: float = 1.0, bound: float | None = None) -> go.Problem:
    """Minimise the integral of weight (u - k)^2."""
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    k = model.parameter("k", 1.0)
    model.ode({x: u})
    problem, leg = one_phase("regulator", model, initial=0.0, final=2.0)
    leg.initial(x=1.0)
    leg.bounds(u=(-1.0, bound))
    problem.minimize(leg.integral(weight * (u - k) ** 2) + leg.final_state("x"))
    return problem


def test_weakly_active_bound_is_named() -> None:
    """The free optimum u = k - 1/2 lies exactly on the bound."""
    solution = solve(regulator(bound=0.5), "2x3")
    with pytest.warns(go.ProblemWarning, match=r"'u, phase leg, segment 1, point 1'.*weakly active"):
        go.sensitivity(solution, "k")


def test_undetermined_control_is_named() -> None:
    model = go.Model("two thrusters")
    x, u, w = model.state("x"), model.control("u"), model.control("w")
    k = model.parameter("k", 1.0)
    model.ode({x: k * (u + w)})
    problem, leg = one_phase("over-actuated", model, initial=0.0, final=1.0)
    leg.initial(x=1.0)
    leg.final(x=0.0)
    problem.minimize(leg.integral((u + w) ** 2))
    with pytest.raises(go.GncOptError, match=r"do not determine '[uw], phase leg, segment"):
        go.sensitivity(solve(problem, "3x3"), "k")


def test_singular_arc_is_named() -> None:
    model, x, _u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("singular", model, initial=0.0, final=2.0)
    leg.initial(x=1.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(x**2))
    solution = solve(problem, "20x4")
    with pytest.warns(go.ProblemWarning, match=r"control 'u' of 'singular' is singular at t = "):
        found = go.sensitivity(solution, initial="x")
    assert found.objective == pytest.approx(1.0, rel=1e-6)  # J = x^3 / 3


def test_mistakes() -> None:
    solution = solve(regulator(), "2x3")
    for arguments, message in (
        ({}, "needs one quantity, not 0"),
        ({"initial": "x", "time": "final"}, "needs one quantity, not 2"),
        ({"initial": "y"}, "no state 'y'"),
        ({"final": "x"}, "final value of 'x'.*is not fixed"),
        ({"time": "end"}, "no time 'end'"),
        ({"constraint": "c"}, "no boundary constraint 'c'"),
    ):
        with pytest.raises(go.ProblemError, match=message):
            go.sensitivity(solution, **arguments)
    with pytest.raises(go.ProblemError, match=r"no model parameter 'kk'.*did you mean 'k'"):
        go.sensitivity(solution, "kk")
    with pytest.raises(go.ProblemError, match="no control 'x'"):
        go.sensitivity(solution, "k").control("x")
    free = solve(brachistochrone(), "6x4")
    with pytest.raises(go.ProblemError, match=r"final time of phase 'leg'.*is optimised"):
        go.sensitivity(free, time="final")
