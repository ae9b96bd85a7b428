"""Kinks and jumps along a phase: nonsmooth operations in states or controls, and their switching arguments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import Mask
from gnc_opt.model.casadi_expression_graph import collect_casadi_operation_codes, iterate_subexpressions
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem_definition import ProblemData
from gnc_opt.planning.problem.symbolic_expressions import (
    build_function_along_phase,
    list_table_calls,
    stack_phase_expressions,
)

_OF_ONE = (ca.OP_FABS, ca.OP_SIGN)
_OF_TWO = (ca.OP_FMIN, ca.OP_FMAX, ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE)
_WORDS = {
    ca.OP_FABS: "fabs",
    ca.OP_SIGN: "sign",
    ca.OP_FMIN: "fmin",
    ca.OP_FMAX: "fmax",
    ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil",
    **dict.fromkeys((ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE), "a comparison"),
}


@dataclass(frozen=True, eq=False)
class KinkFunctions:
    """Nonsmooth operations: descriptions, and ``(t, x, u, p, q)`` -> arguments whose sign changes are the kinks."""

    words: tuple[str, ...]
    arguments: Any

    @property
    def is_state_dependent(self) -> Mask:
        """Whether each operation depends on states, (n_operations,); the others depend on controls only."""
        mask = np.zeros(len(self.words), dtype=bool)
        mask[self.arguments.jac_sparsity(0, 1).row()] = True
        return mask


def has_kinks(expression: Any) -> bool:
    """Return whether an expression contains an operation with a jump or kink, which derivatives do not reveal."""
    return bool(collect_casadi_operation_codes(expression) & _WORDS.keys())


def find_nonsmooth_operations(problem: ProblemData, phase: Phase) -> KinkFunctions | None:
    """Return the nonsmooth operations along a phase, except tables; None if there are none."""

    def collect_kink_functions() -> KinkFunctions | None:
        _, x, u, _ = phase.model.symbolic_arguments()
        expression = ca.vertcat(phase.model.state_derivative(), phase.integrand_expression())
        if not has_kinks(expression):
            return None
        looked_up = frozenset[int]().union(
            *(use.subexpression_hashes for use in list_table_calls(problem, phase))
        )
        kinks: dict[int, tuple[str, Any]] = {}
        for node in iterate_subexpressions(expression):
            operation = node.op()
            if operation in _WORDS and node.element_hash() not in looked_up:
                argument = _get_kink_argument(node, operation)
                if ca.depends_on(argument, ca.vertcat(x, u)):
                    kinks.setdefault(argument.element_hash(), (_WORDS[operation], argument))
        if not kinks:
            return None
        words, arguments = zip(*kinks.values(), strict=True)
        return KinkFunctions(
            words, build_function_along_phase(problem, phase, "kinks", ca.vertcat(*arguments))
        )

    return problem.memoize(("kinks", phase.name), collect_kink_functions)


def build_threshold_crossing_function(problem: ProblemData, phase: Phase) -> Any:
    """Return ``(t, x, u, p, q)`` -> differences of time or a state and a constant that are compared; None if none are.

    Narrow features such as gusts or time windows are at their zeros.
    """

    def collect_threshold_comparisons() -> Any:
        t, x, _, _ = phase.model.symbolic_arguments()
        moving, differences = ca.vertcat(t, x), {}
        for node in iterate_subexpressions(stack_phase_expressions(phase)):
            if node.op() in (ca.OP_ADD, ca.OP_SUB):
                parts = [node.dep(0), node.dep(1)]
                is_constant = [part.is_constant() and not part.is_zero() for part in parts]
                of_one = [part.is_symbolic() and ca.depends_on(part, moving) for part in parts]
                if any(is_constant) and any(of_one):
                    differences[node.element_hash()] = node
        if not differences:
            return None
        return build_function_along_phase(problem, phase, "centres", ca.vertcat(*differences.values()))

    return problem.memoize(("centres", phase.name), collect_threshold_comparisons)


def _get_kink_argument(node: Any, operation: int) -> Any:
    if operation in _OF_ONE:
        return node.dep(0)
    if operation in _OF_TWO:
        return node.dep(0) - node.dep(1)
    return ca.sin(ca.pi * node.dep(0))  # of a step at every whole number
