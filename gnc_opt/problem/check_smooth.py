"""Warnings of what a solver that needs two derivatives will stumble over: kinks, jumps and coarse tables."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from gnc_opt.errors import ProblemError, warn_user
from gnc_opt.model.graph import nodes_of, operations_in
from gnc_opt.problem.guess.trajectory import start_phase
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.statement import Statement
from gnc_opt.problem.tables import along, outside_tables, table_uses

_IN_PHASES = "let a phase end there and link() the next one to it"
_KINKS: dict[int, tuple[str, str]] = {
    ca.OP_FABS: (
        "fabs, which has a kink",
        "use smooth_abs(), or split_control() for a control whose size costs",
    ),
    ca.OP_SIGN: ("sign, which jumps", f"use tanh(x / width), or {_IN_PHASES}"),
    ca.OP_FLOOR: ("floor (or %), which jumps", _IN_PHASES),
    ca.OP_CEIL: ("ceil, which jumps", _IN_PHASES),
    ca.OP_FMOD: ("fmod, which jumps", _IN_PHASES),
    ca.OP_REMAINDER: ("remainder, which jumps", _IN_PHASES),
    ca.OP_FMIN: ("fmin, which has a kink", "use a control that path constraints keep below both"),
    ca.OP_FMAX: ("fmax, which has a kink", "use a control that path constraints keep above both"),
    **dict.fromkeys(
        (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE),
        ("a comparison (if_else), which switches", f"{_IN_PHASES}, or blend with tanh"),
    ),
}
"""What an operation does to a trajectory, and what to write instead."""

_EXTREMA = (ca.OP_FABS, ca.OP_FMIN, ca.OP_FMAX)
_NOT_CONVEX = {
    "the rate of state": "use smooth_abs() to round it off, for a flight may rest on it where no derivative is; "
    f"or {_IN_PHASES}; of controls alone, as a dead zone is, let its value be the control",
    "path constraint": "it leaves a hole, or is limited from both sides, so that it could not be restated: state the "
    "side that is meant, or a phase per side",
    "integral": "it is not known to cost the more the larger it is, so that it could not be restated: give bounds that "
    "tell the signs of its factors, or use smooth_abs()",
}
"""What to do about kinks in what is restated otherwise."""

_FRACTIONS = np.linspace(0.0, 1.0, 11)


def warn_of_kinks(problem: Statement, leg: Phase) -> None:
    """Issue a `ProblemWarning` for each kind of operation without derivatives along a phase, and coarse tables."""
    uses = table_uses(problem, leg)
    for table in dict.fromkeys(use.table for use in uses):
        if table.method == "linear":
            warn_user(
                f"table '{table.name}' in {leg.where} is linear and has a kink at each of its points, which "
                'slows solvers and refinement down: use method="bspline" or "pchip", or, if it is one of time, '
                "put mesh boundaries there."
            )
    if not operations_in(along(leg)) & _KINKS.keys():
        return
    looked_up = frozenset[int]().union(*(use.hashes for use in uses))
    for operation, (kind, where) in _first_kinks(problem, leg, looked_up):
        meaning, remedy = _KINKS[operation]
        if operation in _EXTREMA:  # one that could not be restated
            remedy = _NOT_CONVEX.get(kind, remedy)
        warn_user(f"{kind} '{where}' of {leg.where} contains {meaning}: {remedy}.")


def check_guess_in_tables(problem: Statement, leg: Phase, *, warn: bool) -> None:
    """Raise `ProblemError` if the guess leaves a table that refuses it; warn, if wanted, where it leaves another."""
    if not table_uses(problem, leg):
        return
    start = start_phase(leg, _FRACTIONS)
    times = start.times[0] + _FRACTIONS * (start.times[1] - start.times[0])
    q = np.concatenate([*problem.parameter_guess.values(), np.zeros(0)])
    p = leg.model.parameter_values
    for found in outside_tables(problem, leg, times, start.states, start.controls, p, q):
        if found.table.outside == "error":
            raise ProblemError(
                f"the guess leaves a table ({found}): give another guess(), or a larger table."
            )
        if warn:
            warn_user(
                f"the guess leaves a table ({found}), which goes on there as '{found.table.outside}' says."
            )


def _first_kinks(
    problem: Statement, leg: Phase, looked_up: frozenset[int]
) -> Iterator[tuple[int, tuple[str, str]]]:
    """Yield each meaning's first operation with the kind and name of its expression."""
    t, x, u, _ = leg.model.arguments()
    free = [leg.model.symbol(name) for name in problem.parameters.names if name in leg.model.parameters]
    changing = ca.vertcat(t, x, u, *free, problem.parameter_symbols())
    kinds = (
        ("the rate of state", leg.model.states.labels, leg.model.derivative()),
        ("path constraint", leg.path_labels, leg.path_expression()),
        ("integral", tuple(leg.integrands), leg.integrand_expression()),
    )
    told: set[str] = set()
    for what, labels, stacked in kinds:
        for label, expression in zip(labels, ca.vertsplit(stacked) if labels else (), strict=True):
            for node in nodes_of(expression):
                operation = node.op()
                if operation not in _KINKS or node.element_hash() in looked_up:
                    continue
                if _KINKS[operation][0] not in told and ca.depends_on(node, changing):
                    told.add(_KINKS[operation][0])
                    yield operation, (what, label)
