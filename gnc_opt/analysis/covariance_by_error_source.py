"""Propagation of first-order deviations of the closed-loop state along the nominal run."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gnc_opt.array_types import Array


@dataclass(frozen=True, eq=False)
class DeviationSources:
    """Sources of deviations by name: covariances of dispersions, and indices of random numbers."""

    names: tuple[str, ...]
    spreads: tuple[Array, ...]
    numbers: tuple[slice, ...]

    @property
    def parameter_slices_by_source(self) -> list[slice]:
        """Slices of the sources among all dispersed parameters."""
        edges = [0, *np.cumsum([spread.shape[0] for spread in self.spreads])]
        return [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]


@dataclass(frozen=True, eq=False)
class StateDeviations:
    """Deviations of a column (n,): derivatives in the dispersed parameters, and covariances by noise block."""

    sources: DeviationSources
    by_parameters: Array
    noise: Sequence[Array]

    @classmethod
    def from_noise_and_parameter_jacobians(
        cls, sources: DeviationSources, g: Array, h: Array
    ) -> StateDeviations:
        """Return the deviations of a column with derivatives g, h in the initial noise and the dispersed parameters."""
        quiet = [np.zeros((g.shape[0], g.shape[0])) for _ in sources.numbers]
        return cls(sources, np.hstack([h, g]), quiet)

    def propagate_state_deviations(self, a: Array, g: Array, h: Array, *, first: bool) -> StateDeviations:
        """Return the deviations of a x + g n + h p, with the noise n of a step and the parameters p."""
        added = np.hstack([h, g if first else np.zeros_like(g)])
        noise = [a @ s @ a.T for s in self.noise]
        if not first:
            noise = [s + g[:, p] @ g[:, p].T for s, p in zip(noise, self.sources.numbers, strict=True)]
        return StateDeviations(self.sources, a @ self.by_parameters + added, noise)

    def transform_state_deviations_linearly(self, matrix: Array) -> StateDeviations:
        """Return the deviations of a matrix times the column."""
        noise = [matrix @ s @ matrix.T for s in self.noise]
        return StateDeviations(self.sources, matrix @ self.by_parameters, noise)

    @property
    def state_dimension(self) -> int:
        return int(self.by_parameters.shape[0])

    @property
    def covariances_by_source(self) -> Array:
        """Covariances by source, (n_sources, n, n)."""
        parts = [
            self.by_parameters[:, place] @ spread @ self.by_parameters[:, place].T
            for place, spread in zip(
                self.sources.parameter_slices_by_source, self.sources.spreads, strict=True
            )
        ]
        for i, s in enumerate(self.noise, start=len(parts) - len(self.noise)):
            parts[i] = parts[i] + s
        return np.reshape(parts, (len(parts), self.state_dimension, self.state_dimension))
