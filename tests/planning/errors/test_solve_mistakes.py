"""Mistakes in the call of solve: meshes, schemes, options, guesses."""

from __future__ import annotations

import pytest
from testing.wrong_arguments import cart, refused, rest_to_rest, scalar

import gnc_opt as go


def test_only_problems_are_solved() -> None:
    with refused(go.ArgumentError, "solve()", "Model", "solve(problem)"):
        go.solve(cart(), tol=None)
    solution = go.solve(rest_to_rest()[0], mesh="2x3", tol=None)
    with refused(go.ArgumentError, "solve()", "Solution", "solution.problem"):
        go.solve(solution, tol=None)


def test_meshes_and_schemes_refused() -> None:
    with refused(go.ProblemError, "mesh '20 by 3'", "20x3"):
        go.solve(rest_to_rest()[0], mesh="20 by 3", tol=None)
    with refused(go.ProblemError, "20 is not a mesh", "Mesh.uniform(20, 3)"):
        go.solve(rest_to_rest()[0], mesh=20, tol=None)
    with refused(go.ProblemError, "number of segments of a mesh is 0", ">= 1"):
        go.solve(rest_to_rest()[0], mesh="0x3", tol=None)
    with refused(go.ArgumentError, "LGL has no rule with 1 points", "from 2 to 64"):
        go.solve(rest_to_rest()[0], mesh="4x1", scheme="LGL", tol=None)
    with refused(
        go.UnknownNameError, "mesh of problem 'rest to rest' has no phase 'lag'", "did you mean 'leg'?"
    ):
        go.solve(rest_to_rest()[0], mesh={"leg": "2x3", "lag": "2x3"}, tol=None)
    with refused(go.ProblemError, "mesh of problem 'rest to rest' lacks phase 'leg'", "every phase"):
        go.solve(rest_to_rest()[0], mesh={}, tol=None)
    with refused(go.ArgumentError, "unknown scheme 'radau'", "did you mean 'LGR'?"):
        go.solve(rest_to_rest()[0], scheme="radau", tol=None)


def test_solver_options_refused() -> None:
    with refused(go.UnknownNameError, "no solver 'ipotp'", "did you mean 'ipopt'?"):
        go.SolverOptions(solver="ipotp")
    with refused(go.UnknownNameError, "IPOPT has no linear_solver 'mump'", "did you mean 'mumps'?"):
        go.SolverOptions(linear_solver="mump")
    with refused(go.ArgumentError, "tolerance is -1e-09", "> 0"):
        go.SolverOptions(tolerance=-1e-9)
    with refused(go.ArgumentError, "max_iterations is 10.5", "integer"):
        go.SolverOptions(max_iterations=10.5)
    with refused(go.ArgumentError, "max_wall_time is '1 min'", "finite number > 0"):
        go.SolverOptions(max_wall_time="1 min")
    with refused(go.ArgumentError, "options of solve()", "dict", "SolverOptions(tolerance=1e-9)"):
        go.solve(rest_to_rest()[0], options={"tolerance": 1e-9}, tol=None)


def test_unknown_option_of_the_solver_is_named() -> None:
    options = go.SolverOptions(extra={"ipopt.max_itre": 5})
    with pytest.raises(go.ArgumentError, match="max_itre"):
        go.solve(rest_to_rest()[0], mesh="2x3", options=options, tol=None)


def test_guesses_from_solutions_refused() -> None:
    problem, _ = rest_to_rest()
    with refused(go.ArgumentError, "guess of solve()", "Problem", "with_guess"):
        go.solve(problem, guess=problem)

    old = go.solve(rest_to_rest()[0], mesh="2x3", tol=None)
    model, problem, leg = scalar()
    problem.minimize(leg.integral(model.symbol("u") ** 2))
    with refused(go.ProblemError, "guess for phase 'leg' of problem 'decay'", "states ['q', 'v']", "['x']"):
        go.solve(problem, guess=old)

    old = go.solve(rest_to_rest()[0], mesh="2x3", tol=None)
    problem, model = go.Problem("p"), cart()
    way = problem.phase("way", model)
    way.time(0.0, 1.0)
    problem.minimize(way.integral(model.symbol("a") ** 2))
    with refused(go.ProblemError, "guess has no phase 'way'", "'leg'"):
        go.solve(problem, guess=old, mesh="2x3")
