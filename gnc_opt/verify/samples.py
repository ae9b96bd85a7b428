"""A phase sampled densely in time, between and at the nodes, from model and trajectory alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gnc_opt.model.layout import Array
from gnc_opt.problem.functions import PhaseFunctions
from gnc_opt.solution.phase_solution import PhaseSolution
from gnc_opt.solution.polynomial import PiecewisePolynomial
from gnc_opt.transcription.quadrature import CollocationRule, collocation_rule
from gnc_opt.verify.propagate import state_magnitudes

AT_BOUND = 1e-6
"""A value this close to its bound, relative to the range, sits on it."""

EXTRA = 9
"""Samples per segment beyond the number of collocation points; segment ends come on top."""


@dataclass(frozen=True, eq=False)
class PhaseSamples:
    """Everything the conditions need, at the times of a fine quadrature in every segment and at its ends.

    Attributes
    ----------
    leg : PhaseSolution
    functions : PhaseFunctions
    times : array (n_samples,)
        Sorted; segment boundaries appear twice, as the end of one and the start of the next segment.
    segments : int array (n_samples,)
    weights : array (n_samples,)
        Quadrature weights in s; zero at segment ends.
    """

    leg: PhaseSolution
    functions: PhaseFunctions
    times: Array
    segments: NDArray[np.int64]
    weights: Array

    @classmethod
    def of(cls, leg: PhaseSolution, functions: PhaseFunctions) -> PhaseSamples:
        """Sample a phase."""
        times, segments, weights = [], [], []
        for k, degree in enumerate(leg.mesh.degrees):
            rule = _sampling_rule(degree)
            half = 0.5 * (leg.breaks[k + 1] - leg.breaks[k])
            inside = leg.breaks[k] + half * (1 + rule.points)
            times.append(np.concatenate([[leg.breaks[k]], inside, [leg.breaks[k + 1]]]))
            weights.append(np.concatenate([[0.0], half * rule.weights, [0.0]]))
            segments.append(np.full(times[-1].size, k))
        return cls(leg, functions, np.concatenate(times), np.concatenate(segments), np.concatenate(weights))

    @cached_property
    def at_end(self) -> NDArray[np.bool_]:
        """Which samples are the end of their segment."""
        return np.append(self.segments[1:] > self.segments[:-1], True)

    def sample(self, signal: PiecewisePolynomial) -> Array:
        """Evaluate a signal at the samples, with the limit from inside each segment."""
        values = signal(self.times, "right")
        values[:, self.at_end] = signal(self.times[self.at_end], "left")
        return values

    @cached_property
    def x(self) -> Array:
        """States (n, n_samples)."""
        return self.sample(self.leg.x)

    @cached_property
    def x_rate(self) -> Array:
        """Time derivatives of the state polynomials."""
        return self.sample(self.leg.x.derivative())

    @cached_property
    def u_polynomial(self) -> Array:
        """Controls by their collocation polynomials (m, n_samples)."""
        return self.sample(self.leg.u)

    @cached_property
    def u(self) -> Array:
        """Controls as flown, within bounds."""
        values = self.leg.flown(self.times, "right")
        values[:, self.at_end] = self.leg.flown(self.times[self.at_end], "left")
        return values

    @cached_property
    def lam(self) -> Array:
        """Costates (n, n_samples)."""
        return self.sample(self.leg.lam)

    @cached_property
    def lam_rate(self) -> Array:
        """Time derivatives of the costate polynomials."""
        return self.sample(self.leg.lam.derivative())

    @cached_property
    def mu(self) -> Array:
        """Path multiplier densities (n_paths, n_samples)."""
        return self.sample(self.leg.path_multiplier)

    @cached_property
    def state_multiplier(self) -> Array:
        """State bound multiplier densities (n, n_samples)."""
        return self.sample(self.leg.state_multiplier)

    @cached_property
    def hamiltonian(self) -> Array:
        """H along the flown control (n_samples,)."""
        return self.functions.hamiltonian(self.times, self.x, self.u, self.lam)

    @cached_property
    def control_gradient(self) -> Array:
        """d(H + mu.c)/du along the flown control (m, n_samples)."""
        return self.functions.control_gradient(self.times, self.x, self.u, self.lam, self.mu)

    @cached_property
    def state_scale(self) -> Array:
        """Magnitude of each state along the phase (n,)."""
        return state_magnitudes(self.leg)

    @cached_property
    def control_scale(self) -> Array:
        """Range of each control's bounds, or its magnitude along the phase where unbounded (m,)."""
        bounds = self.leg.control_bounds
        span = bounds.upper - bounds.lower
        reach = np.max(np.abs(self.u), axis=1, initial=0.0)
        return np.where(np.isfinite(span) & (span > 0), span, np.where(reach > 1e-6, reach, 1.0))

    @cached_property
    def cost_scale(self) -> float:
        """Largest |lambda_i| x_i along the phase: what the states are worth in units of the cost."""
        worth = np.max(np.abs(self.lam) * self.state_scale[:, None], initial=0.0)
        return float(worth) if worth > 0 else 1.0

    @cached_property
    def hamiltonian_scale(self) -> float:
        """Largest sum of the magnitudes of H's terms along the phase (cost per second)."""
        rates = self.functions.rates(self.times, self.x, self.u)
        terms = np.sum(np.abs(self.lam * rates), axis=0)
        integrands = self.functions.integrands(self.times, self.x, self.u)
        terms = terms + np.sum(np.abs(self.functions.weights[:, None] * integrands), axis=0)
        # Where H vanishes altogether, as on a singular arc of zero cost, rounding must not set the scale.
        return max(float(np.max(terms, initial=0.0)), 1e-9)

    def place(self, column: int, what: str = "") -> str:
        """Return "phase leg, t = 1.23 s, v[2]" for a sample."""
        return f"phase {self.leg.name}, t = {self.times[column]:.6g} s{f', {what}' if what else ''}"

    def segment_place(self, segment: int, what: str) -> str:
        """Return the place of a whole segment."""
        left, right = self.leg.breaks[segment], self.leg.breaks[segment + 1]
        return f"phase {self.leg.name}, segment {segment + 1} ({left:.6g} to {right:.6g} s), {what}"

    def integral_from_start(self, values: Array) -> Array:
        """Integrate values (n_samples,) over time from the phase's start to every sample."""
        result, total = np.empty(self.times.size), 0.0
        for k, degree in enumerate(self.leg.mesh.degrees):
            rule, here = _sampling_rule(degree), np.flatnonzero(self.segments == k)
            half = 0.5 * (self.leg.breaks[k + 1] - self.leg.breaks[k])
            inside = values[here[1:-1]]
            result[here[0]] = total
            result[here[1:-1]] = total + half * rule.integration @ inside
            total += half * float(rule.weights @ inside)
            result[here[-1]] = total
        return result

    def per_segment(self, values: Array) -> Array:
        """Integrate |values| (n, n_samples) over each segment: (n, K)."""
        weighted = np.abs(values) * self.weights
        starts = np.searchsorted(self.segments, np.arange(self.leg.mesh.segments))
        return np.add.reduceat(weighted, starts, axis=1)


def _sampling_rule(degree: int) -> CollocationRule:
    return collocation_rule("LG", min(degree + EXTRA, 64))
