"""SmoothPlan: a solution whose controls lie between their limits, and what is given at its end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gnc_opt.arrays import Array, Mask
from gnc_opt.control.reference import Reference
from gnc_opt.errors import DesignError
from gnc_opt.problem.functions import PhaseFunctions
from gnc_opt.problem.problem import Problem
from gnc_opt.solution.phase_solution import PhaseSolution
from gnc_opt.solution.solution import Solution
from gnc_opt.tolerances import AT_LIMIT, magnitude


@dataclass(frozen=True, eq=False)
class SmoothPlan:
    """A flight without active limits.

    Attributes
    ----------
    solution : Solution
    problem : Problem
    leg : PhaseSolution
    functions : PhaseFunctions
    reference : Reference
        The flight as it was planned; after its end, at rest or with the last control held.
    given : bool array (n_states,)
        Which states are given at the end.
    free_end : bool
        Whether the end time is free.
    """

    solution: Solution
    problem: Problem
    leg: PhaseSolution
    functions: PhaseFunctions
    reference: Reference
    given: Mask
    free_end: bool

    @property
    def name(self) -> str:
        """Of the problem."""
        return self.solution.problem_name

    @classmethod
    def of(cls, solution: Solution) -> SmoothPlan:
        """Read a solution.

        Raises
        ------
        DesignError
            It has several phases, boundary constraints, free parameters or norms as controls, or a limit is active.
        """
        problem, name = solution.need_problem("follow"), solution.problem_name
        if len(solution.phases) != 1:
            raise DesignError(f"the plan '{name}' has {len(solution.phases)} phases: plan in one.")
        (leg,) = solution.phases.values()
        if problem.constraints or solution.parameter_values.size:
            raise DesignError(
                f"the plan '{name}' has boundary constraints or free parameters, which the feedback does not know: "
                "give the end by final(), or follow the plan by design_tvlqr()."
            )
        if problem.phases[leg.name].restatement is not None:
            raise DesignError(
                f"the plan '{name}' was restated with thrust directions and sizes: follow it by design_tvlqr()."
            )
        reference = Reference(solution, tail="hold")
        given = _given(solution, leg)
        free_end = not (leg.final_time_bounds.fixed[0] or leg.duration_bounds.fixed[0])
        plan = cls(solution, problem, leg, solution.functions(leg.name), reference, given, free_end)
        plan._require_no_limit()
        return plan

    def beyond(self, u: Array) -> Mask:
        """Return where controls (n_controls, n) are beyond their limits, (n,)."""
        bounds = self.leg.control_bounds
        return np.asarray(np.any((u < bounds.lower[:, None]) | (u > bounds.upper[:, None]), axis=0))

    def _require_no_limit(self) -> None:
        leg, times = self.leg, self.leg.sample_times()
        inner = times[1:-1]
        paths = self.functions.paths(inner, leg.x(inner), leg.flown(inner))
        for values, box, labels in (
            (leg.flown(times), leg.control_bounds, leg.controls.labels),
            (leg.x(inner), leg.state_bounds, leg.states.labels),
            (paths, leg.path_bounds, leg.path_labels),
        ):
            if not len(labels):
                continue
            scale = magnitude(np.max(np.abs(values), axis=1))
            at = np.any(np.logical_or(*box.near(values, AT_LIMIT * scale)), axis=1)
            if np.any(at):
                raise DesignError(
                    f"'{labels[int(np.flatnonzero(at)[0])]}' of the plan '{self.name}' is on its limit for a while: "
                    "neighbours of smooth plans only are known; plan with a reserve, a bang-bang plan is for "
                    "design_neighbouring_optimal()."
                )


def _given(solution: Solution, leg: PhaseSolution) -> Mask:
    """Return which states are given at the end; the others must be off their limits there."""
    given = np.asarray(leg.final_bounds.fixed, dtype=bool)
    x = leg.x(leg.final_time, "left")
    at = np.logical_or(*leg.final_bounds.near(x, AT_LIMIT * magnitude(np.abs(x)))) & ~given
    if np.any(at):
        label = leg.states.labels[int(np.flatnonzero(at)[0])]
        raise DesignError(
            f"'{label}' ends on a limit in the plan '{solution.problem_name}': give it there by "
            "final(), or leave it free."
        )
    return given
