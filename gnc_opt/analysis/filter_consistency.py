r"""Filter consistency: comparison of estimation errors and innovations with their covariances.

For a consistent linear filter the normalised estimation error squared, :math:`\text{NEES} = e^T P^{-1} e`, is
chi-square distributed with as many degrees of freedom as e has components. The same holds for the normalised innovation
squared (NIS) with m components. After a gate at :math:`c`

.. math:: E = m \frac{F_{m+2}(c)}{F_m(c)}, \qquad E^{(2)} = m (m + 2) \frac{F_{m+4}(c)}{F_m(c)},

with the distribution function :math:`F_k` of chi-square with k degrees of freedom. The interval of the mean is that of
a scaled chi-square distribution with this mean and variance. Estimation errors are independent only between runs.

Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 5.4.2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from gnc_opt.argument_checks import StrictAttributes, read_probability, require_type
from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.estimation.estimator_and_output_feedback import Estimator
from gnc_opt.numerical_tolerances import ROUNDING
from gnc_opt.simulation.campaign_results import Campaign
from gnc_opt.simulation.simulation_run_results import Run
from gnc_opt.text_html_and_json_formatting import PrintableResult

Band = tuple[float, float]


@dataclass(frozen=True)
class InnovationTest(StrictAttributes):
    """Consistency test of the innovations of one measurement.

    Attributes
    ----------
    average : float
        Mean NIS of the accepted samples over all runs; NaN without samples.
    band : tuple of two floats
        Interval of the mean for a consistent filter, at the requested confidence.
    taken, refused : int

    Examples
    --------
    >>> test = InnovationTest(average=0.9, band=(0.7, 1.3), taken=80, refused=0)
    >>> print(test.ok)
    True
    """

    average: float
    band: Band
    taken: int
    refused: int

    @property
    def ok(self) -> bool:
        """Whether the mean is within its band."""
        return self.band[0] <= self.average <= self.band[1]


@dataclass(frozen=True, repr=False)
class Consistency(PrintableResult):
    """Consistency test of an estimator's errors and innovations.

    Attributes
    ----------
    nees : array (n_times,) or (m,)
        NEES of the predictions of a run, or at the ends of m runs; NaN for runs without such an end.
    average : float
    band : tuple of two floats
        Interval for a consistent filter at the requested confidence, of the mean (campaign) or of each value (run).
    components : int
        Number of error components, the expected mean.
    independent : bool
        Whether the values of ``nees`` are independent (campaigns).
    confidence : float
    innovations : mapping of str to InnovationTest
        Test of each measurement's innovations.

    Examples
    --------
    >>> test = InnovationTest(average=0.9, band=(0.7, 1.3), taken=80, refused=0)
    >>> result = Consistency(np.array([1.9, 2.2]), 2.05, (0.1, 5.6), 2, True, 0.95, {"q": test})
    >>> print(result.ok)
    True
    """

    nees: Array
    average: float
    band: Band
    components: int
    independent: bool
    confidence: float
    innovations: Mapping[str, InnovationTest]

    @property
    def ok(self) -> bool:
        """Whether all means are within their intervals; for a run, those of the innovations only."""
        inside = not self.independent or self.band[0] <= self.average <= self.band[1]
        return inside and all(test.ok for test in self.innovations.values())

    @property
    def share_within(self) -> float:
        """Share of the values of ``nees`` within the interval of single values; expected: the confidence."""
        low, high = _compute_chi_square_interval(self.components, 1, self.confidence)
        known = self.nees[np.isfinite(self.nees)]
        return float(np.mean((known >= low) & (known <= high))) if known.size else float("nan")

    def __str__(self) -> str:
        low, high, share = *self.band, 100 * self.share_within
        where = "mean over the runs" if self.independent else "mean over the run, band of single values"
        lines = [f"NEES {self.average:.4g}, {low:.4g} to {high:.4g} expected ({where}; {share:.1f} % within)"]
        for name, test in self.innovations.items():
            if not test.taken:
                lines.append(f"NIS of {name}: no sample taken ({test.refused} refused)")
                continue
            low, high = test.band
            lines.append(
                f"NIS of {name} {test.average:.4g}, {low:.4g} to {high:.4g} expected "
                f"({test.taken} samples, {test.refused} refused)"
            )
        return "\n".join([*lines, f"bands: {100 * self.confidence:g} %"])


def consistency(flown: Run | Campaign, estimator: Estimator, *, confidence: float = 0.95) -> Consistency:
    """Return the consistency of an estimator's errors and innovations with its covariances.

    Parameters
    ----------
    flown : Run or Campaign
        Run or campaign of a loop with this estimator.
    estimator : Estimator
    confidence : float
        In (0, 1).

    Raises
    ------
    ArgumentError
        The loop has another estimator, the plant has none of its states, or a state is known exactly.

    Examples
    --------
    >>> from gnc_opt.estimation import Measurement
    >>> ekf = go.design_ekf(cart, [1, 0], [Measurement("q", 1e-3)], sigma0={"q": 0.1, "v": 0.02}, dt=0.1)
    >>> filtered = go.ClosedLoop(cart, go.output_feedback(regulator, ekf), sensors=loop.sensors)
    >>> result = consistency(filtered.simulate([1.05, 0.01], tf=8.0), ekf)
    >>> share = f"{result.share_within:.0%} within {np.round(result.band, 2)}"
    >>> print(result.nees.shape, share, result.innovations["q"].ok)
    (81,) 91% within [0.05 7.38] True
    """
    require_type(estimator, Estimator, "the estimator of consistency()", "give the estimator of the loop")
    level = read_probability(confidence, "the confidence of consistency()")
    if not isinstance(flown, (Run, Campaign)):
        require_type(flown, Run, "the runs of consistency()", "give a run or a campaign")
    layout = flown.layouts.get("memory")
    missing = [
        v.name
        for v in estimator.memory.variables
        if layout is None or v.name not in layout or layout[v.name].size != v.size
    ]
    if missing or layout is None or not flown.memory.size:
        raise ArgumentError(
            f"the memory of the loop has no '{missing[0] if missing else 'state'}' of estimator '{estimator.name}'."
        )
    memory = np.vstack([flown.memory[layout.slice(name)] for name in estimator.memory.names])
    independent = isinstance(flown, Campaign)
    nees, components = _compute_nees(flown, estimator, memory)
    known = nees[np.isfinite(nees)]
    ends = memory if independent else memory[:, -1:]
    return Consistency(
        nees=nees,
        average=float(np.mean(known)) if known.size else float("nan"),
        band=_compute_chi_square_interval(components, known.size if independent else 1, level),
        components=components,
        independent=independent,
        confidence=level,
        innovations={
            name: _test_innovation_consistency(estimator, name, ends, level) for name in estimator.sizes
        },
    )


def _compute_nees(runs: Run | Campaign, estimator: Estimator, memory: Array) -> tuple[Array, int]:
    there = runs.layouts["state"]
    shared = [name for name in estimator.states.names if name in there]
    if not shared:
        raise ArgumentError(
            f"the plant has no state that '{estimator.name}' estimates: there is nothing to compare with."
        )
    estimate = estimator.estimate(memory)
    truth = estimate.copy()
    for name in shared:
        truth[estimator.states.slice(name)] = runs.states[there.slice(name)]
    rows = np.concatenate([np.r_[estimator.errors.slice(name)] for name in shared])
    errors = np.asarray(estimator.error(truth, estimate).full())[rows]
    P = estimator.covariance(memory)[:, rows][:, :, rows]
    sigma = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    # variances at the rounding level of the states are not tested
    least = np.concatenate([
        np.tile(ROUNDING * np.max(np.abs(truth[estimator.states.slice(name)]), axis=0), (size, 1))
        for name, size in ((name, estimator.errors[name].size) for name in shared)
    ])  # fmt: skip
    exact = sigma <= np.nan_to_num(least.T, posinf=0.0)
    if np.any(exact):
        label = estimator.errors.labels[rows[int(np.flatnonzero(np.any(exact, axis=0))[0])]]
        raise ArgumentError(
            f"'{estimator.name}' treats '{label}' as exactly known (variance at rounding level): give sigma0 > 0, and "
            "process_noise if it decays."
        )
    found = np.full(errors.shape[1], np.nan)
    good = np.all(np.isfinite(errors), axis=0) & np.all(np.isfinite(P), axis=(1, 2))
    scaled = errors.T[good] / sigma[good]
    correlation = P[good] / (sigma[good][:, :, None] * sigma[good][:, None, :])
    found[good] = np.sum(scaled * np.linalg.solve(correlation, scaled[:, :, None])[:, :, 0], axis=1)
    return found, rows.size


def _test_innovation_consistency(
    estimator: Estimator, name: str, ends: Array, confidence: float
) -> InnovationTest:
    total, taken, refused = (
        float(np.nansum(ends[estimator.memory.slice(f"{name}_{what}")]))
        for what in ("nis", "taken", "refused")
    )
    return InnovationTest(
        average=total / taken if taken else float("nan"),
        band=_compute_chi_square_interval(
            estimator.sizes[name], int(taken), confidence, estimator.gates.get(name)
        ),
        taken=int(taken),
        refused=int(refused),
    )


def _compute_chi_square_interval(
    components: int, values: int, confidence: float, gate: float | None = None
) -> Band:
    """Return the equal-tailed interval of the mean of independent (gated) chi-square values."""
    if values < 1:
        return float("nan"), float("nan")
    mean, freedom = (
        (components, components) if gate is None else _fit_scaled_chi_square_to_gated_nis(components, gate)
    )
    tails = [0.5 - confidence / 2, 0.5 + confidence / 2]
    low, high = scipy.stats.chi2.ppf(tails, freedom * values).tolist()
    return mean * low / (freedom * values), mean * high / (freedom * values)


def _fit_scaled_chi_square_to_gated_nis(components: int, gate: float) -> tuple[float, float]:
    """Return the mean of a gated chi-square value, and the degrees of freedom of the equivalent scaled chi-square."""
    half, limit = components / 2, float(scipy.stats.chi2.ppf(gate, components)) / 2
    first, second = (float(scipy.special.gammainc(half + k, limit)) / gate for k in (1, 2))
    mean = components * first
    return mean, 2 * mean**2 / (components * (components + 2) * second - mean**2)
