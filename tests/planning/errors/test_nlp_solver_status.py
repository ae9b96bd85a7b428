"""How solves end that end badly: the right status, the culprit by name, and an iterate to look at."""

from __future__ import annotations

import itertools
import signal
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing import ill_posed_problems as ill_posed
from testing.models import dynamics, one_phase
from testing.wrong_arguments import refused, rest_to_rest

import gnc_opt as go

SCHEMES = ("LG", "LGR", "LGL")
Build = Callable[[], go.Problem]


def ended(build: Build, scheme: str = "LG", **options: object) -> go.Solution:
    """Solve without raising."""
    chosen = go.SolverOptions(**options)  # type: ignore[arg-type]
    return go.solve(build(), mesh="10x3", scheme=scheme, options=chosen, throw=False, tol=None)  # type: ignore[arg-type]


@pytest.mark.parametrize("scheme", ["LG"])
@pytest.mark.parametrize(
    ("build", "status", "culprit"),
    [
        (ill_posed.too_little_time, go.Status.INFEASIBLE, "q defect, phase leg, segment"),
        (ill_posed.windows_apart, go.Status.INFEASIBLE, "constraint link_"),
        (ill_posed.overdetermined, go.Status.INFEASIBLE, "x defect, phase leg, segment 10"),
        (ill_posed.path_out_of_reach, go.Status.INFEASIBLE, "path ceiling, phase leg, segment"),
        (ill_posed.free_ride, go.Status.UNBOUNDED, "u, phase leg, segment 10"),
        (ill_posed.concave, go.Status.UNBOUNDED, "u, phase leg, segment"),
        (ill_posed.endless, go.Status.UNBOUNDED, "final time, phase leg diverges"),
        (
            ill_posed.root_of_clipped_state,
            go.Status.NOT_A_NUMBER,
            "the rate of state 'x' with respect to 'x' is nan",
        ),
        (
            ill_posed.clipped_cost,
            go.Status.NOT_A_NUMBER,
            "integral 'loss' with respect to 'x' is nan, phase leg, t = ",
        ),
    ],
)
def test_status_and_cause(build: Build, status: go.Status, culprit: str, scheme: str) -> None:
    problem = build()
    with pytest.raises(go.SolveError) as caught:
        go.solve(problem, mesh="10x3", scheme=scheme, tol=None)  # type: ignore[arg-type]
    message, solution = str(caught.value), caught.value.solution
    assert solution.status is status
    assert f"no solution of '{problem.name}'" in message and f"status {status.value}" in message
    assert culprit in message and status.remedy in message.replace("\n* ", " ")
    assert culprit in solution.violations[0].name
    assert all(line.startswith("* ") for line in message.splitlines()[1:])


@pytest.mark.parametrize(
    "build", [ill_posed.too_little_time, ill_posed.free_ride, ill_posed.root_of_clipped_state]
)
def test_the_iterate_of_a_failed_solve_can_be_looked_at(build: Build) -> None:
    solution = ended(build)
    phase = solution.phase()
    times = np.linspace(phase.initial_time, phase.final_time, 5)
    for name in phase.states.names:
        assert np.all(np.isfinite(solution.state(name)(times)))
    assert np.isfinite(solution.objective)
    text = str(solution)
    assert "NOT SOLVED" in text and solution.violations[0].name in text
    assert not go.verify(solution).ok


@pytest.mark.slow
def test_violations_are_sorted_and_true() -> None:
    solution = go.solve(ill_posed.windows_apart(), mesh="3x3", throw=False, tol=None)
    amounts = [v.amount for v in solution.violations]
    assert amounts == sorted(amounts, reverse=True) and amounts[0] > 0
    legs = [solution.phase(name) for name in ("first", "middle", "last")]
    gaps = [after.initial_time - before.final_time for before, after in itertools.pairwise(legs)]
    assert sum(gaps) == pytest.approx(0.5, abs=1e-6)  # the least that the windows leave


@pytest.mark.slow
def test_slow_growth_counts_as_unbounded() -> None:
    """The objective of this one never gets large, so only its variables tell."""
    solution = go.solve(ill_posed.slowly_growing(), mesh="2x2", throw=False, tol=None)
    assert solution.status is go.Status.UNBOUNDED
    assert "diverges" in solution.violations[0].name


def test_solved_problems_have_no_violations() -> None:
    solution = go.solve(rest_to_rest()[0], mesh="4x3", tol=None)
    assert solution.status is go.Status.OPTIMAL and solution.violations == ()


def test_iteration_limit() -> None:
    solution = ended(lambda: rest_to_rest()[0], max_iterations=1)
    assert solution.status is go.Status.ITERATION_LIMIT and solution.statistics.iterations == 1
    with pytest.raises(
        go.SolveError, match=r"(?s)after 1 iterations, status iteration_limit; .*raise `max_iterations`"
    ):
        go.solve(rest_to_rest()[0], mesh="10x3", options=go.SolverOptions(max_iterations=1), tol=None)


def test_mistakes_that_are_found_before_the_solver_starts_refused() -> None:
    problem = ill_posed.free_ride().with_bounds(x=(0.0, 0.5))
    with refused(go.ProblemError, "initial value of 'x' in phase 'leg'", "is 1", "bounds [0, 0.5]"):
        go.solve(problem, tol=None)

    model = go.Model("m")
    x, u, k = model.state("x"), model.control("u"), ca.SX.sym("k")
    with refused(go.ModelError, "state 'x'", "uses 'k'", "not a symbol of this model", "known: x, u"):
        model.ode({x: u - k * x})

    problem = ill_posed.undefined_at_guess()
    with refused(
        go.ProblemError, "rate of state 'x' is nan", "phase 'leg'", "t = 0.0", "x = -0.9", "guess()"
    ):
        go.solve(problem, tol=None)


def test_nan_at_the_guess_is_repaired_by_another_guess() -> None:
    problem = ill_posed.undefined_at_guess().with_guess(x=(1.0, 0.5))
    # Collocation with 30 points of a smooth problem: error far below 1e-8.
    assert go.solve(problem, mesh="10x3", tol=None).objective == pytest.approx(
        0.5 * np.log(2.0) ** 2, abs=1e-8
    )


@pytest.mark.parametrize("mesh", ["5x5"])
@pytest.mark.parametrize(("cost", "scheme"), [*zip(["time", "both", "both"], SCHEMES, strict=True)])
def test_vanishing_phase(mesh: str, scheme: str, cost: str) -> None:
    """A duration t moves q by t^2/4 only, less than tolerances see: rounding decides how near to 0 the solver gets."""
    problem = ill_posed.going_nowhere(cost)
    solution = go.solve(problem, mesh=mesh, scheme=scheme, tol=None)  # type: ignore[arg-type]
    assert 0.0 <= solution.objective < 2e-5
    assert 0.0 <= solution.phase().duration < 2e-5
    assert solution.state("q")(0.0) == pytest.approx(1.0, abs=1e-9)
    assert solution.state("q")(solution.phase().final_time) == pytest.approx(1.0, abs=1e-9)
    assert np.isfinite(solution.hamiltonian(0.0)) and np.isfinite(solution.accuracy.defect)
    assert -1.0 <= solution.saturated_control("a")(0.0) <= 1.0  # type: ignore[operator]
    assert "solved" in str(solution) and len(go.verify(solution).conditions) > 0


def test_a_linear_solver_that_is_not_installed_is_named() -> None:
    with pytest.raises(go.SolveError) as raised:
        go.solve(rest_to_rest()[0], mesh="4x3", options=go.SolverOptions(linear_solver="ma86"))
    text = str(raised.value)
    assert text.startswith(
        "linear solver 'ma86' is not installed, or IPOPT rejects an option: no solution of"
    )
    assert "defect" not in text and raised.value.solution.violations == ()


def test_vanishing_phase_of_exactly_no_duration() -> None:
    """The final time may sit on its bound to the last bit, and late, where seconds have few digits left."""
    problem = ill_posed.going_nowhere(start=1e6)
    options = go.SolverOptions(tolerance=1e-9)  # a time has 1e-10 of a second
    solution = go.solve(problem, mesh="40x4", tol=None, options=options)
    assert 0.0 <= solution.phase().duration < 1e-3
    assert np.all(np.diff(solution.phase().breaks) > 0)
    assert np.isfinite(solution.state("q")(solution.phase().final_time))


def endless_work() -> go.Problem:
    """A problem that keeps the solver busy for thousands of iterations."""
    return ill_posed.slowly_growing()


def test_wall_time_limit_returns_the_iterate() -> None:
    options = go.SolverOptions(max_wall_time=1e-3, max_iterations=100_000)
    solution = go.solve(
        endless_work(), mesh="20x3", options=options, tol=None
    )  # throw=True, and yet it does not
    assert solution.status is go.Status.INTERRUPTED
    assert np.isfinite(solution.objective) and "NOT SOLVED" in str(solution)


def test_ctrl_c_returns_the_iterate(ctrl_c_when: Any) -> None:
    before = signal.getsignal(signal.SIGINT)
    ctrl_c_when(lambda: signal.getsignal(signal.SIGINT) is not before)  # the solver has taken over
    solution = go.solve(
        endless_work(), mesh="20x3", options=go.SolverOptions(max_iterations=100_000), tol=None
    )
    assert solution.status is go.Status.INTERRUPTED
    assert signal.getsignal(signal.SIGINT) is before
    assert np.all(np.isfinite(solution.state("x")(np.linspace(0.0, 1.0, 5))))


def test_an_interrupted_iterate_serves_as_a_guess() -> None:
    problem, _ = rest_to_rest()
    stopped = go.solve(
        problem, mesh="10x3", options=go.SolverOptions(max_iterations=1), throw=False, tol=None
    )
    finished = go.solve(problem, mesh="10x3", guess=stopped)
    assert finished.objective == pytest.approx(12.0, abs=1e-6)  # 12 d^2 / T^3


def circle(times: np.ndarray | None = None, speed: float | None = None) -> go.Problem:
    """A satellite that has no time for its orbit, its velocity inconclusive."""
    model, _r, v, a = dynamics("satellite", "r:2 v:2", "a:2", lambda r, v, a: {r: v, v: a})
    problem, leg = one_phase("circle", model, initial=0.0, final=1.0)
    leg.initial(r=[1.0, 0.0])
    leg.final(r=[-1.0, 0.0])
    leg.path("slow", ca.dot(v, v), upper=0.01)
    problem.minimize(leg.integral(ca.dot(a, a)))
    if times is not None:
        problem = problem.with_guess("leg", times, r=np.zeros((2, times.size)))
    return problem if speed is None else problem.with_guess("leg", v=[0.0, speed])


@pytest.mark.slow
def test_the_guess_that_helps_is_named() -> None:
    """Which kind, and the states of which no number tells the size; not beside a trajectory, which is the user's."""
    with pytest.raises(
        go.SolveError,
        match=r"\* .*go\.guess_from_simulation\(\), waypoints .* polar .*\n\* Start with 'v', whose",
    ):
        go.solve(circle(), mesh="4x3", tol=None)
    with pytest.raises(go.SolveError, match=r"guess_from_simulation") as told:
        go.solve(circle(speed=1.0), mesh="4x3", tol=None)
    assert "* Start with" not in str(told.value)
    with pytest.raises(go.SolveError) as own:
        go.solve(circle(np.linspace(0.0, 1.0, 5)), mesh="4x3", tol=None)
    assert "guess_from_simulation" not in str(own.value)
