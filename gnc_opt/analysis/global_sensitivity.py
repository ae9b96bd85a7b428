r"""Global sensitivity: shares of dispersions and noise in the variance of a measure (Sobol' indices).

*Sobol' indices* divide the variance V of a measure f among the factors, the dispersions and the noise. With rows of
two independent campaigns A and B, and A with one factor taken from B, :math:`AB_i`,

.. math::
    S_i = \frac{1}{V} \overline{f_B\,(f_{AB_i} - f_A)}, \qquad T_i = \frac{1}{2 V} \overline{(f_A - f_{AB_i})^2}:

the share of V that vanishes if factor i is known, and the share that remains if all other factors are known. Confidence
intervals are bootstrap percentiles.

Source: A. Saltelli et al., Variance based sensitivity analysis of model output, Computer Physics
Communications 181 (2010), table 2.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gnc_opt.analysis.dispersed_closed_loop_scenario import Scenario, run_tasks_in_workers
from gnc_opt.argument_checks import read_integer, read_probability, require_type, suggest_keywords
from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError, GncOptError
from gnc_opt.simulation.campaign_batches_and_checkpoints import BATCH_MAX_RUNS
from gnc_opt.simulation.confidence_intervals import CONFIDENCE
from gnc_opt.simulation.dispersions import draw_dispersed_parameters
from gnc_opt.text_html_and_json_formatting import PrintableResult

NOISE = "noise"
"""Factor that contains all random numbers of the control steps."""

_RESAMPLED = 1000
"""Number of bootstrap samples."""


@dataclass(frozen=True)
class IntervalEstimate(PrintableResult):
    """Estimate with its confidence interval.

    Attributes
    ----------
    value, low, high : float

    Examples
    --------
    >>> print(IntervalEstimate(0.5, 0.4, 0.6))
    0.500 (0.400 to 0.600)
    """

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.3f} ({self.low:.3f} to {self.high:.3f})"


@dataclass(frozen=True, eq=False, repr=False)
class SobolIndices(PrintableResult):
    """Sobol' indices of a measure; see `sobol_indices`.

    Attributes
    ----------
    measure : str
    mean, variance : float
    first, total : mapping of str to Share
        S and T by factor: names of the dispersions, and "noise".
    confidence : float
        Confidence of each interval.
    rows, lost : int
        Number of rows used, and of rows omitted because of a failed run.

    Examples
    --------
    >>> scenario = go.Scenario(loop, x0=[1.0, 0.0], tf=3.0, dispersions=spread)
    >>> shares = sobol_indices(scenario, "max(overshoot)", n=20, executor="serial")
    >>> print(tuple(shares.first), shares.rows, f"{shares.mean:.2f}")
    ('initial.q', 'initial.v', 'noise') 20 -0.13
    """

    measure: str
    mean: float
    variance: float
    first: Mapping[str, IntervalEstimate]
    total: Mapping[str, IntervalEstimate]
    confidence: float
    rows: int
    lost: int

    def __str__(self) -> str:
        width = max(map(len, self.total))
        lines = [
            f"variance of '{self.measure}' (mean {self.mean:.4g}, standard deviation {np.sqrt(self.variance):.3g})",
            f"  {'':{width}}  first order              total",
        ]
        for name in sorted(self.total, key=lambda n: -self.total[n].value):
            lines.append(f"  {name:{width}}  {self.first[name]!s:23}  {self.total[name]}")
        without = f", {self.lost} omitted because of failed runs" if self.lost else ""
        lines.append(f"  {self.rows} rows{without}; intervals: {100 * self.confidence:g} %")
        return "\n".join(lines)


@suggest_keywords
def sobol_indices(
    scenario: Scenario,
    measure: str,
    *,
    n: int = 500,
    confidence: float = CONFIDENCE,
    executor: Executor | Literal["serial"] | None = None,
) -> SobolIndices:
    """Return the Sobol' indices of a measure: shares of dispersions and noise in its variance.

    Parameters
    ----------
    scenario : Scenario
        A dispersed vector is one factor.
    measure : str
        As in `Campaign.measure`, or one of the scenario's ``measures``.
    n : int
        Number of rows; a row takes two runs plus one per factor.
    confidence : float
        Confidence of each interval, in (0, 1).
    executor : concurrent.futures.Executor or "serial", optional
        As in `monte_carlo`.

    Raises
    ------
    ArgumentError, UnknownNameError
        Inconsistent arguments, or a measure that does not vary; the message names the cause.
    GncOptError
        The runs could not be simulated, or nearly every row contains a failed run.

    Examples
    --------
    >>> scenario = go.Scenario(loop, x0=[1.0, 0.0], tf=3.0, dispersions=spread)
    >>> shares = sobol_indices(scenario, "max(overshoot)", n=20, executor="serial")
    >>> print(max(shares.total, key=lambda name: shares.total[name].value))
    initial.q
    """
    name = "sobol_indices()"
    require_type(scenario, Scenario, f"the argument of {name}", "give a Scenario")
    scenario.check_performance_measure_name(measure)
    count = read_integer(n, f"the number of rows of {name}", 10)
    level = read_probability(confidence, f"the confidence of {name}")
    design = _SobolDesign(scenario, measure)
    chunks = [range(k, min(k + BATCH_MAX_RUNS, count)) for k in range(0, count, BATCH_MAX_RUNS)]
    f = np.hstack(
        run_tasks_in_workers(design, _SobolDesign.simulate_sobol_sample_matrices, chunks, executor, name)
    )
    usable = np.isfinite(f).all(axis=0)
    if np.sum(usable) < max(10, count // 2):
        raise GncOptError(
            f"of {count} rows {count - np.sum(usable)} have a failed run: reduce the dispersions."
        )
    return _bootstrap_sobol_indices(
        measure, design.dispersed_factor_names, f[:, usable], count, level, scenario.seed
    )


def _bootstrap_sobol_indices(
    measure: str, factors: tuple[str, ...], f: Array, asked: int, level: float, seed: int
) -> SobolIndices:
    mean, variance = float(f[:2].mean()), float(f[:2].var())
    if not variance > (np.finfo(float).eps * mean) ** 2:
        raise ArgumentError(f"'{measure}' does not vary: add a dispersion that affects it.")
    first, total = estimate_sobol_indices(f)
    rows = f.shape[1]
    generator = np.random.default_rng([seed, rows])
    again = [estimate_sobol_indices(f[:, generator.integers(rows, size=rows)]) for _ in range(_RESAMPLED)]
    ends = np.quantile(np.array(again), [0.5 - level / 2, 0.5 + level / 2], axis=0)  # (2, 2, n_factors)

    def estimate_bootstrap_intervals(values: Array, which: int) -> dict[str, IntervalEstimate]:
        return {
            name: IntervalEstimate(float(values[i]), float(ends[0, which, i]), float(ends[1, which, i]))
            for i, name in enumerate(factors)
        }

    return SobolIndices(
        measure,
        mean,
        variance,
        estimate_bootstrap_intervals(first, 0),
        estimate_bootstrap_intervals(total, 1),
        level,
        rows,
        asked - rows,
    )


def estimate_sobol_indices(f: Array) -> tuple[Array, Array]:
    """Return S and T (n_factors,) from values (2 + n_factors, n_rows) of A, B and AB_i."""
    centred = f - f[:2].mean()
    a, b, mixed = centred[0], centred[1], centred[2:]
    variance = centred[:2].var()
    return (b * (mixed - a)).mean(axis=1) / variance, ((a - mixed) ** 2).mean(axis=1) / (2 * variance)


@dataclass(frozen=True, eq=False)
class _SobolDesign:
    scenario: Scenario
    measure: str

    @property
    def dispersed_factor_names(self) -> tuple[str, ...]:
        noise = (NOISE,) if self.scenario.noise_size else ()
        return (*self.scenario.dispersions, *noise)

    def simulate_sobol_sample_matrices(self, rows: range) -> Array:
        """Return the values (2 + n_factors, n_rows) of A, B and AB_i; infinite for failed runs."""
        loop, dispersions = self.scenario.compiled_loop, self.scenario.dispersions
        a, b = (
            np.stack(
                [draw_dispersed_parameters(dispersions, loop.layout, loop.nominal, s, i) for i in rows],
                axis=1,
            )
            for s in (2 * self.scenario.seed, 2 * self.scenario.seed + 1)
        )
        numbers = [[[2 * self.scenario.seed + k, i] for i in rows] for k in (0, 1)]
        found = [
            self._simulate_performance_measures(a, numbers[0]),
            self._simulate_performance_measures(b, numbers[1]),
        ]
        for name in dispersions:
            mixed, place = a.copy(), loop.layout.slice(name)
            mixed[place] = b[place]
            found.append(self._simulate_performance_measures(mixed, numbers[0]))
        if self.scenario.noise_size:
            found.append(self._simulate_performance_measures(a, numbers[1]))
        return np.stack(found)

    def _simulate_performance_measures(self, P: Array, seeds: list[list[int]]) -> Array:
        return self.scenario.compute_performance_measure(self.measure, P, seeds)
