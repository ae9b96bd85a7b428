r"""Linear covariance analysis: error covariances of a closed loop from one pass along its nominal run.

With the derivatives of `Linearization`, a dispersion with covariance :math:`\Sigma_j` causes the deviations
:math:`\delta X_k = \Phi_{jk}\, \delta P_j`. The noise of a block causes the covariance S,

.. math:: \Phi_{k+1} = A_k \Phi_k + H_k, \qquad S_{k+1} = A_k S_k A_k^T + G_k G_k^T,

so that every covariance is a sum over the sources.

Source: D. K. Geller, Linear covariance techniques for orbital rendezvous analysis and autonomous
onboard mission planning, Journal of Guidance, Control, and Dynamics 29 (2006), section III.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.analysis.closed_loop_linearization import Linearization
from gnc_opt.analysis.covariance_by_error_source import DeviationSources, StateDeviations
from gnc_opt.analysis.dispersed_closed_loop_scenario import Scenario
from gnc_opt.argument_checks import read_integer, require_type, suggest_keywords
from gnc_opt.array_types import Array
from gnc_opt.errors import unknown_name_error
from gnc_opt.model.model_variables import Layout
from gnc_opt.numerical_tolerances import TINY
from gnc_opt.simulation.compiled_closed_loop import CompiledLoop
from gnc_opt.simulation.dispersions import Dispersions
from gnc_opt.text_html_and_json_formatting import PrintableResult, format_percentage, pluralise_noun
from gnc_opt.threads_and_package_versions import limit_to_one_thread


def format_covariance_table(found: LinearCovariance) -> str:
    """Return the table of final standard deviations: one line per state, with its main sources."""
    layout = found.layouts["error"]
    width = max([5, *map(len, layout.names)])
    units = max([1, *(len(v.unit) for v in layout.variables)])
    lines = [
        f"linear covariance over {found.times[-1] - found.times[0]:g} s, "
        f"{pluralise_noun(len(found.sources), 'source')}",
        f"  {'at the end':{width + units + 1}}  1 sigma   sources",
    ]
    for variable in layout.variables:
        sigma = float(np.linalg.norm(found.std(variable.name)[:, -1]))
        line = f"  {variable.name:{width}} {variable.unit:{units}}  {sigma:<8.3g}  "
        shares = [(s, share) for s, share in found.variance_budget(variable.name).items() if share > 0][:3]
        lines.append((line + ", ".join(f"{s} {format_percentage(share)}" for s, share in shares)).rstrip())
    lines.append("  sources: shares of the variance")
    return "\n".join(lines)


FROZEN_GAINS_MAX_NIS = 1e-2
"""Largest sum of normalised innovations squared over the nominal run at which filter gains are kept constant."""

_KINDS = {"command": "commands", "applied": "applied"}
"""Signals other than the errors, with their names in the log."""


@dataclass(frozen=True, eq=False)
class LinearCovariance(PrintableResult):
    """Covariances along a nominal run by source; see `linear_covariance`.

    A *signal* is the name of a state (its error), ``command(F)`` or ``applied(F)`` (mean over the step).

    Attributes
    ----------
    times : array (n_times,)
        Times, s; commands and applied controls have no value at the last one.
    sources : tuple of str
        Names of dispersions, then of blocks that draw random numbers.
    nominal : array (n_states, n_times)
        States of the nominal run, without dispersions and noise.
    mean : array (n_errors, n_times)
        Mean errors; nonzero for dispersions with nonzero mean.
    parts : mapping
        Covariances by source (n_sources, n_times, n, n) of "error", "command" and "applied".
    layouts : mapping
        Names, sizes and units: error, command, applied.
    compiled_loop : CompiledLoop
    dispersions : mapping of str to Dispersion

    Examples
    --------
    >>> scenario = go.Scenario(loop, x0=[1.0, 0.0], tf=8.0, dispersions=spread)
    >>> result = go.linear_covariance(scenario)
    >>> print({source: f"{share:.0%}" for source, share in result.variance_budget("q").items()})
    {'initial.q': '55%', 'gauge': '43%', 'initial.v': '1%'}
    """

    times: Array
    sources: tuple[str, ...]
    nominal: Array
    mean: Array
    parts: Mapping[str, Array]
    layouts: Mapping[str, Layout]
    compiled_loop: CompiledLoop
    dispersions: Dispersions

    def __str__(self) -> str:
        return format_covariance_table(self)

    def covariance(self, signal: str) -> Array:
        """Return the covariance of a signal over time, (n_times, size, size)."""
        return np.asarray(self.covariance_by_source(signal).sum(axis=0))

    def std(self, signal: str) -> Array:
        """Return the standard deviations (1 sigma) of a signal over time, (size, n_times)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance(signal), axis1=1, axis2=2).T, 0.0))

    def covariance_by_source(self, signal: str) -> Array:
        """Return the covariances of a signal due to each of `sources`, (n_sources, n_times, size, size)."""
        kind, name = self._parse_signal_name(signal)
        place = self.layouts[kind].slice(name)
        return self.parts[kind][:, :, place, place]

    def variance_budget(self, signal: str, at: float | None = None) -> dict[str, float]:
        """Return the share of each source in a signal's variance, in descending order.

        The variance is the trace of the covariance. The shares add up to 1, unless the variance is zero.

        Parameters
        ----------
        signal : str
        at : float, optional
            Time (s); the nearest logged one is used. Default: the last.
        """
        parts = self.covariance_by_source(signal)
        k = -1 if at is None else int(np.argmin(np.abs(self.times[: parts.shape[1]] - at)))
        traces = np.trace(parts[:, k], axis1=1, axis2=2)
        shares = traces / max(float(traces.sum()), TINY)
        order = np.argsort(-shares, kind="stable")
        return {self.sources[i]: float(shares[i]) for i in order}

    def _parse_signal_name(self, signal: str) -> tuple[str, str]:
        kind, _, rest = signal.partition("(") if isinstance(signal, str) else ("", "", "")
        name = rest[:-1] if rest.endswith(")") else ""
        if kind in _KINDS and name in self.layouts[kind]:
            return kind, name
        if signal in self.layouts["error"]:
            return "error", signal
        known = [*self.layouts["error"].names]
        known += [f"{kind}({name})" for kind in _KINDS for name in self.layouts[kind].names]
        raise unknown_name_error("signal", signal, "the linear covariance", known)


@limit_to_one_thread()
@suggest_keywords
def linear_covariance(scenario: Scenario, *, every: int = 1) -> LinearCovariance:
    """Return the covariances of a closed loop's errors along its nominal run, by source.

    Parameters
    ----------
    scenario : Scenario
        Its loop must have no events.
    every : int
        Store every n-th control step, and the last one.

    Raises
    ------
    ArgumentError, UnknownNameError
        Inconsistent arguments, a loop with events, or a derivative that is not finite; the message names the cause.

    Examples
    --------
    >>> scenario = go.Scenario(loop, x0=[1.0, 0.0], tf=8.0, dispersions=spread)
    >>> result = go.linear_covariance(scenario)
    >>> print(result.sources)
    ('initial.q', 'initial.v', 'gauge')
    >>> print(f"{1e3 * result.std('q')[0, -1]:.2f} mm at the end")
    0.26 mm at the end
    """
    require_type(scenario, Scenario, "the argument of linear_covariance()", "give a Scenario")
    every = read_integer(every, "the number of control steps of which one is kept", 1)
    loop, dispersions = scenario.compiled_loop, scenario.dispersions
    columns = [int(i) for name in dispersions for i in range(loop.layout.size)[loop.layout.slice(name)]]
    linearization = Linearization(loop, scenario.loop.wiring, columns)
    if linearization.sum_normalised_innovations_squared() <= FROZEN_GAINS_MAX_NIS:
        linearization = replace(linearization, hold=True)
    return _CovariancePropagation(linearization, dispersions, every).propagate_covariance()


class _CovariancePropagation:
    def __init__(self, linearization: Linearization, dispersions: Dispersions, every: int) -> None:
        self.linearization, self.compiled_loop = linearization, linearization.loop
        self.every, self.dispersions = every, dispersions
        layout, nominal = self.compiled_loop.layout, self.compiled_loop.nominal
        moments = {name: d.moments(nominal[layout.slice(name)]) for name, d in dispersions.items()}
        self.shift = np.concatenate([np.empty(0), *[mean for mean, _ in moments.values()]])
        numbers = linearization.noise_slices_by_block
        units = [np.eye(place.stop - place.start) for place in numbers.values()]
        self.sources = DeviationSources(
            (*moments, *numbers),
            (*(covariance for _, covariance in moments.values()), *units),
            tuple(numbers.values()),
        )
        self.values: dict[str, list[Array]] = {kind: [] for kind in ("state", *_KINDS)}
        self.covariances_by_source: dict[str, list[Array]] = {kind: [] for kind in ("error", *_KINDS)}
        self.mean: list[Array] = []

    def propagate_covariance(self) -> LinearCovariance:
        X, g, h = self.linearization.differentiate_initial_loop_state()
        scatter = StateDeviations.from_noise_and_parameter_jacobians(self.sources, g, h)
        for k, step in enumerate(self.linearization.linearize_control_steps(X)):
            first = k == 0
            if k % self.every == 0:
                self._store_state_covariance(X, scatter)
                self._store_output_covariances(
                    step.y, scatter.propagate_state_deviations(step.c, step.d, step.e, first=first)
                )
            scatter, X = scatter.propagate_state_deviations(step.a, step.g, step.h, first=first), step.X_next
        self._store_state_covariance(X, scatter)
        return self._build_linear_covariance()

    def _store_state_covariance(self, X: Array, scatter: StateDeviations) -> None:
        places = self.linearization.linearised_state_layout.split_vector_by_name(
            np.arange(scatter.state_dimension)
        )["plant"]
        x = self.compiled_loop.kernel.state.split_vector_by_name(X)["plant"]
        to_errors = np.zeros((self.compiled_loop.error_layout.size, scatter.state_dimension))
        to_errors[:, places] = self._state_error_jacobian(x).full()
        errors = scatter.transform_state_deviations_linearly(to_errors)
        self.values["state"].append(x)
        self.covariances_by_source["error"].append(errors.covariances_by_source)
        self.mean.append(errors.by_parameters[:, : self.shift.size] @ self.shift)

    def _store_output_covariances(self, y: Array, scatter: StateDeviations) -> None:
        values = self.linearization.linearised_output_layout.split_vector_by_name(y)
        places = self.linearization.linearised_output_layout.split_vector_by_name(np.eye(y.size))
        for kind, name in _KINDS.items():
            part = scatter.transform_state_deviations_linearly(places[name])
            self.values[kind].append(values[name])
            self.covariances_by_source[kind].append(part.covariances_by_source)

    @cached_property
    def _state_error_jacobian(self) -> Any:
        x, x_ref = (ca.SX.sym(n, self.compiled_loop.states.size) for n in ("x", "x_ref"))
        jacobian = ca.jacobian(self.compiled_loop.errors(x, x_ref), x)
        return ca.Function("by_x", [x_ref], [ca.substitute(jacobian, x, x_ref)])

    def _build_linear_covariance(self) -> LinearCovariance:
        loop = self.compiled_loop
        kept = np.append(np.arange(0, loop.n_steps, self.every), loop.n_steps)
        parts = {kind: np.stack(found, axis=1) for kind, found in self.covariances_by_source.items()}
        return LinearCovariance(
            times=loop.times[kept],
            sources=self.sources.names,
            nominal=np.stack(self.values["state"], axis=1),
            mean=np.stack(self.mean, axis=1),
            parts=parts,
            layouts={
                "error": loop.error_layout,
                "command": loop.commands,
                "applied": loop.controls,
            },
            compiled_loop=loop,
            dispersions=self.dispersions,
        )
