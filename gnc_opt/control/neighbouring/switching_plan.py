"""SwitchingPlan: a bang-bang solution as what its controls are at first and when they jump."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.control.reference import Reference
from gnc_opt.errors import DesignError
from gnc_opt.problem.arc import Arc
from gnc_opt.solution.phase_solution import PhaseSolution
from gnc_opt.solution.solution import Solution


@dataclass(frozen=True, eq=False)
class SwitchingPlan:
    """Controls that jump between their limits, from a start to an end at which all states are given.

    Attributes
    ----------
    reference : Reference
        The flight as it was planned.
    first : array (n_controls,)
        Controls at the start.
    channels : tuple of int
        The control that each switch is of, in the order of time.
    jumps : array (n_switches,)
        By how much it jumps there.
    times : array (n_switches + 1,)
        Switch times and the end, s.
    """

    reference: Reference
    first: Array
    channels: tuple[int, ...]
    jumps: Array
    times: Array

    @property
    def initial_time(self) -> float:
        """s."""
        return self.reference.initial_time

    @property
    def initial(self) -> Array:
        """Planned initial state (n_states,)."""
        return self.reference.x(self.reference.initial_time)

    @property
    def final(self) -> Array:
        """Final state (n_states,)."""
        return self.reference.x(self.reference.final_time)

    def control(self, s: Any, times: Any) -> Any:
        """Return the controls (SX) at a time s for these switch times; a switch counts from its time on."""
        u = ca.vertsplit(ca.SX(self.first))
        for k, (channel, jump) in enumerate(zip(self.channels, self.jumps, strict=True)):
            u[channel] += jump * (s > times[k])
        return ca.vertcat(*u)

    def mean_control(self, begin: Any, length: float, times: Any) -> Any:
        """Return the mean of the controls (SX) over a step, without regard to the end."""
        u = ca.vertsplit(ca.SX(self.first))
        for k, (channel, jump) in enumerate(zip(self.channels, self.jumps, strict=True)):
            u[channel] += jump * ca.fmin(1, ca.fmax(0, (begin + length - times[k]) / length))
        return ca.vertcat(*u)

    @classmethod
    def of(cls, solution: Solution) -> SwitchingPlan:
        """Read a solution.

        Raises
        ------
        DesignError
            It has several phases, path or point constraints, a control between its limits, a fixed end time, or
            states that are not given at the end.
        """
        reference = Reference(solution)
        name = solution.problem_name
        if len(solution.phases) != 1:
            raise DesignError(f"the plan '{name}' has {len(solution.phases)} phases: plan in one.")
        (leg,) = solution.phases.values()
        if leg.path_labels or solution.need_problem("follow").constraints:
            raise DesignError(
                f"the plan '{name}' has constraints beside its limits of controls, which the guidance does not "
                "know: follow it by design_tvlqr() or design_mpc()."
            )
        loose = [
            label for label, fixed in zip(leg.states.labels, leg.final_bounds.fixed, strict=True) if not fixed
        ]
        if loose:
            raise DesignError(
                f"the plan '{name}' does not give '{loose[0]}' at the end: fix it with final()."
            )
        if leg.final_time_bounds.fixed[0] or leg.duration_bounds.fixed[0]:
            raise DesignError(f"the plan '{name}' ends at a fixed time: leave the end free and minimise it.")
        first, switches = _switches(solution, leg)
        return cls(
            reference,
            first,
            tuple(channel for _, channel, _ in switches),
            np.array([jump for *_, jump in switches]),
            np.array([*(time for time, *_ in switches), leg.final_time]),
        )


def _switches(solution: Solution, leg: PhaseSolution) -> tuple[Array, list[tuple[float, int, float]]]:
    """Return the first controls, and time, channel and jump of each switch."""

    def level(arc: Arc, channel: int) -> float:
        bounds = leg.control_bounds
        return float((bounds.upper if arc.kind.sign > 0 else bounds.lower)[channel])

    first, switches = np.zeros(leg.controls.size), []
    for channel, label in enumerate(leg.controls.labels):
        arcs = [arc for arc in solution.structure if arc.channel == label]
        inner = next((arc for arc in arcs if not arc.kind.at_limit), None)
        if not arcs or inner is not None:
            where = f" from {inner.start:g} s to {inner.end:g} s" if inner is not None else ""
            raise DesignError(
                f"'{label}' of the plan '{solution.problem_name}' is not known to be on its limits{where}: refine the "
                "solution, or follow it by design_tvlqr() if it is not bang-bang."
            )
        first[channel] = level(arcs[0], channel)
        switches += [
            (float(after.start), channel, level(after, channel) - level(before, channel))
            for before, after in itertools.pairwise(arcs)
        ]
    return first, sorted(switches)
