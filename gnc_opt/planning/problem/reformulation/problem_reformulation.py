"""Reformulation of a problem: norms, kinks, and redundant bounds."""

from __future__ import annotations

from functools import partial
from typing import Any, TypeVar

import numpy as np

from gnc_opt.model.casadi_expression_graph import collect_casadi_operation_codes
from gnc_opt.planning.problem.interval_arithmetic import SymbolRanges
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem_definition import ProblemData
from gnc_opt.planning.problem.redundant_bounds import (
    find_bounds_not_implied_by_norm,
    remove_redundant_control_bounds,
)
from gnc_opt.planning.problem.reformulation.control_splitting import ControlKinks
from gnc_opt.planning.problem.reformulation.epigraph import (
    KINKED,
    EndpointEpigraph,
    KinkedTerms,
    has_kinks_in_endpoint_functions,
)
from gnc_opt.planning.problem.reformulation.vector_norm_reformulation import (
    find_norm_substitution,
    remove_square_roots_from_norms,
)
from gnc_opt.planning.problem.symbolic_expressions import stack_phase_expressions

P = TypeVar("P", bound=ProblemData)


def reformulate_problem(problem: P) -> P:
    """Return the problem in the form that is solved, with the same states, costates and cost; possibly unchanged.

    Variations of a problem with other numbers have reformulations that are variations of one another.
    """
    problem = _reformulate_norms_and_kinks(problem)
    relaxed = {name: remove_redundant_control_bounds(problem, p) for name, p in problem.phases.items()}
    if all(numbers is problem.phases[name].numbers for name, numbers in relaxed.items()):
        return problem
    reformulated = problem.clone()
    for name, numbers in relaxed.items():
        reformulated.phases[name].numbers = numbers
    return reformulated


def _reformulate_norms_and_kinks(problem: P) -> P:
    kinked_ends = has_kinks_in_endpoint_functions(problem)
    if not kinked_ends and all(phase.numbers.arcs is not None for phase in problem.phases.values()):
        return problem
    reformulated, keys = problem.clone(), []
    for phase in reformulated.phases.values():
        rootless = problem.memoize(("rootless", phase.name), partial(remove_square_roots_from_norms, phase))
        phase.paths |= rootless
        box = find_bounds_not_implied_by_norm(problem, phase)
        signs, free = np.sign(phase.numbers.controls.lower), np.isinf(box.lower) & np.isinf(box.upper)
        key: tuple[Any, ...] = (phase.name, np.concatenate([signs, free]).tobytes(), *rootless)
        while (form := problem.memoize(("form", *key), partial(find_norm_substitution, phase))) is not None:
            key = (*key, *form.names, *form.reformulate_phase(problem, phase))
        for kind in (ControlKinks, KinkedTerms):
            key = _reformulate_nonsmooth_terms(problem, phase, key, kind)
        keys.append(key)
    ends: tuple[Any, ...] = ()
    if kinked_ends:
        domain = SymbolRanges.collect_boundary_variable_ranges(problem)
        at_ends = problem.memoize(
            ("ends", domain.cache_key), lambda: EndpointEpigraph.from_problem(problem, domain)
        )
        if at_ends.texts:
            at_ends.reformulate_endpoint_functions(reformulated)
            ends = at_ends.cache_key
    if all(len(key) == 2 for key in keys) and not ends:
        return problem
    reformulated.builds = problem.builds.setdefault(("restated", *keys, *ends), {})
    return reformulated


def _reformulate_nonsmooth_terms(
    problem: ProblemData,
    phase: Phase,
    key: tuple[Any, ...],
    kind: type[ControlKinks | KinkedTerms],
) -> tuple[Any, ...]:
    """Reformulate terms of one kind in a phase; return the key that identifies the form."""
    place = ("operations", *key)
    codes = problem.memoize(place, lambda: collect_casadi_operation_codes(stack_phase_expressions(phase)))
    if not codes & {*KINKED}:
        return key
    domain = SymbolRanges.from_phase(problem, phase)
    place = (kind.__name__, *key, domain.cache_key)
    nonsmooth_terms = problem.memoize(place, lambda: kind.from_phase(problem, phase, domain))
    if not nonsmooth_terms.cache_key:
        return key
    key = (*key, *nonsmooth_terms.cache_key)
    nonsmooth_terms.reformulate_phase(problem, phase, key)
    return key
