r"""Final values of runs, and their integration error from companion runs with half the step size.

Both runs have the same parameters, random numbers and plans. With the order p of the method (5 for smooth rates and
constant inputs, 2 at kinks of a rate), the final states x and :math:`\hat x` of the run and its companion satisfy

.. math:: |x - x^*| \le \frac{|x - \hat x|}{1 - 2^{-p}} .

Source of the estimate: Richardson, "The deferred approach to the limit", Phil. Trans. R. Soc. A 226, 1927.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.simulation.block_signal_chain import ColumnLayout
from gnc_opt.simulation.simulation_run_outcome import Outcome


@dataclass(frozen=True)
class FinalValues:
    """Final values and performance figures of n runs.

    Attributes
    ----------
    states : array (n_states, n)
    errors : array (n_errors, n) or None
        Errors relative to the reference at the last time, with the plant's difference function.
    memory : array (n_memory, n)
        Memory of the controller.
    effort, energy : array (n_controls, n)
        Integrals of \\|u\\| and u^2 of the applied controls (unit s, unit^2 s).
    saturation_time : array (n_commands, n)
        Time during which a limit acted on a command, s.
    variation : array (n_commands, n)
        Total variation of the commands, which measures chattering.
    integration_error, state_error : array (n,)
        See `estimate_integration_errors`.
    outcomes : tuple of n Outcome
    event_counts, event_times : array (n_events, n)
        Number of occurrences of each event, and the first time (s), NaN without an occurrence.
    replans : array (2, n)
        Numbers of successful and of failed re-plannings.
    sums, samples : arrays (3 n_quantities, n), (n_quantities, n_samples, n) or None
        Maxima, minima, integrals and samples of quantities.

    Examples
    --------
    >>> compiled_loop = loop.compile([1.0, 0.0], tf=8.0)
    >>> ending = compiled_loop.final_values(np.tile(compiled_loop.nominal[:, None], 3), [1, 2, 3])
    >>> print(ending.states.shape, np.abs(ending.errors).max() < 0.01)
    (2, 3) True
    """

    states: Array
    errors: Array | None
    memory: Array
    effort: Array
    energy: Array
    saturation_time: Array
    variation: Array
    integration_error: Array
    state_error: Array
    outcomes: tuple[Outcome, ...]
    event_counts: Array
    event_times: Array
    replans: Array
    sums: Array | None = None
    samples: Array | None = None


RICHARDSON_FACTOR = 4 / 3
"""Ratio of the error to the change by halving the step, for order 2 and higher."""


def estimate_integration_errors(
    layout: ColumnLayout, final: Array, companions: Array, end: float
) -> tuple[Array, Array]:
    """Return the relative errors (n,) of runs, relative to max(1, \\|x\\|): of all entries, and of the states only."""
    one, two = layout.split_vector_by_name(final), layout.split_vector_by_name(companions)
    x, other = one["plant"], two["plant"]
    if "stop" not in one:
        errors = RICHARDSON_FACTOR * _compute_final_state_distances(x, other)
        return errors, errors
    t, late = (np.where(parts["stop"] > 0, parts["stop time"], end) for parts in (one, two))
    drift = np.where(one["stop"] > 0, two["stop rate"] * (late - t), 0.0)
    errors = RICHARDSON_FACTOR * _compute_final_state_distances(np.vstack([x, t]), np.vstack([other, late]))
    return errors, np.fmin(errors, RICHARDSON_FACTOR * _compute_final_state_distances(x, other - drift))


def _compute_final_state_distances(one: Array, two: Array) -> Array:
    """Return the distances between columns (n,); infinite if only the second is not finite."""
    with np.errstate(invalid="ignore", over="ignore"):
        distances = np.max(np.abs(one - two) / np.maximum(1.0, np.abs(one)), axis=0)
    return np.asarray(np.where(np.isnan(distances) & np.isfinite(one).all(axis=0), np.inf, distances))
