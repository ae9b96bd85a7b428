"""Solution: result of `solve`, for evaluation, verification, storage and use as a guess."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import require_type
from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError, GncOptError, ProblemError, unknown_name_error
from gnc_opt.model.model_variables import Layout, Variable
from gnc_opt.model.split_and_magnitude_direction_controls import (
    AssembledControl,
    SplitControl,
    UnitVectorControl,
    VectorControl,
)
from gnc_opt.model.trajectory_protocol import TrajectoryPhase
from gnc_opt.npz_result_files import DataclassSerializer, FileFormat
from gnc_opt.planning.nlp.nlp_solver_status import Status
from gnc_opt.planning.problem.active_constraint_arcs import Arc, ArcKind
from gnc_opt.planning.problem.angle_valued_controls import UnboundedAngles
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.problem.hamiltonian_functions import (
    PhaseFunctions,
    compile_expression,
    compile_phase_functions,
)
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.problem import Problem
from gnc_opt.planning.problem.reformulation import reformulate_problem
from gnc_opt.planning.problem.symbolic_expressions import (
    OutsideTable,
    find_boundary_values_outside_tables,
    find_points_outside_tables,
    list_table_calls,
)
from gnc_opt.planning.solution.constraint_violation_diagnosis import Violation
from gnc_opt.planning.solution.defects_and_violations import Propagation, integrate_dynamics
from gnc_opt.planning.solution.optimality_verdict import LowerBound, Verdict
from gnc_opt.planning.solution.phase_solution import (
    PhaseSolution,
    Signal,
    build_time_history,
    drop_singleton_axes,
)
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.piecewise_polynomial import PiecewisePolynomial, Side
from gnc_opt.planning.solution.refinement_history import (
    Actions,
    History,
    RefinementIteration,
    RefinementStatus,
    Statistics,
)
from gnc_opt.planning.solution.solution_accuracy import (
    Accuracy,
    ObjectiveError,
    estimate_objective_error,
    measure_accuracy,
)
from gnc_opt.planning.solution.solution_summary import summary
from gnc_opt.planning.transcription.collocation_families import Scheme
from gnc_opt.planning.transcription.mesh import Mesh
from gnc_opt.text_html_and_json_formatting import PrintableResult


@dataclass(frozen=True, eq=False, repr=False)
class Solution(PrintableResult):
    """Trajectory with costates and multipliers.

    For a single phase, the phase argument of all methods is optional.

    Attributes
    ----------
    problem_name : str
    status : Status
    objective : float
        Value as stated (not negated for a maximum).
    maximised : bool
    phases : dict of PhaseSolution
    free_parameters : Layout
        Layout of the optimised parameters.
    parameter_values, parameter_multipliers : array (n_parameters,)
        Values, and multipliers of their bounds.
    constraint_labels : tuple of str
    constraint_values, constraint_multipliers : array (n_constraints,)
        Boundary constraints and their multipliers nu.
    violations : tuple of Violation
        In descending order of severity; empty if solved.
    statistics : Statistics
    structure : tuple of Arc
        Arcs of the controls at and between their bounds, from a refinement with optimised switching times; else empty.
    history : History or None
        History of the refinement.
    provenance : dict of str
        Versions, options, scheme, mesh and fingerprint of the problem.
    problem : Problem or None
        Immutable copy of the solved problem; None if loaded without it.
    bound : LowerBound or None
        Lower bound of the cost of all trajectories, from `lower_bound`; not saved to files.
    verdict : Verdict or None
        Result of `verify` with its default tolerance, once computed. Copies by `dataclasses.replace` have none.

    Examples
    --------
    >>> print(f"{solution.objective:.6f} s, from {solution.state('q')(0.0):.1f} m")
    2.000000 s, from 1.0 m
    """

    problem_name: str
    status: Status
    objective: float
    maximised: bool
    phases: dict[str, PhaseSolution]
    free_parameters: Layout
    parameter_values: Array
    parameter_multipliers: Array
    constraint_labels: tuple[str, ...]
    constraint_values: Array
    constraint_multipliers: Array
    violations: tuple[Violation, ...]
    statistics: Statistics
    provenance: Mapping[str, str]
    structure: tuple[Arc, ...] = ()
    history: History | None = None
    problem: Problem | None = None
    bound: LowerBound | None = None
    verdict: Verdict | None = field(default=None, init=False)

    @property
    def scheme(self) -> Scheme:
        """Collocation scheme: LG, LGR or LGL."""
        return next(iter(self.phases.values())).scheme

    @property
    def converged(self) -> bool:
        """Whether a refinement reached its tolerance and passed the optimality check."""
        return self.history is not None and self.history.converged

    @property
    def gap(self) -> float | None:
        """Distance of the objective from its lower bound, relative to the objective; None without a bound.

        Accurate to the tolerances of both solves, so that it may be negative; see ``bound.certified`` for its validity.
        """
        if self.bound is None:
            return None
        distance = (self.objective - self.bound.value) * (-1.0 if self.maximised else 1.0)
        return distance / abs(self.objective) if distance else 0.0

    # --- evaluation -------------------------------------------------------------------------------

    def phase(self, name: str | None = None) -> PhaseSolution:
        """Return the solution of a phase; the name is optional for a single phase."""
        if name is None:
            if len(self.phases) != 1:
                raise ProblemError(
                    f"the solution of '{self.problem_name}' has {len(self.phases)} phases: "
                    f"name one of {list(self.phases)}."
                )
            return next(iter(self.phases.values()))
        if not isinstance(name, str) or name not in self.phases:
            raise unknown_name_error("phase", name, f"the solution of '{self.problem_name}'", self.phases)
        return self.phases[name]

    def state(self, name: str, phase: str | None = None) -> Signal:
        """Return a state over time: ``solution.state("q")(0.3)``."""
        return self.phase(phase).state(name)

    def control(self, name: str, phase: str | None = None) -> Signal:
        """Return the collocation polynomial of a control, which may exceed its bounds between nodes."""
        return self.phase(phase).control(name)

    def saturated_control(self, name: str, phase: str | None = None) -> Signal:
        """Return an applied control over time, within its bounds."""
        return self.phase(phase).saturated_control(name)

    def costate(self, name: str, phase: str | None = None) -> Signal:
        """Return the costate of a state over time, lambda(t0) = dJ*/dx0 of the minimised functional."""
        return self.phase(phase).costate(name)

    def parameter(self, name: str) -> Array | float:
        """Return the value of an optimised parameter."""
        values = self.parameter_values[self.free_parameters.slice(name)]
        return float(values[0]) if values.size == 1 else values

    def multiplier(self, name: str) -> Array | float:
        """Return the multiplier(s) nu of a named boundary constraint."""
        rows = [i for i, label in enumerate(self.constraint_labels) if label.split("[")[0] == name]
        if not rows:
            names = list(dict.fromkeys(label.split("[")[0] for label in self.constraint_labels))
            raise unknown_name_error(
                "boundary constraint", name, f"the solution of '{self.problem_name}'", names
            )
        values = self.constraint_multipliers[rows]
        return float(values[0]) if values.size == 1 else values

    def hamiltonian(self, t: ArrayLike, phase: str | None = None, side: Side = "right") -> Array | float:
        """Return H = L + lambda.f at time(s) t; needs the problem."""
        selected = self.phase(phase)
        arguments = t, selected.x(t, side), selected.u(t, side), selected.lam(t, side)
        return drop_singleton_axes(self.phase_functions(selected.name).hamiltonian(*arguments)[None], t)

    def switching_function(
        self, name: str, t: ArrayLike, phase: str | None = None, side: Side = "right"
    ) -> Array | float:
        """Return dH/du of a control at time(s) t; positive values imply the lower bound."""
        selected = self.phase(phase)
        arguments = t, selected.x(t, side), selected.u(t, side), selected.lam(t, side)
        values = self.phase_functions(selected.name).switching_functions(*arguments)
        return drop_singleton_axes(values[selected.controls.slice(name)], t)

    def evaluate(
        self, expression: Any, t: ArrayLike, phase: str | None = None, side: Side = "right"
    ) -> Array | float:
        """Return an expression in the model's symbols, or an output given by name, at time(s) t.

        Parameters
        ----------
        expression : casadi.SX or str
        t : float or array (n_times,), s
        """
        selected = self.phase(phase)
        problem = self.need_problem("evaluate")
        function = compile_expression(problem, selected.name, expression)
        arguments = t, selected.x(t, side), selected.u(t, side)
        return drop_singleton_axes(function(*arguments, selected.parameters, self.parameter_values), t)

    def phase_functions(self, phase: str) -> PhaseFunctions:
        """Return dynamics, Hamiltonian and derivatives of a phase for the parameters of this solution."""
        selected = self.phase(phase)
        problem = self.need_problem("evaluate functions of")
        return compile_phase_functions(
            problem, selected.name, selected.parameters, self.parameter_values, selected.integral_weights
        )

    def samples(self) -> dict[str, PhaseSamples]:
        """Return dense samples of every phase, from model and trajectory; needs the problem."""
        return dict(self._cached_phase_samples)

    @cached_property
    def _cached_phase_samples(self) -> dict[str, PhaseSamples]:
        """Cached samples; refinement evaluates derived quantities repeatedly."""
        return {
            name: PhaseSamples.from_phase(phase, self.phase_functions(name))
            for name, phase in self.phases.items()
        }

    # --- accuracy ---------------------------------------------------------------------------------

    @cached_property
    def accuracy(self) -> Accuracy:
        """Estimated error of the objective, violation of limits, error of the final states, in their units; defect.

        The applied control is integrated independently of the collocation. Needs the problem or a saved value.
        """
        error = self.objective_error.absolute_error
        return measure_accuracy(self.samples().values(), self.objective, error)

    @cached_property
    def objective_error(self) -> ObjectiveError:
        """Estimated error of the objective; see `gnc_opt.planning.solution.solution_accuracy`. Needs the problem."""
        return estimate_objective_error(self.samples().values(), self.objective)

    def outside_tables(self) -> list[OutsideTable]:
        """Return where the trajectory is outside of the tables of its problem; needs the problem."""
        problem = self.need_problem("look for the tables of")
        points: list[OutsideTable] = []
        for name, phase in problem.phases.items():
            if list_table_calls(problem, phase):
                s = self._cached_phase_samples[name]
                parameters = s.phase.parameters, self.parameter_values
                points += find_points_outside_tables(problem, phase, s.times, s.x, s.u, *parameters)
        values = [value for phase in self.phases.values() for value in phase.endpoint_arguments]
        return points + find_boundary_values_outside_tables(problem, [*values, self.parameter_values])

    def propagate(self, phase: str | None = None) -> Propagation:
        """Return the dynamics integrated with the applied control (DOP853), independently of the collocation.

        Parameters
        ----------
        phase : str, optional

        Returns
        -------
        Propagation
            Times, states and the error of each final state.
        """
        selected = self.phase(phase)
        return integrate_dynamics(selected, self.phase_functions(selected.name))

    def __str__(self) -> str:
        return summary(self)

    def __repr__(self) -> str:
        state = f"{self.status.value}, objective={self.objective:.10g}, phases={list(self.phases)}"
        return f"Solution({self.problem_name!r}, {state})"

    # --- files and tables -------------------------------------------------------------------------

    def to_pandas(self, phase: str | None = None, times: ArrayLike | None = None) -> Any:
        """Return states, applied controls and costates as a table, one column per component, over time (s).

        Parameters
        ----------
        phase : str, optional
            Optional for a single phase.
        times : array (n_times,), optional
            Times, s; default: ten intervals per segment. At a jump of a control its right limit is used.

        Returns
        -------
        pandas.DataFrame
            Columns such as ``r[0]`` and ``lam_r[0]``; ``attrs["units"]`` contains their units.

        Raises
        ------
        GncOptError
            pandas is not installed; it is part of the extra ``data``.
        """
        return build_time_history(self.phase(phase), times).to_pandas()

    def to_xarray(self, phase: str | None = None, times: ArrayLike | None = None) -> Any:
        """Return states, applied controls and costates as variables over time (s), with units, an xarray.Dataset.

        Arguments are those of `to_pandas`; xarray is part of the extra ``data``. Vectors have a dimension for their
        components; problem, status, objective and provenance are attributes.
        """
        attributes = {"problem": self.problem_name, "status": self.status.value, "objective": self.objective}
        table = build_time_history(self.phase(phase), times).to_xarray()
        return table.assign_attrs({**attributes, **self.provenance})

    def export(self, path: str | Path, phase: str | None = None, times: ArrayLike | None = None) -> Path:
        """Write states, applied controls and costates to a file for other programs, and return its path.

        Parameters
        ----------
        path : str or Path
            ``.csv`` (readable by `guess_from_data`), ``.json`` or ``.mat``, with all digits. `save` stores everything.
        phase, times
            See `to_pandas`.

        Raises
        ------
        ArgumentError
            Unknown suffix.
        """
        return build_time_history(self.phase(phase), times).write(path)

    def save(self, path: str | Path) -> Path:
        """Write the solution to a file that `load` reads without the model.

        Parameters
        ----------
        path : str or Path
            ``.npz`` is appended to a path without suffix. An existing file is replaced when the new one is complete.

        Returns
        -------
        Path
            Path of the file. Its accuracy is computed now, or copied if the solution has no problem.

        Raises
        ------
        OSError
            The file cannot be written, e.g. because its folder does not exist.
        """
        accuracy = vars(self).get("accuracy") if self.problem is None else self.accuracy
        written_by = self.provenance.get("gnc_opt", "unknown")
        return SOLUTION_FILES.write_result_file(
            path, self, written_by=written_by, accuracy=accuracy, history=self.history
        )

    def with_problem(self, problem: Problem) -> Solution:
        """Return this solution with its problem, e.g. after `load`.

        Raises
        ------
        ProblemError
            The problem is not the solved one (its fingerprint differs).
        """
        require_type(problem, Problem, "the argument of with_problem()", "give the problem that was solved")
        problem = reformulate_problem(problem)
        if problem.fingerprint() != self.provenance.get("fingerprint"):
            raise ProblemError(
                f"problem '{problem.name}' is not the one that this solution of '{self.problem_name}' solves: "
                "its functions or numbers differ; build it with the same options."
            )
        return replace(self, problem=problem.frozen())

    def trajectory_phases(self) -> tuple[TrajectoryPhase, ...]:
        """Return states and applied controls by phase, in the controls as stated, of a solved solution."""
        problem = self.need_solved_problem("follow")
        pairs = ((phase, problem.phases[name]) for name, phase in self.phases.items())
        return tuple(_extract_phase_trajectory(*pair) for pair in pairs)

    def with_verdict(self, verdict: Verdict | None) -> Solution:
        """Return a copy with a verdict."""
        copy = replace(self)
        object.__setattr__(copy, "verdict", verdict)
        return copy

    def need_problem(self, action: str) -> Problem:
        """Return the problem; without one raise GncOptError, whose text contains the ``action``, a verb: "refine"."""
        if self.problem is None:
            raise GncOptError(
                f"cannot {action} the solution of '{self.problem_name}' without its problem: "
                "load it with load(path, problem=...)."
            )
        return self.problem

    def need_solved_problem(self, action: str) -> Problem:
        """Return the problem of a solved solution, like `need_problem`; otherwise raise `ArgumentError`."""
        problem = self.need_problem(action)
        if not self.status.solved:
            raise ArgumentError(
                f"cannot {action} the solution of '{self.problem_name}', which ended as {self.status.value}: "
                f"{self.status.remedy}"
            )
        return problem


def _extract_phase_trajectory(solved: PhaseSolution, phase: Phase) -> TrajectoryPhase:
    model = phase.model if phase.control_map is None else phase.control_map.model
    names = model.parameters.names
    values = {name: solved.parameters[solved.model_parameters.slice(name)] for name in names}
    signals = [solved.saturated_control(name) for name in model.controls.names]

    def evaluate_stated_controls(times: Array) -> Array:
        return np.concatenate(
            [np.zeros((0, times.size)), *(np.atleast_2d(signal(times)) for signal in signals)]
        )

    return TrajectoryPhase(
        solved.name,
        model.with_parameters(**values) if names else model,
        solved.initial_time,
        solved.final_time,
        solved.applied.jump_times,
        solved.x,
        evaluate_stated_controls,
    )


SOLUTION_FILES = FileFormat(
    Solution,
    "solution",
    4,
    DataclassSerializer(
        (
            *(Solution, PhaseSolution, PiecewisePolynomial, Layout, Variable, Interval, Mesh),
            *(SplitControl, VectorControl, AssembledControl, UnitVectorControl, UnboundedAngles),
            *(Statistics, Violation, Arc, ArcKind, Status, Accuracy),
            *(History, RefinementIteration, Actions, RefinementStatus),
        ),
        left_out={Solution: ("problem", "history", "bound", "verdict")},
    ),
    alike=(1, 2, 3),  # without accuracy; 1 and 2 without turns; 1 without composed controls
    unused=("quality",),
)
"""File format of solutions: numbers and text only. Raise the version if a stored class changes its fields."""


def load(path: str | Path, problem: Problem | None = None) -> Solution:
    """Return a solution from a file written by `Solution.save`.

    Parameters
    ----------
    path : str or Path
    problem : Problem, optional
        Solved problem, built again. Without it states, controls, costates, multipliers and the stored accuracy are
        available; Hamiltonian, expressions and the optimality check need the problem.

    Returns
    -------
    Solution

    Raises
    ------
    FileNotFoundError
        The file does not exist.
    GncOptError
        The file is damaged, not a solution of gnc_opt, or of another format version.
    ProblemError
        ``problem`` is not the solved one. (Functions are compared in CasADi's serialised form, which
        may change with the CasADi version.)

    Examples
    --------
    >>> path = solution.save("plan.npz")
    >>> print(go.load(path, problem=problem).objective == solution.objective)
    True
    """
    solution, stored = SOLUTION_FILES.read_result_file(path)
    assert isinstance(solution, Solution)
    solution = replace(solution, history=stored.get("history"))
    if problem is not None:
        return solution.with_problem(problem)
    if stored.get("accuracy") is not None:
        vars(solution)["accuracy"] = stored["accuracy"]  # value of the cached property
    return solution
