r"""Linear covariance analysis: how far the errors of a closed loop scatter, from one pass along its nominal run.

With the derivatives of `Linearization`, the deviations due to a dispersion with covariance :math:`\Sigma_j` are
:math:`\delta X_k = \Phi_{jk}\, \delta P_j` and those due to the noise of a block have the covariance S of

.. math:: \Phi_{k+1} = A_k \Phi_k + H_k, \qquad S_{k+1} = A_k S_k A_k^T + G_k G_k^T,

so that each source has its own share of every covariance. Nonlinearity within the dispersions is measured by runs whose
random numbers also give the linear prediction: if r is the root mean square of the differences, standard deviations lie
within :math:`\sigma \pm r`, by the triangle inequality.

Source: D. K. Geller, Linear covariance techniques for orbital rendezvous analysis and autonomous
onboard mission planning, Journal of Guidance, Control, and Dynamics 29 (2006), section III.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import scipy

from gnc_opt.analysis.deviation_propagation import Scatter, Sources
from gnc_opt.analysis.loop_linearization import OUTPUTS, Linearization
from gnc_opt.analysis.scenario import Scenario
from gnc_opt.arguments import (
    Strict,
    expect,
    read_integer,
    read_positive,
    read_probability,
    suggesting_keywords,
)
from gnc_opt.arrays import Array
from gnc_opt.environment import one_thread
from gnc_opt.errors import ArgumentError, unknown_name, warn_user
from gnc_opt.model.model import Model
from gnc_opt.model.variables import Layout
from gnc_opt.simulation.campaign import Campaign
from gnc_opt.simulation.compiled_loop import LEG, CompiledLoop
from gnc_opt.simulation.confidence_intervals import CONFIDENCE
from gnc_opt.simulation.dispersions import Dispersions, dispersed
from gnc_opt.simulation.step_selection import steps_for_modes
from gnc_opt.text import Printed
from gnc_opt.tolerances import ROUNDING, TINY


@dataclass(frozen=True, eq=False)
class CovarianceCheck(Printed):
    """Variances of the runs of a campaign over those of a linear covariance; arrays have an entry per component.

    Attributes
    ----------
    labels : tuple of str
        The components that scatter.
    runs : int
        That ended with finite numbers.
    ratio : array (n,)
        Variance of the runs over that predicted.
    band : array (2, n)
        Of the ratio: chi-square with 2 / (kurtosis - 1) degrees of freedom per run.
    confidence : float
        Of all bands together (Bonferroni).

    Examples
    --------
    >>> scenario = go.Scenario(loop, x0=[1.0, 0.0], tf=8.0, dispersions=spread)
    >>> result = go.linear_covariance(scenario, checks=0)
    >>> agreement = result.compare(campaign)
    >>> print(agreement.labels, agreement.runs, agreement.ok)
    ('q', 'v') 20 True
    """

    labels: tuple[str, ...]
    runs: int
    ratio: Array
    band: Array
    confidence: float

    @property
    def within(self) -> Array:
        """Whether each ratio is in its band, bool array (n,)."""
        return np.asarray((self.band[0] <= self.ratio) & (self.ratio <= self.band[1]))

    @property
    def ok(self) -> bool:
        """Whether all are."""
        return bool(np.all(self.within))

    def __str__(self) -> str:
        width = max([9, *map(len, self.labels)])
        title = f"variance of {self.runs} runs over the predicted one"
        lines = [f"{title} ({100 * self.confidence:g} % for all bands together)"]
        for label, ratio, (low, high), inside in zip(
            self.labels, self.ratio, self.band.T, self.within, strict=True
        ):
            verdict = "within" if inside else "OUTSIDE"
            lines.append(f"  {label:{width}}  {ratio:<8.4f}  {low:.4f} to {high:.4f}  {verdict}")
        return "\n".join(lines)


def magnitudes(values: Array) -> Array:
    """Return the scale of integration errors (n,) from values over time (n, n_times): 1 or their size."""
    return np.asarray(np.maximum(1.0, np.max(np.abs(values), axis=1)))


def error_sizes(flight: CompiledLoop, states: Array) -> Array:
    """Return the same of each component of the errors, (n_errors,), by states over time (n_states, n_times)."""
    sizes, places = magnitudes(states), flight.states
    return np.concatenate(
        [
            np.full(error.size, np.max(sizes[places.slice(error.name)]))
            for error in flight.error_layout.variables
        ]
    )


def covariance_table(found: LinearCovariance) -> str:
    """Return the standard deviations at the end as text: a line per state, with its main sources."""
    layout = found.layouts["error"]
    width = max([5, *map(len, layout.names)])
    units = max([1, *(len(v.unit) for v in layout.variables)])
    lines = [
        f"linear covariance over {found.times[-1] - found.times[0]:g} s, {len(found.sources)} sources",
        f"  {'at the end':{width + units + 1}}  1 sigma   "
        + ("nonlinear  " if found.checked else "")
        + "sources",
    ]
    for variable in layout.variables:
        sigma = float(np.linalg.norm(found.std(variable.name)[:, -1]))
        line = f"  {variable.name:{width}} {variable.unit:{units}}  {sigma:<8.3g}  "
        if found.checked:
            line += f"{_percent(float(np.max(found.nonlinearity(variable.name)[:, -1]))):<9}  "
        shares = [(s, share) for s, share in found.budget(variable.name).items() if share > 0][:3]
        lines.append((line + ", ".join(f"{s} {_percent(share)}" for s, share in shares)).rstrip())
    if found.checked:
        bent = [name for name in layout.names if not found.linear(name)]
        verdict = (
            f"not linear: {', '.join(bent)}"
            if bent
            else f"all linear, to {_percent(LINEAR_MAX_ERROR_SIGMA)} of sigma"
        )
        lines.append(
            f"  {verdict} ({found.checked} runs beside their predictions); sources: shares of the variance"
        )
    return "\n".join(lines)


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.995 else f"{100 * share:.0f} %"


class PlantModes:
    """Integration steps that a plant's modes need along its nominal run (`steps_for_modes`)."""

    def __init__(self, linearization: Linearization, asked: float) -> None:
        self._asked = asked
        self._flight: CompiledLoop = linearization.flight
        self._plant: Model = linearization.wiring.plant
        self._outputs = linearization.output
        layout, nominal = self._flight.layout, self._flight.nominal
        places = [layout.slice(f"plant.{name}") for name in self._plant.parameters.names]
        self._p = np.concatenate([np.empty(0), *[nominal[place] for place in places]])

    def needed(self, t: float, X: Array, y: Array) -> int:
        """Return the integration steps per minor step at a time (s), from the loop's column and its `OUTPUTS`."""
        x, applied = self._flight.kernel.state.split(X)["plant"], self._outputs.split(y)[OUTPUTS[1]]
        a, _ = self._plant.linearize(t, x, applied, self._p)
        if not np.isfinite(a).all():
            return 1  # the linearization itself names values that are not finite
        length = self._flight.dt / self._flight.minor_steps
        return steps_for_modes(np.linalg.eigvals(a).astype(complex), length, self._asked)


LINEAR_MAX_ERROR_SIGMA = 0.05
"""Share of a standard deviation by which it may be wrong at most, and the loop still counts as linear."""

FROZEN_GAINS_MAX_NIS = 1e-2
"""Sum of the normalised innovations squared of a filter over the nominal run, up to which its gains are frozen."""

_FOLLOWED = 1e-3
"""Relative error of a mode over the run above which a warning is given."""

_KINDS = {"command": "commands", "applied": "applied"}
"""Signals in addition to the errors, and their names in the log."""


@dataclass(frozen=True, eq=False)
class LinearCovariance(Strict, Printed):
    """Covariances along a nominal run, by source; see `linear_covariance`.

    A *signal* is the name of a state (its error), ``command(F)`` or ``applied(F)`` (mean over the step).

    Attributes
    ----------
    times : array (n_times,)
        s; commands and applied controls have all but the last.
    sources : tuple of str
        Names of dispersions, then of blocks that draw random numbers.
    nominal : array (n_states, n_times)
        The plant without dispersions and noise.
    mean : array (n_errors, n_times)
        Of the errors; not zero where dispersions are not centred.
    parts : mapping
        Arrays (n_sources, n_times, n, n): covariances by source, of "error", "command" and "applied".
    bends : mapping
        Arrays (n, n_times) of the same: see `nonlinearity`.
    checked : int
        Number of these runs.
    layouts : mapping
        Names, sizes and units: error, command, applied.
    flight : Flight
    dispersions : mapping of str to Dispersion

    Examples
    --------
    >>> scenario = go.Scenario(loop, x0=[1.0, 0.0], tf=8.0, dispersions=spread)
    >>> result = go.linear_covariance(scenario, checks=0)
    >>> print({source: f"{share:.0%}" for source, share in result.budget("q").items()})
    {'initial.q': '55%', 'gauge': '43%', 'initial.v': '1%'}
    """

    times: Array
    sources: tuple[str, ...]
    nominal: Array
    mean: Array
    parts: Mapping[str, Array]
    bends: Mapping[str, Array]
    checked: int
    layouts: Mapping[str, Layout] = field(repr=False)
    flight: CompiledLoop = field(repr=False)
    dispersions: Dispersions = field(repr=False)

    def __str__(self) -> str:

        return covariance_table(self)

    def covariance(self, signal: str) -> Array:
        """Return the covariance of a signal over time, (n_times, size, size)."""
        return np.asarray(self.by_source(signal).sum(axis=0))

    def std(self, signal: str) -> Array:
        """Return the standard deviations (1 sigma) of a signal over time, (size, n_times)."""
        return _roots(self.covariance(signal))

    def by_source(self, signal: str) -> Array:
        """Return the covariances of a signal due to each of `sources`, (n_sources, n_times, size, size)."""
        kind, name = self._parse(signal)
        place = self.layouts[kind].slice(name)
        return self.parts[kind][:, :, place, place]

    def budget(self, signal: str, at: float | None = None) -> dict[str, float]:
        """Return which share of a signal's variance each source has, the largest first.

        The variance is the trace of the covariance; shares add up to 1, unless the variance is zero.

        Parameters
        ----------
        signal : str
        at : float, optional
            Time (s), the logged one nearest to it; default the last.
        """
        parts = self.by_source(signal)
        k = -1 if at is None else int(np.argmin(np.abs(self.times[: parts.shape[1]] - at)))
        traces = np.trace(parts[:, k], axis1=1, axis2=2)
        shares = traces / max(float(traces.sum()), TINY)
        order = np.argsort(-shares, kind="stable")
        return {self.sources[i]: float(shares[i]) for i in order}

    def nonlinearity(self, signal: str) -> Array:
        """Return the RMS error of the linear prediction, (size, n_times), in standard deviations.

        Infinite if the prediction does not scatter, NaN without runs.
        """
        kind, name = self._parse(signal)
        return self.bends[kind][self.layouts[kind].slice(name)]

    def linear(self, signal: str, tolerance: float = LINEAR_MAX_ERROR_SIGMA) -> bool:
        """Whether the final standard deviations are right to ``tolerance``; `ArgumentError` without runs."""
        if not self.checked:
            raise ArgumentError(
                "no run was compared with its linear prediction: give checks= a number of runs."
            )
        tolerance = read_positive(tolerance, "the tolerance of linear()")
        return bool(np.all(self.nonlinearity(signal)[:, -1] <= tolerance))

    def compare(self, campaign: Campaign, confidence: float = CONFIDENCE) -> CovarianceCheck:
        """Return the variances of a campaign's errors at the end over those predicted, with bands.

        Parameters
        ----------
        campaign : Campaign
            Of the same loop, nominal run and dispersions.
        confidence : float
            Of all bands together, in (0, 1).

        Raises
        ------
        ArgumentError
            The campaign flew another loop or span, or fewer than two runs ended.
        """
        expect(campaign, Campaign, "what compare() got", "give what monte_carlo() returned")
        level = read_probability(confidence, "the confidence of compare()")
        flight, nominal = self.flight, self.nominal[:, -1]
        if campaign.fingerprint != flight.fingerprint:
            raise ArgumentError(
                "the campaign flew another loop or span than the linear covariance is of: fly the same."
            )
        ends = campaign.states[:, np.isfinite(campaign.states).all(axis=0)]
        runs = ends.shape[1]
        if runs < 2:
            raise ArgumentError(f"{runs} runs of the campaign ended with finite numbers: fly at least two.")
        variance = np.diag(self.parts["error"][:, -1].sum(axis=0))
        erring = float(np.median(np.fmin(campaign.integration_error, flight.accuracy))) + ROUNDING
        scatters = np.flatnonzero(variance > (erring * error_sizes(flight, nominal[:, None])) ** 2)
        errors = np.asarray(flight.errors(ends, np.repeat(nominal[:, None], runs, axis=1)).full())[scatters]
        kurtosis = np.maximum(scipy.stats.kurtosis(errors, axis=1, fisher=False), 1 + ROUNDING)
        freedom = 2 * (runs - 1) / (kurtosis - 1)
        tail = (1 - level) / (2 * max(scatters.size, 1))
        return CovarianceCheck(
            labels=tuple(flight.error_layout.labels[i] for i in scatters),
            runs=runs,
            ratio=errors.var(axis=1, ddof=1) / variance[scatters],
            band=np.stack([scipy.stats.chi2.ppf(p, freedom) / freedom for p in (tail, 1 - tail)]),
            confidence=level,
        )

    def _parse(self, signal: str) -> tuple[str, str]:
        kind, _, rest = signal.partition("(") if isinstance(signal, str) else ("", "", "")
        name = rest[:-1] if rest.endswith(")") else ""
        if kind in _KINDS and name in self.layouts[kind]:
            return kind, name
        if signal in self.layouts["error"]:
            return "error", signal
        known = [*self.layouts["error"].names]
        known += [f"{kind}({name})" for kind in _KINDS for name in self.layouts[kind].names]
        raise unknown_name("signal", signal, "the linear covariance", known)


@one_thread()
@suggesting_keywords
def linear_covariance(
    scenario: Scenario,
    *,
    every: int = 1,
    checks: int = 30,
) -> LinearCovariance:
    """Return the covariances of a closed loop's errors along its nominal run, by source.

    Parameters
    ----------
    scenario : Scenario
        Whose loop has no events. Its seed is that of the runs to compare with.
    every : int
        Of so many control steps one is kept; the end always is.
    checks : int
        Runs simulated for `LinearCovariance.nonlinearity`; 0: none.

    Raises
    ------
    ArgumentError, UnknownNameError
        Something does not fit, the loop has events, or a derivative is not finite; the message says which.

    Examples
    --------
    >>> scenario = go.Scenario(loop, x0=[1.0, 0.0], tf=8.0, dispersions=spread)
    >>> result = go.linear_covariance(scenario, checks=0)
    >>> print(result.sources)
    ('initial.q', 'initial.v', 'gauge')
    >>> print(f"{1e3 * result.std('q')[0, -1]:.2f} mm at the end")
    0.26 mm at the end
    """
    expect(scenario, Scenario, "what linear_covariance() got", "give a Scenario")
    every = read_integer(every, "the number of control steps of which one is kept", 1)
    checks = read_integer(checks, "the number of runs to compare with", 0)
    flight, dispersions = scenario.flight, scenario.dispersions
    columns = [int(i) for name in dispersions for i in range(flight.layout.size)[flight.layout.slice(name)]]
    linearization = Linearization(flight, scenario.loop.wiring, columns)
    if linearization.nominal_nis() <= FROZEN_GAINS_MAX_NIS:
        linearization = replace(linearization, hold=True)
    return _Pass(linearization, dispersions, every, checks, scenario.seed).result()


class _Pass:
    """One sweep along the nominal run, with the propagated quantities."""

    def __init__(
        self, linearization: Linearization, dispersions: Dispersions, every: int, checks: int, seed: int
    ) -> None:
        self.linearization, self.flight = linearization, linearization.flight
        self.every, self.seed, self.dispersions = every, seed, dispersions
        layout, nominal = self.flight.layout, self.flight.nominal
        moments = {name: d.moments(nominal[layout.slice(name)]) for name, d in dispersions.items()}
        self.shift = np.concatenate([np.empty(0), *[mean for mean, _ in moments.values()]])
        columns = [dispersed(dispersions, layout, nominal, seed, i) for i in range(checks)]
        self.drawn = np.reshape(columns, (checks, layout.size)).T
        numbers = linearization.noises
        units = [np.eye(place.stop - place.start) for place in numbers.values()]
        chosen = linearization.columns
        self.sources = Sources(
            (*moments, *numbers),
            (*(covariance for _, covariance in moments.values()), *units),
            tuple(numbers.values()),
            self.drawn[chosen] - nominal[chosen, None],
        )
        self.values: dict[str, list[Array]] = {kind: [] for kind in ("state", *_KINDS)}
        self.scatters: dict[str, list[tuple[Array, Array]]] = {kind: [] for kind in ("error", *_KINDS)}
        self.mean: list[Array] = []

    def result(self) -> LinearCovariance:
        """Return what the pass found."""
        X, g, h = self.linearization.start()
        numbers = self._numbers()
        n = next(numbers)
        scatter = Scatter.first(self.sources, g, h, n)
        flown, needed = self.flight.n_steps, 1
        looks = max(1, flown // 10)
        resolution = PlantModes(self.linearization, _FOLLOWED / (flown * self.flight.minor_steps))
        for k, step in enumerate(self.linearization.steps(X)):
            first = k == 0
            n = n if first else next(numbers)
            if k % looks == 0:
                needed = max(needed, resolution.needed(self.flight.times[k], X, step.y))
            if k % self.every == 0:
                self._keep_state(X, scatter)
                self._keep_outputs(step.y, scatter.through(step.c, step.d, step.e, n, first=first))
            scatter, X = scatter.through(step.a, step.g, step.h, n, first=first), step.X_next
        self._keep_state(X, scatter)
        self._warn_of_modes(needed)
        return self._collected()

    # --- internals ----------------------------------------------------------------------------------------

    def _warn_of_modes(self, needed: int) -> None:
        if needed > self.flight.substeps:
            warn_user(
                f"the nominal run of the covariance has so little in it that {self.flight.substeps} integration steps "
                f"per minor step do; its modes ask for {needed}, and what is told of them is off: give the loop "
                f"substeps={needed}, and the runs that are compared with it."
            )

    def _numbers(self) -> Iterator[Array]:
        """Yield the random numbers (n, n_runs) of each step of the runs to compare with."""
        flight, drawn = self.flight, self.linearization.drawn
        known = [np.empty((min(flight.n_steps, LEG), flight.kernel.known.size)) for _ in self.drawn.T]
        if not known:
            yield from itertools.repeat(np.empty((len(drawn), 0)))
        for legs in zip(*(flight.legs([self.seed, i], rows) for i, rows in enumerate(known)), strict=True):
            yield from np.stack([rows[:, drawn] for _, rows in legs], axis=2)

    def _keep_state(self, X: Array, scatter: Scatter) -> None:
        places = self.linearization.state.split(np.arange(scatter.runs.shape[0]))["plant"]
        x = self.flight.kernel.state.split(X)["plant"]
        to_errors = np.zeros((self.flight.error_layout.size, scatter.runs.shape[0]))
        to_errors[:, places] = self._error_jacobian(x).full()
        errors = scatter.turned(to_errors)
        self.values["state"].append(x)
        self.scatters["error"].append((errors.covariances, errors.runs))
        self.mean.append(errors.by_parameters[:, : self.shift.size] @ self.shift)

    def _keep_outputs(self, y: Array, scatter: Scatter) -> None:
        values = self.linearization.output.split(y)
        places = self.linearization.output.split(np.eye(y.size))
        for kind, name in _KINDS.items():
            part = scatter.turned(places[name])
            self.values[kind].append(values[name])
            self.scatters[kind].append((part.covariances, part.runs))

    @cached_property
    def _error_jacobian(self) -> Any:
        """Derivatives of the errors relative to the nominal state, there."""
        x, x_ref = (ca.SX.sym(n, self.flight.states.size) for n in ("x", "x_ref"))
        jacobian = ca.jacobian(self.flight.errors(x, x_ref), x)
        return ca.Function("by_x", [x_ref], [ca.substitute(jacobian, x, x_ref)])

    def _collected(self) -> LinearCovariance:
        flight = self.flight
        kept = np.append(np.arange(0, flight.n_steps, self.every), flight.n_steps)
        parts = {kind: np.stack([c for c, _ in found], axis=1) for kind, found in self.scatters.items()}
        return LinearCovariance(
            times=flight.times[kept],
            sources=self.sources.names,
            nominal=np.stack(self.values["state"], axis=1),
            mean=np.stack(self.mean, axis=1),
            parts=parts,
            bends=self._bends({kind: _roots(part.sum(axis=0)) for kind, part in parts.items()}),
            checked=self.drawn.shape[1],
            layouts={"error": flight.error_layout, "command": flight.commands, "applied": flight.controls},
            flight=flight,
            dispersions=self.dispersions,
        )

    def _bends(self, sigma: dict[str, Array]) -> dict[str, Array]:
        """Return the root mean square of what runs differ by from their predictions, in standard deviations."""
        flight, checks = self.flight, self.drawn.shape[1]
        if not checks:
            return {kind: np.full(s.shape, np.nan) for kind, s in sigma.items()}
        nominal = {kind: np.stack(values, axis=1) for kind, values in self.values.items()}
        squares = {kind: np.zeros(s.shape) for kind, s in sigma.items()}
        erring = ROUNDING
        for i in range(checks):
            run = flight.run(self.drawn[:, i], [self.seed, i], every=self.every)
            erring = max(erring, float(np.fmin(run.integration_error, flight.accuracy)))
            moved = {kind: getattr(run, name) - nominal[kind] for kind, name in _KINDS.items()}
            moved["error"] = np.asarray(flight.errors(run.states, nominal["state"]).full())
            for kind, deviations in moved.items():
                predicted = np.stack([runs[:, i] for _, runs in self.scatters[kind]], axis=1)
                squares[kind] += np.nan_to_num((deviations - predicted) ** 2, nan=np.inf)
        found = {}
        for kind, s in sigma.items():
            apart = np.sqrt(squares[kind] / checks)
            sizes = error_sizes(flight, nominal["state"]) if kind == "error" else magnitudes(nominal[kind])
            quiet = erring * sizes[:, None]  # what integration may err by is no scatter
            bent = np.where(apart <= quiet, 0.0, np.inf)
            found[kind] = np.divide(apart, s, out=bent, where=s > quiet)
        return found


def _roots(covariance: Array) -> Array:
    """Return the standard deviations (size, n_times) in covariances (n_times, size, size)."""
    return np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2).T, 0.0))
