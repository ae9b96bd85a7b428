"""Sensitivity: derivatives of an optimal solution in the numbers of its problem.

The derivatives are those of the transcribed program (see `kkt_sensitivity`), and of the continuous
problem up to its discretisation error. They are valid while the set of active limits does not change.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import StrictAttributes
from gnc_opt.array_types import Array
from gnc_opt.errors import ProblemError, unknown_name_error, warn_user
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_batch
from gnc_opt.model.model_variables import Layout
from gnc_opt.planning.optimality.kkt_system import ProgramPoint
from gnc_opt.planning.problem.hamiltonian_functions import compile_phase_functions
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.solution.phase_solution import PhaseSolution, Signal
from gnc_opt.planning.solution.piecewise_polynomial import PiecewisePolynomial, Side
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.solution_from_nlp_result import build_state_polynomial, read_phase_parameters
from gnc_opt.planning.study.kkt_sensitivity import DataPerturbation, KktPoint, SolutionDerivative
from gnc_opt.planning.study.problem_data_perturbation import list_problem_data_perturbations
from gnc_opt.planning.transcription.nlp_layout import PhaseIndices
from gnc_opt.planning.transcription.transcription import Transcription
from gnc_opt.threads_and_package_versions import limit_to_one_thread


@dataclass(frozen=True)
class SignalSensitivity:
    """Derivative of a state or control at fixed time, of the same shape; a vector quantity adds a first axis."""

    name: str
    scalar: bool
    components: tuple[Signal, ...]

    def __call__(self, t: ArrayLike, side: Side = "right") -> Array | float:
        """Return the derivative at time t (s)."""
        values = [signal(t, side) for signal in self.components]
        return values[0] if self.scalar else np.stack([np.asarray(v) for v in values])


@dataclass(frozen=True, eq=False)
class PhaseSensitivity(StrictAttributes):
    """Derivatives of the solution of one phase.

    Attributes
    ----------
    initial_time, final_time : float or array (n_components,)
    switching_times : array (n_movable,) or (n_components, n_movable)
        Derivatives of the times of free mesh breaks.
    """

    name: str
    initial_time: Array | float
    final_time: Array | float
    switching_times: Array
    states: Mapping[str, SignalSensitivity]
    controls: Mapping[str, SignalSensitivity]


@dataclass(frozen=True, eq=False)
class Sensitivity(StrictAttributes):
    """Derivatives of a solution in one quantity (per unit of it).

    For a quantity with several components, they are the first axis of every derivative.

    Attributes
    ----------
    quantity : str
        Name, e.g. ``"parameter 'k'"``.
    objective : float or array (n_components,)
        Derivative of the objective as stated (not negated for a maximum).
    phases : mapping of PhaseSensitivity
    parameters : mapping of float or array
        Derivatives of the optimised parameters.

    Examples
    --------
    >>> change = go.sensitivity(solution, initial="q")
    >>> print(change.quantity, f"{change.final_time:.6f}")
    initial value of 'q' in phase 'leg' 1.000000
    """

    quantity: str
    objective: Array | float
    phases: Mapping[str, PhaseSensitivity]
    parameters: Mapping[str, Array | float]

    def phase(self, name: str | None = None) -> PhaseSensitivity:
        """Return the derivatives of a phase; the name is optional for a single phase."""
        if name is None and len(self.phases) == 1:
            return next(iter(self.phases.values()))
        if name is None:
            raise ProblemError(f"there are {len(self.phases)} phases: name one of {list(self.phases)}.")
        if name not in self.phases:
            raise unknown_name_error("phase", name, "the sensitivity", self.phases)
        return self.phases[name]

    def state(self, name: str, phase: str | None = None) -> SignalSensitivity:
        """Return the derivative of a state over time: ``s.state("q")(0.3)``."""
        return _get_state_or_control_sensitivity(self.phase(phase).states, name, "state")

    def control(self, name: str, phase: str | None = None) -> SignalSensitivity:
        """Return the derivative of a control over time."""
        return _get_state_or_control_sensitivity(self.phase(phase).controls, name, "control")

    def parameter(self, name: str) -> Array | float:
        """Return the derivative of an optimised parameter."""
        if name not in self.parameters:
            raise unknown_name_error("optimised parameter", name, "the sensitivity", self.parameters)
        return self.parameters[name]

    @property
    def initial_time(self) -> Array | float:
        """Derivative of the initial time of the only phase."""
        return self.phase().initial_time

    @property
    def final_time(self) -> Array | float:
        """Derivative of the final time of the only phase."""
        return self.phase().final_time


def _get_state_or_control_sensitivity(
    signals: Mapping[str, SignalSensitivity], name: str, kind: str
) -> SignalSensitivity:
    if not isinstance(name, str) or name not in signals:
        raise unknown_name_error(kind, name, "the sensitivity", signals)
    return signals[name]


FREE_CONTROL_CURVATURE_MIN_SHARE = 1e-10
"""Curvature of H in a free control, relative to the largest, below which it counts as zero."""

_POINTS: WeakKeyDictionary[Solution, KktPoint] = WeakKeyDictionary()


@limit_to_one_thread()
def sensitivity(
    solution: Solution,
    parameter: str | None = None,
    /,
    *,
    initial: str | None = None,
    final: str | None = None,
    time: Literal["initial", "final"] | None = None,
    constraint: str | None = None,
    phase: str | None = None,
) -> Sensitivity:
    """Return the derivatives of the optimal solution in one quantity.

    Parameters
    ----------
    solution : Solution
        Solved solution with its problem.
    parameter : str, optional
        Model parameter, in every phase that has it (or in ``phase``).
    initial, final : str, optional
        State with a fixed initial or final value, or one at its limit.
    time : {"initial", "final"}, optional
        Time that is fixed or at its limit.
    constraint : str, optional
        Boundary constraint; its active limit is varied.
    phase : str, optional
        Optional for a single phase.

    Returns
    -------
    Sensitivity
        Derivatives of objective, times, states and controls (at fixed time) and optimised parameters. Those of the
        objective are the costates: d(objective)/d(initial q) is costate("q")(t0), negated for a maximum.

    Raises
    ------
    ProblemError
        No quantity or several, an unknown one, or an optimised one.
    GncOptError
        No problem, not solved, or first-order conditions that do not determine the solution.

    Warns
    -----
    ProblemWarning
        A limit is weakly active, so that derivatives are one-sided.

    Examples
    --------
    From rest at a distance q the minimum time is 2 sqrt(q):

    >>> print(f"{go.sensitivity(solution, initial='q').objective:.6f}")
    1.000000
    """
    given = {
        "parameter": parameter,
        "initial": initial,
        "final": final,
        "time": time,
        "constraint": constraint,
    }
    chosen = [(kind, name) for kind, name in given.items() if name is not None]
    if len(chosen) != 1:
        raise ProblemError(
            f"sensitivity() needs one quantity, not {len(chosen)}: name one, as in sensitivity(solution, 'k'), or by "
            "initial='x', final='x', time='final' or constraint='c'."
        )
    solution.need_solved_problem("differentiate")
    point = _get_factorised_kkt(solution)
    kind, name = chosen[0]
    quantity, changes = list_problem_data_perturbations(point.program, solution, kind, name, phase)
    responses = [point.differentiate_solution(change) for change in changes]
    return _assemble_solution_sensitivity(point.program, solution, quantity, changes, responses)


def _get_factorised_kkt(solution: Solution) -> KktPoint:
    if solution not in _POINTS:
        _POINTS[solution] = KktPoint(solution)
        _warn_of_singular_controls(_POINTS[solution].program, solution)
    return _POINTS[solution]


def _warn_of_singular_controls(program: ProgramPoint, solution: Solution) -> None:
    """Warn if a control between its limits has no curvature of H; its derivative then depends on the mesh."""
    for name, part in program.transcription.parts.items():
        phase, collocation = solution.phases[name], part.collocation
        free = ~program.variables.active[collocation.point_controls]
        free &= ~np.any(program.rows.active[collocation.path_rows], axis=0)
        if not free.any():
            continue
        times, variables = phase.point_times, program.x * program.scaling.variables
        states, controls = (variables[p] for p in (collocation.point_states, collocation.point_controls))
        functions = solution.phase_functions(name)
        curvature = functions.control_hessian(
            times, states, controls, phase.point_costates, phase.path_multipliers
        )
        sizes = program.scaling.variables[collocation.point_controls[:, 0]]
        curvature = curvature * (sizes[:, None] * sizes)[:, :, None]
        largest = float(np.max(np.abs(curvature)))
        for j in np.flatnonzero(free.any(axis=0)):
            rows = np.flatnonzero(free[:, j])
            values, vectors = np.linalg.eigh(curvature[np.ix_(rows, rows, [j])][:, :, 0])
            if np.min(np.abs(values)) > FREE_CONTROL_CURVATURE_MIN_SHARE * largest:
                continue
            label = phase.controls.labels[rows[int(np.argmax(np.abs(vectors[:, np.argmin(np.abs(values))])))]]
            warn_user(
                f"control '{label}' of '{solution.problem_name}' is singular at "
                f"t = {times[j]:.6g} {functions.time_unit}, phase {name} (the Hamiltonian has no curvature in it): "
                "the derivatives of the controls there depend on the mesh; "
                "refine(solution, structure='auto') resolves bang-bang arcs."
            )
            return


def _assemble_solution_sensitivity(
    program: ProgramPoint,
    solution: Solution,
    quantity: str,
    changes: list[DataPerturbation],
    responses: list[SolutionDerivative],
) -> Sensitivity:
    problem, transcription = program.problem, program.transcription
    layout = problem.parameters
    values = np.stack([r.variables[transcription.parameter_indices] for r in responses])
    parameters = {
        name: _stack_signal_components(list(values[:, layout.slice(name)])) for name in layout.names
    }
    phases = {
        name: _build_phase_sensitivity(program, part, solution.phases[name], changes, responses)
        for name, part in transcription.parts.items()
    }
    objective = _stack_signal_components([np.array([problem.sense * r.objective]) for r in responses])
    return Sensitivity(quantity, objective, phases, parameters)


def _stack_signal_components(components: list[Array]) -> Array | float:
    """Return the values of all components; single components and single values have no axis."""
    flat = [c[0] if c.size == 1 else c for c in components]
    if len(flat) > 1:
        return np.asarray(flat)
    return float(flat[0]) if components[0].size == 1 else np.asarray(flat[0])


def _build_phase_sensitivity(
    program: ProgramPoint,
    part: PhaseIndices,
    phase: PhaseSolution,
    changes: list[DataPerturbation],
    responses: list[SolutionDerivative],
) -> PhaseSensitivity:
    pieces = [
        _differentiate_phase_trajectory(program, part, phase, c, r)
        for c, r in zip(changes, responses, strict=True)
    ]
    anchors = [piece[0] for piece in pieces]
    scalar = len(pieces) == 1

    def build_state_or_control_sensitivities(
        layout: Layout, sources: list[PiecewisePolynomial]
    ) -> dict[str, SignalSensitivity]:
        return {
            v.name: SignalSensitivity(
                v.name,
                scalar,
                tuple(Signal(v.name, "", v.labels, source, layout.slice(v.name)) for source in sources),
            )
            for v in layout.variables
        }

    inner = np.stack([a[1:-1] for a in anchors])
    return PhaseSensitivity(
        phase.name,
        _stack_signal_components([a[:1] for a in anchors]),
        _stack_signal_components([a[-1:] for a in anchors]),
        inner[0] if scalar else inner,
        build_state_or_control_sensitivities(phase.states, [piece[1] for piece in pieces]),
        build_state_or_control_sensitivities(phase.controls, [piece[2] for piece in pieces]),
    )


def _differentiate_phase_trajectory(
    program: ProgramPoint,
    part: PhaseIndices,
    phase: PhaseSolution,
    change: DataPerturbation,
    response: SolutionDerivative,
) -> tuple[Array, PiecewisePolynomial, PiecewisePolynomial]:
    """Return the derivatives of the anchors (n_arcs + 1,), and of states and controls at fixed times."""
    transcription, collocation = program.transcription, part.collocation
    n_times = 2 * len(transcription.parts)
    moved = np.concatenate([response.variables, change.numbers[-n_times:]])
    anchors = moved[part.times]
    rates = _differentiate_rates_at_points(program, part, phase, change, moved)
    states = build_state_polynomial(collocation, phase.breaks, response.variables, rates)
    controls = phase.interpolate_point_values(response.variables[collocation.point_controls])
    shifts = _differentiate_boundary_times(transcription, part, anchors)
    return (
        anchors,
        _convert_derivative_to_fixed_time(states, phase.x, shifts),
        _convert_derivative_to_fixed_time(controls, phase.u, shifts),
    )


def _differentiate_boundary_times(transcription: Transcription, part: PhaseIndices, anchors: Array) -> Array:
    mesh = part.collocation.mesh
    starts = anchors[mesh.segment_arcs] + mesh.arc_starts * np.diff(anchors)[mesh.segment_arcs]
    return np.append(starts, anchors[-1])


def _convert_derivative_to_fixed_time(
    change: PiecewisePolynomial, signal: PiecewisePolynomial, shifts: Array
) -> PiecewisePolynomial:
    """Return the derivative at fixed time: dX/dp at a node minus dx/dt times the node's dt/dp."""
    if not np.any(shifts):
        return change
    slopes = signal.derivative()
    values = []
    for k, nodes in enumerate(change.nodes):
        moved = shifts[k] + 0.5 * (1 + nodes) * (shifts[k + 1] - shifts[k])
        values.append(change.values[k] - slopes.values[k] * moved)
    return PiecewisePolynomial(change.breaks, change.nodes, tuple(values))


def _differentiate_rates_at_points(
    program: ProgramPoint, part: PhaseIndices, phase: PhaseSolution, change: DataPerturbation, moved: Array
) -> Array:
    """Return the derivatives of dx/dt times the arc duration at the points, (n_states, N)."""
    collocation, problem = part.collocation, program.problem
    own = problem.phases[part.name]
    variables = program.x * program.scaling.variables
    q = variables[program.transcription.parameter_indices]
    extended = np.concatenate([variables, program.transcription.list_fixed_phase_times(problem)])
    here, there = extended[part.times], moved[part.times]
    arcs, fractions = collocation.point_arc_indices, collocation.normalised_times_in_arcs
    spans, stretch = np.diff(here)[arcs], np.diff(there)[arcs]
    times, time_changes = here[arcs] + fractions * spans, there[arcs] + fractions * stretch
    x, u = extended[collocation.point_states], extended[collocation.point_controls]
    p = read_phase_parameters(problem, own, q)
    functions = compile_phase_functions(problem, part.name, p, q, phase.integral_weights)
    # Index of the parameters of this phase.
    names = list(problem.phases)
    earlier = (problem.phases[name] for name in names[: names.index(part.name)])
    offset = sum(other.model.parameters.size for other in earlier)
    directions = [
        time_changes[None, :],
        moved[collocation.point_states],
        moved[collocation.point_controls],
        change.numbers[offset : offset + p.size],
        moved[program.transcription.parameter_indices],
    ]
    derivative = _build_rate_derivative_function(problem, own)
    change_of_f = evaluate_casadi_batch(derivative, times.size, times[None, :], x, u, p, q, *directions)
    return np.asarray(spans * change_of_f + stretch * functions.state_rates(times, x, u))


def _build_rate_derivative_function(problem: Problem, phase: Phase) -> Any:
    def build_directional_derivative() -> Any:
        arguments = [*phase.model.symbolic_arguments(), problem.parameter_symbols()]
        changes = [ca.SX.sym(f"d{i}", a.shape[0]) for i, a in enumerate(arguments)]
        rates = problem.substitute_parameters(phase, phase.model.state_derivative())
        outputs = ca.densify(ca.jtimes(rates, ca.vertcat(*arguments), ca.vertcat(*changes)))
        return ca.Function("rate_derivative", [*arguments, *changes], [outputs])

    return problem.memoize(("rate derivative", phase.name), build_directional_derivative)
