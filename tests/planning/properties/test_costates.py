"""Costates as derivatives of the optimal cost, and what they must not depend on."""

from __future__ import annotations

import numpy as np
import pytest
from testing.models import one_phase
from testing.nonlinear_problems import (
    PROBLEMS,
    SCHEMES,
    initial_costates,
    orbit_raising,
    relative_difference,
    reorientation,
    solve,
    van_der_pol,
)

import gnc_opt as go


@pytest.mark.parametrize(("name", "scheme"), [*zip(PROBLEMS, SCHEMES, strict=True)])
def test_costates_are_derivatives_of_the_optimal_cost(name: str, scheme: str) -> None:
    """lam(t0) = dJ*/dx0 by central differences of re-solved problems; of -J where J is maximised.

    Steps of 1e-4 leave h^2 / 6 times the third derivative, about 1e-8, and 1e-12 / h from the solver.
    """
    build, mesh = PROBLEMS[name]
    problem = build()
    solution = solve(problem, mesh, scheme)
    sign = -1.0 if solution.maximised else 1.0
    numbers = problem.get_phase().numbers.initial.lower
    step = 1e-4
    found = []
    for state in problem.get_phase().model.states.variables:
        place = problem.get_phase().model.states.slice(state.name)
        for i in range(state.size):
            costs = []
            for direction in (-1.0, 1.0):
                value = numbers[place].copy()
                value[i] += direction * step
                twin = problem.with_initial(**{state.name: value})
                costs.append(sign * solve(twin, mesh, scheme, guess=solution).objective)
            found.append((costs[1] - costs[0]) / (2 * step))
    assert relative_difference(initial_costates(solution), np.asarray(found)) < 1e-5


@pytest.mark.parametrize("scheme", ["LGR"])
def test_final_costates_are_derivatives_of_the_optimal_cost(scheme: str) -> None:
    """lam(tf) = -dJ*/dx_f where the final state is given."""
    problem, mesh = reorientation(), PROBLEMS["reorientation"][1]
    solution = solve(problem, mesh, scheme)
    step, found = 1e-4, []
    for i in range(3):
        costs = []
        for direction in (-1.0, 1.0):
            value = np.zeros(3)
            value[i] = direction * step
            costs.append(solve(problem.with_final(omega=value), mesh, scheme, guess=solution).objective)
        found.append(-(costs[1] - costs[0]) / (2 * step))
    final = solution.costate("omega")(solution.phase().final_time, "left")
    assert relative_difference(np.asarray(final), np.asarray(found)) < 1e-5


@pytest.mark.parametrize("scheme", ["LGL"])
def test_multipliers_are_derivatives_of_the_optimal_cost(scheme: str) -> None:
    """For a constraint c = b the multiplier is -dJ*/db, and H(tf) is dJ*/dtf; J is the minimised -r(tf)."""
    problem, mesh = orbit_raising(), PROBLEMS["orbit raising"][1]
    solution = solve(problem, mesh, scheme)
    step = 1e-4
    late, early = (
        -solve(problem.with_time(final=3.32 + d), mesh, scheme, guess=solution).objective
        for d in (step, -step)
    )
    end = solution.phase().final_time
    # On a mesh H varies a little (LGL: by 1e-3 here); its mean is what the discrete problem's derivative is.
    assert solution.hamiltonian(end, side="left") == pytest.approx((late - early) / (2 * step), rel=3e-3)
    more, less = (
        -solve(orbit_raising(circular=1 + d), mesh, scheme, guess=solution).objective for d in (step, -step)
    )
    assert solution.multiplier("circular") == pytest.approx(-(more - less) / (2 * step), rel=1e-5)


@pytest.mark.parametrize("factor", [1e4])
@pytest.mark.parametrize(("name", "variable"), [("van der Pol", "u"), ("reorientation", "omega")])
def test_scales_do_not_change_costates(name: str, variable: str, factor: float) -> None:
    """From the default guess, a scale that is wrong by 1e4 changes answers by less than 1e-6 (LG)."""
    build, mesh = PROBLEMS[name]
    assert_same(solve(build().with_scale(**{variable: factor}), mesh), solve(build(), mesh))


@pytest.mark.parametrize("factor", [1e-4])
@pytest.mark.parametrize("variable", ["r", "angle"])
def test_scales_do_not_change_costates_at_a_solution(variable: str, factor: float) -> None:
    """Orbit raising from its solution in other scales (from afar such scales can cost the convergence)."""
    build, mesh = PROBLEMS["orbit raising"]
    problem = build()
    usual = solve(problem, mesh)
    assert_same(solve(problem.with_scale(**{variable: factor}), mesh, guess=usual), usual)


def assert_same(odd: go.Solution, usual: go.Solution) -> None:
    """Fail where trajectories or costates differ by 1e-6, relative to the largest."""
    times = usual.phase().sample_times(4)
    assert odd.objective == pytest.approx(usual.objective, rel=1e-8)
    assert relative_difference(odd.phase().lam(times), usual.phase().lam(times)) < 1e-6
    assert relative_difference(odd.phase().x(times), usual.phase().x(times)) < 1e-6


@pytest.mark.parametrize("scheme", ["LG"])
@pytest.mark.parametrize("factor", [1e4])
def test_nominal_values_do_not_change_costates(factor: float, scheme: str) -> None:
    """The same through the model's nominal values, of all states at once."""

    def problem(nominal: float | None) -> go.Problem:
        model = go.Model("pendulum")
        angle = model.state("angle", nominal=nominal)
        rate = model.state("rate", nominal=nominal)
        torque = model.control("torque")
        model.ode({angle: rate, rate: torque - angle + angle**3 / 6})
        p, leg = one_phase("pendulum", model, initial=0.0, final=2.0)
        leg.initial(angle=1.0, rate=0.0)
        leg.final(angle=0.0, rate=0.0)
        p.minimize(leg.integral(torque**2 / 2))
        return p

    usual, odd = (solve(problem(nominal), go.Mesh.uniform(4, 5), scheme) for nominal in (None, factor))
    times = usual.phase().sample_times(4)
    assert relative_difference(odd.phase().lam(times), usual.phase().lam(times)) < 1e-6


@pytest.mark.parametrize("scheme", ["LGL"])
def test_units_of_a_state(scheme: str) -> None:
    """Counting x in thousandths makes x a thousand times larger and its costate a thousand times smaller."""
    mesh = PROBLEMS["van der Pol"][1]
    metres, millimetres = solve(van_der_pol(), mesh, scheme), solve(van_der_pol(unit=1000.0), mesh, scheme)
    times = np.linspace(0.0, 4.0, 33)
    assert millimetres.objective == pytest.approx(metres.objective, rel=1e-9)
    for name, factor in (("x", 1000.0), ("y", 1.0)):
        states = [s.state(name)(times) for s in (metres, millimetres)]
        costates = [s.costate(name)(times) for s in (metres, millimetres)]
        assert relative_difference(states[1], factor * states[0]) < 1e-7
        assert relative_difference(factor * costates[1], costates[0]) < 1e-7


@pytest.mark.parametrize("scheme", ["LG"])
def test_shift_of_time(scheme: str) -> None:
    """An autonomous problem does not know when it starts."""
    mesh = PROBLEMS["van der Pol"][1]
    now, later = solve(van_der_pol(), mesh, scheme), solve(van_der_pol(start=7.0), mesh, scheme)
    times = np.linspace(0.0, 4.0, 33)
    assert later.objective == pytest.approx(now.objective, rel=1e-10)
    for name in ("x", "y"):
        assert relative_difference(later.costate(name)(times + 7.0), now.costate(name)(times)) < 1e-8
    np.testing.assert_allclose(later.hamiltonian(times + 7.0), now.hamiltonian(times), atol=1e-7)


@pytest.mark.parametrize("scheme", ["LGR"])
def test_multiple_of_the_cost(scheme: str) -> None:
    """Costates, H and multipliers are proportional to the cost."""
    mesh = PROBLEMS["orbit raising"][1]
    small, large = (solve(orbit_raising(weight=weight), mesh, scheme) for weight in (1.0, 500.0))
    times = small.phase().sample_times(4)
    assert relative_difference(large.phase().lam(times), 500 * small.phase().lam(times)) < 1e-6
    assert large.multiplier("circular") == pytest.approx(500 * small.multiplier("circular"), rel=1e-7)
