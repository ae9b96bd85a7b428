"""Judge: what became of a run, from the state of its kernel at the end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.model.layout import Layout
from gnc_opt.simulation.event import MOST
from gnc_opt.simulation.outcome import Outcome, RunStatus

_AVERAGED = ", owed to actuators that take the mean of what they get"
"""Said of runs that more integration steps do not make more accurate."""

_LOST = ": no digit is right"
"""Said of runs whose states are off by more than their size; how far then is hard to tell."""

_ZENO = f"more than {MOST - 1} events in a control step (Zeno: let what they follow come to rest by another event)"
"""What ended a run whose events do not let time pass."""

_UNKEPT = (
    "the reset of '{}' leaves it at rest on zero, and the plant pulls it through (let it change a mode, too: a state "
    "with the rate 0, by which the equations choose what holds it there)"
)
"""What ended a run in which something came to rest on what does not bear it."""


@dataclass(frozen=True, eq=False)
class Judge:
    """What a run has to keep.

    Attributes
    ----------
    watched, alarms : tuple of str
        Quantities that must stay finite, and entries of the memory that must stay 0.
    states : Layout
        Of the plant.
    plausible : array (n_states,)
        Size of the states beyond which a run has diverged.
    events : tuple of str
        By the codes that end a run, code 1 first.
    failures : tuple of str
        Those of them that are failures.
    accuracy : float
        Asked of the integration, relative.
    """

    watched: tuple[str, ...]
    alarms: tuple[str, ...]
    states: Layout
    plausible: Array
    events: tuple[str, ...]
    failures: tuple[str, ...]
    accuracy: float

    def outcome(self, parts: dict[str, Any], i: int, error: float) -> Outcome:
        """Return what became of the i-th run, from the kernels' states by name (., n) and its estimated error."""
        watched, diverged, alarm = (int(parts[name][0, i]) for name in ("fault", "divergence", "alarm"))
        if watched:
            return Outcome(RunStatus.NOT_FINITE, self.watched[watched - 1], float(parts["fault time"][0, i]))
        if diverged:
            k = diverged - 1
            what = f"state '{self.states.labels[k]}' beyond {self.plausible[k]:g}"
            return Outcome(RunStatus.DIVERGED, what, float(parts["divergence time"][0, i]))
        if alarm:
            return Outcome(RunStatus.ALARM, self.alarms[alarm - 1], float(parts["alarm time"][0, i]))
        name, time = self._stop(parts, i)
        if name in self.failures or (name and name not in self.events):
            return Outcome(RunStatus.STOPPED, name, time)
        if not error <= self.accuracy:
            why = _AVERAGED if 2 * float(parts["blur"][0, i]) > error else _LOST if error > 1 else ""
            return Outcome(RunStatus.INACCURATE, f"integration error {error:.2g}{why}")
        return Outcome(RunStatus.OK, name, time)

    def _stop(self, parts: dict[str, Any], i: int) -> tuple[str, float]:
        """Return the event that ended a run, and when."""
        code = int(parts["stop"][0, i]) if self.events else 0
        names = (*self.events, _ZENO, *(_UNKEPT.format(event) for event in self.events))
        return (names[code - 1], float(parts["stop time"][0, i])) if code else ("", np.nan)
