"""Transcription: an optimal control problem as a sparse nonlinear program with named rows and columns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from gnc_opt.errors import ProblemError, unknown_name
from gnc_opt.model.layout import Array
from gnc_opt.nlp.solver import NlpProblem
from gnc_opt.problem.interval import Interval, free
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.problem import Problem
from gnc_opt.transcription.collocation import PhaseCollocation, weight_matrix
from gnc_opt.transcription.mesh import Mesh
from gnc_opt.transcription.quadrature import Scheme
from gnc_opt.transcription.separable import Block, PointFunction, SeparableProgram

Indices = NDArray[np.int64]

SHORTEST_ARC = 1e-9
"""Least length (s) of an arc between movable mesh boundaries; an arc that short has vanished."""


@dataclass(frozen=True)
class PhasePart:
    """Where a phase lives in the program.

    Attributes
    ----------
    collocation : PhaseCollocation
    times : int array (n_arcs + 1,)
        Places of initial time, movable mesh boundaries and final time in the extended variables; >= n_variables
        where fixed.
    """

    name: str
    collocation: PhaseCollocation
    times: Indices


class Transcription:
    """The nonlinear program of a problem on given meshes; numbers (bounds, guesses, scales) come later.

    Parameters
    ----------
    problem : Problem
    meshes : mapping from phase name to Mesh
    scheme : {"LG", "LGR", "LGL"}

    Notes
    -----
    Variables: per phase states and controls in time order; then free times, parameters, integrals.
    Rows: per phase dynamics and path constraints; then durations, boundary constraints, integrals.
    """

    def __init__(self, problem: Problem, meshes: Mapping[str, Mesh], scheme: Scheme) -> None:
        self.problem = problem
        self.scheme = scheme
        self.parts: dict[str, PhasePart] = {}
        self._movable = {name: mesh.movable for name, mesh in meshes.items()}
        self._place_phases(meshes)
        self._place_end_block()
        self.program = SeparableProgram(
            self.n_variables,
            self.n_constraints,
            self._linear(),
            (*(self._phase_block(leg) for leg in problem.phases.values()), self._end_block()),
        )

    # --- numbering --------------------------------------------------------------------------------

    def _place_phases(self, meshes: Mapping[str, Mesh]) -> None:
        variable = row = 0
        collocations = {}
        for name, leg in self.problem.phases.items():
            collocation = PhaseCollocation(
                self.scheme,
                meshes[name],
                leg.model.states.size,
                leg.model.controls.size,
                len(leg.path_labels),
                variable,
                row,
            )
            collocations[name] = collocation
            variable += collocation.n_variables
            row += collocation.n_rows
        free_times = [
            (name, anchor)
            for name, collocation in collocations.items()
            for anchor in collocation.mesh.anchors
            if not self._is_fixed(name, anchor)
        ]
        time_place = {key: variable + i for i, key in enumerate(free_times)}
        variable += len(free_times)
        self.parameter_places = variable + np.arange(self.problem.parameters.size)
        variable += self.problem.parameters.size
        self._direct, self._defined = self._sort_integrals()
        self.integral_places = variable + np.arange(len(self._defined))
        self.n_variables = variable + len(self._defined)
        self._time_labels = [
            f"{'initial' if anchor == 0 else 'final' if anchor == meshes[name].segments else f'boundary {anchor}'} "
            f"time, phase {name}"
            for name, anchor in free_times
        ]
        self._first_end_row = row
        for k, (name, collocation) in enumerate(collocations.items()):
            places = [
                time_place.get((name, anchor), self.n_variables + 2 * k + min(anchor, 1))
                for anchor in collocation.mesh.anchors
            ]
            self.parts[name] = PhasePart(name, collocation, np.asarray(places, dtype=np.int64))

    def _is_fixed(self, name: str, anchor: int) -> bool:
        if anchor in self._movable[name]:
            return False
        return time_is_fixed(self.problem.phases[name], min(anchor, 1))

    def _place_end_block(self) -> None:
        self._durations = [
            name for name, part in self.parts.items() if np.all(part.times[[0, -1]] < self.n_variables)
        ]
        self._arcs = [(name, arc) for name, movable in self._movable.items() if movable for arc in range(len(movable) + 1)]
        self._end_labels = [f"duration of phase {name}" for name in self._durations]
        self._end_labels += [f"length of arc {arc + 1}, phase {name}" for name, arc in self._arcs]
        self._end_labels += [f"constraint {label}" for label in self.problem.constraint_labels()]
        self._end_labels += [f"integral {label}, phase {name}" for name, label in self._defined]
        self.n_constraints = self._first_end_row + len(self._end_labels)
        first = self._first_end_row + len(self._durations) + len(self._arcs)
        self.constraint_rows = first + np.arange(len(self.problem.constraint_labels()))

    # --- integrals --------------------------------------------------------------------------------

    def _sort_integrals(self) -> tuple[dict[tuple[str, str], Array], list[tuple[str, str]]]:
        """Split integrals into those with constant coefficients in (cost, constraints) and the others."""
        outputs = ca.vertcat(self.problem.sense * self.problem.cost, self.problem.constraint_expression())
        direct: dict[tuple[str, str], Array] = {}
        defined = []
        for leg in self.problem.phases.values():
            for label, (symbol, _) in leg.integrands.items():
                coefficients = ca.jacobian(outputs, symbol)
                if coefficients.is_constant():
                    direct[leg.name, label] = np.asarray(ca.DM(coefficients).full()).ravel()
                else:
                    defined.append((leg.name, label))
        return direct, defined

    # --- blocks -----------------------------------------------------------------------------------

    def _phase_block(self, leg: Phase) -> Block:
        part = self.parts[leg.name]
        collocation = part.collocation
        n_points, q = collocation.mesh.size, self.problem.parameters.size
        variables = np.vstack(
            [
                collocation.point_states,
                collocation.point_controls,
                part.times[collocation.point_arcs],
                part.times[collocation.point_arcs + 1],
                np.tile(self.parameter_places[:, None], n_points).reshape(q, n_points),
            ]
        )
        function, dynamics, integrals, paths = self._point_function(leg)
        entries = [collocation.weights(function.rows, dynamics, paths)]
        entries = [(rows + 1, columns, values) for rows, columns, values in entries]
        entries += self._integral_entries(leg, function.rows, integrals)
        data = ca.vertcat(
            ca.MX(ca.DM(collocation.arc_fractions.reshape(1, -1))),
            ca.repmat(self._model_parameters[leg.name], 1, n_points),
        )
        weights = weight_matrix(1 + self.n_constraints, function.rows * n_points, *entries)
        return Block(function, variables.astype(np.int64), data, weights)

    def _point_function(self, leg: Phase) -> tuple[PointFunction, Indices, Indices, Indices]:
        t, x, u, p = leg.model.arguments()
        t0, tf, fraction = ca.SX.sym("t0"), ca.SX.sym("tf"), ca.SX.sym("fraction")
        q = self.problem.parameter_symbols()
        span = tf - t0
        outputs = ca.vertcat(
            span * leg.model.derivative(), span * leg.integrand_expression(), leg.path_expression()
        )
        outputs = ca.substitute(self.problem.bind(leg, outputs), t, t0 + fraction * span)
        function = PointFunction.build(
            f"{leg.name}_point", ca.vertcat(x, u, t0, tf, q), ca.vertcat(fraction, p), outputs
        )
        sizes = [leg.model.states.size, len(leg.integrands), len(leg.path_labels)]
        starts = np.concatenate([[0], np.cumsum(sizes)])
        dynamics, integrals, paths = (starts[i] + np.arange(sizes[i]) for i in range(3))
        return function, dynamics, integrals, paths

    def _integral_entries(self, leg: Phase, n_outputs: int, places: Indices) -> list[Any]:
        collocation = self.parts[leg.name].collocation
        entries = []
        for place, label in zip(places, leg.integrands, strict=True):
            columns = place + n_outputs * np.arange(collocation.mesh.size)
            for row, coefficient in self._integral_rows(leg.name, label):
                entries.append((np.full(columns.size, row), columns, coefficient * collocation.quadrature))
        return entries

    def _integral_rows(self, phase: str, label: str) -> list[tuple[int, float]]:
        """Rows (0 is the objective) and coefficients by which an integral enters the program."""
        if (phase, label) in self._direct:
            coefficients = self._direct[phase, label]
            rows = np.concatenate([[0], 1 + self.constraint_rows])
            return [(int(rows[i]), float(coefficients[i])) for i in np.flatnonzero(coefficients)]
        row = self.n_constraints - len(self._defined) + self._defined.index((phase, label))
        return [(1 + row, -1.0)]

    def _end_block(self) -> Block:
        function, variables = self._end_function()
        rows = np.concatenate([[0], 1 + self._first_end_row + np.arange(len(self._end_labels))])
        weights = weight_matrix(1 + self.n_constraints, rows.size, (rows, np.arange(rows.size), np.ones(rows.size)))
        data = ca.vertcat(*self._model_parameters.values())
        return Block(function, variables.reshape(-1, 1).astype(np.int64), data, weights)

    def _end_function(self) -> tuple[PointFunction, Indices]:
        """The cost and the end rows as one function of end points, parameters and integrals."""
        phases = self.problem.phases.values()
        arguments, variables = [], []
        arc_lengths: list[Any] = []
        for leg in phases:
            part = self.parts[leg.name]
            inner = ca.SX.sym("boundary", len(self._movable[leg.name]))
            times = ca.vertcat(leg.initial_time, inner, leg.final_time)
            arguments += [leg.ends("initial"), leg.ends("final"), times]
            variables += [part.collocation.boundary_states[:, 0], part.collocation.boundary_states[:, -1], part.times]
            arc_lengths += [times[1:] - times[:-1]] if self._movable[leg.name] else []
        defined = [self.problem.phases[name].integrands[label][0] for name, label in self._defined]
        arguments += [self.problem.parameter_symbols(), *defined]
        variables += [self.parameter_places, self.integral_places]
        outputs = ca.vertcat(
            self.problem.sense * self.problem.cost,
            *[self.problem.phases[name].duration for name in self._durations],
            *arc_lengths,
            self.problem.constraint_expression(),
            *defined,
        )
        for name, label in self._direct:
            outputs = ca.substitute(outputs, self.problem.phases[name].integrands[label][0], 0)
        for leg in phases:
            outputs = self.problem.bind(leg, outputs)
        data = ca.vertcat(*[leg.model.symbols("parameter") for leg in phases])
        function = PointFunction.build("ends", ca.vertcat(*arguments), data, outputs)
        return function, np.concatenate(variables)

    def _linear(self) -> Any:
        entries = [part.collocation.linear for part in self.parts.values()]
        rows, columns, values = (np.concatenate([e[i] for e in entries]) for i in range(3))
        return sp.coo_array((values, (1 + rows, columns)), shape=(1 + self.n_constraints, self.n_variables))

    # --- the program as CasADi functions ------------------------------------------------------------

    @cached_property
    def _model_parameters(self) -> dict[str, Any]:
        return {
            name: ca.MX.sym(f"{name}_parameters", leg.model.parameters.size)
            for name, leg in self.problem.phases.items()
        }

    @cached_property
    def _symbols(self) -> tuple[Any, Any, Any, Any, Any]:
        """MX symbols: scaled variables, fixed times, variable scales, row scales, objective scale."""
        return (
            ca.MX.sym("x", self.n_variables),
            ca.MX.sym("fixed_times", 2 * len(self.parts)),
            ca.MX.sym("variable_scales", self.n_variables),
            ca.MX.sym("row_scales", self.n_constraints),
            ca.MX.sym("objective_scale"),
        )

    @cached_property
    def nlp(self) -> NlpProblem:
        """The scaled program with its sparse derivatives, ready for a solver."""
        x, times, scales, row_scales, objective_scale = self._symbols
        p = ca.vertcat(*self._model_parameters.values(), times, scales, row_scales, objective_scale)
        symbols = [*self._model_parameters.values(), times, scales, row_scales, objective_scale]
        p_symbol = ca.MX.sym("p", p.size1())
        pieces = ca.vertsplit(p_symbol, np.concatenate([[0], np.cumsum([s.size1() for s in symbols])]).tolist())

        def bound(expressions: list[Any]) -> list[Any]:
            return list(ca.graph_substitute(expressions, symbols, pieces))

        physical = scales * x
        output_scales = ca.vertcat(objective_scale, row_scales)
        values, nonzeros = bound(
            [output_scales * self.program.values(physical, times), self.program.jacobian(physical, times)]
        )
        f, g = values[0], values[1:]
        sigma, lam = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.n_constraints)
        hessian_values = bound(
            [self.program.hessian(physical, times, output_scales * ca.vertcat(sigma, lam))]
        )[0]
        scales, output_scales = bound([scales, output_scales])
        gradient, jacobian = self._split_jacobian(nonzeros, scales, output_scales)
        hessian = self._hessian_matrix(hessian_values, scales)
        return NlpProblem(
            x=x,
            p=p_symbol,
            f=f,
            g=g,
            grad_f=ca.Function("nlp_grad_f", [x, p_symbol], [f, gradient], ["x", "p"], ["f", "grad_f_x"]),
            jac_g=ca.Function("nlp_jac_g", [x, p_symbol], [g, jacobian], ["x", "p"], ["g", "jac_g_x"]),
            hess_lag=ca.Function(
                "nlp_hess_l",
                [x, p_symbol, sigma, lam],
                [hessian],
                ["x", "p", "lam_f", "lam_g"],
                ["triu_hess_gamma_x_x"],
            ),
        )

    @cached_property
    def physical(self) -> Any:
        """Function (x, model parameters and fixed times) -> ((f, g), nonzeros of its Jacobian), unscaled."""
        x, times = self._symbols[:2]
        numbers = [*self._model_parameters.values(), times]
        stacked = ca.MX.sym("numbers", sum(s.size1() for s in numbers))
        pieces = ca.vertsplit(stacked, np.concatenate([[0], np.cumsum([s.size1() for s in numbers])]).tolist())
        outputs = [self.program.values(x, times), self.program.jacobian(x, times)]
        return ca.Function("physical", [x, stacked], ca.graph_substitute(outputs, numbers, pieces))

    def numbers(self, problem: Problem) -> Array:
        """Model parameters and fixed times of a problem, as `physical` takes them."""
        models = [leg.model.parameter_values for leg in problem.phases.values()]
        return np.concatenate([*models, self.fixed_times(problem)])

    def _split_jacobian(self, nonzeros: Any, scales: Any, output_scales: Any) -> tuple[Any, Any]:
        rows, columns = self.program.jacobian_pattern
        scaled = nonzeros * output_scales[rows.tolist()] * scales[columns.tolist()]
        objective, others = np.flatnonzero(rows == 0), np.flatnonzero(rows > 0)
        gradient = _sparse(self.n_variables, 1, columns[objective], 0 * objective, scaled[objective.tolist()])
        jacobian = _sparse(
            self.n_constraints, self.n_variables, rows[others] - 1, columns[others], scaled[others.tolist()]
        )
        return ca.densify(gradient), jacobian

    def _hessian_matrix(self, nonzeros: Any, scales: Any) -> Any:
        rows, columns = self.program.hessian_pattern
        scaled = nonzeros * scales[rows.tolist()] * scales[columns.tolist()]
        return _sparse(self.n_variables, self.n_variables, rows, columns, scaled)

    # --- numbers ----------------------------------------------------------------------------------

    def parameter_vector(self, problem: Problem, scales: Array, row_scales: Array, objective_scale: float) -> Array:
        """Stack the program's parameters: model parameters, fixed times and scales."""
        return np.concatenate([self.numbers(problem), scales, row_scales, [objective_scale]])

    def fixed_times(self, problem: Problem) -> Array:
        """Initial and final time of each phase where fixed, else 0, shape (2 * n_phases,)."""
        times = [_times(leg)[end] for leg in problem.phases.values() for end in (0, 1)]
        return np.asarray([t.lower[0] if t.fixed[0] else 0.0 for t in times])

    def variable_interval(self, problem: Problem) -> Interval:
        """Bounds of all variables, in physical units."""
        box = free(self.n_variables)
        for name, part in self.parts.items():
            self._put_phase_bounds(box, problem.phases[name], part)
        q = problem.parameter_interval()
        box.lower[self.parameter_places], box.upper[self.parameter_places] = q.lower, q.upper
        return box

    def _put_phase_bounds(self, box: Interval, leg: Phase, part: PhasePart) -> None:
        collocation, numbers = part.collocation, leg.numbers
        for places, bounds in (
            (collocation.boundary_states, numbers.states),
            (collocation.point_states, numbers.states),
            (collocation.point_controls, numbers.controls),
        ):
            box.lower[places], box.upper[places] = bounds.lower[:, None], bounds.upper[:, None]
        if numbers.arcs is not None:
            self._hold_controls(box, leg, collocation)
        for places, values in ((collocation.boundary_states[:, 0], numbers.initial),
                               (collocation.boundary_states[:, -1], numbers.final)):  # fmt: skip
            box.lower[places] = np.maximum(box.lower[places], values.lower)
            box.upper[places] = np.minimum(box.upper[places], values.upper)
        for place, time in zip(part.times[[0, -1]], _times(leg), strict=True):
            if place < self.n_variables:
                box.lower[place], box.upper[place] = time.lower[0], time.upper[0]

    def _hold_controls(self, box: Interval, leg: Phase, collocation: PhaseCollocation) -> None:
        arcs = np.asarray(leg.numbers.arcs)
        if arcs.shape[1] != collocation.mesh.segments:
            raise ProblemError(
                f"arcs of {leg.where} are given for {arcs.shape[1]} segments, but its mesh has "
                f"{collocation.mesh.segments}: give one column per segment."
            )
        signs = np.repeat(arcs, collocation.mesh.degrees, axis=1)
        bounds, places = leg.numbers.controls, collocation.point_controls
        for sign, limits in ((-1, bounds.lower), (1, bounds.upper)):
            held = np.broadcast_to(limits[:, None], signs.shape)[signs == sign]
            box.lower[places[signs == sign]] = box.upper[places[signs == sign]] = held

    def row_interval(self, problem: Problem) -> Interval:
        """Bounds of all rows, in physical units."""
        box = Interval(np.zeros(self.n_constraints), np.zeros(self.n_constraints))
        for name, part in self.parts.items():
            paths = problem.phases[name].path_interval()
            rows = part.collocation.path_rows
            box.lower[rows], box.upper[rows] = paths.lower[:, None], paths.upper[:, None]
        for i, name in enumerate(self._durations):
            duration = problem.phases[name].numbers.duration
            box.lower[self._first_end_row + i] = duration.lower[0]
            box.upper[self._first_end_row + i] = duration.upper[0]
        first = self._first_end_row + len(self._durations)
        arcs = slice(first, first + len(self._arcs))
        box.lower[arcs], box.upper[arcs] = SHORTEST_ARC, np.inf
        ends = problem.constraint_interval()
        box.lower[self.constraint_rows], box.upper[self.constraint_rows] = ends.lower, ends.upper
        return box

    def duration_multiplier(self, phase: str, lam_g: Array) -> float:
        """Return the multiplier of a phase's duration row, 0 if it has none."""
        if phase not in self._durations:
            return 0.0
        return float(lam_g[self._first_end_row + self._durations.index(phase)])

    @cached_property
    def row_labels(self) -> tuple[str, ...]:
        """The name of every constraint row."""
        labels: list[str] = []
        for name, part in self.parts.items():
            leg = self.problem.phases[name]
            labels += part.collocation.row_labels(name, leg.model.states.labels, leg.path_labels)
        return (*labels, *self._end_labels)

    @cached_property
    def variable_labels(self) -> tuple[str, ...]:
        """The name of every variable."""
        labels: list[str] = []
        for name, part in self.parts.items():
            model = self.problem.phases[name].model
            labels += part.collocation.variable_labels(name, model.states.labels, model.controls.labels)
        labels += self._time_labels
        labels += [f"parameter {label}" for label in self.problem.parameters.labels]
        labels += [f"integral {label}, phase {name}" for name, label in self._defined]
        return tuple(labels)


def transcribe(problem: Problem, meshes: Mapping[str, Mesh], scheme: Scheme) -> Transcription:
    """Return the transcription of a problem, re-using an earlier one of the same structure and meshes."""
    for name in meshes:
        if name not in problem.phases:
            raise unknown_name("phase", name, f"mesh of problem '{problem.name}'", problem.phases)
    fixed = tuple(time_is_fixed(leg, end) for leg in problem.phases.values() for end in (0, 1))
    key = (scheme, tuple(meshes[name] for name in problem.phases), fixed)
    if key not in problem.builds:
        problem.builds[key] = Transcription(problem, meshes, scheme)
    built: Transcription = problem.builds[key]
    return built


def time_is_fixed(leg: Phase, end: int) -> bool:
    """Whether the phase's initial (0) or final (1) time is a given number."""
    return bool(_times(leg)[end].fixed[0])


def _times(leg: Phase) -> tuple[Interval, Interval]:
    initial, final = leg.numbers.initial_time, leg.numbers.final_time
    assert initial is not None and final is not None, "check_problem refuses phases without times"
    return initial, final


def _sparse(n_rows: int, n_columns: int, rows: Indices, columns: Indices, nonzeros: Any) -> Any:
    """Build an MX matrix from column-major (row, column) places and its nonzeros."""
    starts = np.searchsorted(columns, np.arange(n_columns + 1))
    pattern = ca.Sparsity(n_rows, n_columns, starts.tolist(), rows.tolist())
    return ca.MX(pattern, nonzeros)
