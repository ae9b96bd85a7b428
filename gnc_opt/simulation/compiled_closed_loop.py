"""Compiled closed loop over one time span, numeric and picklable, for single runs and campaigns."""

from __future__ import annotations

import hashlib
import itertools
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from gnc_opt.argument_checks import StrictAttributes, read_integer
from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError, quote_value
from gnc_opt.model.model_variables import Layout
from gnc_opt.simulation.control_step_casadi_function import LoopKernel
from gnc_opt.simulation.control_step_execution import (
    MIN_EVALUATIONS_TO_COMPILE,
    StepExecutor,
    build_control_step_library,
)
from gnc_opt.simulation.final_states_and_integration_error import FinalValues, estimate_integration_errors
from gnc_opt.simulation.recorded_extremes_and_integrals import select_quantity_sample_steps
from gnc_opt.simulation.replanned_reference import ActiveReference, PlanUpdater
from gnc_opt.simulation.simulation_run_outcome import Outcome, OutcomeClassifier, RunStatus
from gnc_opt.simulation.simulation_run_results import Run
from gnc_opt.simulation.zero_crossing_events import EventOccurrence, read_event_occurrences

MAX_STEPS_PER_CALL = 1000
"""Largest number of control steps per function call; limits the memory of long runs."""


@dataclass(frozen=True, eq=False)
class CompiledLoop(StrictAttributes):
    """Closed loop compiled for many runs; see `ClosedLoop.compile`.

    Attributes
    ----------
    layout, nominal, ranges : Layout, array (n_parameters,), pair of them
        Names and units, nominal values, smallest and largest permitted values of the parameter columns P.
    times, dt, schedule : array (n_steps + 1,), float, array (n_signals, n_steps + 1)
        Step times, s; control step, s; planned schedule of the controller.
    followed_rows, estimates : int array (n,) or None
        Row indices of the reference in the schedule; indices of the estimated states in the memory.
    kernel, companion, substeps : Kernel, Kernel, int
        Symbolic step with ``substeps`` integration steps per minor step, and with twice as many.
    states, measured, followed, commands, controls, memory, error_layout, events, quantities : Layout
        Names, sizes and units; ``followed`` are the states of the reference.
    errors : casadi Function
        Errors of the states relative to the reference.
    classifier, replanner, minor_steps : OutcomeClassifier, PlanUpdater or None, int
    saturations : mapping
        Names of the limited signals by the name of the `Saturation`.
    libraries : tuple of two str
        Paths of the compiled steps of both kernels; "" if the interpreter is used.

    Examples
    --------
    >>> compiled_loop = loop.compile([1.0, 0.0], tf=8.0)
    >>> print(compiled_loop.n_steps, compiled_loop.layout.names)
    80 ('initial.q', 'initial.v', 'gauge.sigma')
    """

    kernel: LoopKernel
    companion: LoopKernel
    substeps: int
    nominal: Array
    layout: Layout
    ranges: tuple[Array, Array]
    times: Array
    schedule: Array
    dt: float
    followed_rows: Any
    states: Layout
    measured: Layout
    followed: Layout
    commands: Layout
    controls: Layout
    memory: Layout
    errors: Any
    error_layout: Layout
    classifier: OutcomeClassifier
    minor_steps: int
    events: Layout = field(default_factory=lambda: Layout("event"))
    replanner: PlanUpdater | None = None
    estimates: Any = None
    quantities: Layout = field(default_factory=lambda: Layout("quantity"))
    saturations: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    libraries: tuple[str, str] = ("", "")

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in vars(self).items() if not k.startswith("_")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)

    @property
    def n_steps(self) -> int:
        """Number of control steps."""
        return int(self.times.size - 1)

    @property
    def layouts(self) -> dict[str, Layout]:
        """Names, sizes and units by kind, as in `Run` and `Campaign`."""
        kinds = {
            "parameter": self.layout,
            "state": self.states,
            "error": self.error_layout,
            "event": self.events,
        }
        kinds |= {"measured": self.measured, "followed": self.followed, "command": self.commands}
        kinds |= {"applied": self.controls, "memory": self.memory}
        return kinds | ({"quantity": self.quantities} if self.quantities.size else {})

    @property
    def accuracy(self) -> float:
        """Required relative accuracy of the integration."""
        return self.classifier.accuracy

    @property
    def reference(self) -> Array | None:
        """Planned reference (n, n_steps + 1) of the controller, in the followed states."""
        return None if self.followed_rows is None else self.schedule[self.followed_rows]

    @cached_property
    def fingerprint(self) -> str:
        """Digest of all data that determine a run, except its parameters and its seed."""
        digest = hashlib.sha256()
        for kernel in (self.kernel, self.companion):
            for function in (kernel.start, kernel.constants, kernel.step):
                digest.update(function.serialize().encode())
        for array in (self.times, self.schedule[:, :-1]):
            digest.update(np.ascontiguousarray(array).tobytes())
        if self.replanner is not None:
            digest.update(self.replanner.description.encode())
        return digest.hexdigest()

    def with_machine_code(self, runs: int) -> CompiledLoop:
        """Return the loop with machine code, if that is faster for so many runs, possible and bitwise identical."""
        if runs * self.n_steps < MIN_EVALUATIONS_TO_COMPILE:
            return self
        first, second = (
            build_control_step_library(folded.compiled_step_function) for folded in self._step_executors
        )
        quick = replace(self, libraries=(first, second))
        _, rows = next(
            self.iterate_known_values(
                0, np.empty((min(self.n_steps, MAX_STEPS_PER_CALL), self.kernel.known.size))
            )
        )
        X, C = self._build_initial_closed_loop_states(rows[0], self.nominal)
        ends = [np.empty_like(X) for _ in range(2)]
        for compiled_loop, end in zip((self, quick), ends, strict=True):
            compiled_loop._simulate_run_segment(X, rows, C, end)
        return quick if ends[0].tobytes() == ends[1].tobytes() else self

    def final_values(self, P: Array, seeds: Sequence[Any]) -> FinalValues:
        """Return the final values of n runs, including failed ones with their status.

        Parameters
        ----------
        P : array (n_parameters, n)
            One column per run, in the order of `layout`.
        seeds : sequence of n seeds
            Each an int, a list of ints or a ``SeedSequence``.
        """
        P = np.asarray(P, dtype=float)
        if P.shape != (self.layout.size, len(seeds)):
            raise ArgumentError(
                f"the parameters of {len(seeds)} runs have the shape {P.shape}: "
                f"give ({self.layout.size}, {len(seeds)})."
            )
        final = np.full((P.shape[1], 2, self.kernel.state.size), np.nan)
        inputs = np.empty((min(self.n_steps, MAX_STEPS_PER_CALL), self.kernel.known.size))
        samples = np.full((self.quantities.size, self._sampling_step_indices.size, P.shape[1]), np.nan)
        invalid_runs: dict[int, str] = {}
        replans = np.zeros((2, P.shape[1]))
        followed = np.full((self.followed.size, P.shape[1]), np.nan)
        is_filled = False
        for i, seed in enumerate(seeds):
            invalid = self.describe_invalid_parameters(P[:, i])
            if invalid:
                invalid_runs[i] = invalid
                continue
            course = self._create_replannable_reference()
            for last, X, _ in self._simulate_run_segments(P[:, i], seed, inputs, course, is_filled=is_filled):
                self._record_quantities_at_step(samples[..., i], last, X[0])
                final[i], is_filled = X, True
            if self.replanner is not None:
                replans[:, i] = len(course.replans), sum(replan.failed for replan in course.replans)
                followed[:, i] = self._evaluate_reference_at_run_end(course, final[i, :1].T)[:, 0]
        if self.replanner is None:
            followed = self._evaluate_reference_at_run_end(
                self._create_replannable_reference(), final[:, 0].T
            )
        ending = self._collect_final_states_of_runs(final, invalid_runs, followed, replans)
        if not self.quantities.size:
            return ending
        record = self.kernel.state.split_vector_by_name(final[:, 0].T)["quantities"]
        return replace(ending, sums=record[: 3 * self.quantities.size], samples=samples)

    def run(self, P: Array, seed: Any, *, every: int = 1) -> Run:
        """Return one run with all signals; its final state is bitwise identical to that of `final_values`.

        Parameters
        ----------
        P : array (n_parameters,)
        seed, every
            As in `ClosedLoop.simulate`.

        Raises
        ------
        ArgumentError
            A parameter exceeds its permitted range.
        """
        P = np.asarray(P, dtype=float)
        every = read_integer(every, "the number of control steps of which one is logged", 1)
        invalid = self.describe_invalid_parameters(P)
        if invalid:
            raise ArgumentError(f"the run cannot be simulated: {invalid}.")
        logged_steps = np.append(np.arange(0, self.n_steps, every), self.n_steps)
        log: dict[str, list[Array]] = defaultdict(list)
        inputs = np.empty((min(self.n_steps, MAX_STEPS_PER_CALL), self.kernel.known.size))
        events: list[EventOccurrence] = []
        course, last = self._create_replannable_reference(), self.n_steps
        for end, X, logged in self._simulate_run_segments(P, seed, inputs, course, logged=True):
            if logged is None:  # the companion also needs the steps until an event ends it
                continue
            parts, logs = (
                self.kernel.state.split_vector_by_name(logged[0]),
                self.kernel.log.split_vector_by_name(logged[1]),
            )
            count = logged[1].shape[1]
            n_done, first = count, end - count
            if self.events.size:
                n_done = int(np.sum(parts["stop"][0, :-1] < 0.5))
                events += read_event_occurrences(logs, n_done, self.events.names, self.states.size)
            at = np.arange(first + (-first) % every, first + n_done, every) - first
            if at.size:
                for name in ("measured", "commands", "applied"):
                    log[name].append(logs[name][:, at])
                self._log_run_segment_signals(
                    log, parts, at, course.interpolate_reference(self.times[first + at])
                )
            if self._has_event_ended_run(X[0]):
                last = first + n_done
        final = self.kernel.state.split_vector_by_name(X[:1].T)
        ended = self._find_run_end_times(final)
        followed = self._evaluate_reference_at_run_end(course, X[:1].T)
        self._log_run_segment_signals(log, final, np.array([0]), followed)
        ending = self._collect_final_states_of_runs(X[None], {}, followed)
        arrays = {name: np.hstack(columns) for name, columns in log.items()}
        times = np.append(self.times[logged_steps[logged_steps < last]], ended)
        return Run(
            times=times,
            states=arrays["states"],
            measured=arrays["measured"],
            commands=arrays["commands"],
            applied=arrays["applied"],
            memory=arrays["memory"],
            reference=course.interpolate_reference(times),
            errors=arrays.get("errors"),
            parameters=P.copy(),
            effort=ending.effort[:, 0],
            energy=ending.energy[:, 0],
            saturation=ending.saturation_time[:, 0],
            variation=ending.variation[:, 0],
            integration_error=float(ending.integration_error[0]),
            outcome=ending.outcomes[0],
            seed=str(seed),
            events=tuple(events),
            replans=tuple(course.replans),
            layouts=self.layouts,
        )

    def describe_invalid_parameters(self, P: Array) -> str:
        """Return the error message for a column P (n_parameters,); "" if it is valid."""
        lower, upper = self.ranges
        invalid = np.flatnonzero(~((lower <= P) & (upper >= P)))
        if not invalid.size:
            return ""
        i = int(invalid[0])
        return f"'{self.layout.labels[i]}' is {P[i]:g}, outside [{lower[i]:g}, {upper[i]:g}]"

    def iterate_known_values(
        self, seed: Any, known: Array, course: ActiveReference | None = None, *, again: bool = False
    ) -> Iterator[tuple[int, Array]]:
        """Yield, for each segment, its first step and the known and drawn values of its steps (n_steps, n_known).

        The values are written to ``known``; with ``again`` it contains those of a run with the same schedule.
        """
        planned = course is None or course.schedule is self.schedule
        followed = self._reference_schedule_by_step if course is None or planned else course.schedule.T
        first_noise = 1 + self.schedule.shape[0]
        numbers = self._create_normal_number_generator(seed, known.shape[1] - first_noise)
        written = again and planned and len(self._run_segment_boundary_steps) == 2
        for first, last in itertools.pairwise(self._run_segment_boundary_steps):
            rows = known[: last - first]
            if not written:
                rows[:, 0] = self.times[first:last]
                rows[:, 1:first_noise] = followed[first:last]
            rows[:, first_noise:] = numbers(first, last)
            yield first, rows

    def _create_normal_number_generator(self, seed: Any, size: int) -> Callable[[int, int], Array]:
        """Return a function of two steps that draws the standard normal numbers (n, size) for the steps between."""
        generator = np.random.Generator(np.random.Philox(_build_seed_sequence(seed)))
        return lambda first, last: generator.standard_normal((last - first, size))

    @cached_property
    def _reference_schedule_by_step(self) -> Array:
        return np.ascontiguousarray(self.schedule.T)

    @cached_property
    def _run_segment_boundary_steps(self) -> list[int]:
        """Steps that bound the segments of a run: every `MAX_STEPS_PER_CALL`, at re-plans and at sampling times."""
        period = self.n_steps if self.replanner is None else round(self.replanner.every / self.dt)
        starts = range(0, self.n_steps, period)
        edges = {
            *(k for s in starts for k in range(s, min(s + period, self.n_steps), MAX_STEPS_PER_CALL)),
            self.n_steps,
        }
        return sorted(edges | set(self._sampling_step_indices.tolist()))

    @cached_property
    def _sampling_step_indices(self) -> Any:
        return select_quantity_sample_steps(self.n_steps) if self.quantities.size else np.zeros(0, dtype=int)

    def _record_quantities_at_step(self, samples: Array, step: int, X: Array) -> None:
        """Write the quantities at a step, the last values in the kernel state X, to (n, n_samples)."""
        if step in self._sampling_step_indices and not self._has_event_ended_run(X):
            n = self.quantities.size
            record = X[self.kernel.state.slices["quantities"]]
            samples[:, np.searchsorted(self._sampling_step_indices, step)] = record[4 * n :]
            samples[:, 0] = record[3 * n : 4 * n]

    def _create_replannable_reference(self) -> ActiveReference:
        return ActiveReference(
            self.replanner, self.times, self.schedule, self.dt, self.followed, self.followed_rows
        )

    def _update_guidance_plan_if_due(
        self, course: ActiveReference, step: int, X: Array, rows: Array, C: tuple[Array, Array]
    ) -> None:
        """Re-plan at the first of the steps ``rows`` if a plan is due, and write the new plan to these rows."""
        if self.replanner is None:
            return
        if step % round(self.replanner.every / self.dt) == 0 and not self._has_event_ended_run(X[0]):
            if self.estimates is None:
                x = self.kernel.measure(X[0], rows[0], C[0]).full()[:, 0]
            else:
                x = X[0, self.kernel.state.slices["memory"]][self.estimates]
            course.replan_reference_if_due(step, np.asarray(x))
        rows[:, 1 : 1 + self.schedule.shape[0]] = course.schedule[:, step : step + len(rows)].T

    def _build_initial_closed_loop_states(self, inputs: Array, P: Array) -> tuple[Array, tuple[Array, Array]]:
        """Return the initial X of a run and its companion (2, n_state), and their constants."""
        (X, C), (companion, companion_constants) = (
            folded.compute_initial_loop_state_and_constants(inputs, P) for folded in self._step_executors
        )
        return np.stack([X, companion]), (C, companion_constants)

    def _simulate_run_segment(self, X: Array, rows: Array, C: tuple[Array, Array], final: Array) -> None:
        """Write the states of a run and its companion after a segment to ``final_values`` (2, n_state)."""
        for folded, x, c, end in zip(self._step_executors, X, C, final, strict=True):
            folded.simulate_control_steps(x, rows, c, end)

    def _simulate_run_segments(
        self,
        P: Array,
        seed: Any,
        inputs: Array,
        course: ActiveReference,
        *,
        is_filled: bool = False,
        logged: bool = False,
    ) -> Iterator[tuple[int, Array, tuple[Array, Array] | None]]:
        """Yield, for each segment, its last step, the final states (2, n_state), and the logged states and logs."""
        for first, rows in self.iterate_known_values(seed, inputs, course, again=is_filled):
            if first == 0:
                X, C = self._build_initial_closed_loop_states(rows[0], P)
            else:
                self._update_guidance_plan_if_due(course, first, X, rows, C)
            before, logs = X.copy(), None
            if logged and not self._has_event_ended_run(X[0]):
                logs = self._step_executors[0].propagate_steps_with_log(before[0], rows, C[0])
                self._step_executors[1].simulate_control_steps(before[1], rows, C[1], X[1])
                X[0] = logs[0][:, -1]
            else:
                self._simulate_run_segment(before, rows, C, X)
            yield first + len(rows), X, logs
            if all(self._has_event_ended_run(x) for x in X):
                return

    def _log_run_segment_signals(
        self, log: dict[str, list[Array]], parts: dict[str, Array], columns: Any, followed: Array | None
    ) -> None:
        """Log the states of a segment at its columns ``columns``, and the reference there."""
        states = parts["plant"][:, columns]
        log["states"].append(states)
        log["memory"].append(parts["memory"][:, columns])
        if self.followed_rows is not None:
            log["errors"].append(self._compute_tracking_errors(states, followed))

    def _has_event_ended_run(self, X: Array) -> bool:
        return bool(self.events.size and X[self.kernel.state.slices["stop"]][0] > 0)

    def _find_run_end_times(self, parts: dict[str, Array]) -> Array:
        if not self.events.size:
            return np.full(parts["plant"].shape[1], self.times[-1])
        return np.asarray(np.where(parts["stop"][0] > 0, parts["stop time"][0], self.times[-1]))

    @cached_property
    def _step_executors(self) -> tuple[StepExecutor, StepExecutor]:
        return StepExecutor(self.kernel, self.libraries[0]), StepExecutor(self.companion, self.libraries[1])

    def _evaluate_reference_at_run_end(self, course: ActiveReference, X: Array) -> Array:
        """Return the reference (n_followed, n) at the end of runs; NaN without a reference."""
        reference = course.interpolate_reference(
            self._find_run_end_times(self.kernel.state.split_vector_by_name(X))
        )
        return np.full((self.followed.size, X.shape[1]), np.nan) if reference is None else reference

    def _collect_final_states_of_runs(
        self, ends: Array, invalid_runs: dict[int, str], followed: Array, replans: Array | None = None
    ) -> FinalValues:
        """Return the final values from the kernel states of runs and their companions (n, 2, n_state)."""
        final, companions = ends[:, 0].T, ends[:, 1].T
        parts = self.kernel.state.split_vector_by_name(final)
        errors, assessed = estimate_integration_errors(
            self.kernel.state, final, companions, float(self.times[-1])
        )
        outcomes = tuple(
            Outcome(RunStatus.INVALID_PARAMETERS, invalid_runs[i])
            if i in invalid_runs
            else self.classifier.classify_run_outcome(parts, i, assessed[i])
            for i in range(final.shape[1])
        )
        empty = np.empty((0, final.shape[1]))
        counts, firsts = (parts["count"], parts["first"]) if self.events.size else (empty, empty)
        return FinalValues(
            parts["plant"],
            None if self.followed_rows is None else self._compute_tracking_errors(parts["plant"], followed),
            parts["memory"],
            parts["effort"],
            parts["energy"],
            parts["saturation"],
            parts["variation"],
            errors,
            assessed,
            outcomes,
            counts,
            firsts,
            np.zeros((2, final.shape[1])) if replans is None else replans,
        )

    def _compute_tracking_errors(self, states: Array, reference: Any) -> Array:
        """Return the errors of plant states relative to the reference (n_followed, n); NaN without a reference."""
        follow = np.full(states.shape, np.nan)
        for name in self.followed.names:
            if name in self.states:
                follow[self.states.slice(name)] = reference[self.followed.slice(name)]
        return np.asarray(self.errors(states, follow).full())


def _build_seed_sequence(seed: Any) -> np.random.SeedSequence:
    """Return the seed sequence of a seed; raise an error for a seed that is not reproducible."""
    if isinstance(seed, np.random.SeedSequence):
        return seed
    try:
        if seed is not None and not isinstance(seed, bool):
            return np.random.SeedSequence(seed)
    except (TypeError, ValueError):
        pass
    raise ArgumentError(f"the seed of a run is {quote_value(seed)}: give an integer >= 0, or several.")
