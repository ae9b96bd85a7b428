"""Agreement: the ends of a campaign's runs beside a predicted mean and variance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from gnc_opt.arguments import expect, read_positive
from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.simulation.campaign import Campaign
from gnc_opt.simulation.dispersion import Dispersions, dispersed
from gnc_opt.simulation.flight import Flight
from gnc_opt.tolerances import ROUNDING

_LEAST_KURTOSIS = 1.01
"""Of a sample; two values that are equally frequent have 1, and their variance is known at once."""

_REDRAWN = 20
"""Runs whose parameters are drawn again: few values could be the same by chance."""


@dataclass(frozen=True, eq=False)
class Agreement:
    """A campaign beside linear covariances; arrays have an entry per component of the errors.

    Attributes
    ----------
    labels : tuple of str
        The components that scatter.
    runs : int
        That ended with finite numbers.
    ratio : array (n,)
        Variance of the runs over that predicted.
    band : array (2, n)
        Where the ratio should be: quantiles of chi-square, over their degrees of freedom, which are 2 / (kurtosis - 1)
        per run, by the kurtosis of the sample (one per run for normal errors).
    shift : array (n,)
        Mean of the runs less that predicted, in standard deviations of such a mean.
    shift_limit : float
        Largest shift to be expected.
    confidence : float
        Of all bands together (Bonferroni).

    Examples
    --------
    >>> experiment = go.Experiment(loop, x0=[1.0, 0.0], tf=8.0, dispersions=spread)
    >>> told = go.linear_covariance(experiment, checks=0)
    >>> agreement = told.compare(campaign)
    >>> print(agreement.labels, agreement.runs, agreement.ok)
    ('q', 'v') 20 True
    """

    labels: tuple[str, ...]
    runs: int
    ratio: Array
    band: Array
    shift: Array
    shift_limit: float
    confidence: float

    @property
    def within(self) -> Array:
        """Whether each component's variance and mean are within their bands, bool array (n,)."""
        inside = (self.band[0] <= self.ratio) & (self.ratio <= self.band[1])
        return np.asarray(inside & (np.abs(self.shift) <= self.shift_limit))

    @property
    def ok(self) -> bool:
        """Whether all are."""
        return bool(np.all(self.within))

    def __str__(self) -> str:
        width = max([9, *map(len, self.labels)])
        lines = [
            f"{self.runs} runs beside the linear covariance ({100 * self.confidence:g} % for all bands together)"
        ]
        lines.append(f"  {'':{width}}  variance ratio  band              mean shift")
        for i, label in enumerate(self.labels):
            low, high = self.band[:, i]
            lines.append(
                f"  {label:{width}}  {self.ratio[i]:<14.4f}  {low:.4f} to {high:.4f}  {self.shift[i]:+.2f} "
                f"(of {self.shift_limit:.2f})  {'within' if self.within[i] else 'OUTSIDE'}"
            )
        return "\n".join(lines)


def agreement(
    flight: Flight,
    dispersions: Dispersions,
    nominal: Array,
    predicted: tuple[Array, Array],
    campaign: Campaign,
    confidence: float,
) -> Agreement:
    """Return how the ends of runs agree with the mean and variance (n_errors,) predicted about a nominal end."""
    expect(campaign, Campaign, "what compare() got", "give what monte_carlo() returned")
    level = read_positive(confidence, "the confidence of compare()")
    if level >= 1:
        raise ArgumentError(f"the confidence of compare() is {level:g}: give a number in (0, 1).")
    if campaign.fingerprint != flight.fingerprint:
        raise ArgumentError(
            "the campaign flew another loop or span than the linear covariance is of: fly the same."
        )
    _require_same(dispersions, flight, campaign)
    ends = campaign.states[:, np.isfinite(campaign.states).all(axis=0)]
    runs = ends.shape[1]
    if runs < 2:
        raise ArgumentError(f"{runs} runs of the campaign ended with finite numbers: fly at least two.")
    errors = np.asarray(flight.errors(ends, np.repeat(nominal[:, None], runs, axis=1)).full())
    mean, variance = predicted
    # what scatters by no more than the integration errs is fixed
    erring = float(np.median(np.fmin(campaign.integration_error, flight.accuracy))) + ROUNDING
    scatters = np.flatnonzero(variance > (erring * error_sizes(flight, nominal[:, None])) ** 2)
    errors, mean, variance = errors[scatters], mean[scatters], variance[scatters]
    kurtosis = np.maximum(scipy.stats.kurtosis(errors, axis=1, fisher=False), _LEAST_KURTOSIS)
    freedom = 2 * (runs - 1) / (kurtosis - 1)
    tail = (1 - level) / (4 * max(scatters.size, 1))  # two bands per component, two ends each
    return Agreement(
        labels=tuple(flight.error_layout.labels[i] for i in scatters),
        runs=runs,
        ratio=errors.var(axis=1, ddof=1) / variance,
        band=np.stack([scipy.stats.chi2.ppf(p, freedom) / freedom for p in (tail, 1 - tail)]),
        shift=(errors.mean(axis=1) - mean) / np.sqrt(variance / runs),
        shift_limit=float(-scipy.special.ndtri(tail)),
        confidence=level,
    )


def magnitudes(values: Array) -> Array:
    """Return what errors of integration are relative to, (n,), by values over time (n, n_times): 1 or their size."""
    return np.asarray(np.maximum(1.0, np.max(np.abs(values), axis=1)))


def error_sizes(flight: Flight, states: Array) -> Array:
    """Return the same of each component of the errors, (n_errors,), by states over time (n_states, n_times)."""
    sizes, places = magnitudes(states), flight.states
    return np.concatenate(
        [
            np.full(error.size, np.max(sizes[places.slice(error.name)]))
            for error in flight.error_layout.variables
        ]
    )


def _require_same(dispersions: Dispersions, flight: Flight, campaign: Campaign) -> None:
    """Refuse a campaign whose runs have drawn what these dispersions do not: they are drawn again."""
    names = flight.layout.names
    for index, drawn in zip(campaign.indices[:_REDRAWN], campaign.parameters.T[:_REDRAWN], strict=True):
        again = dispersed(dispersions, flight.layout, flight.nominal, campaign.seed, int(index))
        for name in names:
            place = flight.layout.slice(name)
            if not np.allclose(again[place], drawn[place], rtol=ROUNDING, atol=0.0, equal_nan=True):
                raise ArgumentError(
                    f"run {index} of the campaign has another '{name}' than the dispersions of the linear covariance "
                    "draw: give both the same dispersions, initial state and parameters."
                )
