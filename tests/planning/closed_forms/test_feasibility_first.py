"""Problems whose default guess leads into an infeasible corner: constraints first, cost afterwards.

The oscillator x'' = -x + u, |u| <= 1, brought to rest in minimum time is the classic one (Pontryagin et al., The
Mathematical Theory of Optimal Processes, 1962, section 5): bang-bang, with switches exactly pi apart.
"""

from __future__ import annotations

import cmath
import itertools

import numpy as np
import pytest
from scipy.optimize import brentq
from testing.internals import (
    DEFAULT_MESH,
    FIXED_TIME_FACTORS,
    build_nlp_point_from_guess,
    generate_feasibility_initial_points,
    has_trajectory_guess,
    transcribe_problem,
)
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning import Status


def oscillator(displacement: float, final: tuple[float, float | None] = (0.1, None)) -> go.Problem:
    """Bring x'' = -x + u, |u| <= 1, from (displacement, 0) to rest in minimum time."""
    model, *_ = dynamics("oscillator", "x v", "u", lambda x, v, u: {x: v, v: -x + u})
    problem, leg = one_phase("oscillator", model, initial=0.0, final=final)
    leg.initial(x=displacement, v=0.0)
    leg.final(x=0.0, v=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    return problem


def minimum_time(displacement: float) -> float:
    """The least time over all controls of +1 and -1 that switch pi apart.

    With z = x + i v, z - u turns clockwise at 1 rad/s. After a first arc and m arcs of length pi, the last arc must
    lie on the unit circle around its u that leads through the origin.
    """
    times = []
    for sign, m in itertools.product((-1.0, 1.0), range(int(displacement) + 2)):

        def last(first: float, sign: float = sign, m: int = m) -> tuple[complex, float]:
            z, u = sign + (displacement - sign) * cmath.exp(-1j * first), sign
            for _ in range(m):
                u = -u
                z = 2 * u - z
            return z, -u

        def miss(first: float) -> float:
            z, u = last(first)
            return abs(z - u) - 1.0

        grid = np.linspace(0.0, np.pi, 400)
        values = [miss(t) for t in grid]
        firsts = [t for t, value in zip(grid, values, strict=True) if abs(value) < 1e-12]
        firsts += [
            float(brentq(miss, grid[j], grid[j + 1], xtol=1e-15))
            for j in range(grid.size - 1)
            if values[j] * values[j + 1] < 0
        ]
        for first in firsts:
            z, u = last(first)
            angle = cmath.phase((z - u) / (0.0 - u)) % (2 * np.pi)
            angle = 0.0 if angle > 2 * np.pi - 1e-9 else angle
            if angle <= np.pi + 1e-9:
                times.append(first + m * np.pi + angle)
    return min(times)


@pytest.mark.parametrize(("displacement", "half_turns"), [(2.0, 1), (4.0, 2), (8.0, 4)])
def test_theory_even_displacements_take_half_turns(displacement: float, half_turns: int) -> None:
    """From 2 n each half turn about -1 or +1 takes 2 off the displacement: t = n pi."""
    assert minimum_time(displacement) == pytest.approx(half_turns * np.pi, rel=1e-7)


@pytest.mark.parametrize(("displacement", "final"), [(3.0, (0.1, 50.0)), (15.0, (0.1, None))])
def test_oscillator_from_the_default_guess(displacement: float, final: tuple[float, float | None]) -> None:
    """20 x 4 points meet switches within a cell, and only feasible controls: a little slower than the optimum."""
    solution = go.solve(oscillator(displacement, final), tol=None)
    assert solution.status is Status.OPTIMAL
    exact = minimum_time(displacement)
    assert exact * (1 - 1e-9) < solution.objective < 1.01 * exact


@pytest.mark.slow
def test_oscillator_refined() -> None:
    """Switch times become variables: the minimum time to many digits, and the verdict holds."""
    solution = go.solve(oscillator(5.0), tol=1e-8)
    assert solution.objective == pytest.approx(minimum_time(5.0), rel=1e-8)
    assert solution.structure is not None
    switches = sorted({arc.end for arc in solution.structure})[:-1]
    np.testing.assert_allclose(np.diff(switches), np.pi, rtol=1e-6)
    assert go.verify(solution).ok


@pytest.mark.slow
def test_too_little_time_is_still_infeasible() -> None:
    """A displacement of 5 needs 7.9 s; the violation is that of the first attempt, its effort that of all."""
    problem = oscillator(5.0, (0.1, 7.0))
    with pytest.raises(go.SolveError, match="no point satisfies all constraints") as raised:
        go.solve(problem, tol=None)
    failed = raised.value.solution
    assert failed.status is Status.INFEASIBLE and failed.violations
    text = str(go.verify(failed))
    assert text.startswith("no solution, status infeasible: ") and "Refine the mesh" not in text
    once = go.solve(problem, guess=failed, throw=False, check=False)  # from a given trajectory only
    assert failed.statistics.iterations > once.statistics.iterations


def test_starts_hold_times_at_multiples_of_the_guess() -> None:
    problem = oscillator(5.0, (0.1, 50.0))
    transcription = transcribe_problem(problem, {"leg": DEFAULT_MESH}, "LG")
    start = build_nlp_point_from_guess(transcription, problem)
    starts = list(generate_feasibility_initial_points(transcription, problem, start))
    times = [float(variables[held[0]]) for variables, held in starts if held.size]
    guess = 0.5 * (0.1 + 50.0)
    assert times == pytest.approx([guess, 50.0]), "longer ones are all clipped to the bound, and tried once"
    assert len(starts) == 1 + len(times) + 2, "free times, held ones, two random ones"
    boxless = oscillator(5.0)
    transcription = transcribe_problem(boxless, {"leg": DEFAULT_MESH}, "LG")
    start = build_nlp_point_from_guess(transcription, boxless)
    starts = list(generate_feasibility_initial_points(transcription, boxless, start))
    times = [float(variables[held[0]]) for variables, held in starts if held.size]
    assert times == pytest.approx(FIXED_TIME_FACTORS), "of 1 s, the default duration"


def test_a_guessed_trajectory_is_the_users_own() -> None:
    """End values and constants are no trajectory; functions and tables are, and their failure is reported at once."""
    problem = oscillator(5.0)
    times = np.linspace(0.0, 3.0, 5)
    assert not has_trajectory_guess(problem)
    assert not has_trajectory_guess(problem.with_guess("leg", time=(0.0, 3.0), x=(5.0, 0.0), u=0.0))
    assert has_trajectory_guess(problem.with_guess("leg", x=lambda t: 5.0 - t))
    assert has_trajectory_guess(problem.with_guess("leg", time=times, x=5.0 - times))
