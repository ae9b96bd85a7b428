"""Ending: how runs ended."""

from __future__ import annotations

from dataclasses import dataclass

from gnc_opt.arrays import Array
from gnc_opt.simulation.outcome import Outcome


@dataclass(frozen=True)
class FinalValues:
    """Final values and figures of merit of n runs.

    Attributes
    ----------
    states : array (n_states, n)
        At the last time.
    errors : array (n_errors, n) or None
        Of the states relative to the reference at the last time, by the plant's own difference.
    memory : array (n_memory, n)
        Of the controller.
    effort, energy : array (n_controls, n)
        Integrals of \\|u\\| and u^2 of the applied controls (unit s, unit^2 s).
    saturation_time : array (n_commands, n)
        Time in which a limit acted on a command, s.
    variation : array (n_commands, n)
        Sum of the changes of the commands: chattering.
    integration_error : array (n,)
        Estimated, relative to max(1, \\|x\\|), of the states and of the instant of an event that ends the run.
    state_error : array (n,)
        The same of the states at one time: ``accuracy`` is asked of it.
    outcomes : tuple of n Outcome
    event_counts, event_times : array (n_events, n)
        Number of occurrences of each event, and the first time (s), NaN without an occurrence.
    replans : array (2, n)
        Numbers of successful and of failed re-plans.
    sums : array (3 n_quantities, n) or None
        Largest values, least values and integrals of the loop's quantities.
    samples : array (n_quantities, n_samples, n) or None
        Of them, at some control steps.

    Examples
    --------
    >>> flight = loop.compile([1.0, 0.0], tf=8.0)
    >>> ending = flight.final(np.tile(flight.nominal[:, None], 3), [1, 2, 3])
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
