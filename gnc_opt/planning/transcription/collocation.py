r"""Collocation of one phase: variables, constraint rows, and their constant matrices.

Let :math:`\Delta` be the duration of an arc (the phase, or its part between two movable mesh breaks),
:math:`w_k` the width of segment k as a fraction of its arc, and :math:`F_j = \Delta f(t_j, X_j, U_j)` the point
values. The rows of a segment are

* LG: :math:`\sum_j D_{ij} X_j - \tfrac{w_k}{2} F_i = 0` at its n points, and :math:`X_e - \sum_j e_j X_j = 0` for the
  end state, where e_j is the basis of the state polynomial at the end of the segment. This is equivalent to Gauss
  quadrature of the dynamics, with constant coefficients.
* LGR: :math:`\sum_j D_{ij} X_j - \tfrac{w_k}{2} F_i = 0` at its n points; the end state is a node of D.
* LGL: :math:`X_i - X_1 - \tfrac{w_k}{2} \sum_j A_{ij} F_j = 0` for i = 2...n (Lobatto IIIA; n = 2 is the
    trapezoidal rule, n = 3 Hermite-Simpson). The integral form is used because the square matrix D of LGL is
    singular, so that the costates of the differential form are not unique.

Adjacent segments share the state at their boundary.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from gnc_opt.array_types import Array, Indices
from gnc_opt.planning.transcription.collocation_families import PointFamily, Scheme, get_point_family
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.transcription.quadrature import CollocationRule, get_collocation_rule


@dataclass(frozen=True)
class PhaseCollocation:
    """Indices of the variables and rows of one phase in the program, and its constant matrices."""

    scheme: Scheme
    mesh: Mesh
    n_states: int
    n_controls: int
    n_paths: int
    first_variable: int
    first_row: int

    @property
    def family(self) -> PointFamily:
        return get_point_family(self.scheme)

    @cached_property
    def collocation_rules(self) -> tuple[CollocationRule, ...]:
        """The collocation rule of each segment."""
        return tuple(get_collocation_rule(self.scheme, n) for n in self.mesh.degrees)

    def _map_points_to_segments(self, starts: Array, widths: Array) -> Array:
        pieces = [starts[k] + 0.5 * widths[k] * (1 + r.points) for k, r in enumerate(self.collocation_rules)]
        return np.concatenate(pieces)

    @cached_property
    def normalised_point_times(self) -> Array:
        """Collocation times as fractions of the phase on the given mesh, shape (N,); for guesses."""
        return self._map_points_to_segments(np.asarray(self.mesh.breaks), self.mesh.segment_widths)

    @cached_property
    def normalised_times_in_arcs(self) -> Array:
        """Collocation times as fractions of their arcs, shape (N,)."""
        return self._map_points_to_segments(self.mesh.arc_starts, self.mesh.arc_widths)

    @cached_property
    def point_arc_indices(self) -> Indices:
        """Arc index of each collocation point, shape (N,)."""
        return np.repeat(self.mesh.segment_arcs, self.mesh.degrees)

    @cached_property
    def quadrature_weights(self) -> Array:
        """Quadrature weights as fractions of the arcs, shape (N,); they sum to 1 over each arc."""
        widths = self.mesh.arc_widths
        return np.concatenate([0.5 * widths[k] * r.weights for k, r in enumerate(self.collocation_rules)])

    # --- variables --------------------------------------------------------------------------------

    @cached_property
    def _state_and_control_indices(self) -> tuple[Indices, Indices, Indices, int]:
        n, m, mesh = self.n_states, self.n_controls, self.mesh
        starts, ends = self.family.starts_at_point, self.family.ends_at_point
        degrees, offsets = np.asarray(mesh.degrees), np.asarray(mesh.point_offsets)
        # Variables of a segment: states and controls point by point, then the state at its end.
        sizes = (n + m) * degrees - n * starts + n * (not ends)
        places = self.first_variable + n + np.concatenate([[0], np.cumsum(sizes)])
        within = np.arange(mesh.size) - np.repeat(offsets[:-1], degrees)
        controls = np.repeat(places[:-1], degrees) + (n + m) * within + n * (not starts)
        points = controls - n
        inner = points[offsets[1:] - 1] if ends else places[1:] - n
        boundary = np.concatenate([[self.first_variable], inner])
        if starts:
            points[offsets[:-1]] = boundary[:-1]
        grids = (
            _list_consecutive_indices(boundary, n),
            _list_consecutive_indices(points, n),
            _list_consecutive_indices(controls, m),
        )
        return *grids, int(places[-1]) - self.first_variable

    @property
    def boundary_states(self) -> Indices:
        """Variable indices of the states at the mesh breaks, shape (n_states, K + 1)."""
        return self._state_and_control_indices[0]

    @property
    def point_states(self) -> Indices:
        """Variable indices of the states at the collocation points, shape (n_states, N)."""
        return self._state_and_control_indices[1]

    @property
    def point_controls(self) -> Indices:
        """Variable indices of the controls at the collocation points, shape (n_controls, N)."""
        return self._state_and_control_indices[2]

    @property
    def n_variables(self) -> int:
        """Number of state and control variables of the phase."""
        return self._state_and_control_indices[3]

    # --- rows -------------------------------------------------------------------------------------

    @property
    def _segment_dynamics_row_counts(self) -> list[int]:
        return [n + self.family.extra_rows for n in self.mesh.degrees]

    @property
    def n_dynamics_rows(self) -> int:
        return self.n_states * sum(self._segment_dynamics_row_counts)

    @property
    def n_rows(self) -> int:
        """Number of constraint rows of the phase: dynamics, then path constraints."""
        return self.n_dynamics_rows + self.n_paths * self.mesh.size

    @cached_property
    def dynamics_rows(self) -> tuple[Indices, ...]:
        """Dynamics rows of each segment, shape (n_states, rows of the segment)."""
        starts = self.first_row + self.n_states * np.concatenate(
            [[0], np.cumsum(self._segment_dynamics_row_counts)]
        )
        return tuple(
            (starts[k] + np.arange(self.n_states * count)).reshape(count, self.n_states).T
            for k, count in enumerate(self._segment_dynamics_row_counts)
        )

    @cached_property
    def path_rows(self) -> Indices:
        """Row indices of the path constraints, shape (n_paths, N)."""
        start = self.first_row + self.n_dynamics_rows
        return (start + np.arange(self.n_paths * self.mesh.size)).reshape(self.mesh.size, self.n_paths).T

    def list_constraint_row_labels(
        self, phase: str, states: tuple[str, ...], paths: tuple[str, ...]
    ) -> list[str]:
        labels = []
        for k, count in enumerate(self._segment_dynamics_row_counts):
            for i in range(count):
                where = self.family.describe_dynamics_row_location(i, self.mesh.degrees[k])
                place = f"phase {phase}, segment {k + 1}, {where}"
                labels += [f"{s} defect, {place}" for s in states]
        for k, j in self._list_segment_and_point_indices():
            labels += [f"path {c}, phase {phase}, segment {k + 1}, point {j + 1}" for c in paths]
        return labels

    def list_variable_labels(
        self, phase: str, states: tuple[str, ...], controls: tuple[str, ...]
    ) -> list[str]:
        labels = [""] * self.n_variables
        for k, column in enumerate(self.boundary_states.T):
            place = "start" if k == 0 else f"end of segment {k}"
            for name, index in zip(states, column, strict=True):
                labels[index - self.first_variable] = f"{name}, phase {phase}, {place}"
        for (k, j), xs, us in zip(
            self._list_segment_and_point_indices(), self.point_states.T, self.point_controls.T, strict=True
        ):
            place = f"segment {k + 1}, point {j + 1}"
            for name, index in zip((*states, *controls), (*xs, *us), strict=True):
                labels[index - self.first_variable] = (
                    labels[index - self.first_variable] or f"{name}, phase {phase}, {place}"
                )
        return labels

    def _list_segment_and_point_indices(self) -> list[tuple[int, int]]:
        return [(k, j) for k, n in enumerate(self.mesh.degrees) for j in range(n)]

    # --- constant matrices --------------------------------------------------------------------------

    def build_dynamics_state_matrix(self, k: int) -> Array:
        """Return coefficients of the states of `index_segment_states` in the rows of segment k: (rows, nodes)."""
        rule = self.collocation_rules[k]
        return self.family.build_dynamics_state_matrix(rule.differentiation, rule.end_values)

    def build_dynamics_rate_matrix(self, k: int) -> Array:
        """Return the coefficients of the point values F_j in the rows of segment k, without -w_k/2: (rows, n)."""
        return self.family.build_dynamics_rate_matrix(self.collocation_rules[k].integration)

    @cached_property
    def linear_dynamics_nonzeros(self) -> tuple[Indices, Indices, Array]:
        """Return entries (rows, variables, values) of the constant part of the dynamics rows."""
        rows, columns, values = [], [], []
        for k in range(self.mesh.segments):
            nodes, matrix = self.index_segment_states(k), self.build_dynamics_state_matrix(k)
            i, j = np.nonzero(matrix)
            rows.append(self.dynamics_rows[k][:, i].ravel())
            columns.append(nodes[:, j].ravel())
            values.append(np.tile(matrix[i, j], self.n_states))
        return np.concatenate(rows), np.concatenate(columns), np.concatenate(values)

    def index_segment_states(self, k: int) -> Indices:
        """Return the state variables in the rows of segment k, shape (n_states, nodes)."""
        points = self.point_states[:, self.mesh.point_offsets[k] : self.mesh.point_offsets[k + 1]]
        return self.family.list_dynamics_row_variables(
            self.boundary_states[:, [k]], points, self.boundary_states[:, [k + 1]]
        )

    def list_quadrature_nonzeros(
        self, n_outputs: int, dynamics: Indices, paths: Indices
    ) -> tuple[Indices, Indices, Array]:
        """Return entries (rows, point outputs, values) of the point values in the rows.

        ``dynamics`` and ``paths`` are the indices of Delta f and of the path constraints in the ``n_outputs``.
        """
        rows, columns, values = [], [], []
        for k in range(self.mesh.segments):
            matrix = -0.5 * self.mesh.arc_widths[k] * self.build_dynamics_rate_matrix(k)
            i, j = np.nonzero(matrix)
            rows.append(self.dynamics_rows[k][:, i].ravel())
            point = self.mesh.point_offsets[k] + j
            columns.append((dynamics[:, None] + n_outputs * point[None, :]).ravel())
            values.append(np.tile(matrix[i, j], self.n_states))
        rows.append(self.path_rows.ravel())
        columns.append((paths[:, None] + n_outputs * np.arange(self.mesh.size)[None, :]).ravel())
        values.append(np.ones(self.path_rows.size))
        return np.concatenate(rows), np.concatenate(columns), np.concatenate(values)


def assemble_sparse_matrix(n_rows: int, n_columns: int, *entries: tuple[Any, Any, Any]) -> Any:
    """Return a csc matrix with the given entries (rows, columns, values)."""
    rows, columns, values = (np.concatenate([np.asarray(e[i]) for e in entries]) for i in range(3))
    matrix = scipy.sparse.csc_array((values, (rows, columns)), shape=(n_rows, n_columns))
    matrix.sum_duplicates()
    return matrix


def _list_consecutive_indices(first: Indices, count: int) -> Indices:
    return np.asarray(first[:, None] + np.arange(count), dtype=np.int64).T
