"""Measures of a campaign: scalar results of each run, and envelopes of quantities over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import scipy

from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError, unknown_name_error
from gnc_opt.model.model_variables import Layout
from gnc_opt.simulation.confidence_intervals import estimate_percentile
from gnc_opt.simulation.recorded_extremes_and_integrals import KEPT
from gnc_opt.spacecraft.attitude import compute_attitude_angle
from gnc_opt.text_html_and_json_formatting import simplify_time_integral_unit


@dataclass(frozen=True, eq=False)
class Envelope:
    """Pointwise percentiles of a quantity over time.

    Attributes
    ----------
    name, unit : str
    times : array (n_times,)
        s.
    levels : tuple of float
    values : array (n_levels, n_times)
        Values that a share ``level`` of the runs still active does not exceed.
    low, high : array (n_levels, n_times)
        Confidence intervals of the percentiles, at the given ``confidence``; infinite for few runs.
    runs : int array (n_times,)
        Number of runs still active.
    confidence : float

    Examples
    --------
    >>> envelope = campaign.envelope("overshoot", levels=(0.5, 0.9))
    >>> print(envelope.times.shape, envelope.values.shape, f"{envelope.values[1].max():.3f} {envelope.unit}")
    (81,) (2, 81) 0.005 m
    """

    name: str
    unit: str
    times: Array
    levels: tuple[float, ...]
    values: Array
    low: Array
    high: Array
    runs: Array
    confidence: float


def compute_percentile_envelope(
    name: str, unit: str, times: Array, samples: Array, levels: Sequence[float], confidence: float
) -> Envelope:
    """Return the envelope of samples (n_times, n_runs) that are NaN after the end of a run; see `Envelope`."""
    shape = (len(levels), times.size)
    values, low, high = (np.full(shape, np.nan) for _ in range(3))
    n_flying = np.sum(~np.isnan(samples), axis=1)
    for k in np.flatnonzero(n_flying):
        finite = samples[k][~np.isnan(samples[k])]
        for j, level in enumerate(levels):
            percentile = estimate_percentile(finite, level, confidence)
            values[j, k], low[j, k], high[j, k] = percentile.value, percentile.low, percentile.high
    return Envelope(name, unit, times, tuple(map(float, levels)), values, low, high, n_flying, confidence)


def rank_dispersions(runs: Runs, values: Array) -> list[tuple[str, float, Array]]:
    """Return label, rank correlation with ``values`` (m,) and draws of each dispersed parameter, largest first.

    It is Spearman's, of the value or ("|label|") of its distance from the median, if that is larger. NaN ranks last.
    """
    effects, ranks = [], scipy.stats.rankdata(np.where(np.isnan(values), np.inf, values))
    for label, drawn in zip(runs.layouts["parameter"].labels, runs.parameters, strict=True):
        if np.ptp(ranks) and np.all(np.isfinite(drawn)) and np.ptp(drawn):
            pairs = {label: drawn, f"|{label}|": np.abs(drawn - np.median(drawn))}
            orders = {name: scipy.stats.rankdata(x) for name, x in pairs.items() if np.ptp(x)}
            correlations = [(name, float(np.corrcoef(x, ranks)[0, 1]), drawn) for name, x in orders.items()]
            effects.append(max(correlations, key=lambda effect: abs(effect[1])))
    return sorted(effects, key=lambda effect: -abs(effect[1]))


COMPONENT_SUMS = {"effort": " s", "energy": "^2 s", "variation": ""}
"""Control costs that are summed over components, with the suffix of their unit."""

REPLANS = ("replans", "failed replans")
"""Measures of runs with re-planning."""

_DESCRIPTIONS = {
    "error": "final error",
    "angle": "final angle",
    "saturation": "saturation time",
    "variation": "total variation",
    "max": "maximum",
    "min": "minimum",
}
"""Words for kinds of measures whose name is no word."""

ATTITUDE = (3, 4)
"""Valid numbers of attitude components: 3 (modified Rodrigues parameters) or 4 (quaternion)."""


Runs: TypeAlias = Any
"""A `gnc_opt.simulation.Campaign`; not imported here to avoid a circular import."""


class Measures:
    """Measures of the runs of a campaign; `Campaign.measure` lists their names."""

    def __init__(self, runs: Runs) -> None:
        self._runs = runs
        self._known: dict[str, Array] = {}

    def layout(self, kind: str) -> Layout:
        """Return the layout of a kind; empty for events and quantities missing in older files."""
        layouts: Mapping[str, Layout] = self._runs.layouts
        return layouts.get(kind, Layout(kind, (), "the campaign"))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all measures that have values."""
        controls, commands = self.layout("applied").names, self.layout("command").names
        states = [n for n in self.layout("state").names if self._has_target_state(n)]
        costs = [f"{cost}({n})" for cost in ("effort", "energy") for n in controls]
        costs += [f"{cost}({n})" for cost in ("saturation", "variation") for n in commands]
        times = [f"time({n})" for n in self.layout("event").names]
        extremes = [f"{kind}({n})" for n in self.layout("quantity").names for kind in KEPT]
        replans = REPLANS if self._runs.replans.any() else ()
        return (*states, *self._runs.measured, *costs, *times, *extremes, *replans)

    def compute_performance_measure(self, name: str) -> Array:
        """Return a measure of every run, (m,)."""
        if name in self._runs.measured:
            return np.asarray(self._runs.measured[name])
        if name in REPLANS:
            return np.asarray(self._runs.replans[REPLANS.index(name)])
        if name not in self._known:
            self._known[name] = self._evaluate_performance_measure(
                *self._parse_performance_measure_name(name)
            )
        return self._known[name]

    def unit(self, name: str) -> str:
        if name in self._runs.measured or name in REPLANS:
            return ""
        kind, subject = self._parse_performance_measure_name(name)
        if kind in KEPT:
            unit = self.layout("quantity")[subject].unit
            return simplify_time_integral_unit(f"{unit} s".strip()) if kind == "integral" else unit
        if kind in ("angle", "saturation", "time"):
            return "rad" if kind == "angle" else "s"
        if kind == "error":
            return self.layout("error")[subject].unit
        unit = self.layout("command" if kind == "variation" else "applied")[subject].unit
        bracketed = f"({unit})" if kind == "energy" and set(unit) & set(" /*") else unit
        return simplify_time_integral_unit(f"{bracketed}{COMPONENT_SUMS[kind]}".strip())

    def describe_performance_measure(self, name: str, format_name: Callable[[str], str] = str) -> str:
        """Return a measure in words: "final error of q", "effort of F"."""
        if name in self._runs.measured or name in REPLANS:
            return name
        kind, subject = self._parse_performance_measure_name(name)
        return f"{_DESCRIPTIONS.get(kind, kind)} of {format_name(subject)}"

    def _evaluate_performance_measure(self, kind: str, subject: str) -> Array:
        runs = self._runs
        if kind == "error":
            return np.asarray(np.linalg.norm(runs.errors[self.layout("error").slice(subject)], axis=0))
        if kind == "angle":
            place = self.layout("state").slice(subject)
            return np.asarray(compute_attitude_angle(runs.states[place], runs.target[place][:, None]))
        if kind == "time":
            return np.asarray(runs.event_times[self.layout("event").slice(subject)][0])
        if kind in KEPT:
            quantities = self.layout("quantity")
            return np.asarray(runs.sums[KEPT.index(kind) * quantities.size + quantities.slice(subject).start])
        if kind == "saturation":
            return np.asarray(np.max(runs.saturation_time[self.layout("command").slice(subject)], axis=0))
        layout = self.layout("command" if kind == "variation" else "applied")
        return np.asarray(np.sum(getattr(runs, kind)[layout.slice(subject)], axis=0))

    def _parse_performance_measure_name(self, name: str) -> tuple[str, str]:
        """Return kind and subject of a measure: ``"effort(F)"`` is ("effort", "F"), ``"q"`` is ("error", "q")."""
        kind, _, argument = name.partition("(") if isinstance(name, str) else ("", "", "")
        subject = argument[:-1] if argument.endswith(")") else ""
        states = self.layout("state")
        if isinstance(name, str) and name in states:
            kind, subject = "error", name
        elif kind == "angle" and subject in states:
            if states[subject].size not in ATTITUDE:
                raise ArgumentError(
                    f"'{subject}' has {states[subject].size} component(s): an attitude has three "
                    "(modified Rodrigues parameters) or four (quaternion)."
                )
        elif not (kind in _SUBJECTS and subject in self.layout(_SUBJECTS[kind])):
            names = [*self.names, *(n for n in states.names if n not in self.names)]
            names += [f"angle({n})" for n in states.names if states[n].size in ATTITUDE]
            raise unknown_name_error("measure", name, "the campaign", names)
        if kind in ("error", "angle") and not self._has_target_state(subject):
            raise ArgumentError(
                f"the controller has no reference for '{subject}': give target={{'{subject}': ...}}."
            )
        return kind, subject

    def _has_target_state(self, name: str) -> bool:
        return bool(np.all(np.isfinite(self._runs.target[self.layout("state").slice(name)])))


_SUBJECTS = {
    **dict.fromkeys(("effort", "energy"), "applied"),
    **dict.fromkeys(("saturation", "variation"), "command"),
    "time": "event",
    **dict.fromkeys(KEPT, "quantity"),
}
"""Layout kind of the subject of each measure, except errors and angles."""
