"""Perturbations of problem data: parameters, end values, times and limits whose effect `sensitivity` returns."""

from __future__ import annotations

import numpy as np

from gnc_opt.errors import ProblemError, suggest_similar_name, unknown_name_error
from gnc_opt.planning.optimality.kkt_system import ProgramPoint
from gnc_opt.planning.solution.phase_solution import PhaseSolution
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.study.kkt_sensitivity import DataPerturbation


def list_problem_data_perturbations(
    program: ProgramPoint, solution: Solution, kind: str, name: str, phase: str | None
) -> tuple[str, list[DataPerturbation]]:
    """Return the name of a quantity for messages, and a perturbation for each of its components."""
    if kind == "parameter":
        return f"parameter '{name}'", _perturb_model_parameter(program, name, phase)
    if kind == "constraint":
        return f"boundary constraint '{name}'", _perturb_boundary_constraint_limits(program, solution, name)
    selected = solution.phase(phase)
    if kind == "time":
        if name not in ("initial", "final"):
            raise ProblemError(
                f"sensitivity() has no time {name!r}: {suggest_similar_name(str(name), ('initial', 'final'))}"
            )
        return f"{name} time of phase '{selected.name}'", [
            _perturb_phase_end_time(program, selected.name, name)
        ]
    return f"{kind} value of '{name}' in phase '{selected.name}'", _perturb_end_states(
        program, selected, kind, name
    )


def _create_zero_data_perturbation(program: ProgramPoint) -> DataPerturbation:
    transcription = program.transcription
    return DataPerturbation(
        np.zeros(transcription.stack_model_parameters_and_fixed_times(program.problem).size),
        np.zeros(transcription.n_variables),
        np.zeros(transcription.n_constraints),
    )


def _perturb_model_parameter(program: ProgramPoint, name: str, phase: str | None) -> list[DataPerturbation]:
    """Return the directions of a model parameter, in every phase that has it (or in one)."""
    problem = program.problem
    if name in problem.parameters:
        raise ProblemError(
            f"parameter '{name}' of problem '{problem.name}' is optimised, so that its value has no effect: choose "
            "a parameter of a model, or read Sensitivity.parameter()."
        )
    starts, offset = {}, 0
    for candidate in problem.phases.values():
        if name in candidate.model.parameters and phase in (None, candidate.name):
            starts[candidate.name] = offset + candidate.model.parameters.slice(name).start
        offset += candidate.model.parameters.size
    if not starts:
        known = sorted({n for candidate in problem.phases.values() for n in candidate.model.parameters.names})
        raise unknown_name_error("model parameter", name, f"problem '{problem.name}'", known)
    size = problem.phases[next(iter(starts))].model.parameters[name].size
    changes = []
    for component in range(size):
        change = _create_zero_data_perturbation(program)
        change.numbers[[start + component for start in starts.values()]] = 1.0
        changes.append(change)
    return changes


def _perturb_end_states(
    program: ProgramPoint, phase: PhaseSolution, end: str, name: str
) -> list[DataPerturbation]:
    rows = phase.states.slice(name)
    collocation = program.transcription.parts[phase.name].collocation
    places = collocation.boundary_states[rows, 0 if end == "initial" else -1]
    changes = []
    for place, label in zip(places, phase.states.labels[rows], strict=True):
        if not program.variables.active[place]:
            raise ProblemError(
                f"the {end} value of '{label}' in phase '{phase.name}' of '{program.problem.name}' is not fixed and "
                "not at a limit, so that there is no derivative: choose another state."
            )
        change = _create_zero_data_perturbation(program)
        change.limits[place] = 1.0
        changes.append(change)
    return changes


def _perturb_phase_end_time(program: ProgramPoint, phase: str, end: str) -> DataPerturbation:
    transcription = program.transcription
    place = int(transcription.parts[phase].times[0 if end == "initial" else -1])
    change = _create_zero_data_perturbation(program)
    if place >= transcription.n_variables:
        n_models = change.numbers.size - 2 * len(transcription.parts)
        change.numbers[n_models + place - transcription.n_variables] = 1.0
    elif program.variables.active[place]:
        change.limits[place] = 1.0
    else:
        raise ProblemError(
            f"the {end} time of phase '{phase}' of '{program.problem.name}' is optimised, so that "
            "its value has no effect: fix it with time() first."
        )
    return change


def _perturb_boundary_constraint_limits(
    program: ProgramPoint, solution: Solution, name: str
) -> list[DataPerturbation]:
    solution.multiplier(name)  # raises an error for unknown names
    rows = program.transcription.constraint_rows
    changes = []
    for label, row in zip(solution.constraint_labels, rows, strict=True):
        if label.split("[")[0] != name:
            continue
        if not program.rows.active[row]:
            raise ProblemError(
                f"boundary constraint '{label}' of '{program.problem.name}' is not active: its limit has no effect."
            )
        change = _create_zero_data_perturbation(program)
        change.row_limits[row] = 1.0
        changes.append(change)
    return changes
