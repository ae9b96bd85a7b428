"""Mistakes in the call of solve: meshes, schemes, options, guesses."""

from __future__ import annotations

import pytest
from testing.wrong_arguments import cart, mistake, rest_to_rest, scalar

import gnc_opt as go


@mistake(go.ArgumentError, "solve()", "Model", "solve(problem)")
def test_solve_of_a_model() -> None:
    go.solve(cart(), tol=None)  # type: ignore[arg-type]  # wrong


@mistake(go.ArgumentError, "solve()", "Solution", "solution.problem")
def test_solve_of_a_solution(solved: go.Solution | None = None) -> None:
    solution = go.solve(rest_to_rest()[0], mesh="2x3", tol=None)
    go.solve(solution, tol=None)  # type: ignore[arg-type]  # wrong


# --- meshes and schemes -----------------------------------------------------------------------------------


@mistake(go.ProblemError, "mesh '20 by 3'", "20x3")
def test_mesh_text_that_is_not_understood() -> None:
    go.solve(rest_to_rest()[0], mesh="20 by 3", tol=None)  # wrong


@mistake(go.ProblemError, "20 is not a mesh", "Mesh.uniform(20, 3)")
def test_number_as_mesh() -> None:
    go.solve(rest_to_rest()[0], mesh=20, tol=None)  # type: ignore[arg-type]  # wrong


@mistake(go.ProblemError, "number of segments of a mesh is 0", ">= 1")
def test_mesh_without_segments() -> None:
    go.solve(rest_to_rest()[0], mesh="0x3", tol=None)  # wrong


@mistake(go.ProblemError, "degrees of a mesh", "0", "integers >= 1")
def test_mesh_without_points() -> None:
    go.solve(rest_to_rest()[0], mesh="4x0", tol=None)  # wrong


@mistake(go.ArgumentError, "LGL has no rule with 1 points", "from 2 to 64")
def test_too_few_points_for_the_scheme() -> None:
    go.solve(rest_to_rest()[0], mesh="4x1", scheme="LGL", tol=None)  # wrong


@mistake(go.ArgumentError, "LG has no rule with 65 points", "more segments")
def test_too_many_points() -> None:
    go.solve(rest_to_rest()[0], mesh="1x65", tol=None)  # wrong


@mistake(go.ProblemError, "breaks of a mesh", "increase")
def test_mesh_breaks_that_cross() -> None:
    go.Mesh((0.0, 0.7, 0.4, 1.0), (3, 3, 3))  # wrong


@mistake(go.ProblemError, "breaks of a mesh run from 0 to 10", "fractions from 0 to 1")
def test_mesh_breaks_that_are_times() -> None:
    go.Mesh((0.0, 5.0, 10.0), (3, 3))  # wrong


@mistake(go.ProblemError, "2 segments, but 3 degrees", "one each")
def test_mesh_with_the_wrong_number_of_degrees() -> None:
    go.Mesh((0.0, 0.5, 1.0), (3, 3, 3))  # wrong


@mistake(go.ProblemError, "times of a mesh", "increasing")
def test_mesh_times_that_go_back() -> None:
    go.Mesh.at_times([0.0, 2.0, 1.0, 3.0], 3)  # wrong


@mistake(go.UnknownNameError, "mesh of problem 'rest to rest' has no phase 'lag'", "did you mean 'leg'?")
def test_mesh_for_an_unknown_phase() -> None:
    go.solve(rest_to_rest()[0], mesh={"leg": "2x3", "lag": "2x3"}, tol=None)  # wrong


@mistake(go.ProblemError, "mesh of problem 'rest to rest' lacks phase 'leg'", "every phase")
def test_mesh_that_lacks_a_phase() -> None:
    go.solve(rest_to_rest()[0], mesh={}, tol=None)  # wrong


@mistake(go.ArgumentError, "unknown scheme 'radau'", "did you mean 'LGR'?")
def test_unknown_scheme() -> None:
    go.solve(rest_to_rest()[0], scheme="radau", tol=None)  # type: ignore[arg-type]  # wrong


# --- solver options ---------------------------------------------------------------------------------------


@mistake(go.UnknownNameError, "no solver 'ipotp'", "did you mean 'ipopt'?")
def test_unknown_solver() -> None:
    go.SolverOptions(solver="ipotp")  # wrong


@mistake(go.UnknownNameError, "IPOPT has no linear_solver 'mump'", "did you mean 'mumps'?")
def test_unknown_linear_solver() -> None:
    go.SolverOptions(linear_solver="mump")  # wrong


@mistake(go.ArgumentError, "tolerance is -1e-09", "> 0")
def test_negative_tolerance() -> None:
    go.SolverOptions(tolerance=-1e-9)  # wrong


@mistake(go.ArgumentError, "max_iterations is 10.5", "integer")
def test_broken_number_of_iterations() -> None:
    go.SolverOptions(max_iterations=10.5)  # type: ignore[arg-type]  # wrong


@mistake(go.ArgumentError, "max_wall_time is '1 min'", "finite number > 0")
def test_text_as_time_limit() -> None:
    go.SolverOptions(max_wall_time="1 min")  # type: ignore[arg-type]  # wrong


@mistake(go.ArgumentError, "options of solve()", "dict", "SolverOptions(tolerance=1e-9)")
def test_options_as_a_dictionary() -> None:
    go.solve(rest_to_rest()[0], options={"tolerance": 1e-9}, tol=None)  # type: ignore[arg-type]  # wrong


def test_unknown_option_of_the_solver_is_named() -> None:
    options = go.SolverOptions(extra={"ipopt.max_itre": 5})
    with pytest.raises(go.ArgumentError, match="max_itre"):
        go.solve(rest_to_rest()[0], mesh="2x3", options=options, tol=None)


# --- guesses from solutions -------------------------------------------------------------------------------


@mistake(go.ArgumentError, "guess of solve()", "Problem", "with_guess")
def test_problem_as_guess() -> None:
    problem, _ = rest_to_rest()
    go.solve(problem, guess=problem)  # type: ignore[arg-type]  # wrong


@mistake(go.ProblemError, "guess for phase 'leg' of problem 'decay'", "states ['q', 'v']", "['x']")
def test_guess_with_other_states() -> None:
    old = go.solve(rest_to_rest()[0], mesh="2x3", tol=None)
    model, problem, leg = scalar()
    problem.minimize(leg.integral(model.symbol("u") ** 2))
    go.solve(problem, guess=old)  # wrong


@mistake(go.ProblemError, "guess has no phase 'way'", "'leg'")
def test_guess_with_other_phases() -> None:
    old = go.solve(rest_to_rest()[0], mesh="2x3", tol=None)
    problem, model = go.Problem("p"), cart()
    way = problem.phase("way", model)
    way.time(0.0, 1.0)
    problem.minimize(way.integral(model.symbol("a") ** 2))
    go.solve(problem, guess=old, mesh="2x3")  # wrong
