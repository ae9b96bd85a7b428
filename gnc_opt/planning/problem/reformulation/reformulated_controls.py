"""Form of a phase with reformulated controls: all data except its numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from gnc_opt.array_types import Array
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_batch
from gnc_opt.model.model_variables import Symbol
from gnc_opt.model.split_and_magnitude_direction_controls import ComposedControl
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.planning.problem.constraints import Constraint
from gnc_opt.planning.problem.guess.guess_evaluation import VectorizedGuess
from gnc_opt.planning.problem.guess.initial_guess import build_phase_guess, guess_phase_times
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.phase_bounds_and_guess import ControlMap, PhaseBoundsAndGuess
from gnc_opt.planning.problem.problem_definition import ProblemData
from gnc_opt.planning.problem.symbolic_expressions import build_function_along_phase


def collect_variable_names(model: Model) -> frozenset[str]:
    layouts = (model.states, model.controls, model.parameters, model.outputs)
    return frozenset(name for layout in layouts for name in layout.names)


def choose_unused_variable_name(model: Model, name: str) -> str:
    """Return a name that the model does not contain."""
    used_names = collect_variable_names(model)
    while name in used_names:
        name += "_"
    return name


def substitute_controls_in_phase(
    phase: Phase,
    controls: Sequence[Symbol],
    composed: Sequence[tuple[ComposedControl, Any]],
    express: Callable[[Any], Any],
    excluded_path: str = "",
) -> tuple[Model, dict[str, Constraint], dict[str, tuple[Any, Any]]]:
    """Return model, path constraints (except ``excluded_path``) and integrands of a phase in other controls.

    See `Model.express_in_other_controls`; limits of the lengths of directions are kept.
    """
    lengths = {v.direction_norm_constraint_name for v in phase.vector_controls}
    paths = {name: c for name, c in phase.paths.items() if name != excluded_path}
    paths |= {n: replace(c, expression=express(c.expression)) for n, c in paths.items() if n not in lengths}
    integrands = {name: (symbol, express(e)) for name, (symbol, e) in phase.integrands.items()}
    return phase.model.express_in_other_controls(controls, composed, express), paths, integrands


@dataclass(frozen=True, eq=False)
class ReformulatedPhase:
    """Model, constraints and integrands of a phase in reformulated controls."""

    model: Model
    paths: dict[str, Constraint]
    integrands: dict[str, tuple[Any, Any]]
    control_map: ControlMap

    def apply_to_phase(self, phase: Phase, numbers: PhaseBoundsAndGuess) -> None:
        """Apply the form to a phase, with numbers in the new controls."""
        layout, values = phase.model.parameters, phase.model.parameter_values
        parameters = {name: values[layout.slice(name)] for name in layout.names}
        phase.model = self.model.with_parameters(**parameters)
        phase.numbers = numbers
        phase.paths, phase.integrands = dict(self.paths), dict(self.integrands)
        phase.control_map = self.control_map.compose_control_maps(phase.control_map)


def build_guess_of_expression(problem: ProblemData, original: Phase, column: Any) -> VectorizedGuess:
    """Return the values of a column along the guess of a phase as a function of times."""
    function = build_function_along_phase(problem, original, "guessed", column)
    q = problem.get_parameter_guess()

    def evaluate_expression_at_times(times: Array) -> Array:
        first, last = guess_phase_times(original)
        start = build_phase_guess(original, (times - first) / (last - first), perturbed=False)
        p = original.model.parameter_values
        trajectory = times[None], start.states, start.controls
        return evaluate_casadi_batch(function, times.size, *trajectory, p, q)

    return VectorizedGuess(evaluate_expression_at_times)
