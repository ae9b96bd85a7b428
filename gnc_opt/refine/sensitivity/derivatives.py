"""What `Solution.sensitivity` returns: derivatives of an optimal solution with respect to one quantity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arrays import Array
from gnc_opt.errors import ProblemError, unknown_name
from gnc_opt.solution.phase_solution import Signal
from gnc_opt.solution.polynomial import Side


@dataclass(frozen=True)
class SignalSensitivity:
    """Derivative of a state or control at fixed time, with respect to a quantity.

    ``signal(t)`` returns what the state or control itself would; for a vector quantity one such value per
    component, stacked along a new first axis. ``side`` picks the limit exactly at a segment boundary.
    """

    name: str
    scalar: bool
    components: tuple[Signal, ...]

    def __call__(self, t: ArrayLike, side: Side = "right") -> Array | float:
        """Evaluate at time t (s)."""
        values = [signal(t, side) for signal in self.components]
        return values[0] if self.scalar else np.stack([np.asarray(v) for v in values])


@dataclass(frozen=True, eq=False)
class PhaseSensitivity:
    """Derivatives of one phase.

    Attributes
    ----------
    name : str
    initial_time, final_time : float or array (n_components,)
    switch_times : array (n_movable,) or (n_components, n_movable)
        Of the movable mesh boundaries, which are the switch times of a solution with optimised structure.
    states, controls : mapping of SignalSensitivity
    """

    name: str
    initial_time: Array | float
    final_time: Array | float
    switch_times: Array
    states: Mapping[str, SignalSensitivity]
    controls: Mapping[str, SignalSensitivity]


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of a solution with respect to one quantity (per unit of it).

    A quantity of several components puts them on the first axis of every derivative.

    Attributes
    ----------
    quantity : str
        E.g. ``"parameter 'k'"``.
    objective : float or array (n_components,)
        Of the objective as stated (not negated when maximised).
    phases : mapping of PhaseSensitivity
    parameters : mapping of float or array
        Of the optimised parameters.

    Examples
    --------
    >>> told = go.sensitivity(solution, initial="q")
    >>> print(told.quantity, f"{told.final_time:.6f}")
    initial value of 'q' in phase 'leg' 1.000000
    """

    quantity: str
    objective: Array | float
    phases: Mapping[str, PhaseSensitivity]
    parameters: Mapping[str, Array | float]

    def phase(self, name: str | None = None) -> PhaseSensitivity:
        """Return the derivatives of a phase; the name may be left out when there is only one."""
        if name is None and len(self.phases) == 1:
            return next(iter(self.phases.values()))
        if name is None:
            raise ProblemError(f"there are {len(self.phases)} phases: name one of {list(self.phases)}.")
        if name not in self.phases:
            raise unknown_name("phase", name, "the sensitivity", self.phases)
        return self.phases[name]

    def state(self, name: str, phase: str | None = None) -> SignalSensitivity:
        """Return the derivative of a state over time: ``s.state("q")(0.3)``."""
        return _named(self.phase(phase).states, name, "state")

    def control(self, name: str, phase: str | None = None) -> SignalSensitivity:
        """Return the derivative of a control over time."""
        return _named(self.phase(phase).controls, name, "control")

    def parameter(self, name: str) -> Array | float:
        """Return the derivative of an optimised parameter."""
        if name not in self.parameters:
            raise unknown_name("optimised parameter", name, "the sensitivity", self.parameters)
        return self.parameters[name]

    @property
    def initial_time(self) -> Array | float:
        """Of the initial time of the only phase."""
        return self.phase().initial_time

    @property
    def final_time(self) -> Array | float:
        """Of the final time of the only phase."""
        return self.phase().final_time


def _named(signals: Mapping[str, SignalSensitivity], name: str, kind: str) -> SignalSensitivity:
    if not isinstance(name, str) or name not in signals:
        raise unknown_name(kind, name, "the sensitivity", signals)
    return signals[name]
