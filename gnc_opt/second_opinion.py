"""A second opinion on a solution whose refinement does not come to rest.

A local minimum on a coarse mesh need not be one of the problem, and where refining it goes on without end it is a poor
one: it hugs bounds that finer meshes shift. Another barrier strategy takes another way from the same guess, for the
price of one coarse solve. Both answers are on the same mesh, so a clearly better one is no accident of the
discretisation; it is refined as well, and what is better and no less accurate is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from gnc_opt.nlp import SolverOptions
from gnc_opt.problem.problem import Problem
from gnc_opt.solution.solution import Solution

STRATEGY = "ipopt.mu_strategy"

CLEARLY = 1e-3
"""Relative gain in the objective on the same mesh that makes the other solution worth refining."""


def better_of_two(
    problem: Problem,
    first: Solution,
    refined: Solution,
    refine: Callable[[Solution], Solution],
    options: SolverOptions,
    common: Mapping[str, Any],
) -> Solution:
    """Return the refined solution, or one from another way through the iterates if that is better.

    Parameters
    ----------
    problem : Problem
    first, refined : Solution
        On the first mesh, and what came of it.
    refine : function
        Refines a solution as the first one was refined.
    options : SolverOptions
        Of the first solve; IPOPT's adaptive barrier takes the place of its monotone one.
    common : mapping
        Mesh and scheme of the first solve.
    """
    from gnc_opt.solve import solve

    if options.solver != "ipopt" or _chosen_by_user(options):
        return refined
    other = replace(options, extra={**options.extra, STRATEGY: "adaptive"})
    second = solve(problem, options=other, throw=False, **common)
    if not second.status.solved or _gain(first, second) < CLEARLY:
        return refined
    second = refine(second)
    return second if _gain(refined, second) > 0 and _as_accurate(second, refined) else refined


def at_rest(solution: Solution) -> bool:
    """Whether the refinement reached its tolerance."""
    return solution.history is not None and solution.history.converged


def _chosen_by_user(options: SolverOptions) -> bool:
    nested = options.extra.get("ipopt")
    return STRATEGY in options.extra or (isinstance(nested, Mapping) and "mu_strategy" in nested)


def _gain(old: Solution, new: Solution) -> float:
    """By how much the new objective is better, relative to the larger one."""
    size = max(abs(old.objective), abs(new.objective))
    gain = new.objective - old.objective if new.maximised else old.objective - new.objective
    return gain / size if size > 0 else 0.0


def _as_accurate(new: Solution, old: Solution) -> bool:
    if at_rest(new):
        return True
    assert new.history is not None and old.history is not None, "both have just been refined"
    return new.history.final.error <= old.history.final.error
