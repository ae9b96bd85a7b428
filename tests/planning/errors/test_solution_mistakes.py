"""Mistakes in asking a solution: unknown names, times outside its span."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from testing.wrong_arguments import assert_clear, refused, rest_to_rest, ship

import gnc_opt as go


@cache
def solution() -> go.Solution:
    problem, leg = rest_to_rest()
    problem.parameter("reach", lower=0.5, upper=2.0)
    problem.constrain("meet", leg.final_state("q") - problem.parameter_symbols(), upper=0.0)
    return go.solve(problem, mesh="2x3", tol=None)


@pytest.mark.parametrize(
    ("ask", "fragments"),
    [
        (lambda s: s.state("vv"), ("model 'cart'", "no state 'vv'", "did you mean 'v'?")),
        (lambda s: s.costate("a"), ("model 'cart'", "no state 'a'", "known: q, v")),
        (lambda s: s.control("aa"), ("model 'cart'", "no control 'aa'", "did you mean 'a'?")),
        (lambda s: s.switching_function("q", 0.5), ("no control 'q'", "known: a")),
        (lambda s: s.phase("lag"), ("solution of 'rest to rest'", "no phase 'lag'", "did you mean 'leg'?")),
        (lambda s: s.state("q", "lag"), ("no phase 'lag'", "did you mean 'leg'?")),
        (lambda s: s.parameter("rech"), ("no parameter 'rech'", "did you mean 'reach'?")),
        (lambda s: s.multiplier("met"), ("no boundary constraint 'met'", "did you mean 'meet'?")),
        (
            lambda s: s.phase().integral("efort"),
            ("phase 'leg'", "no integral 'efort'", "did you mean 'effort'?"),
        ),
        (lambda s: s.evaluate("speed", 0.5), ("model 'cart' has no output 'speed'", "none is declared")),
    ],
)
def test_unknown_names(ask: Callable[[go.Solution], object], fragments: tuple[str, ...]) -> None:
    with pytest.raises(go.UnknownNameError) as caught:
        ask(solution())
    assert_clear(str(caught.value), *fragments)


@pytest.mark.parametrize("t", [-0.1, 1.1, np.nan, [0.5, 2.0]])
@pytest.mark.parametrize(
    "ask",
    [
        lambda s, t: s.state("q")(t),
        lambda s, t: s.costate("v")(t),
        lambda s, t: s.control("a")(t),
        lambda s, t: s.saturated_control("a")(t),
        lambda s, t: s.hamiltonian(t),
        lambda s, t: s.switching_function("a", t),
        lambda s, t: s.evaluate(s.problem.phases["leg"].model.symbol("q"), t),
    ],
)
def test_times_outside_the_span(ask: Callable[[go.Solution, object], object], t: object) -> None:
    with pytest.raises(go.ArgumentError) as caught:
        ask(solution(), t)
    assert_clear(
        str(caught.value), f"time {np.atleast_1d(t)[-1]} is", "outside the span 0.0 to 1.0 of", "choose"
    )


def test_solution_mistakes() -> None:
    state = solution().state("q")
    with refused(go.ArgumentError, "the time is 'noon'", "not a number"):
        state("noon")
    with refused(go.ArgumentError, "side", "'middle'", "'left' or 'right'"):
        state(0.5, "middle")

    solved = solution()
    with refused(go.ProblemError, "expression to evaluate", "'w_0'", "model 'cart'"):
        solved.evaluate(ship().symbol("w")[0], 0.5)

    solved, (other, _) = solution(), rest_to_rest(time=2.0)
    with refused(go.ProblemError, "not the one that this solution", "same options"):
        solved.with_problem(other)

    solved = solution()
    with refused(go.ArgumentError, "with_problem()", "Solution", "problem that was solved"):
        solved.with_problem(solved)
