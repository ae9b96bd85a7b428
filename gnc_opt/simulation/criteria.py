"""Criteria: what the runs of a campaign are compared with and measured by."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import read_mapping, read_positive
from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError, in_words
from gnc_opt.model.layout import as_vector
from gnc_opt.simulation.campaign import Campaign
from gnc_opt.simulation.flight import Flight

Judge = Callable[[Campaign], ArrayLike]
"""A measure of one's own: returns a number per run, (m,)."""


@dataclass(frozen=True)
class Criteria:
    """Target, limits and measures of one's own; see `monte_carlo`."""

    target: Mapping[str, ArrayLike] = field(default_factory=dict)
    limits: Mapping[str, float] = field(default_factory=dict)
    judge: Mapping[str, Judge] = field(default_factory=dict)

    def goal(self, flight: Flight) -> Array:
        """Return what states are compared with at the end (n_states,); not-a-number where there is nothing."""
        goal = np.full(flight.states.size, np.nan)
        if flight.reference is not None:
            for name in flight.followed.names:
                if name in flight.states:
                    goal[flight.states.slice(name)] = flight.reference[flight.followed.slice(name), -1]
        for name, value in self.target.items():
            place = flight.states.slice(name)
            numbers = as_vector(value, flight.states[name].size, f"the target of '{name}'", ArgumentError)
            if not np.all(np.isfinite(numbers)):
                raise ArgumentError(
                    f"the target of '{name}' is {numbers}: give finite numbers, or leave it out."
                )
            goal[place] = numbers
        return goal

    def check(self, empty: Campaign) -> None:
        """Refuse limits of measures that a campaign (without runs) does not have, and what is no limit or measure."""
        for name, value in self.limits.items():
            if name not in self.judge:
                empty.measure(name)
            _limit(name, value)
        for name, function in self.judge.items():
            if name in empty.measures:
                raise ArgumentError(f"the campaign has a measure '{name}' already: give yours another name.")
            if not callable(function):
                raise ArgumentError(f"the measure '{name}' is no function: give one of the campaign.")

    def applied(self, campaign: Campaign) -> Campaign:
        """Return a campaign with the limits and the measures of one's own."""
        campaign = replace(
            campaign, limits={name: _limit(name, value) for name, value in self.limits.items()}
        )
        return replace(
            campaign, measured={name: _measured(name, judge, campaign) for name, judge in self.judge.items()}
        )


def read_criteria(target: Any, judge: Any, limits: Any = None) -> Criteria:
    """Return the criteria of optional mappings; what is none is refused."""
    return Criteria(
        read_mapping(target, "the target of runs", 'write {"q": 0.0}'),
        read_mapping(limits, "the limits of runs", 'write {"q": 0.05}'),
        read_mapping(judge, "the judge of runs", 'write {"miss": lambda campaign: ...}'),
    )


def _limit(name: str, value: float) -> float:
    return read_positive(value, f"the limit of '{name}'", or_zero=True)


def _measured(name: str, judge: Judge, campaign: Campaign) -> Array:
    try:
        values = np.asarray(judge(campaign), dtype=float)
    except (TypeError, ValueError) as error:
        raise ArgumentError(
            f"the measure '{name}' gives no numbers ({in_words(error)}): return one per run, ({len(campaign)},)."
        ) from error
    if values.shape != (len(campaign),):
        raise ArgumentError(
            f"the measure '{name}' has the shape {values.shape}: return one number per run, ({len(campaign)},)."
        )
    return values
