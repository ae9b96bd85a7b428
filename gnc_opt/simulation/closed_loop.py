"""ClosedLoop: plant, controller, actuators, sensors, disturbances and events of a simulation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_integer, read_positive_number, require_type
from gnc_opt.array_types import Array
from gnc_opt.control.discrete_time_controller import Controller
from gnc_opt.errors import ArgumentError, quote_value, unknown_name_error
from gnc_opt.model.model_variables import Layout, read_state_vector, read_vector
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.numerical_tolerances import PLAUSIBLE, STEP_SLACK
from gnc_opt.simulation.actuators.memoryless_nonlinearities import Saturation
from gnc_opt.simulation.closed_loop_block_connections import LoopBlocks, LoopWiring, connect_closed_loop
from gnc_opt.simulation.compiled_closed_loop import MAX_STEPS_PER_CALL, CompiledLoop
from gnc_opt.simulation.control_step_casadi_function import LoopKernel, build_closed_loop_step_functions
from gnc_opt.simulation.control_step_expressions import (
    list_controller_alarm_labels,
    list_nonfinite_quantity_labels,
)
from gnc_opt.simulation.disturbances import Disturbance
from gnc_opt.simulation.recorded_extremes_and_integrals import Quantity
from gnc_opt.simulation.replanned_reference import PlanUpdater
from gnc_opt.simulation.sensor_and_actuator_block import Block
from gnc_opt.simulation.simulation_run_outcome import OutcomeClassifier
from gnc_opt.simulation.simulation_run_results import Run
from gnc_opt.simulation.step_size_selection import StepSelection
from gnc_opt.simulation.zero_crossing_events import Event
from gnc_opt.text_html_and_json_formatting import PrintableResult

_MAX_STEPS = 2_000_000
"""Largest number of control steps of a run; with 50 numbers per step its log has 1 GB."""

_MAX_UNROLLED = 2000
"""Largest number of integration steps per control step; they are unrolled in the compiled function."""


@dataclass(frozen=True, eq=False, repr=False)
class ClosedLoop(PrintableResult):
    """Plant under a discrete-time controller, with actuators, sensors and disturbances.

    A control step (``dt``) has a measurement, a command (zero-order hold) and ``minor_steps`` minor steps.

    Parameters
    ----------
    plant : Model
        May differ from the design model if it contains the controller's measurements and the applied controls by name;
        its other controls are zero.
    controller : Controller
        Includes the estimator if it comes from `output_feedback`.
    actuators, sensors : sequence of Block
        In the order of the signal flow.
    disturbances : sequence of Disturbance
    events : sequence of Event
    quantities : sequence of Quantity
        Expressions whose extremes, integrals and envelopes are stored by campaigns.
    replanner : Replanner, optional
    dt : float, optional
        Control step, s; default the controller's own.
    minor_steps : int
    accuracy : float
        Accuracy of the integration over a run, relative to max(1, \\|x\\|) per state. The step size is chosen so that
        the estimated error of the nominal run is below a tenth of it; runs that exceed it are flagged.
    substeps : int, optional
        Integration steps per minor step; default: chosen according to ``accuracy``.
    divergence_limits : float or mapping
        Magnitude of states, one for all or by name, above which a run has *diverged*; default 1e15.

    Raises
    ------
    ArgumentError, UnknownNameError
        Inconsistent parts; the message names the cause.

    Examples
    --------
    >>> regulator = go.design_lqr(cart, [0.0, 0.0], Q=1, R=1, dt=0.1)
    >>> run = go.ClosedLoop(cart, regulator, dt=0.1).simulate(x0=[1.0, 0.0], tf=10.0)
    >>> print(run.outcome, run.miss("q") < 1e-3)
    ok True
    """

    plant: Model
    controller: Controller
    actuators: Sequence[Block] = ()
    sensors: Sequence[Block] = ()
    disturbances: Sequence[Disturbance] = ()
    events: Sequence[Event] = field(default=(), kw_only=True)
    replanner: PlanUpdater | None = field(default=None, kw_only=True)
    quantities: Sequence[Quantity] = field(default=(), kw_only=True)
    dt: float = field(default=None, kw_only=True)  # type: ignore[assignment]
    minor_steps: int = field(default=1, kw_only=True)
    accuracy: float = field(default=1e-9, kw_only=True)
    substeps: int | None = field(default=None, kw_only=True)
    divergence_limits: float | Mapping[str, ArrayLike] = field(default=PLAUSIBLE, kw_only=True)
    wiring: LoopWiring = field(init=False, repr=False)
    _kernels: dict[int, LoopKernel] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        require_type(self.plant, Model, "the plant of a closed loop", "give a Model")
        require_type(
            self.controller, Controller, "the controller of a closed loop", "design one or use feedforward()"
        )
        set_ = object.__setattr__
        set_(self, "dt", self.controller.step_length(self.dt))
        set_(self, "minor_steps", read_integer(self.minor_steps, "minor_steps of a closed loop", 1))
        set_(self, "accuracy", read_positive_number(self.accuracy, "the accuracy of a closed loop"))
        if self.substeps is not None:
            read_integer(self.substeps, "substeps of a closed loop", 1)
        self.plant.state_derivative()
        for name, kind in (("actuators", Block), ("sensors", Block), ("disturbances", Disturbance)):
            parts = _read_closed_loop_blocks(
                getattr(self, name), kind, name, f"use those of gnc_opt.simulation.{name}"
            )
            set_(self, name, parts)
        set_(
            self,
            "events",
            _read_closed_loop_blocks(self.events, Event, "events", "write Event(name, expression)"),
        )
        quantities = _read_closed_loop_blocks(
            self.quantities, Quantity, "quantities", "write Quantity(name, expression)"
        )
        set_(self, "quantities", quantities)
        blocks = LoopBlocks(
            tuple(self.actuators),
            tuple(self.sensors),
            tuple(self.disturbances),
            tuple(self.events),
            tuple(quantities),
        )
        if self.replanner is not None:
            require_type(
                self.replanner,
                PlanUpdater,
                "the replanner of a closed loop",
                "write Replanner(resolver, every=...)",
            )
            followed, signals = self.controller.reference_layout, self.controller.signals
            self.replanner.check_controller_follows_plan(
                followed, signals, self.dt, lambda t: self.controller.schedule_row(t, self.dt)
            )
        divergence_limits = _read_divergence_limits(self.divergence_limits, self.plant.states)
        set_(
            self,
            "wiring",
            connect_closed_loop(
                self.plant, self.controller, blocks, self.dt, self.minor_steps, divergence_limits
            ),
        )

    def __str__(self) -> str:
        heading = f"closed loop of plant '{self.plant.name}' and controller '{self.controller.name}'"
        lines = [f"{heading}, control step {self.dt:g} s"]
        for kind in ("actuators", "sensors", "disturbances", "events", "quantities"):
            blocks = ", ".join(f"{block.name} ({type(block).__name__})" for block in getattr(self, kind))
            lines += [f"  {kind:13} {blocks}"] * bool(blocks)
        if self.replanner is not None:
            lines.append(f"  replanner     {type(self.replanner).__name__}")
        return "\n".join(lines)

    # --- what can be dispersed ----------------------------------------------------------------------------

    @property
    def layout(self) -> Layout:
        """Names, sizes and units of all parameters that can differ between runs.

        ``"plant.<parameter>"``, ``"initial.<state>"`` and ``"<block>.<parameter>"``.
        """
        return self.wiring.layout

    @property
    def default_parameters(self) -> Array:
        """Default values of `layout`, shape (n,); NaN for initial states."""
        return self.wiring.default_parameters

    @property
    def parameter_ranges(self) -> tuple[Array, Array]:
        """Smallest and largest permitted values of `layout`, each of shape (n,)."""
        return self.wiring.parameter_ranges

    def parameters(
        self,
        x0: ArrayLike | Mapping[str, ArrayLike] | None = None,
        changes: Mapping[str, ArrayLike] | None = None,
    ) -> Array:
        """Return the parameter column P (n,) of a run: defaults, initial states and changes by dotted name.

        Parameters
        ----------
        x0 : array (n_states,) or mapping by name
            Initial state of the plant.
        changes : mapping
            E.g. ``{"plant.mass": 3100.0, "initial.r_L": [20.0, 0.0, 0.0], "thrusters.tau": 0.05}``.
        """
        P = self.default_parameters.copy()
        states = self.plant.states
        require_type(
            {} if changes is None else changes, Mapping, "the changes of parameters", 'write {"plant.m": 2.0}'
        )
        if isinstance(x0, Mapping):
            changes = {**{f"initial.{n}": v for n, v in x0.items()}, **(changes or {})}
        elif x0 is not None:
            x = read_state_vector(x0, states.size, "the initial state of a run", ArgumentError)
            for name in states.names:
                P[self.layout.slice(f"initial.{name}")] = x[states.slice(name)]
        for name, value in (changes or {}).items():
            if name not in self.layout:
                raise unknown_name_error("parameter", name, "the closed loop", self.layout.names)
            P[self.layout.slice(name)] = read_vector(
                value, self.layout[name].size, f"parameter '{name}' of a run", ArgumentError
            )
        labels = self.layout.labels
        invalid = [
            i for i, p in enumerate(P) if np.isnan(p) or (np.isinf(p) and labels[i].startswith("initial."))
        ]
        if invalid:
            label = labels[invalid[0]]
            missing = [n for n in states.names if np.all(np.isnan(P[self.layout.slice(f"initial.{n}")]))]
            if missing:
                names = ", ".join(f"'{name}'" for name in missing)
                raise ArgumentError(
                    f"the initial state of a run lacks {names}: give x0 a value of every state."
                )
            raise ArgumentError(f"'{label}' of a run is not a number (it is {P[invalid[0]]:g}): give one.")
        return P

    def compile(
        self,
        x0: ArrayLike | Mapping[str, ArrayLike],
        *,
        t0: float = 0.0,
        tf: float,
        parameters: Mapping[str, ArrayLike] | None = None,
    ) -> CompiledLoop:
        """Return the loop compiled for many runs over one time span; it can be pickled.

        Parameters
        ----------
        x0 : array (n_states,) or mapping by name
            Nominal initial state.
        t0, tf : float
            Start and end time, s. The last control step ends at ``tf`` or less than one step later.
        parameters : mapping
            Changed nominal parameters by dotted name.

        Raises
        ------
        ArgumentError
            Invalid times or parameters; or the plant is too fast for ``accuracy`` at this minor step.
        """
        nominal = self.parameters(x0, parameters)
        times = self._compute_control_step_times(t0, tf)
        rows = self._sample_reference_schedule(times)
        compiled_loop = self._choose_integration_substeps(nominal, times, rows)
        return replace(compiled_loop, replanner=self.replanner)

    def _choose_integration_substeps(self, nominal: Array, times: Array, rows: Array) -> CompiledLoop:
        """Return the compiled loop with the number of integration steps that its accuracy requires."""
        accuracy = StepSelection(self.plant, self.dt / self.minor_steps, self.accuracy, self.substeps)
        modes = accuracy.compute_initial_plant_eigenvalues(
            times[0], *self._read_initial_states_and_parameters(nominal)
        )
        duration = float(times[-1] - times[0])
        return accuracy.select_integration_steps(
            lambda n: self._compile_closed_loop(nominal, times, rows, n), modes, duration
        )

    def _read_initial_states_and_parameters(self, nominal: Array) -> tuple[Array, Array]:
        """Return the plant's states (n_states,) and parameters (n_parameters,) from a parameter column."""
        named = [
            [nominal[self.layout.slice(f"{group}.{name}")] for name in layout.names]
            for group, layout in (("initial", self.plant.states), ("plant", self.plant.parameters))
        ]
        x, p = (np.concatenate([np.empty(0), *parts]) for parts in named)
        return x, p

    def simulate(
        self,
        x0: ArrayLike | Mapping[str, ArrayLike],
        *,
        t0: float = 0.0,
        tf: float,
        seed: Any = 0,
        parameters: Mapping[str, ArrayLike] | None = None,
        every: int = 1,
    ) -> Run:
        """Return a run of the loop with all signals; a failed run is returned with its outcome.

        Parameters
        ----------
        x0, t0, tf
            As in `compile`.
        seed : int or sequence of int
            Seed of the random numbers; equal seeds give bitwise identical runs.
        parameters : mapping
            Changed parameters by dotted name, see `layout`.
        every : int
            Log every n-th control step, and the last one. Integrals such as the effort include all steps.
        """
        compiled_loop = self.compile(x0, t0=t0, tf=tf, parameters=parameters)
        return compiled_loop.run(compiled_loop.nominal, seed, every=every)

    def kernel(self, substeps: int) -> LoopKernel:
        """Return the symbolic control step with ``substeps`` integration steps per minor step."""
        if substeps * self.minor_steps > _MAX_UNROLLED:
            raise ArgumentError(
                f"a control step of {self.dt:g} s with {self.minor_steps} minor steps of {substeps} integration steps "
                f"each has more than {_MAX_UNROLLED}: give a shorter dt, fewer minor_steps or a coarser accuracy."
            )
        if substeps not in self._kernels:
            self._kernels[substeps] = build_closed_loop_step_functions(self.wiring, substeps)
        return self._kernels[substeps]

    def _compile_closed_loop(self, nominal: Array, times: Array, rows: Array, substeps: int) -> CompiledLoop:
        return CompiledLoop(
            kernel=self.kernel(substeps),
            companion=self.kernel(2 * substeps),
            substeps=substeps,
            nominal=nominal,
            layout=self.layout,
            ranges=self.parameter_ranges,
            times=times,
            schedule=rows,
            dt=self.dt,
            followed_rows=self._find_reference_signal_indices(),
            states=self.plant.states,
            measured=self.controller.states,
            followed=self.controller.reference_layout,
            commands=self.controller.commands,
            controls=self.plant.controls,
            memory=self.controller.memory,
            errors=self._build_tracking_error_function(),
            error_layout=self.plant.errors,
            events=self.wiring.events.layout,
            quantities=self.wiring.quantities.layout,
            classifier=self._build_run_outcome_classifier(),
            minor_steps=self.minor_steps,
            estimates=self._find_estimated_state_indices(),
            saturations={
                a.block.name: a.on for a in self.wiring.actuators if isinstance(a.block, Saturation)
            },
        )

    def _build_run_outcome_classifier(self) -> OutcomeClassifier:
        return OutcomeClassifier(
            tuple(list_nonfinite_quantity_labels(self.wiring)),
            tuple(list_controller_alarm_labels(self.wiring)),
            self.plant.states,
            self.wiring.divergence_limits,
            self.wiring.events.layout.names,
            tuple(event.name for event in self.events if event.failure),
            self.accuracy,
        )

    def _compute_control_step_times(self, t0: float, tf: float) -> Array:
        begin, end = (
            float(read_vector(t, 1, f"{name} of a run", ArgumentError)[0])
            for name, t in (("t0", t0), ("tf", tf))
        )
        if not (np.isfinite([begin, end]).all() and end > begin):
            raise ArgumentError(
                f"a run cannot last from t0 = {begin:g} s to tf = {end:g} s: give finite times, tf > t0."
            )
        count = max(1, int(np.ceil((end - begin) / self.dt - STEP_SLACK)))
        if count > _MAX_STEPS:
            raise ArgumentError(
                f"a run of {count} control steps is too long: give a larger dt or an earlier tf."
            )
        return np.asarray(begin + self.dt * np.arange(count + 1), dtype=np.float64)

    def _sample_reference_schedule(self, times: Array) -> Array:
        size = self.controller.signals.size
        rows = np.empty((size, times.size))
        for first in range(0, times.size, MAX_STEPS_PER_CALL):  # limits the memory of the evaluation
            part = times[first : first + MAX_STEPS_PER_CALL]
            table = np.asarray(self.controller.schedule(part, self.dt), dtype=float)
            if table.shape != (size, part.size):
                raise ArgumentError(
                    f"the schedule of '{self.controller.name}' has the shape {table.shape} where ({size}, {part.size}) "
                    "is needed."
                )
            rows[:, first : first + MAX_STEPS_PER_CALL] = table
        return rows

    def _find_reference_signal_indices(self) -> Any:
        signals, states = self.controller.signals, self.controller.reference_layout
        if all(f"{n}_ref" in signals for n in states.names):
            return np.concatenate([np.r_[signals.slice(f"{n}_ref")] for n in states.names])
        if "x_ref" in signals and signals["x_ref"].size == states.size:
            return np.r_[signals.slice("x_ref")]
        return None

    def _find_estimated_state_indices(self) -> Any:
        """Return the indices of the estimated states in the memory; None without an estimator."""
        memory, states = self.controller.memory, self.controller.estimated
        if states is None:
            return None
        return np.concatenate([np.r_[memory.slice(f"{n}_hat")] for n in states.names])

    def _build_tracking_error_function(self) -> Any:
        x, x_ref = (ca.SX.sym(n, self.plant.states.size) for n in ("x", "x_ref"))
        return ca.Function("e", [x, x_ref], [self.plant.state_error_expression(x, x_ref)])


def _read_closed_loop_blocks(value: Any, kind: type, name: str, remedy: str) -> tuple[Any, ...]:
    parts = (value,) if isinstance(value, kind) else value
    if not isinstance(parts, Iterable):
        raise ArgumentError(f"the {name} of a closed loop are {quote_value(value)}: give a list; {remedy}.")
    return tuple(require_type(part, kind, f"one of the {name} of a closed loop", remedy) for part in parts)


def _read_divergence_limits(value: float | Mapping[str, ArrayLike], states: Layout) -> Array:
    """Return the largest permitted magnitudes of the states, (n_states,)."""
    largest = np.full(states.size, PLAUSIBLE)
    by_name = value if isinstance(value, Mapping) else dict.fromkeys(states.names, value)
    for name, size in by_name.items():
        if name not in states:
            raise unknown_name_error("state", name, "the plausible sizes of a closed loop", states.names)
        what = f"the plausible size of '{name}'"
        largest[states.slice(name)] = read_vector(size, states[name].size, what, ArgumentError)
    if not np.all(largest > 0):
        raise ArgumentError(f"the plausible sizes of the states are {largest}: give positive ones.")
    return largest
