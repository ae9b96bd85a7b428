"""Transcription of an optimal control problem to a sparse nonlinear program with labelled rows and columns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import casadi as ca
import numpy as np
import scipy

from gnc_opt.array_types import Array, Indices
from gnc_opt.errors import unknown_name_error
from gnc_opt.numerical_tolerances import SHORTEST
from gnc_opt.planning.nlp.nonlinear_program import NlpProblem
from gnc_opt.planning.nlp.partially_separable_nlp import PointFunction, PointTerm, SeparableProgram
from gnc_opt.planning.problem.active_constraint_arcs import Junction
from gnc_opt.planning.problem.bounds import Interval, unbounded_interval
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.state_constraint_order import get_constraint_order
from gnc_opt.planning.problem.symbolic_expressions import list_model_parameter_arguments
from gnc_opt.planning.transcription.arc_constraints import (
    check_number_of_arc_segments,
    compute_junction_constraint_limits,
    find_controls_at_junction,
    impose_control_limits_on_arcs,
    impose_path_limits_on_arcs,
    impose_state_bounds_at_junctions,
    impose_state_limits_on_arcs,
    list_arc_junctions,
    list_junction_derivative_orders,
    list_polynomial_control_nonzeros,
    list_polynomial_controls,
    relax_bounds_of_linked_starts,
    relax_bounds_of_monotone_states,
    remove_implied_state_bounds,
)
from gnc_opt.planning.transcription.collocation import assemble_sparse_matrix
from gnc_opt.planning.transcription.collocation_families import Scheme
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.planning.transcription.nlp_layout import NlpLayout, PhaseIndices, is_boundary_time_fixed


@dataclass(frozen=True)
class _Symbols:
    """MX symbols of the program: scaled variables x, parameters p, and the parts of p."""

    x: Any
    p: Any
    models: dict[str, Any]
    times: Any
    scales: Any
    row_scales: Any
    objective_scale: Any


CACHED_PROGRAMS = 8
"""Largest number of cached programs of a problem; each may have a solver of many megabytes."""


class Transcription(NlpLayout):
    """Nonlinear program of a problem on given meshes; independent of the problem's numbers."""

    def __init__(self, problem: Problem, meshes: Mapping[str, Mesh], scheme: Scheme) -> None:
        super().__init__(problem, meshes, scheme)
        self.built: dict[Any, Any] = {}
        phase_blocks = [block for phase in problem.phases.values() for block in self._transcribe_phase(phase)]
        junctions = [self._transcribe_junction_constraint(*placed) for placed in self.junctions]
        self.program = SeparableProgram(
            self._build_linear_constraint_matrix(),
            (*phase_blocks, *junctions, self._transcribe_cost_and_boundary_constraints()),
        )
        self.objective, self.constraints = (
            self.program.select_constraint_rows(0, 1),
            self.program.select_constraint_rows(1, 1 + self.n_constraints),
        )

    # --- blocks -----------------------------------------------------------------------------------

    def _transcribe_phase(self, phase: Phase) -> list[PointTerm]:
        """Return the blocks of dynamics and path constraints, and of integrals, which need no dynamics."""
        collocation = self.parts[phase.name].collocation
        n_states, n_paths = phase.model.states.size, len(phase.path_labels)
        rows, columns, values = collocation.list_quadrature_nonzeros(
            n_states + n_paths, np.arange(n_states), n_states + np.arange(n_paths)
        )
        blocks = [self._transcribe_collocated_functions(phase, "dynamics", [(rows + 1, columns, values)])]
        entries = self._list_quadrature_weight_entries(phase)
        if entries:  # integrals that are only evaluated have no entries
            blocks.append(self._transcribe_collocated_functions(phase, "integrals", entries))
        return blocks

    def _transcribe_collocated_functions(
        self, phase: Phase, of: Literal["dynamics", "integrals"], entries: list[Any]
    ) -> PointTerm:
        """Return a block of rates times the duration, or of other functions, at all collocation points."""
        part = self.parts[phase.name]
        collocation = part.collocation
        n_points = collocation.mesh.size
        end_places = np.stack(
            [part.times[collocation.point_arc_indices], part.times[collocation.point_arc_indices + 1]]
        )
        is_free = np.any(end_places < self.n_variables, axis=1)
        free, fixed = np.flatnonzero(is_free), np.flatnonzero(~is_free)
        fixed_times = [
            self._nlp_parameter_symbols.times[(end_places[i] - self.n_variables).tolist()].T for i in fixed
        ]
        parameter_indices = np.tile(self.parameter_indices[:, None], (1, n_points))
        variables = np.vstack(
            [collocation.point_states, collocation.point_controls, end_places[free], parameter_indices]
        )
        data = ca.vertcat(
            ca.MX(ca.DM(collocation.normalised_times_in_arcs[None])),
            *fixed_times,
            ca.repmat(self._nlp_parameter_symbols.models[phase.name], 1, n_points),
        )
        function = self.problem.memoize(
            ("point", phase.name, of, *free.tolist()),
            lambda: self._build_dynamics_or_integral_function(phase, of, free, fixed),
        )
        weights = assemble_sparse_matrix(1 + self.n_constraints, function.n_rows * n_points, *entries)
        return PointTerm(function, variables.astype(np.int64), data, weights)

    def _build_dynamics_or_integral_function(
        self, phase: Phase, of: Literal["dynamics", "integrals"], free: Indices, fixed: Indices
    ) -> PointFunction:
        """Return the mesh-independent function of states, controls, free ends of the arc, and free parameters."""
        t, x, u, p = phase.model.symbolic_arguments()
        ends, fraction = ca.SX.sym("ends", 2), ca.SX.sym("fraction")
        span = ends[1] - ends[0]
        rates, others = (
            (phase.model.state_derivative(), phase.path_expression())
            if of == "dynamics"
            else (phase.integrand_expression(), ca.SX(0, 1))
        )
        outputs = self.problem.substitute_parameters(phase, ca.vertcat(span * rates, others))
        return PointFunction.from_expression(
            "point",
            ca.vertcat(x, u, ends[free.tolist()], self.problem.parameter_symbols()),
            ca.vertcat(fraction, ends[fixed.tolist()], p),
            ca.substitute(outputs, t, ends[0] + fraction * span),
        )

    def _list_quadrature_weight_entries(self, phase: Phase) -> list[Any]:
        collocation = self.parts[phase.name].collocation
        entries = []
        for place, label in enumerate(phase.integrands):
            columns = place + len(phase.integrands) * np.arange(collocation.mesh.size)
            for row, coefficient in self._list_nlp_coefficients_of_integral(phase.name, label):
                entries.append(
                    (np.full(columns.size, row), columns, coefficient * collocation.quadrature_weights)
                )
        return entries

    def _list_nlp_coefficients_of_integral(self, phase: str, label: str) -> list[tuple[int, float]]:
        """Return rows (0 is the objective) and coefficients of an integral in the program."""
        if (phase, label) in self._direct:
            coefficients = self._direct[phase, label]
            rows = np.concatenate([[0], 1 + self.constraint_rows])
            return [(int(rows[i]), float(coefficients[i])) for i in np.flatnonzero(coefficients)]
        row = self.n_constraints - len(self._defined) + self._defined.index((phase, label))
        return [(1 + row, -1.0)]

    def _transcribe_junction_constraint(self, name: str, junction: Junction, rows: Indices) -> PointTerm:
        """Return the block of a state constraint and its derivatives at a mesh break."""
        phase, part = self.problem.phases[name], self.parts[name]
        mesh = part.collocation.mesh
        t, x, u, p = phase.model.symbolic_arguments()
        segment, ends = min(junction.boundary, mesh.segments - 1), ca.SX.sym("ends", 2)
        arc = int(mesh.segment_arcs[segment])
        found = get_constraint_order(self.problem, phase, junction.constraint)
        orders = list_junction_derivative_orders(junction, len(phase.path_labels))
        outputs = ca.vertcat(*[found.derivatives[k] for k in orders], ca.SX(0, 1))
        beside = find_controls_at_junction(part.collocation, junction)
        points = ca.SX.sym("points", u.numel(), beside.points.shape[1])
        if junction.tangent:
            last = found.derivatives[-1]
            outputs = ca.vertcat(outputs, ca.substitute(last, u, points @ beside.weights))
        fraction = float(mesh.arc_starts[segment]) if junction.boundary < mesh.segments else 1.0
        time = ends[0] + fraction * (ends[1] - ends[0])
        places = part.times[[arc, arc + 1]]
        free, fixed = np.flatnonzero(places < self.n_variables), np.flatnonzero(places >= self.n_variables)
        function = PointFunction.from_expression(
            "junction",
            ca.vertcat(x, ca.vec(points), ends[free.tolist()], self.problem.parameter_symbols()),
            ca.vertcat(ends[fixed.tolist()], p),
            ca.substitute(outputs, t, time),
        )
        states = part.collocation.boundary_states[:, junction.boundary]
        variables = np.concatenate([states, beside.points.T.ravel(), places[free], self.parameter_indices])
        data = ca.vertcat(
            self._nlp_parameter_symbols.times[(places[fixed] - self.n_variables).tolist()],
            self._nlp_parameter_symbols.models[name],
        )
        weights = assemble_sparse_matrix(
            1 + self.n_constraints, rows.size, (1 + rows, np.arange(rows.size), np.ones(rows.size))
        )
        return PointTerm(function, variables[:, None].astype(np.int64), data, weights)

    def _transcribe_cost_and_boundary_constraints(self) -> PointTerm:
        """Return the block of the cost and the end rows, a function of end points, parameters and integrals."""
        places = [
            place
            for part in self.parts.values()
            for place in (
                part.collocation.boundary_states[:, 0],
                part.collocation.boundary_states[:, -1],
                part.times,
            )
        ]
        variables = np.concatenate([*places, self.parameter_indices, self.integral_places])
        arcs = [len(boundaries) for boundaries in self._movable.values()]
        function = self.problem.memoize(
            ("end rows", *arcs, *self._durations), self._build_boundary_constraint_function
        )
        rows = np.concatenate([[0], 1 + self._first_end_row + np.arange(len(self._end_labels))])
        weights = assemble_sparse_matrix(
            1 + self.n_constraints, rows.size, (rows, np.arange(rows.size), np.ones(rows.size))
        )
        data = ca.vertcat(*self._nlp_parameter_symbols.models.values())
        return PointTerm(function, variables[:, None].astype(np.int64), data, weights)

    def _build_boundary_constraint_function(self) -> PointFunction:
        """Return the function of the end block for a given number of movable breaks."""
        phases = self.problem.phases.values()
        arguments: list[Any] = []
        arc_lengths: list[Any] = []
        for phase in phases:
            inner = ca.SX.sym("boundary", len(self._movable[phase.name]))
            times = ca.vertcat(phase.initial_time, inner, phase.final_time)
            arguments += [phase.end_states("initial"), phase.end_states("final"), times]
            arc_lengths += [times[1:] - times[:-1]] if self._movable[phase.name] else []
        defined = [self.problem.phases[name].integrands[label][0] for name, label in self._defined]
        arguments += [self.problem.parameter_symbols(), *defined]
        outputs = ca.vertcat(
            self.problem.sense * self.problem.cost,
            *[self.problem.phases[name].duration for name in self._durations],
            *arc_lengths,
            self.problem.constraint_expression(),
            *defined,
        )
        for name, label in self._direct:
            outputs = ca.substitute(outputs, self.problem.phases[name].integrands[label][0], 0)
        for phase in phases:
            outputs = self.problem.substitute_parameters(phase, outputs)
        data = ca.vertcat(*list_model_parameter_arguments(self.problem.phases.values()))
        return PointFunction.from_expression("ends", ca.vertcat(*arguments), data, outputs)

    def _build_linear_constraint_matrix(self) -> Any:
        entries = [part.collocation.linear_dynamics_nonzeros for part in self.parts.values()]
        entries.append(list_polynomial_control_nonzeros(self._smooth, self._first_smooth_row))
        rows, columns, values = (np.concatenate([e[i] for e in entries]) for i in range(3))
        return scipy.sparse.coo_array(
            (values, (1 + rows, columns)), shape=(1 + self.n_constraints, self.n_variables)
        )

    # --- CasADi functions of the program ------------------------------------------------------------

    @cached_property
    def _nlp_parameter_symbols(self) -> _Symbols:
        models = {
            name: ca.MX.sym(f"{name}_parameters", phase.model.parameters.size)
            for name, phase in self.problem.phases.items()
        }
        others = (
            ca.MX.sym("fixed_times", 2 * len(models)),
            ca.MX.sym("scales", self.n_variables),
            ca.MX.sym("row_scales", self.n_constraints),
            ca.MX.sym("objective_scale"),
        )
        # Separate symbols instead of one vector: each function then copies only the parts that it uses.
        return _Symbols(
            ca.MX.sym("x", self.n_variables), ca.vertcat(*models.values(), *others), models, *others
        )

    @cached_property
    def nlp(self) -> NlpProblem:
        """Scaled program with its sparse derivatives, the input of the solver."""
        s = self._nlp_parameter_symbols
        arguments = s.scales * s.x, s.times
        sigma, lam = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.n_constraints)
        multipliers = ca.vertcat(s.objective_scale * sigma, s.row_scales * lam)
        f, gradient = self.objective.evaluate_constraints_and_jacobian(*arguments)
        g, jacobian = self.constraints.evaluate_constraints_and_jacobian(*arguments)
        hessian = self.program.evaluate_hessian(*arguments, multipliers)
        n, m = self.n_variables, self.n_constraints
        _, columns = self.objective.jacobian_pattern
        scaled = gradient * s.objective_scale * s.scales[columns.tolist()]
        gradient = ca.densify(_build_sparse_matrix(n, 1, columns, 0 * columns, scaled))
        rows, columns = self.constraints.jacobian_pattern
        # vec, because CasADi indexes a vector of one entry as a row
        scaled = jacobian * ca.vec(s.row_scales[rows.tolist()]) * s.scales[columns.tolist()]
        jacobian = _build_sparse_matrix(m, n, rows, columns, scaled)
        rows, columns = self.program.hessian_pattern
        hessian = _build_sparse_matrix(
            n, n, rows, columns, hessian * s.scales[rows.tolist()] * s.scales[columns.tolist()]
        )
        point, names = [s.x, s.p], ["x", "p"]
        return NlpProblem(
            x=s.x,
            p=s.p,
            f=s.objective_scale * self.objective.evaluate_constraint_rows(*arguments),
            g=s.row_scales * self.constraints.evaluate_constraint_rows(*arguments),
            grad_f=ca.Function(
                "nlp_grad_f", point, [s.objective_scale * f, gradient], names, ["f", "grad_f_x"]
            ),
            jac_g=ca.Function("nlp_jac_g", point, [s.row_scales * g, jacobian], names, ["g", "jac_g_x"]),
            hess_lag=ca.Function(
                "nlp_hess_l",
                [*point, sigma, lam],
                [hessian],
                [*names, "lam_f", "lam_g"],
                ["triu_hess_gamma_x_x"],
            ),
        )

    def evaluate_nlp_first_derivatives(self, problem: Problem, x: Array) -> tuple[Array, Array, Array]:
        """Return rows (n_constraints,), objective gradient (n_variables,) and Jacobian nonzeros in physical units."""
        ones = np.ones(self.n_variables), np.ones(self.n_constraints)
        p = self.build_parameter_vector(problem, *ones, 1.0)
        (_, gradient), (g, jacobian) = self.nlp.grad_f(x, p), self.nlp.jac_g(x, p)
        return g.full().ravel(), gradient.full().ravel(), np.asarray(jacobian.nonzeros())

    # --- numbers ----------------------------------------------------------------------------------

    def stack_model_parameters_and_fixed_times(self, problem: Problem) -> Array:
        """Return the model parameters and fixed times of a problem."""
        models = [phase.model.parameter_values for phase in problem.phases.values()]
        return np.concatenate([*models, self.list_fixed_phase_times(problem)])

    def build_parameter_vector(
        self, problem: Problem, scales: Array, row_scales: Array, objective_scale: float
    ) -> Array:
        """Return the parameters of the program: model parameters, fixed times and scales."""
        return np.concatenate(
            [self.stack_model_parameters_and_fixed_times(problem), scales, row_scales, [objective_scale]]
        )

    def list_fixed_phase_times(self, problem: Problem) -> Array:
        """Return initial and final time of each phase if fixed, else 0, shape (2 * n_phases,)."""
        times = [phase.time_ranges()[end] for phase in problem.phases.values() for end in (0, 1)]
        return np.asarray([t.lower[0] if t.is_fixed[0] else 0.0 for t in times])

    def get_variable_bounds(self, problem: Problem) -> Interval:
        """Return the bounds of all variables in physical units."""
        box = unbounded_interval(self.n_variables)
        for name, part in self.parts.items():
            self._set_phase_bounds(box, problem, problem.phases[name], part)
        q = problem.get_parameter_bounds()
        box.lower[self.parameter_indices], box.upper[self.parameter_indices] = q.lower, q.upper
        return box

    def _set_phase_bounds(self, box: Interval, problem: Problem, phase: Phase, part: PhaseIndices) -> None:
        collocation, numbers = part.collocation, phase.numbers
        controls = (
            numbers.controls
            if numbers.turns is None
            else numbers.turns.widen_bounds_for_solver(numbers.controls)
        )
        for places, bounds in (
            (collocation.boundary_states, numbers.states),
            (collocation.point_states, numbers.states),
            (collocation.point_controls, controls),
        ):
            box.lower[places], box.upper[places] = bounds.lower[:, None], bounds.upper[:, None]
        relax_bounds_of_linked_starts(box, phase, collocation)
        relax_bounds_of_monotone_states(box, problem, phase, collocation)
        remove_implied_state_bounds(box, problem, phase, collocation)
        check_number_of_arc_segments(phase, collocation)
        if numbers.arcs is not None:
            impose_control_limits_on_arcs(box, numbers.arcs, numbers.controls, collocation)
        for places, values in ((collocation.boundary_states[:, 0], numbers.initial),
                               (collocation.boundary_states[:, -1], numbers.final)):  # fmt: skip
            # Not max and min: a value beyond a bound by rounding must not cross it.
            lower, upper = box.lower[places], box.upper[places]
            box.lower[places], box.upper[places] = (
                np.clip(values.lower, lower, upper),
                np.clip(values.upper, lower, upper),
            )
        if numbers.arcs is not None:
            impose_state_limits_on_arcs(box, phase, numbers.arcs, collocation)
            impose_state_bounds_at_junctions(box, numbers.arcs, numbers.states, collocation)
        for place, time in zip(part.times[[0, -1]], phase.time_ranges(), strict=True):
            if place < self.n_variables:
                box.lower[place], box.upper[place] = time.lower[0], time.upper[0]

    def get_constraint_bounds(self, problem: Problem) -> Interval:
        """Return the bounds of all rows in physical units."""
        box = Interval(np.zeros(self.n_constraints), np.zeros(self.n_constraints))
        for name, part in self.parts.items():
            paths = problem.phases[name].get_path_bounds()
            rows = part.collocation.path_rows
            box.lower[rows], box.upper[rows] = paths.lower[:, None], paths.upper[:, None]
            held = problem.phases[name].numbers.arcs
            if held is not None:
                impose_path_limits_on_arcs(box, held, paths, part.collocation)
        for i, name in enumerate(self._durations):
            duration = problem.phases[name].numbers.duration
            box.lower[self._first_end_row + i] = duration.lower[0]
            box.upper[self._first_end_row + i] = duration.upper[0]
        for name, junction, rows in self.junctions:
            phase = problem.phases[name]
            order = get_constraint_order(self.problem, phase, junction.constraint).order
            values = compute_junction_constraint_limits(junction, phase.get_path_bounds(), order)
            box.lower[rows] = box.upper[rows] = values
        first = self._first_end_row + len(self._durations)
        arcs = slice(first, first + len(self._arcs))
        box.lower[arcs], box.upper[arcs] = SHORTEST, np.inf
        ends = problem.get_boundary_constraint_bounds()
        box.lower[self.constraint_rows], box.upper[self.constraint_rows] = ends.lower, ends.upper
        return box

    def get_duration_multiplier(self, phase: str, lam_g: Array) -> float:
        """Return the multiplier of a phase's duration row, 0 if it has none."""
        if phase not in self._durations:
            return 0.0
        return float(lam_g[self._first_end_row + self._durations.index(phase)])


def transcribe_problem(problem: Problem, meshes: Mapping[str, Mesh], scheme: Scheme) -> Transcription:
    """Return the transcription of a problem; one of the same structure and meshes is reused."""
    for name in meshes:
        if name not in problem.phases:
            raise unknown_name_error("phase", name, f"mesh of problem '{problem.name}'", problem.phases)
    fixed = tuple(is_boundary_time_fixed(phase, end) for phase in problem.phases.values() for end in (0, 1))
    held = tuple(
        (list_polynomial_controls(phase), list_arc_junctions(phase)) for phase in problem.phases.values()
    )
    key = (scheme, tuple(meshes[name] for name in problem.phases), fixed, held)
    builds = problem.builds
    built: Transcription = builds.pop(key, None) or Transcription(problem, meshes, scheme)
    builds[key] = built  # the most recent one is last
    programs = [k for k, value in builds.items() if isinstance(value, Transcription)]
    for old in programs[:-CACHED_PROGRAMS]:
        del builds[old]
    return built


def _build_sparse_matrix(n_rows: int, n_columns: int, rows: Indices, columns: Indices, nonzeros: Any) -> Any:
    starts = np.searchsorted(columns, np.arange(n_columns + 1))
    pattern = ca.Sparsity(n_rows, n_columns, starts.tolist(), rows.tolist())
    return ca.MX(pattern, nonzeros)
