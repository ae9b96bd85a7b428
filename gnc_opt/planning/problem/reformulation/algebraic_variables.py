r"""Algebraic variables as states: index reduction of a semi-explicit system of index 1.

A control z that is determined by an equality :math:`g(t, x, z, p) = c` is a function of time and states. If
:math:`\\partial g / \\partial z` is regular, it satisfies

.. math::

    \\dot z = -\\left(\\frac{\\partial g}{\\partial z}\\right)^{-1}
              \\left(\\frac{\\partial g}{\\partial t} + \\frac{\\partial g}{\\partial x} \\dot x\\right)

with :math:`g = c` at the start of the phase, which preserves g = c. The solver treats z as a state with that boundary
constraint, without a path constraint. The costate of z is appended to those of the states (U. M. Ascher and L. R.
Petzold, Computer Methods for Ordinary Differential Equations and Differential-Algebraic Equations, 1998, section 9.1).
Equalities from `Phase.path` are kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from gnc_opt.model.model_variables import Symbol
from gnc_opt.planning.problem.constraints import Constraint
from gnc_opt.planning.problem.guess.initial_guess import guess_phase_times
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem_definition import ProblemData
from gnc_opt.planning.problem.redundant_bounds import find_bounds_not_implied_by_norm
from gnc_opt.planning.problem.reformulation.reformulated_controls import build_guess_of_expression
from gnc_opt.planning.problem.scaling_magnitudes import SAMPLES

P = TypeVar("P", bound=ProblemData)


@dataclass(frozen=True, eq=False)
class AlgebraicVariable:
    """Algebraic variable: symbol, equality, rate and symbols at both ends."""

    symbol: Symbol
    constraint: str
    residual: Any
    rate: Any
    ends: dict[str, dict[str, Any]]

    def is_rate_finite_at_guess(self, problem: ProblemData, phase: Phase) -> bool:
        """Return whether the rate of the variable is finite along the guess of a phase."""
        first, last = guess_phase_times(phase)
        rates = build_guess_of_expression(problem, phase, self.rate)
        with np.errstate(all="ignore"):
            return bool(np.all(np.isfinite(rates.function(first + SAMPLES * (last - first)))))

    def reformulate_phase(self, problem: ProblemData, phase: Phase) -> None:
        """Make the variable a state of a phase."""
        t, x, _, _ = phase.model.symbolic_arguments()
        constraint = phase.paths[self.constraint]
        phase.numbers = replace(phase.numbers, controls=find_bounds_not_implied_by_norm(problem, phase))
        phase.add_states({self.symbol: self.rate}, ends=self.ends)
        phase.drop_path(self.constraint)
        name = f"{self.constraint} at the start of {phase.name}"
        own, start = ca.vertcat(t, x, self.symbol), self.ends["initial"][self.symbol.variable.name]
        initial = [phase.initial_state(n) for n in phase.model.states.names if n != self.symbol.variable.name]
        value = ca.substitute(self.residual, own, ca.vertcat(phase.initial_time, *initial, start))
        text = f"{self.symbol.variable.name} is replaced by a state that follows from {self.constraint}"
        phase.describe_reformulation(text)
        problem.constraints[name] = Constraint(name, value, constraint.interval)


def replace_algebraic_variables(problem: P) -> P:
    """Return a problem with algebraic variables as states; the same problem if it has none."""
    found = []
    for name, phase in problem.phases.items():
        forms = problem.memoize(
            ("algebraic", name),
            lambda phase=phase: list(_find_algebraic_variables(phase)),  # type: ignore[misc]
        )
        found += [(name, form) for form in forms if form.is_rate_finite_at_guess(problem, phase)]
    if not found:
        return problem
    twin = problem.clone()
    for name, form in found:
        form.reformulate_phase(twin, twin.phases[name])
    key = ("algebraic", *((name, form.constraint) for name, form in found))
    twin.builds = problem.builds.setdefault(key, {})
    return twin


def _find_algebraic_variables(phase: Phase) -> Iterator[AlgebraicVariable]:
    model = phase.model
    t, x, _, _ = model.symbolic_arguments()
    rate = model.state_derivative()
    for name in model.algebraic_equations:
        constraint = phase.paths.get(f"equation of {name}")
        if constraint is None:  # the variable is a state already
            continue
        z, residual = model.symbol(name), constraint.expression
        others = ca.vertcat(*(model.symbol(other) for other in model.controls.names if other != name))
        slope = ca.jacobian(residual, z)
        determined = ca.depends_on(residual, ca.vertcat(t, x)) and not ca.depends_on(residual, others)
        if not determined or ca.sprank(slope) < slope.shape[0]:
            continue
        along = ca.jacobian(residual, t) + ca.jacobian(residual, x) @ rate
        label, size = z.variable.name, z.variable.size
        ends = {end: {label: ca.SX.sym(f"{phase.name}_{end}_{label}", size)} for end in ("initial", "final")}
        yield AlgebraicVariable(z, constraint.name, residual, -ca.solve(slope, along), ends)
