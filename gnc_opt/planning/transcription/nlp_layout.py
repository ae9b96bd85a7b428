"""Layout of the nonlinear program: indices and labels of its variables and rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array, Indices, Mask
from gnc_opt.planning.problem.active_constraint_arcs import Junction
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.transcription.arc_constraints import (
    build_polynomial_control_constraints,
    count_junction_constraint_rows,
    list_arc_junctions,
    list_polynomial_controls,
)
from gnc_opt.planning.transcription.collocation import PhaseCollocation
from gnc_opt.planning.transcription.collocation_families import Scheme
from gnc_opt.planning.transcription.mesh import Mesh


@dataclass(frozen=True)
class PhaseIndices:
    """Location of a phase in the program.

    Attributes
    ----------
    times : int array (n_arcs + 1,)
        Indices of initial time, movable mesh breaks and final time; >= n_variables for fixed times.
    """

    name: str
    collocation: PhaseCollocation
    times: Indices


class NlpLayout:
    """Indices and labels of all variables and rows of a problem on given meshes.

    Attributes
    ----------
    parameter_indices, integral_places : int array
        Indices of the free parameters, and of the integrals that are variables.
    constraint_rows : int array
        Row indices of the boundary constraints.
    junctions : list of (phase, Junction, int array)
        Junctions of state constraints, with the row indices of each.

    Notes
    -----
    Variables: states and controls per phase in order of time; then free times, parameters, integrals. Rows: dynamics
    and path constraints per phase; then smooth controls, junctions, durations, arcs, boundary constraints, integrals.
    """

    def __init__(self, problem: Problem, meshes: Mapping[str, Mesh], scheme: Scheme) -> None:
        self.problem = problem
        self.scheme = scheme
        self.parts: dict[str, PhaseIndices] = {}
        self._movable = {name: mesh.movable for name, mesh in meshes.items()}
        self._direct, self._defined = problem.memoize(
            "integrals of the end rows", self._separate_integrals_entering_linearly
        )
        self._assign_phase_variable_indices(meshes)
        self._assign_end_constraint_row_indices()

    # --- indices ----------------------------------------------------------------------------------

    def _separate_integrals_entering_linearly(
        self,
    ) -> tuple[dict[tuple[str, str], Array], list[tuple[str, str]]]:
        """Return the integrals with constant coefficients in (cost, constraints), and the other integrals."""
        outputs = ca.vertcat(self.problem.sense * self.problem.cost, self.problem.constraint_expression())
        direct: dict[tuple[str, str], Array] = {}
        defined = []
        for phase in self.problem.phases.values():
            for label, (symbol, _) in phase.integrands.items():
                coefficients = ca.jacobian(outputs, symbol)
                if coefficients.is_constant():
                    direct[phase.name, label] = np.asarray(ca.DM(coefficients).full()).ravel()
                else:
                    defined.append((phase.name, label))
        return direct, defined

    def _assign_phase_variable_indices(self, meshes: Mapping[str, Mesh]) -> None:
        variable = row = 0
        collocations = {}
        for name, phase in self.problem.phases.items():
            collocation = PhaseCollocation(
                self.scheme,
                meshes[name],
                phase.model.states.size,
                phase.model.controls.size,
                len(phase.path_labels),
                variable,
                row,
            )
            collocations[name] = collocation
            variable += collocation.n_variables
            row += collocation.n_rows
        free_times = [
            (name, anchor)
            for name, collocation in collocations.items()
            for anchor in collocation.mesh.arc_breaks
            if not self._is_arc_break_time_fixed(name, anchor)
        ]
        time_place = {key: variable + i for i, key in enumerate(free_times)}
        variable += len(free_times)
        self.parameter_indices = variable + np.arange(self.problem.parameters.size)
        variable += self.problem.parameters.size
        self.integral_places = variable + np.arange(len(self._defined))
        self.n_variables = variable + len(self._defined)
        self._time_labels = [
            f"{'initial' if anchor == 0 else 'final' if anchor == meshes[name].segments else f'boundary {anchor}'} "
            f"time, phase {name}"
            for name, anchor in free_times
        ]
        self._smooth = [
            build_polynomial_control_constraints(smooth, collocations[name])
            for name, phase in self.problem.phases.items()
            for smooth in list_polynomial_controls(phase)
        ]
        self._first_smooth_row = row
        self.junctions = self._assign_junction_row_indices(
            row + sum(values.shape[0] for _, values in self._smooth)
        )
        self._first_end_row = row + sum(values.shape[0] for _, values in self._smooth)
        self._first_end_row += sum(rows.size for *_, rows in self.junctions)
        for k, (name, collocation) in enumerate(collocations.items()):
            places = [
                time_place.get((name, anchor), self.n_variables + 2 * k + min(anchor, 1))
                for anchor in collocation.mesh.arc_breaks
            ]
            self.parts[name] = PhaseIndices(name, collocation, np.asarray(places, dtype=np.int64))

    def _assign_junction_row_indices(self, row: int) -> list[tuple[str, Junction, Indices]]:
        """Return phase, junction and rows of each junction of a state constraint."""
        placed = []
        for name, phase in self.problem.phases.items():
            for junction in list_arc_junctions(phase):
                count = count_junction_constraint_rows(junction, len(phase.path_labels))
                placed.append((name, junction, row + np.arange(count)))
                row += count
        return placed

    def _is_arc_break_time_fixed(self, name: str, anchor: int) -> bool:
        if anchor in self._movable[name]:
            return False
        return is_boundary_time_fixed(self.problem.phases[name], min(anchor, 1))

    def _assign_end_constraint_row_indices(self) -> None:
        self._durations = [
            name for name, part in self.parts.items() if np.all(part.times[[0, -1]] < self.n_variables)
        ]
        self._arcs = [
            (name, arc)
            for name, movable in self._movable.items()
            if movable
            for arc in range(len(movable) + 1)
        ]
        self._end_labels = [f"duration of phase {name}" for name in self._durations]
        self._end_labels += [f"length of arc {arc + 1}, phase {name}" for name, arc in self._arcs]
        self._end_labels += [f"constraint {label}" for label in self.problem.constraint_labels()]
        self._end_labels += [f"integral {label}, phase {name}" for name, label in self._defined]
        self.n_constraints = self._first_end_row + len(self._end_labels)
        first = self._first_end_row + len(self._durations) + len(self._arcs)
        self.constraint_rows = first + np.arange(len(self.problem.constraint_labels()))

    def mask_interior_states(self) -> Mask:
        """Return which variables are states inside a phase (n_variables,)."""
        found: Mask = np.zeros(self.n_variables, dtype=bool)
        for part in self.parts.values():
            found[part.collocation.point_states] = True
            found[part.collocation.boundary_states] = True
            found[part.collocation.boundary_states[:, [0, -1]]] = False
        return found

    # --- labels -----------------------------------------------------------------------------------

    @property
    def boundary_constraint_row_indices(self) -> dict[str, int]:
        """Rows of durations, arc lengths, boundary constraints and integrals by label."""
        return {label: self._first_end_row + i for i, label in enumerate(self._end_labels)}

    @cached_property
    def constraint_row_labels(self) -> tuple[str, ...]:
        labels: list[str] = []
        for name, part in self.parts.items():
            phase = self.problem.phases[name]
            labels += part.collocation.list_constraint_row_labels(
                name, phase.model.states.labels, phase.path_labels
            )
        labels += ["smoothness of a control"] * sum(values.shape[0] for _, values in self._smooth)
        for name, junction, rows in self.junctions:
            phase = self.problem.phases[name]
            what = (*phase.path_labels, *phase.model.states.labels)[junction.constraint]
            labels += [f"junction of {what}, phase {name}, end of segment {junction.boundary}"] * rows.size
        return (*labels, *self._end_labels)

    @cached_property
    def variable_labels(self) -> tuple[str, ...]:
        labels: list[str] = []
        for name, part in self.parts.items():
            model = self.problem.phases[name].model
            labels += part.collocation.list_variable_labels(name, model.states.labels, model.controls.labels)
        labels += self._time_labels
        labels += [f"parameter {label}" for label in self.problem.parameters.labels]
        labels += [f"integral {label}, phase {name}" for name, label in self._defined]
        return tuple(labels)


def is_boundary_time_fixed(phase: Phase, end: int) -> bool:
    """Return whether the initial (0) or final (1) time of the phase is fixed."""
    return bool(phase.time_ranges()[end].is_fixed[0])
