"""Measures: the numbers of each run by which a campaign is judged, by their names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError, unknown_name
from gnc_opt.model.layout import Layout
from gnc_opt.simulation.metrics import rotation_angle
from gnc_opt.simulation.quantity import KEPT

COMPONENT_SUMS = {"effort": " s", "energy": "^2 s", "variation": ""}
"""Costs that are summed over the components of a command or control, and what follows the unit."""

REPLANS = ("replans", "failed replans")
"""Measures of runs that re-plan in flight."""

ATTITUDE = (3, 4)
"""Components that an attitude can have: modified Rodrigues parameters, or a quaternion."""


class Runs(Protocol):
    """What measures read of a campaign."""

    @property
    def layouts(self) -> Mapping[str, Layout]: ...

    @property
    def measured(self) -> Mapping[str, Array]: ...

    @property
    def states(self) -> Array: ...

    @property
    def errors(self) -> Array: ...

    @property
    def target(self) -> Array: ...

    @property
    def effort(self) -> Array: ...

    @property
    def energy(self) -> Array: ...

    @property
    def saturation_time(self) -> Array: ...

    @property
    def variation(self) -> Array: ...

    @property
    def event_times(self) -> Array: ...

    @property
    def replans(self) -> Array: ...

    @property
    def sums(self) -> Array: ...


class Measures:
    """The measures of a campaign's runs; see `Campaign.measure` for their names."""

    def __init__(self, runs: Runs) -> None:
        self._runs = runs
        self._known: dict[str, Array] = {}

    def layout(self, kind: str) -> Layout:
        """Return names, sizes and units of a kind; files of older versions know neither events nor quantities."""
        return self._runs.layouts.get(kind, Layout(kind, (), "the campaign"))

    @property
    def names(self) -> tuple[str, ...]:
        """All measures that have values."""
        controls, commands = self.layout("applied").names, self.layout("command").names
        states = [n for n in self.layout("state").names if self._has_target(n)]
        costs = [f"{cost}({n})" for cost in ("effort", "energy") for n in controls]
        costs += [f"{cost}({n})" for cost in ("saturation", "variation") for n in commands]
        times = [f"time({n})" for n in self.layout("event").names]
        way = [f"{kind}({n})" for n in self.layout("quantity").names for kind in KEPT]
        again = REPLANS if self._runs.replans.any() else ()
        return (*states, *self._runs.measured, *costs, *times, *way, *again)

    def values(self, name: str) -> Array:
        """Return a measure of every run, (m,)."""
        if name in self._runs.measured:
            return self._runs.measured[name]
        if name in REPLANS:
            return np.asarray(self._runs.replans[REPLANS.index(name)])
        if name not in self._known:
            self._known[name] = self._evaluate(*self._parse(name))
        return self._known[name]

    def unit(self, name: str) -> str:
        """Return the unit of a measure."""
        if name in self._runs.measured or name in REPLANS:
            return ""
        kind, subject = self._parse(name)
        if kind in KEPT:
            unit = self.layout("quantity")[subject].unit
            return f"{unit} s".strip() if kind == "integral" else unit
        if kind in ("angle", "saturation", "time"):
            return "rad" if kind == "angle" else "s"
        if kind == "error":
            return self.layout("error")[subject].unit
        unit = self.layout("command" if kind == "variation" else "applied")[subject].unit
        bracketed = f"({unit})" if kind == "energy" and set(unit) & set(" /*") else unit
        return f"{bracketed}{COMPONENT_SUMS[kind]}".strip()

    def _evaluate(self, kind: str, subject: str) -> Array:
        runs = self._runs
        if kind == "error":
            return np.asarray(np.linalg.norm(runs.errors[self.layout("error").slice(subject)], axis=0))
        if kind == "angle":
            place = self.layout("state").slice(subject)
            columns, target = runs.states[place].T, runs.target[place]
            return np.array([rotation_angle(c, target) if np.isfinite(c).all() else np.nan for c in columns])
        if kind == "time":
            return np.asarray(runs.event_times[self.layout("event").slice(subject)][0])
        if kind in KEPT:
            quantities = self.layout("quantity")
            return np.asarray(runs.sums[KEPT.index(kind) * quantities.size + quantities.slice(subject).start])
        if kind == "saturation":
            return np.asarray(np.max(runs.saturation_time[self.layout("command").slice(subject)], axis=0))
        layout = self.layout("command" if kind == "variation" else "applied")
        return np.asarray(np.sum(getattr(runs, kind)[layout.slice(subject)], axis=0))

    def _parse(self, name: str) -> tuple[str, str]:
        """Return kind and subject of a measure: ``"effort(F)"`` is ("effort", "F"), ``"q"`` is ("error", "q")."""
        kind, _, rest = name.partition("(") if isinstance(name, str) else ("", "", "")
        subject = rest[:-1] if rest.endswith(")") else ""
        states = self.layout("state")
        if isinstance(name, str) and name in states:
            kind, subject = "error", name
        elif kind == "angle" and subject in states:
            if states[subject].size not in ATTITUDE:
                raise ArgumentError(
                    f"'{subject}' has {states[subject].size} component(s): an attitude has three "
                    "(modified Rodrigues parameters) or four (quaternion)."
                )
        elif not (kind in _SUBJECTS and subject in self.layout(_SUBJECTS[kind])):
            known = [*self.names, *(n for n in states.names if n not in self.names)]
            known += [f"angle({n})" for n in states.names if states[n].size in ATTITUDE]
            raise unknown_name("measure", name, "the campaign", known)
        if kind in ("error", "angle") and not self._has_target(subject):
            raise ArgumentError(
                f"the controller follows no reference of '{subject}': give target={{'{subject}': ...}}."
            )
        return kind, subject

    def _has_target(self, name: str) -> bool:
        return bool(np.all(np.isfinite(self._runs.target[self.layout("state").slice(name)])))


_SUBJECTS = {
    **dict.fromkeys(("effort", "energy"), "applied"),
    **dict.fromkeys(("saturation", "variation"), "command"),
    "time": "event",
    **dict.fromkeys(KEPT, "quantity"),
}
"""Of what kind the subject of a measure is, other than of an error and an angle."""
