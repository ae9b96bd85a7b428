"""Run: trajectories, commands and figures of merit of one closed-loop simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_positive_number
from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError, quote_value
from gnc_opt.model.model_variables import Layout, Variable, read_vector
from gnc_opt.model.tabular_export_and_csv_import import TabularData, iterate_nan_padded_variables
from gnc_opt.npz_result_files import DataclassSerializer, FileFormat
from gnc_opt.numerical_tolerances import ROUNDING, SAME_TIME
from gnc_opt.simulation.campaign_tables import LISTED
from gnc_opt.simulation.replanned_reference import Replan
from gnc_opt.simulation.simulation_run_outcome import Outcome, RunStatus
from gnc_opt.simulation.zero_crossing_events import EventOccurrence
from gnc_opt.spacecraft.attitude import compute_attitude_angle
from gnc_opt.text_html_and_json_formatting import PrintableResult, simplify_time_integral_unit


def compute_settling_time(times: Array, distance: Array, band: float) -> float:
    """Return the time (s) from ``times[0]`` after which ``distance`` stays within ``band``, or infinity."""
    band = read_positive_number(band, "the band of a settling time")
    outside = np.flatnonzero(~(distance <= band))
    if not outside.size:
        return 0.0
    last = int(outside[-1])
    return float("inf") if last == times.size - 1 else float(times[last + 1] - times[0])


@dataclass(frozen=True)
class LoggedSignal:
    """Logged signal.

    Attributes
    ----------
    times : array (n_times,)
        Times, s; for commands, measurements and applied controls the starts of the control steps.
    values : array (size, n_times)
    held : bool
        Whether the signal is piecewise constant (commands) or linear (states) between its times.
    """

    name: str
    unit: str
    times: Array
    values: Array
    held: bool
    labels: tuple[str, ...]

    def __call__(self, t: ArrayLike) -> Array:
        """Return the signal, (size,) at one time t (s), (size, n) at many; states are interpolated linearly."""
        times = np.asarray(t, dtype=float)
        first, last = self.times[0], np.inf if self.held else self.times[-1]
        if not np.all((times >= first) & (times <= last * (1 + ROUNDING))):
            raise ArgumentError(
                f"'{self.name}' is logged from {first:g} s to {self.times[-1]:g} s, not at {quote_value(t)} s."
            )
        if self.held:
            index = np.searchsorted(self.times, times + SAME_TIME * (1 + np.abs(times)), side="right") - 1
            return np.asarray(self.values[:, index])
        rows = [np.interp(times, self.times, row) for row in self.values]
        return np.stack(rows)


@dataclass(frozen=True, repr=False)
class Run(PrintableResult):
    """Closed-loop run over N control steps.

    Attributes
    ----------
    times : array (N + 1,)
        Starts of the control steps and end time, s; an event may shorten the last step.
    states : array (n_states, N + 1)
        States of the plant.
    measured : array (n, N)
        Measurements of the controller.
    commands : array (n_commands, N)
        Commands, constant over a control step.
    applied : array (n_controls, N)
        Mean applied controls over the control steps, without disturbances.
    memory : array (n_memory, N + 1)
        Memory of the controller.
    reference : array (n, N + 1) or None
        Reference of the controller, see `reference_layout`.
    errors : array (n_errors, N + 1) or None
        State errors relative to the reference, with the plant's difference function; NaN for states without reference.
    parameters : array (n_parameters,)
    effort, energy, saturation, variation : array (n_controls,), array (n_commands,)
        As in `FinalValues`, from the mean applied controls.
    integration_error : float
        Estimated integration error, relative to max(1, \\|x\\|).
    outcome : Outcome
        First failure and its time, or ok.
    seed : str
    layouts : dict
        Names, sizes and units by kind: state, measured, followed, command, applied, memory, error, parameter, event.
    events, replans : tuples of EventOccurrence, Replan
        In order of time.

    Examples
    --------
    >>> print(np.round(run.state("q")([0.0, 1.0, 8.0]), 2), run.outcome)
    [[ 1.    0.72 -0.  ]] ok
    >>> print(f"{run.miss('q'):.4f} m, settled after {run.settling_time('q', 0.05):.1f} s")
    0.0018 m, settled after 3.8 s
    >>> print(f"effort {run.control_effort('a')[0]:.3f} m/s")
    effort 0.810 m/s
    """

    times: Array
    states: Array
    measured: Array
    commands: Array
    applied: Array
    memory: Array
    reference: Array | None
    errors: Array | None
    parameters: Array
    effort: Array
    energy: Array
    saturation: Array
    variation: Array
    integration_error: float
    outcome: Outcome
    seed: str
    layouts: Mapping[str, Layout]
    events: tuple[EventOccurrence, ...] = ()
    replans: tuple[Replan, ...] = ()

    def __str__(self) -> str:
        lines = [
            f"run of {self.times[-1] - self.times[0]:g} s in {self.times.size - 1} control steps: {self.outcome}",
            f"  integration   error about {self.integration_error:.1e}, seed {self.seed}",
        ]
        if self.errors is not None:
            ends = np.abs(self.errors[:, -1])
            lines.insert(1, "  final errors  " + _format_variable_norms(self.layouts["error"], ends))
        if self.events:
            lines.insert(-1, "  events        " + _format_event_occurrences(self.events))
        if self.replans:
            lines.insert(-1, "  re-plans      " + _format_replanning_counts(self.replans))
        lines.insert(
            -1, "  effort        " + _format_variable_norms(self.layouts["applied"], self.effort, " s")
        )
        lines.insert(
            -1, "  saturated     " + _format_variable_norms(self.layouts["command"], self.saturation, None)
        )
        return "\n".join(lines)

    @property
    def reference_layout(self) -> Layout:
        """Layout of the states of the reference."""
        return self.layouts.get("followed", self.layouts["measured"])  # files before estimators

    # --- signals ------------------------------------------------------------------------------------------

    def state(self, name: str) -> LoggedSignal:
        """Return a state of the plant."""
        return self._build_logged_signal("state", name, self.states, False)

    def measurement(self, name: str) -> LoggedSignal:
        """Return the controller's measurement of a state."""
        return self._build_logged_signal("measured", name, self.measured, True)

    def command(self, name: str) -> LoggedSignal:
        """Return a command of the controller."""
        return self._build_logged_signal("command", name, self.commands, True)

    def control(self, name: str) -> LoggedSignal:
        """Return an applied control of the plant, as the mean over each control step."""
        return self._build_logged_signal("applied", name, self.applied, True)

    def controller_state(self, name: str) -> LoggedSignal:
        """Return an entry of the controller's memory."""
        return self._build_logged_signal("memory", name, self.memory, False)

    def error(self, name: str) -> LoggedSignal:
        """Return the error of a state relative to the reference."""
        return self._build_logged_signal("error", name, self._require_tracking_errors(), False)

    def parameter(self, name: str) -> Array:
        """Return a parameter of the run by its dotted name, (size,)."""
        return self.parameters[self.layouts["parameter"].slice(name)]

    def _build_logged_signal(self, kind: str, name: str, values: Array, held: bool) -> LoggedSignal:
        layout = self.layouts[kind]
        place = layout.slice(name)
        variable = layout[name]
        return LoggedSignal(
            name, variable.unit, self.times[: values.shape[1]], values[place], held, variable.labels
        )

    def _require_tracking_errors(self) -> Array:
        if self.errors is None:
            raise ArgumentError(
                "the controller of this run has no reference: give target=, the value that the error is relative to."
            )
        return self.errors

    # --- metrics ------------------------------------------------------------------------------------------

    def _compute_state_deviation(self, name: str, target: ArrayLike | None) -> Array:
        if target is None:
            return self.error(name).values
        signal = self.state(name).values
        what = f"the target of '{name}'"
        return signal - read_vector(target, signal.shape[0], what, ArgumentError)[:, None]

    def miss(self, name: str, target: ArrayLike | None = None) -> float:
        """Return the Euclidean norm of a state's final error (unit of the state).

        ``target`` is the desired value, (size,); default: the reference at the end.
        """
        return float(np.linalg.norm(self._compute_state_deviation(name, target)[:, -1]))

    def attitude_error(self, name: str, at: float | None = None) -> float:
        """Return the angle (rad, 0 to pi) between an attitude and its reference, at the end or at time ``at`` (s)."""
        index = -1 if at is None else int(np.argmin(np.abs(self.times - at)))
        self._require_tracking_errors()
        assert self.reference is not None
        place = self.reference_layout.slice(name)
        return float(compute_attitude_angle(self.state(name).values[:, index], self.reference[place, index]))

    def settling_time(self, name: str, band: float, target: ArrayLike | None = None) -> float:
        """Return the time (s) after which the norm of a state's error stays within the band, or infinity."""
        return compute_settling_time(
            self.times, np.linalg.norm(self._compute_state_deviation(name, target), axis=0), band
        )

    def control_effort(self, name: str) -> Array:
        """Return the integral of \\|u\\| of an applied control, (size,), in its unit times s."""
        return self.effort[self.layouts["applied"].slice(name)]

    def control_energy(self, name: str) -> Array:
        """Return the integral of u^2 of an applied control, (size,), in its unit squared times s."""
        return self.energy[self.layouts["applied"].slice(name)]

    def delta_v(self, name: str, mass: float) -> float:
        """Return the sum over axes of the integral of \\|F\\| of an applied force, divided by the mass (kg), in m/s."""
        return float(np.sum(self.control_effort(name)) / mass)

    def saturation_time(self, name: str) -> Array:
        """Return the time (s) during which a limit acted on a command, (size,)."""
        return self.saturation[self.layouts["command"].slice(name)]

    def total_variation(self, name: str) -> Array:
        """Return the total variation of a command, (size,), in the unit of the command."""
        return self.variation[self.layouts["command"].slice(name)]

    # --- tables -------------------------------------------------------------------------------------------

    def to_pandas(self) -> Any:
        """Return all logged signals as a DataFrame, one column per component; ``attrs["units"]`` has the units.

        States have their names, other signals a prefix: ``measured.q``, ``command.F``, ``applied.F``, ``memory.z``,
        ``error.q``, ``reference.q``. Values of a control step are listed at its start.
        """
        return self._tabulate_results().to_pandas()

    def to_xarray(self) -> Any:
        """Return a Dataset with units; vector variables have a dimension for their components."""
        return self._tabulate_results().to_xarray()

    def export(self, path: str | Path) -> Path:
        """Write the table to a ``.csv``, ``.json`` or ``.mat`` file and return its path."""
        return self._tabulate_results().write(path)

    def _tabulate_results(self) -> TabularData:
        n = self.times.size
        quantities = [*iterate_nan_padded_variables(self.layouts["state"], self.states)]
        steps = {
            "measured": self.measured,
            "command": self.commands,
            "applied": self.applied,
            "memory": self.memory,
        }
        for kind, values in steps.items():
            quantities += iterate_nan_padded_variables(self.layouts[kind], values, f"{kind}.", n)
        if self.errors is not None:
            quantities += iterate_nan_padded_variables(self.layouts["error"], self.errors, "error.")
        if self.reference is not None:
            quantities += iterate_nan_padded_variables(self.layouts["measured"], self.reference, "reference.")
        about = {"outcome": str(self.outcome), "seed": self.seed}
        return TabularData(Variable("time", unit="s"), self.times, tuple(quantities), about)

    # --- files --------------------------------------------------------------------------------------------

    def save(self, path: str | Path) -> Path:
        """Write the run to a file (default suffix ``.npz``), without loss of precision."""
        return RUN_FILES.write_result_file(path, self)

    @classmethod
    def load(cls, path: str | Path) -> Run:
        """Return a run from a file of `save`; raise `FileNotFoundError`, or `GncOptError` for files without a run."""
        run, _ = RUN_FILES.read_result_file(path)
        assert isinstance(run, Run)
        return run


RUN_FILES = FileFormat(
    Run,
    "run",
    4,
    DataclassSerializer((Run, Outcome, RunStatus, Layout, Variable, EventOccurrence, Replan)),
    alike=(2, 3),  # 2 knows no events, 3 no re-plans
)


def _format_event_occurrences(events: Sequence[EventOccurrence]) -> str:
    more = f", ... ({len(events)})" if len(events) > LISTED else ""
    return ", ".join(str(event) for event in events[:LISTED]) + more


def _format_replanning_counts(replans: Sequence[Replan]) -> str:
    failed, slowest = sum(r.failed for r in replans), max(r.solve_s for r in replans)
    return f"{len(replans)}, {failed} of them failed; the slowest took {slowest:.2g} s here"


def _format_variable_norms(layout: Layout, values: Array, suffix: str | None = "") -> str:
    """Return the norm of every variable with unit and suffix; with ``None`` the values are in s."""
    parts = []
    for variable in layout.variables:
        size = np.linalg.norm(values[layout.slice(variable.name)])
        unit = "s" if suffix is None else simplify_time_integral_unit(f"{variable.unit}{suffix}".strip())
        parts.append(f"{variable.name} {size:.3g} {unit}".rstrip())
    return ", ".join(parts)
