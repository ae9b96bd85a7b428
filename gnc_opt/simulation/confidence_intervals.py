"""Distribution-free confidence intervals of pass rates and percentiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_float_array, read_integer, read_probability
from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.numerical_tolerances import EQUAL
from gnc_opt.text_html_and_json_formatting import format_percentage

CONFIDENCE = 0.95
"""Default confidence of all intervals."""


@dataclass(frozen=True)
class PassRate:
    """Share of n runs that passed, with its confidence interval.

    Attributes
    ----------
    low, high : float
        Confidence interval of the true rate, at least at ``confidence``.
    """

    passed: int
    runs: int
    low: float
    high: float
    confidence: float

    @property
    def rate(self) -> float:
        """Pass rate of the sample."""
        return self.passed / self.runs

    def __str__(self) -> str:
        return f"{format_percentage(self.rate)} ({format_percentage(self.low)} to {format_percentage(self.high)})"


@dataclass(frozen=True)
class Percentile:
    """Percentile of a sample, with its confidence interval.

    Attributes
    ----------
    level : float
        In (0, 1).
    value : float
        Sample percentile, a member of the sample.
    low, high : float
        Confidence interval of the true percentile, at least at ``confidence``; infinite for small samples.
    """

    level: float
    value: float
    low: float
    high: float
    confidence: float


def estimate_pass_rate(passed: int, runs: int, confidence: float = CONFIDENCE) -> PassRate:
    """Return a pass rate with its Clopper-Pearson interval.

    Raises
    ------
    ArgumentError
        No runs, more passed than total runs, or a confidence outside (0, 1).
    """
    runs = read_integer(runs, "the number of runs", 1)
    passed = read_integer(passed, "the number of runs passed", 0)
    if passed > runs:
        raise ArgumentError(f"{passed} of {runs} runs cannot have passed: correct the counts.")
    interval = scipy.stats.binomtest(passed, runs).proportion_ci(
        read_probability(confidence, "the confidence"), method="exact"
    )
    return PassRate(passed, runs, float(interval.low), float(interval.high), confidence)


def estimate_percentile(values: ArrayLike, level: float, confidence: float = CONFIDENCE) -> Percentile:
    r"""Return a percentile with a confidence interval between order statistics.

    Of n sorted values the number below the true percentile has the binomial distribution (n, level) for any continuous
    distribution, so that :math:`P(x_{(l)} \le q < x_{(u)}) = \sum_{k=l}^{u-1} \binom{n}{k} p^k (1-p)^{n-k}`.

    Parameters
    ----------
    values : array (n,)
        NaN counts as infinite.
    level, confidence : float
        In (0, 1).

    References
    ----------
    H. A. David, H. N. Nagaraja, Order Statistics, 3rd ed., Wiley (2003), section 7.1.
    """
    ordered = _sort_with_nan_last(values)
    p = read_probability(level, "the level of a percentile")
    alpha = 1 - read_probability(confidence, "the confidence")
    n = ordered.size
    lower = int(scipy.stats.binom.ppf(alpha / 2, n, p))
    upper = int(scipy.stats.binom.ppf(1 - alpha / 2, n, p)) + 1
    return Percentile(
        level,
        float(ordered[max(int(np.ceil(n * p - EQUAL)), 1) - 1]),
        float(ordered[lower - 1]) if lower >= 1 else -np.inf,
        float(ordered[upper - 1]) if upper <= n else np.inf,
        confidence,
    )


def share_below_maximum(runs: int, confidence: float = CONFIDENCE) -> float:
    r"""Return the share of all possible runs below the largest of n runs, at the given confidence.

    :math:`\alpha^{1/n}`, :math:`\alpha = 1 - \text{confidence}`; n = 59 gives 95 % (Wilks).
    """
    runs = read_integer(runs, "the number of runs", 1)
    return float((1 - read_probability(confidence, "the confidence")) ** (1 / runs))


def _sort_with_nan_last(values: ArrayLike) -> Array:
    array = read_float_array(values, "the values of a percentile").ravel()
    if not array.size:
        raise ArgumentError("there are no values to take a percentile of: give some.")
    return np.sort(np.where(np.isnan(array), np.inf, array))
