"""Campaign: results of many runs, their statistics, and confidence intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError, GncOptError, unknown_name_error
from gnc_opt.model.model_variables import Layout, Variable
from gnc_opt.model.tabular_export_and_csv_import import TabularData, iterate_nan_padded_variables
from gnc_opt.npz_result_files import DataclassSerializer, FileFormat
from gnc_opt.simulation.campaign_performance_measures import Envelope, Measures, compute_percentile_envelope
from gnc_opt.simulation.compiled_closed_loop import CompiledLoop
from gnc_opt.simulation.confidence_intervals import (
    CONFIDENCE,
    PassRate,
    Percentile,
    estimate_pass_rate,
    estimate_percentile,
)
from gnc_opt.simulation.simulation_run_outcome import Outcome, RunStatus
from gnc_opt.simulation.simulation_run_results import Run
from gnc_opt.text_html_and_json_formatting import PrintableResult, format_json


@dataclass(frozen=True, eq=False, repr=False)
class Campaign(PrintableResult):
    """Results of many runs of a closed loop; arrays have one column for each of the m available runs.

    Attributes
    ----------
    seed : int
        Run i uses the random numbers of ``SeedSequence([seed, i])``.
    asked : int
        Number of requested runs; larger than m after Ctrl-C.
    indices : int array (m,)
        Indices of the runs.
    parameters : array (n_parameters, m)
        Drawn parameter values, in the order of ``layouts["parameter"]``.
    states : array (n_states, m)
        Final states of the plant.
    errors : array (n_errors, m)
        Final errors relative to the reference or target, with the plant's difference function.
    target : array (n_states,)
        Final states that the errors are relative to; NaN without a reference.
    effort, energy, saturation_time, variation, integration_error, memory : arrays (..., m)
    event_counts, event_times, replans, sums, samples : arrays (..., m)
        As in `FinalValues`.
    sample_times : array (n_samples,)
        Times of ``samples``, s.
    outcomes : tuple of m Outcome
    span : tuple of two floats
        First and last time, s.
    limits : mapping
        Largest permitted values, by the name of the `measure`.
    measured : mapping
        Values (m,) of user-defined measures by name.
    interrupted : bool
        Whether Ctrl-C ended the campaign early.
    layouts : mapping
        Names, sizes and units by kind: parameter, state, error, applied, command, memory, event.
    compiled_loop : CompiledLoop or None
        Compiled loop; not stored in files.
    fingerprint : str
        Fingerprint of the compiled loop.
    scenario : tuple of (kind, name, description)
        Parts of the loop, dispersions, results of the controller design and software versions in words.

    Examples
    --------
    >>> print(len(campaign), "runs, largest |q| at the end", f"{campaign.maximum('q'):.4f} m")
    20 runs, largest |q| at the end 0.0023 m
    >>> print(campaign.pass_rate(), campaign.worst("q", 2))
    100.0 % (83.2 % to 100.0 %) [1, 7]
    >>> numbers = campaign.measure("max(overshoot)")  # of a quantity of the loop, (20,)
    >>> again = campaign.rerun(7)  # with everything logged
    """

    seed: int
    asked: int
    indices: Any
    parameters: Array
    states: Array
    errors: Array
    target: Array
    effort: Array
    energy: Array
    saturation_time: Array
    variation: Array
    integration_error: Array
    outcomes: tuple[Outcome, ...]
    span: tuple[float, float]
    limits: Mapping[str, float]
    measured: Mapping[str, Array]
    interrupted: bool
    layouts: Mapping[str, Layout]
    compiled_loop: CompiledLoop | None = None
    fingerprint: str = ""
    memory: Array = field(default_factory=lambda: np.empty((0, 0)))
    event_counts: Array = field(default_factory=lambda: np.empty((0, 0)))
    event_times: Array = field(default_factory=lambda: np.empty((0, 0)))
    replans: Array = field(default_factory=lambda: np.empty((2, 0)))
    sums: Array = field(default_factory=lambda: np.empty((0, 0)))
    samples: Array = field(default_factory=lambda: np.empty((0, 0, 0)))
    sample_times: Array = field(default_factory=lambda: np.empty(0))
    scenario: tuple[tuple[str, str, str], ...] = ()

    def __len__(self) -> int:
        return len(self.outcomes)

    def __str__(self) -> str:
        from gnc_opt.simulation.campaign_tables import format_campaign_table

        return format_campaign_table(self)

    def state(self, name: str) -> Array:
        """Return a final state, (size, m)."""
        return self.states[self.layouts["state"].slice(name)]

    def error(self, name: str) -> Array:
        """Return the final error of a state, (size, m)."""
        return self.errors[self.layouts["error"].slice(name)]

    def parameter(self, name: str) -> Array:
        """Return the drawn values of a parameter, (size, m)."""
        return self.parameters[self.layouts["parameter"].slice(name)]

    def event_occurred(self, event: str) -> Any:
        """Return whether an event occurred in each run, bool array (m,)."""
        return self.event_counts[self._performance_measures.layout("event").slice(event)][0] > 0

    def measure(self, name: str) -> Array:
        """Return a measure of each run, (m,); NaN for runs without a value.

        Parameters
        ----------
        name : str
            ``"r_L"``, the name of a state: Euclidean norm of its final error (unit of the error).
            ``"angle(sigma)"``: final angle between an attitude and its target, rad. ``"effort(F_B)"``,
            ``"energy(F_B)"``: integral of \\|u\\| or u^2, summed over the components. ``"variation(F_B)"``:
            total variation, summed; ``"saturation(F_B)"``: longest saturation time of a component, s.
            ``"time(touchdown)"``: time of the first occurrence of an event, s. ``"max(tilt)"``, ``"min(tilt)"``,
            ``"integral(tilt)"``: of a quantity of the loop over the run. ``"replans"``, ``"failed replans"``:
            numbers of successful and of failed re-plannings. Or the name of a user-defined measure.
        """
        return self._performance_measures.compute_performance_measure(name)

    def unit(self, name: str) -> str:
        """Return the unit of a measure."""
        return self._performance_measures.unit(name)

    def describe_measure(self, name: str, format_name: Callable[[str], str] = str) -> str:
        """Return a measure in words, for example "final error of q", with ``format_name`` applied to the variable."""
        return self._performance_measures.describe_performance_measure(name, format_name)

    @property
    def measures(self) -> tuple[str, ...]:
        """Names of all measures that have values."""
        return self._performance_measures.names

    @cached_property
    def _performance_measures(self) -> Measures:
        return Measures(self)

    def envelope(
        self, quantity: str, levels: Sequence[float] = (0.05, 0.5, 0.95), confidence: float = CONFIDENCE
    ) -> Envelope:
        """Return percentiles (``levels`` in (0, 1)) of a quantity over time, with confidence intervals."""
        place = self._performance_measures.layout("quantity").slice(quantity).start
        unit = self._performance_measures.layout("quantity")[quantity].unit
        return compute_percentile_envelope(
            quantity, unit, self.sample_times, self.samples[place], levels, confidence
        )

    @cached_property
    def ok(self) -> Any:
        """Whether the status of each run is OK, bool array (m,)."""
        return np.array([outcome.ok for outcome in self.outcomes], dtype=bool)

    def passed(self, name: str | None = None) -> Any:
        """Return whether each run is OK and within the named limit, or all limits: bool array (m,)."""
        names = self.limits if name is None else [name]
        passed = self.ok.copy()
        for each in names:
            if each not in self.limits:
                raise unknown_name_error("limit", each, "the campaign", self.limits)
            passed &= self.measure(each) <= self.limits[each]  # false for NaN
        return passed

    def pass_rate(self, name: str | None = None, confidence: float = CONFIDENCE) -> PassRate:
        """Return the share of runs that are OK and within the named limit, or all; raise `GncOptError` without runs."""
        return estimate_pass_rate(int(np.sum(self.passed(name))), self._require_finished_runs(), confidence)

    def percentile(self, name: str, level: float, confidence: float = CONFIDENCE) -> Percentile:
        """Return a percentile of a measure; ``level`` in (0, 1). Runs without a value count as infinite."""
        self._require_finished_runs()
        return estimate_percentile(self.measure(name), level, confidence)

    def maximum(self, name: str) -> float:
        """Return the largest value of a measure; infinite if a run has no value."""
        self._require_finished_runs()
        return float(np.max(_replace_nan_by_infinity(self.measure(name))))

    @property
    def status_counts(self) -> dict[RunStatus, int]:
        """Number of runs by status."""
        counts = Counter(outcome.status for outcome in self.outcomes)
        return {status: counts[status] for status in RunStatus if counts[status]}

    @property
    def event_totals(self) -> dict[str, int]:
        """Number of runs in which each event occurred."""
        return {
            name: int(np.sum(self.event_occurred(name)))
            for name in self._performance_measures.layout("event").names
        }

    @property
    def failures(self) -> dict[int, Outcome]:
        """Outcomes of the runs that are not OK, by index."""
        pairs = zip(self.indices, self.outcomes, strict=True)
        return {int(i): outcome for i, outcome in pairs if not outcome.ok}

    def worst(self, name: str, count: int = 5) -> list[int]:
        """Return the indices of the runs with the largest values of a measure, in descending order."""
        order = np.argsort(-_replace_nan_by_infinity(self.measure(name)), kind="stable")
        return [int(i) for i in self.indices[order[:count]]]

    def rerun(self, index: int) -> Run:
        """Simulate one run again and return it with all signals; the final state is bitwise identical.

        Raises
        ------
        ArgumentError
            The index is out of range, or the run cannot be simulated.
        GncOptError
            The campaign was loaded from a file: use ``Campaign.load(path, compiled_loop=loop.compile(...))``.
        """
        columns = np.flatnonzero(self.indices == index)
        if not columns.size:
            raise ArgumentError(f"the campaign has no run {index}: its {len(self)} runs count from 0.")
        if self.compiled_loop is None:
            raise GncOptError(
                "the campaign has no compiled loop: load it with compiled_loop=loop.compile(x0, tf=...)."
            )
        return self.compiled_loop.run(self.parameters[:, columns[0]], [self.seed, int(index)])

    # --- tables -------------------------------------------------------------------------------------------

    def to_pandas(self) -> Any:
        """Return a DataFrame with one row per run and one column per component; ``attrs["units"]`` has the units."""
        return self._tabulate_results().to_pandas()

    def to_xarray(self) -> Any:
        """Return a Dataset with units; vector variables have a dimension for their components."""
        return self._tabulate_results().to_xarray()

    def export(self, path: str | Path) -> Path:
        """Write the table to a ``.csv``, ``.json`` or ``.mat`` file and return its path."""
        return self._tabulate_results().write(path)

    def _tabulate_results(self) -> TabularData:
        outcomes = [outcome.status.value for outcome in self.outcomes]
        measures = [
            (Variable(name, unit=self.unit(name)), self.measure(name)[None, :]) for name in self.measures
        ]
        quantities = (
            (Variable("outcome"), np.array([outcomes], dtype=object)),
            *iterate_nan_padded_variables(self.layouts["parameter"], self.parameters),
            *iterate_nan_padded_variables(self.layouts["state"], self.states, "final."),
            *iterate_nan_padded_variables(self.layouts["error"], self.errors, "error."),
            *measures,
        )
        about = {"seed": self.seed, "asked": self.asked, "fingerprint": self.fingerprint}
        return TabularData(Variable("run"), np.asarray(self.indices), quantities, about)

    # --- files --------------------------------------------------------------------------------------------

    def to_json(self, path: str | Path | None = None) -> str:
        """Return statistics and failures as JSON text; with a path also write them to a file."""
        from gnc_opt.simulation.campaign_tables import build_campaign_summary_dict

        text = format_json(build_campaign_summary_dict(self))
        if path is not None:
            Path(path).write_text(text, encoding="utf-8")
        return text

    def save(self, path: str | Path) -> Path:
        """Write all runs to a file (default suffix ``.npz``), without loss of precision."""
        return CAMPAIGN_FILES.write_result_file(path, self)

    @classmethod
    def load(cls, path: str | Path, compiled_loop: CompiledLoop | None = None) -> Campaign:
        """Return a campaign from a file written by `save`.

        ``compiled_loop`` is ``loop.compile(x0, tf=...)`` of the same loop; `rerun` needs it.

        Raises
        ------
        FileNotFoundError
            The file does not exist.
        GncOptError
            The file is damaged or contains no campaign, or ``compiled_loop`` is of another loop.
        """
        campaign, _ = CAMPAIGN_FILES.read_result_file(path)
        assert isinstance(campaign, Campaign)
        if compiled_loop is not None:
            _require_reproducible_campaign(campaign, compiled_loop, path)
        return replace(campaign, compiled_loop=compiled_loop)

    def _require_finished_runs(self) -> int:
        if not self.outcomes:
            raise GncOptError("no run of the campaign has ended: run it longer.")
        return len(self.outcomes)


def _require_reproducible_campaign(campaign: Campaign, compiled_loop: CompiledLoop, path: str | Path) -> None:
    """Raise an error unless the compiled loop reproduces the runs of the campaign bitwise."""
    span = (float(compiled_loop.times[0]), float(compiled_loop.times[-1]))
    if compiled_loop.layout.labels != campaign.layouts["parameter"].labels:
        why = "another loop than the given loop: its parameters have other names"
    elif span != tuple(campaign.span):
        begin, end = campaign.span
        why = f"from {begin:g} s to {end:g} s, the given loop from {span[0]:g} s to {span[1]:g} s"
    elif campaign.fingerprint and compiled_loop.fingerprint != campaign.fingerprint:
        why = "another loop than the given loop: plant, controller, blocks, accuracy or schedule differ"
    else:
        return
    raise GncOptError(f"the campaign of '{path}' flew {why}.")


CAMPAIGN_FILES = FileFormat(
    Campaign,
    "campaign",
    8,
    DataclassSerializer(
        (Campaign, Outcome, RunStatus, Layout, Variable), left_out={Campaign: ("compiled_loop",)}
    ),
    alike=tuple(
        range(2, 8)
    ),  # 2 without fingerprint, 3 memory, 4 events, 5 re-plans, 6 quantities, 7 scenario
)


def _replace_nan_by_infinity(values: Array) -> Array:
    return np.where(np.isnan(values), np.inf, values)
