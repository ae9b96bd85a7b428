r"""Failure probability by subset simulation.

The probability of a rare failure is a product :math:`p = P(F_1) P(F_2 | F_1) \ldots` of conditional ones, where F_i is
exceeding the level that a tenth of the previous runs exceeded. Runs within a level are made from those that exceeded
the last one by a Markov chain over all standard normal numbers of a run (`Scenario`), dispersions and noise alike,

.. math:: z' = \sqrt{1 - s^2}\, z + s\, \xi, \qquad \xi \sim N(0, 1),

taken if its run exceeds the level as well; s is adapted from level to level. As runs of a chain and levels are
dependent, the whole is repeated independently, and the interval is that of Student's t over the repetitions.

Sources: S.-K. Au, J. L. Beck, Estimation of small failure probabilities in high dimensions by subset
simulation, Probabilistic Engineering Mechanics 16 (2001). I. Papaioannou, W. Betz, K. Zwirglmaier, D. Straub,
MCMC algorithms for subset simulation, Probabilistic Engineering Mechanics 41 (2015), section 3.4.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy

from gnc_opt.analysis.scenario import Scenario, all_answers
from gnc_opt.arguments import expect, read_integer, read_numbers, read_probability, suggesting_keywords
from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError, GncOptError
from gnc_opt.simulation.confidence_intervals import CONFIDENCE, pass_rate
from gnc_opt.text import Printed

LEVEL_EXCEEDANCE_SHARE = 0.1
"""Share of the runs of a level that exceed the next one."""

MOST_LEVELS = 12
"""Most levels: beyond them failures are rarer than 1e-12, below the accuracy of any dispersion model."""

_STEP = 0.6
"""First standard deviation s of the chains' steps."""

_ACCEPTED = 0.44
"""Share of accepted steps that is aimed at."""

Value = Callable[[Array], Array]
"""A measure (n,) of standard normal numbers (n_numbers, n)."""


@dataclass(frozen=True, eq=False)
class FailureProbability(Printed):
    """How probable it is that a run fails or a measure exceeds its limit; see `failure_probability`.

    Attributes
    ----------
    measure : str
    limit : float
    probability : float
        Mean of the repetitions.
    low, high : float
        Interval with ``confidence``: Student's t on the logarithmic scale, or that of Clopper and Pearson.
    confidence : float
    estimates : array (repetitions,)
    levels : array (n_levels,)
        Of the first repetition, the limit last.
    runs : int

    Examples
    --------
    >>> scenario = go.Scenario(loop, x0=[1.0, 0.0], tf=8.0, dispersions=spread)
    >>> asked = {"n": 50, "repetitions": 3, "executor": "serial"}
    >>> print(failure_probability(scenario, "max(overshoot)", 0.006, **asked))
    P(max(overshoot) > 0.006) = 0.000229 (3e-05 to 0.0017, 95 %), 638 runs in 3 repetitions
    """

    measure: str
    limit: float
    probability: float
    low: float
    high: float
    confidence: float
    estimates: Array
    levels: Array
    runs: int

    def __str__(self) -> str:
        return (
            f"P({self.measure} > {self.limit:g}) = {self.probability:.3g} ({self.low:.2g} to {self.high:.2g}, "
            f"{100 * self.confidence:g} %), {self.runs} runs in {self.estimates.size} repetitions"
        )


@suggesting_keywords
def failure_probability(
    scenario: Scenario,
    measure: str,
    limit: float,
    *,
    n: int = 500,
    repetitions: int = 10,
    confidence: float = CONFIDENCE,
    executor: Executor | Literal["serial"] | None = None,
) -> FailureProbability:
    """Return the estimated probability that a run is not OK or a measure exceeds its limit, however rare.

    It takes about ``repetitions * n * log10(1 / p)`` runs to know the probability p to some 20 %.

    Parameters
    ----------
    scenario : Scenario
        The draws include the noise.
    measure : str
        As in `Campaign.measure`, or one of the scenario's ``measures``.
    limit : float
        Largest permitted value.
    n : int
        Runs of a level, a multiple of ten.
    repetitions : int
        Independent ones, at least 3.
    confidence : float
        Of the interval, in (0, 1).
    executor : concurrent.futures.Executor or "serial", optional
        As in `monte_carlo`.

    Raises
    ------
    ArgumentError, UnknownNameError
        Something does not fit; the message names it.
    GncOptError
        Failures are rarer than one in 10^12 or there are none, or a repetition could not be simulated.

    Examples
    --------
    >>> scenario = go.Scenario(loop, x0=[1.0, 0.0], tf=8.0, dispersions=spread)
    >>> asked = {"n": 50, "repetitions": 3, "executor": "serial"}
    >>> rare = failure_probability(scenario, "max(overshoot)", 0.006, **asked)
    >>> print(rare.low < rare.probability < rare.high, rare.runs)
    True 638
    """
    name = "failure_probability()"
    expect(scenario, Scenario, f"what {name} got", "give a Scenario")
    scenario.require(measure)
    bound = float(read_numbers(limit, f"the limit of '{measure}'").reshape(-1)[0])
    if not np.isfinite(bound):
        raise ArgumentError(f"the limit of '{measure}' is {bound:g}: give a finite number.")
    count = read_integer(n, f"the number of runs of a level of {name}", 10)
    if count % round(1 / LEVEL_EXCEEDANCE_SHARE):
        raise ArgumentError(
            f"a level of {name} has {count} runs: give a multiple of {round(1 / LEVEL_EXCEEDANCE_SHARE)}."
        )
    repetitions = read_integer(repetitions, f"the number of repetitions of {name}", 3)
    confidence = read_probability(confidence, f"the confidence of {name}")
    search = _Search(scenario, measure, bound, count)
    answers = all_answers(search, _Search.repetition, range(repetitions), executor, name)
    estimates = np.array([answer.probability for answer in answers])
    if not np.all(estimates > 0):
        largest = max(float(answer.levels[-1]) for answer in answers)
        raise GncOptError(
            f"'{measure}' exceeds {bound!r} less often than once in 10^{MOST_LEVELS} runs, or never: the largest value "
            f"found is {largest!r}; give a limit within reach."
        )
    mean, low, high = repeated_mean(estimates, confidence)
    if all(answer.levels.size == 1 for answer in answers):  # no chains: all runs are independent
        counted = pass_rate(round(float(estimates.sum()) * count), repetitions * count, confidence)
        low, high = counted.low, counted.high
    return FailureProbability(
        measure,
        bound,
        mean,
        low,
        high,
        confidence,
        estimates,
        answers[0].levels,
        sum(a.runs for a in answers),
    )


def repeated_mean(estimates: Array, confidence: float) -> tuple[float, float, float]:
    """Return the mean of independent estimates > 0 and its interval, by Student's t on the logarithmic scale."""
    n, mean = estimates.size, float(estimates.mean())
    share = float(estimates.std(ddof=1)) / (mean * np.sqrt(n))
    factor = float(np.exp(scipy.stats.t.ppf(0.5 + confidence / 2, n - 1) * share))
    return mean, mean / factor, min(mean * factor, 1.0)


@dataclass(frozen=True, eq=False)
class Estimate:
    """One subset simulation; probability 0 if the limit was not reached."""

    probability: float
    levels: Array
    runs: int


@dataclass(frozen=True, eq=False)
class _Search:
    """Common data of all repetitions."""

    scenario: Scenario
    measure: str
    limit: float
    count: int

    def repetition(self, index: int) -> Estimate:
        """Return the estimate of a repetition."""
        generator = np.random.Generator(np.random.Philox(np.random.SeedSequence([self.scenario.seed, index])))
        noise = self.scenario.flight.n_steps * self.scenario.noise_size
        return subset_simulation(self.value, self.scenario.size + noise, self.limit, self.count, generator)

    def value(self, z: Array) -> Array:
        size = self.scenario.size
        shape = (self.scenario.flight.n_steps, self.scenario.noise_size)
        numbers: list[Any] = [column.reshape(shape) for column in z[size:].T]
        return self.scenario.values(self.measure, self.scenario.columns(z[:size]), numbers)


def subset_simulation(
    value: Value, size: int, limit: float, count: int, generator: np.random.Generator
) -> Estimate:
    """Estimate the probability that ``value`` of ``size`` standard normal numbers exceeds a limit."""
    z = generator.standard_normal((size, count))
    y = value(z)
    probability, step, runs = 1.0, _STEP, count
    levels: list[float] = []
    for _ in range(MOST_LEVELS):
        level = float(np.sort(y)[-round(LEVEL_EXCEEDANCE_SHARE * count)])
        if level > limit:
            break
        above = y >= level
        if np.all(above):  # a plateau: nothing leads on from here
            return Estimate(0.0, np.array([*levels, level]), runs)
        probability *= float(np.mean(above))
        levels.append(level)
        z, y, accepted = _chains(value, z[:, above], y[above], level, count, step, generator)
        runs += count - int(np.sum(above))
        step = float(np.clip(step * np.exp(accepted - _ACCEPTED), 0.05, 1.0))
    share = float(np.mean(y > limit))
    return Estimate(probability * share, np.array([*levels, limit if share > 0 else float(np.max(y))]), runs)


def _chains(
    value: Value, z: Array, y: Array, level: float, count: int, step: float, generator: np.random.Generator
) -> tuple[Array, Array, float]:
    """Return ``count`` columns above a level, from those that are, their values, and the share of accepted steps."""
    found_z, found_y, taken, tried = [z], [y], 0, 0
    while sum(part.size for part in found_y) < count:
        moved = np.sqrt(1 - step**2) * z + step * generator.standard_normal(z.shape)
        values = value(moved)
        better = values >= level
        z, y = np.where(better, moved, z), np.where(better, values, y)
        taken, tried = taken + int(np.sum(better)), tried + better.size
        found_z.append(z)
        found_y.append(y)
    return np.hstack(found_z)[:, :count], np.concatenate(found_y)[:count], taken / max(tried, 1)
