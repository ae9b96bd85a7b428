"""Outcome: how a run ended, and when something first went wrong."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum


class RunStatus(Enum):
    """What became of a run; each run has exactly one, the gravest.

    Members
    -------
    OK : everything stayed finite, no alarm, the integration as accurate as asked for.
    INACCURATE : the integration's own error estimate exceeds the accuracy asked for.
    ALARM : the controller reported that it could not keep its promise.
    DIVERGED : a state left its plausible size, see ``plausible`` of `ClosedLoop`.
    NOT_FINITE : a measurement, command, applied control or state is not a finite number, or the expression or
        condition of an event, or a quantity, is not-a-number.
    STOPPED : an event that is a failure ended the run, or events followed each other faster than time (Zeno),
        or a reset left its event at rest on zero and the plant would have gone on through.
    REFUSED : a parameter is outside its permitted range; the run was not flown.
    LOST : the process that flew it died, or the run raised an exception.
    """

    OK = "ok"
    INACCURATE = "inaccurate"
    ALARM = "alarm"
    DIVERGED = "diverged"
    NOT_FINITE = "not finite"
    STOPPED = "stopped"
    REFUSED = "refused"
    LOST = "lost"


@dataclass(frozen=True)
class Outcome:
    """Status of a run with its cause.

    Attributes
    ----------
    status : RunStatus
    what : str
        The culprit, e.g. ``"measured 'omega[1]'"`` or the name of the alarm; of a run that an event ended, its name.
    time : float
        Beginning of the control step at which it happened, s, or the instant of the event; not-a-number where it has no
        time.

    Examples
    --------
    >>> print(run.outcome, run.outcome.ok)
    ok True
    """

    status: RunStatus
    what: str = ""
    time: float = math.nan

    def __eq__(self, other: object) -> bool:
        """Outcomes without a time are equal, too, though not-a-number is not equal to itself."""
        return isinstance(other, Outcome) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[RunStatus, str, float | None]:
        return self.status, self.what, None if math.isnan(self.time) else self.time

    def __reduce__(self) -> tuple[type[Outcome], tuple[RunStatus, str, float]]:
        return Outcome, (self.status, self.what, self.time)

    @property
    def ok(self) -> bool:
        """Whether all is well."""
        return self.status is RunStatus.OK

    @property
    def diverged(self) -> bool:
        """Whether a state left its plausible size."""
        return self.status is RunStatus.DIVERGED

    @property
    def not_finite(self) -> bool:
        """Whether the run left the finite numbers."""
        return self.status is RunStatus.NOT_FINITE

    def __str__(self) -> str:
        at = f" at {self.time:.6g} s" if self.time == self.time else ""
        return f"{self.status.value}: {self.what}{at}" if self.what else self.status.value
