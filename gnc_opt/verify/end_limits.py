r"""Path constraints that are met at an end of a phase only, as boundary constraints.

Where :math:`c(t, x) \le 0` is reached at :math:`t_f`, say, and not before, it pushes with an atom
:math:`\eta \ge 0` there: :math:`\lambda(t_f) = \partial\Phi/\partial x_f + \eta\,\partial c/\partial x` (Hartl, Sethi &
Vickson, SIAM Review 37(2), 1995, theorem 4.1). So it is a condition on the end with :math:`\nu = \eta`, and that is how
the second order and normality take it: neither the points of a mesh nor switch times know of a limit at the ends.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from gnc_opt.arrays import Indices
from gnc_opt.problem.constraint import make_constraint
from gnc_opt.problem.functions import EndGradients
from gnc_opt.problem.phase import Phase
from gnc_opt.solution.samples import PhaseSamples
from gnc_opt.solution.solution import Solution
from gnc_opt.tolerances import AT_LIMIT
from gnc_opt.verify.judged import ends_of
from gnc_opt.verify.pushes import end_push

ENDS = (("initial", 0), ("final", -1))
"""The ends of a phase and their samples."""


def with_end_limits(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients
) -> tuple[Solution, EndGradients]:
    """Return the solution of the problem with these boundary constraints, their multipliers with it, and its ends."""
    met = [(s, end, at, rows) for s in samples for end, at in ENDS if (rows := _met_at(s, at)).size]
    if not met:
        return solution, ends
    problem, pushes = solution.need_problem("verify").clone(), [solution.constraint_multipliers]
    for s, end, at, rows in met:
        leg = problem.phases[s.leg.name]
        box = leg.path_interval()
        for row in rows:
            label = f"{s.leg.path_labels[row]}, {end} end of phase {s.leg.name}"
            expression = _at_end(leg, row, end)
            problem.constraints[label] = make_constraint(
                label, expression, box.lower[row], box.upper[row], None, f"constraint '{label}'"
            )
        pushes.append(end_push(s, at, ends).multipliers[rows])
    problem.changed()
    stated = replace(
        solution,
        problem=problem,
        constraint_multipliers=np.concatenate(pushes),
        constraint_labels=problem.constraint_labels(),
    )
    return stated, ends_of(stated)


def _met_at(s: PhaseSamples, at: int) -> Indices:
    """Path constraints without controls that are at a limit at an end of the phase, and not at the point beside it."""
    leg, pure = s.leg, s.pure_paths
    if not pure.size:
        return pure
    end, point = s.times[[at]], leg.point_times[[at]]
    values = np.hstack([s.functions.paths(t, leg.x(t), leg.flown(t)) for t in (end, point)])
    near = (
        np.any(leg.path_bounds.near(values, AT_LIMIT * s.path_scale), axis=0)
        & ~leg.path_bounds.fixed[:, None]
    )
    return np.asarray(pure[near[pure, 0] & ~near[pure, 1]])


def _at_end(leg: Phase, row: int, end: str) -> ca.SX:
    t, x, _, _ = leg.model.arguments()
    time = leg.initial_time if end == "initial" else leg.final_time
    return ca.substitute(leg.path_expression()[int(row)], ca.vertcat(t, x), ca.vertcat(time, leg.ends(end)))
