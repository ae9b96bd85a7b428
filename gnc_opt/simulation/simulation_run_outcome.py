"""Outcome of a run: its status and the time of the first fault, from the final state of its kernel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.model.model_variables import Layout
from gnc_opt.renamed_public_names import StatusWord
from gnc_opt.simulation.zero_crossing_events import EVENTS_PER_STEP_MAX

_NO_DIGITS = ": no significant digits"
"""Printed for errors larger than the states."""
_ZENO = (
    f"more than {EVENTS_PER_STEP_MAX - 1} events in a control step (Zeno: end the sequence by another event)"
)

_RESET_ON_SURFACE = (
    "the reset of '{}' leaves it at zero with zero rate, and the dynamics move it through zero (let the reset also "
    "change a mode: a state with the rate 0 that switches to equations of contact)"
)


@dataclass(frozen=True, eq=False)
class OutcomeClassifier:
    """Conditions that a run must satisfy, and the classification of its outcome.

    Attributes
    ----------
    watched, alarms : tuple of str
        Quantities that must stay finite, and memory entries that must stay 0.
    divergence_limits : array (n_states,)
        Magnitudes of states above which a run has diverged.
    events, failures : tuple of str
        Events by the codes that end a run, and the failures among them.
    accuracy : float
        Required relative accuracy of the integration.
    """

    watched: tuple[str, ...]
    alarms: tuple[str, ...]
    states: Layout
    divergence_limits: Array
    events: tuple[str, ...]
    failures: tuple[str, ...]
    accuracy: float

    def classify_run_outcome(self, parts: dict[str, Any], i: int, error: float) -> Outcome:
        """Return the outcome of run i from the kernel states by name (., n) and the estimated error."""
        watched, diverged, alarm = (int(parts[name][0, i]) for name in ("fault", "divergence", "alarm"))
        if watched:
            return Outcome(RunStatus.NOT_FINITE, self.watched[watched - 1], float(parts["fault time"][0, i]))
        if diverged:
            k = diverged - 1
            what = f"state '{self.states.labels[k]}' beyond {self.divergence_limits[k]:g}"
            return Outcome(RunStatus.DIVERGED, what, float(parts["divergence time"][0, i]))
        if alarm:
            return Outcome(
                RunStatus.CONTROLLER_ALARM, self.alarms[alarm - 1], float(parts["alarm time"][0, i])
            )
        name, time = self._find_terminal_event(parts, i)
        if name in self.failures or (name and name not in self.events):
            return Outcome(RunStatus.TERMINATED_BY_EVENT, name, time)
        if not error <= self.accuracy:
            why = _NO_DIGITS if error > 1 else ""
            return Outcome(RunStatus.INTEGRATION_ERROR, f"integration error {error:.2g}{why}")
        return Outcome(RunStatus.OK, name, time)

    def _find_terminal_event(self, parts: dict[str, Any], i: int) -> tuple[str, float]:
        code = int(parts["stop"][0, i]) if self.events else 0
        names = (*self.events, _ZENO, *(_RESET_ON_SURFACE.format(event) for event in self.events))
        return (names[code - 1], float(parts["stop time"][0, i])) if code else ("", np.nan)


class RunStatus(StatusWord):
    """Status of a run; each run has exactly one, the most severe.

    Attributes
    ----------
    OK
        All signals finite, no alarm, integration within the required accuracy.
    INTEGRATION_ERROR
        The error estimate of the integration exceeds the required accuracy.
    CONTROLLER_ALARM
        The controller could not meet its guarantees.
    DIVERGED
        A state left its plausible size, see ``divergence_limits`` of `ClosedLoop`.
    NOT_FINITE
        A signal, state or quantity is not finite, or an event is NaN.
    TERMINATED_BY_EVENT
        A failure event ended the run, events accumulated (Zeno), or a reset left its event at zero.
    INVALID_PARAMETERS
        A parameter is outside its permitted range; the run was not simulated.
    LOST
        Its process died, or the run raised an exception.
    """

    OK = "ok"
    INTEGRATION_ERROR = "integration_error"
    CONTROLLER_ALARM = "controller_alarm"
    DIVERGED = "diverged"
    NOT_FINITE = "not_finite"
    TERMINATED_BY_EVENT = "terminated_by_event"
    INVALID_PARAMETERS = "invalid_parameters"
    LOST = "lost"


@dataclass(frozen=True)
class Outcome:
    """Status of a run and its cause.

    Attributes
    ----------
    status : RunStatus
    what : str
        Cause, e.g. ``"measured 'omega[1]'"``, or the name of the alarm or of the event that ended the run.
    time : float
        Start of the control step, or time of the event, s; NaN without a time.

    Examples
    --------
    >>> print(run.outcome, run.outcome.ok)
    ok True
    """

    status: RunStatus
    what: str = ""
    time: float = math.nan

    def __eq__(self, other: object) -> bool:
        """Compare outcomes; two times of NaN are equal."""
        return isinstance(other, Outcome) and self._outcome_comparison_key == other._outcome_comparison_key

    def __hash__(self) -> int:
        return hash(self._outcome_comparison_key)

    @property
    def _outcome_comparison_key(self) -> tuple[RunStatus, str, float | None]:
        return self.status, self.what, None if math.isnan(self.time) else self.time

    def __reduce__(self) -> tuple[type[Outcome], tuple[RunStatus, str, float]]:
        return Outcome, (self.status, self.what, self.time)

    @property
    def ok(self) -> bool:
        """Whether the status is OK."""
        return self.status is RunStatus.OK

    def __str__(self) -> str:
        when = f" at {self.time:.6g} s" if self.time == self.time else ""
        return f"{self.status.value}: {self.what}{when}" if self.what else self.status.value
