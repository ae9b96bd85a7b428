r"""Unit vectors: thrust as magnitude times unit vector in the form of a vector control.

The direction n of a thrust :math:`d n` is free along coasts, d = 0. If all functions are affine in n and d, and n
occurs only times d, n is solved for with :math:`|n| \le 1`, as in ``Model.vector_control``, and reported with
length 1: along coasts against the primer, where it minimises H.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.model.casadi_expression_graph import replace_subexpressions_by_hash
from gnc_opt.model.model_variables import Symbol, Variable
from gnc_opt.model.split_and_magnitude_direction_controls import UnitVectorControl, VectorControl
from gnc_opt.numerical_tolerances import EQUAL
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.interval_arithmetic import evaluate_at_random_points, is_affine
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.phase_bounds_and_guess import ControlMap
from gnc_opt.planning.problem.problem_definition import ProblemData
from gnc_opt.planning.problem.redundant_bounds import (
    compute_fixed_vector_length,
    find_sum_of_squares_variables,
)
from gnc_opt.planning.problem.reformulation.reformulated_controls import (
    ReformulatedPhase,
    choose_unused_variable_name,
    substitute_controls_in_phase,
)
from gnc_opt.planning.problem.reformulation.vector_norm_reformulation import index_control_symbols


@dataclass(frozen=True, eq=False)
class UnitVectorSubstitution(ReformulatedPhase):
    """Form of a phase with the direction of a vector control in place of a unit vector, the first of ``names``."""

    names: tuple[str, str]
    control: VectorControl

    @classmethod
    def find_first_unit_vector(cls, phase: Phase) -> UnitVectorSubstitution | None:
        """Return the form for the first unit vector with a magnitude among the controls, or None."""
        return next((cls.from_unit_vector(phase, *found) for found in _find_unit_vectors(phase)), None)

    @classmethod
    def from_unit_vector(cls, phase: Phase, name: str, magnitude: str, label: str) -> UnitVectorSubstitution:
        """Return the form of a phase for a unit vector, its magnitude, and the path constraint on its length."""
        old, vector = phase.model, ca.SX(phase.model.symbol(name))
        size, v = old.symbol(magnitude), old.controls[name]
        label_of_direction = choose_unused_variable_name(old, f"{name}_direction")
        direction = Symbol(Variable(label_of_direction, v.size, "", (1.0,) * v.size))
        parts = (magnitude, label_of_direction)
        label_of_vector = choose_unused_variable_name(old, f"{magnitude}_{name}")
        control = VectorControl(Variable(label_of_vector, v.size, size.variable.unit), parts)
        unit = direction / ca.norm_2(direction)
        pairs = zip(ca.vertsplit(vector), ca.vertsplit(direction), strict=True)
        instead = {symbol.element_hash(): value for symbol, value in pairs}

        def substitute_unit_vector(expression: Any) -> Any:
            return replace_subexpressions_by_hash(expression, instead)

        controls = [direction if other == name else old.symbol(other) for other in old.controls.names]
        composed = [(control, size * direction), (UnitVectorControl(v, parts[1:]), unit)]
        text = f"{magnitude} * {name} is replaced by {' * '.join(parts)}"
        form = ControlMap(old, vector, unit, old.symbols("control"), (text,))
        terms = controls, composed, substitute_unit_vector
        expressed = substitute_controls_in_phase(phase, *terms, label)
        return cls(*expressed, form, (name, magnitude), control)

    def reformulate_phase(self, problem: ProblemData, phase: Phase) -> tuple[str, ...]:
        """Apply the form to a phase with its own numbers, without the bounds implied by the length."""
        old, place = phase.numbers, phase.model.controls.slice(self.names[0])
        lower, upper = old.controls.lower.copy(), old.controls.upper.copy()
        lower[place], upper[place] = -np.inf, np.inf
        scales = {name: scale for name, scale in old.scales.items() if name != self.names[0]}
        self.replace_phase_functions(phase, replace(old, controls=Interval(lower, upper), scales=scales))
        phase.record_vector_control(self.control, on_sphere=False)
        return ()


def _find_unit_vectors(phase: Phase) -> Iterator[tuple[str, str, str]]:
    """Yield controls of length 1 without other bounds, with magnitude and path constraint on the length."""
    layout, box = phase.model.controls, phase.numbers.controls
    stated = set(index_control_symbols(phase).values())
    for label, constraint in phase.paths.items():
        if constraint.interval.upper.size > 1 or not all(constraint.interval.is_fixed):
            continue
        rows, constant = find_sum_of_squares_variables(phase, constraint.expression)
        length = compute_fixed_vector_length(constraint.interval, constant)
        places = [row - phase.model.states.size for row in rows]
        unit = abs(length - 1.0) <= EQUAL and len(places) > 1 and stated.issuperset(places)
        for v in layout.variables if unit else ():
            whole = places == [*layout.indices(v.name)]
            if whole and np.all(np.stack([-box.lower[places], box.upper[places]]) >= length):
                for magnitude in _find_magnitudes_of_unit_vector(phase, v.name, label):
                    yield v.name, magnitude, label


def _find_magnitudes_of_unit_vector(phase: Phase, name: str, label: str) -> Iterator[str]:
    """Yield the magnitudes of a unit vector: controls >= 0, its only factors, which also occur without it."""
    layout, vector = phase.model.controls, ca.SX(phase.model.symbol(name))
    others = [c.expression for other, c in phase.paths.items() if other != label]
    terms = ca.vertcat(phase.model.derivative(), phase.integrand_expression(), *others)
    slope, rest = ca.vec(ca.jacobian(terms, vector)), ca.substitute(terms, vector, ca.DM.zeros(vector.shape))
    if ca.depends_on(slope, vector):
        return
    for place in index_control_symbols(phase).values():
        symbol = phase.model.symbols("control")[place]
        own = next(v for v in layout.variables if place in layout.indices(v.name))
        if own.size > 1 or phase.numbers.controls.lower[place] != 0 or not ca.depends_on(rest, symbol):
            continue
        affine = is_affine(ca.vertcat(rest, slope), symbol)
        if affine and not np.any(evaluate_at_random_points(ca.substitute(slope, symbol, 0.0))):
            yield own.name
