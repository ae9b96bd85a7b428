"""What all sliding modes are told and do alike: the switching part of a law, checked, with its memory and its facts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import read_positive
from gnc_opt.arrays import Array
from gnc_opt.control.explanation import Fact
from gnc_opt.control.guard import GROWTH, GUARD, Memory
from gnc_opt.control.lie import OutputErrors
from gnc_opt.control.limits import Authority, Limits, read_limits, require_reserve
from gnc_opt.control.reference import Reference
from gnc_opt.control.schedule import reference_times
from gnc_opt.control.sliding.overpowered import gain_exceeded, twist_outrun
from gnc_opt.control.sliding.reaching import (
    Boundary,
    Law,
    SaturationLayer,
    Sign,
    SuperTwisting,
    TanhLayer,
    read_bounds,
)
from gnc_opt.control.sliding.super_twisting import SuperTwistingObserver, sampled_band
from gnc_opt.errors import DesignError
from gnc_opt.model.model import Model

_FULL = 0.99
"""Share of the gain that counts as all of it: the hyperbolic tangent never gets there."""


@dataclass(frozen=True, eq=False)
class SlidingOptions:
    """What the designs of sliding modes are told alike; `design_sliding_mode` explains each."""

    reaching: Law
    boundary: Boundary
    bound: ArrayLike = 0.0
    observer: SuperTwistingObserver | None = None
    limits: Limits | None = None
    start: ArrayLike | None = None
    dt: float | None = None
    guard: float = GUARD
    growth: float = GROWTH

    def switching(self, model: Model, labels: Sequence[str]) -> Switching:
        """Return the switching part of a law for surfaces of these names.

        Raises
        ------
        DesignError
            Disturbances above the gain, steps too long for the boundary layer, limits without room.
        """
        bounds = read_bounds(self.reaching, self.bound, labels)
        dt = _read_step(self.reaching, self.boundary, self.dt, needed=self.observer is not None)
        return Switching(self.reaching, self.boundary, bounds, dt, read_limits(model, self.limits))


@dataclass(frozen=True, eq=False)
class Switching:
    """The switching part of a law, its arguments checked.

    Attributes
    ----------
    reaching : ConstantRate, ExponentialRate, PowerRate or SuperTwisting
    boundary : Sign, SaturationLayer or TanhLayer
    bounds : array (n_surfaces,)
        Largest disturbances of ds/dt; for `SuperTwisting` their largest rates.
    dt : float or None
        Length of a control step, s.
    limits : (lower, upper) or None
        Authority, (n_controls,) each.
    stretch : float
        By what factor s moves further over a step than ds/dt at its beginning says, as the plant moves on under the
        held command; 1 for integrators.
    """

    reaching: Law
    boundary: Boundary
    bounds: Array
    dt: float | None
    limits: Authority | None
    stretch: float = 1.0

    @property
    def bands(self) -> Array:
        """The |s| within which disturbances at their bounds may hold each surface, continuous control."""
        return np.array([self.reaching.band(self.boundary, float(b)) for b in self.bounds])

    @property
    def sampled_bands(self) -> Array | None:
        """The |s| to which the law comes back if its commands are held over steps of dt; None where none is known."""
        if self.dt is None or not isinstance(self.boundary, Sign):
            return self.bands
        if isinstance(self.reaching, SuperTwisting):
            return None if np.any(self.bounds > 0) else np.full(self.bounds.size, self._twisted(self.dt))
        # From beside zero it goes one step to the other side, driven by its full gain and by the disturbance.
        driven = (self._switched + self.bounds) * self.stretch
        return driven * self.dt if np.isfinite(self._switched) else self.bands

    @property
    def _switched(self) -> float:
        """By how much ds/dt is switched, units of s per second: nothing by `SuperTwisting`, whose gain is a rate."""
        return 0.0 if isinstance(self.reaching, SuperTwisting) else self.reaching.gain

    def _twisted(self, dt: float) -> float:
        """Return the band of sampled super-twisting, whose steps are stretched."""
        assert isinstance(self.reaching, SuperTwisting)
        return sampled_band(self.stretch * self.reaching.k1, self.stretch * self.reaching.k2, dt)

    def demand(self, s: Any, drift: Any) -> tuple[Any, list[Memory]]:
        """Return E u, so that ``ds/dt = drift + E u`` obeys the reaching law, and the memory that this takes; SX."""
        wanted = -drift - self.reaching.rate(s, self.boundary)
        if not isinstance(self.reaching, SuperTwisting):
            return wanted, []
        assert self.dt is not None
        size = self.bounds.size
        twist = ca.SX.sym("twist", size)
        grown = twist + self.dt * self.reaching.memory_rate(s, self.boundary)
        return wanted + twist, [Memory("twist", twist, ca.SX.zeros(size), grown)]

    def watch(self, s: Any, *, stays: bool = True) -> list[Memory]:
        """Return the memory that raises the alarm of a disturbance that is stronger than the gain.

        Without ``stays`` s begins at zero, and what another law commands may throw it out of its layer for a while.
        """
        first = s if stays else ca.SX.zeros(s.shape)
        edge = self.boundary.width(_FULL)
        if isinstance(self.reaching, SuperTwisting):
            assert self.dt is not None
            law = self.reaching
            return twist_outrun(s, first, lambda size: law.rate(size, self.boundary), law.k2, edge, self.dt)
        if not np.isfinite(self.reaching.gain):
            return []
        return gain_exceeded(s, first, edge + 2 * self.reaching.gain * (self.dt or 0.0), stays=stays)

    def facts(self) -> list[Fact]:
        """Return the bands of s and the sampling limit."""
        remark = "where a disturbance at its bound may hold s, continuous control"
        facts = [Fact("band of s", self.bands, remark=remark)]
        if self.dt is not None and isinstance(self.boundary, Sign):
            facts += self._chattering(self.dt)
        slope = self.reaching.slope(self.boundary)
        if np.isfinite(slope):
            remark = "longer control steps chatter in the boundary layer"
            facts.append(Fact("sampling limit", 2 / slope, "s", remark))
        return facts

    def _chattering(self, dt: float) -> list[Fact]:
        """Return the fact about the |s| within which a law without a boundary layer switches, if that is known."""
        if isinstance(self.reaching, SuperTwisting):
            remark = "of the sampled law, under any constant disturbance"
            return [Fact("chattering band of s", self._twisted(dt), remark=remark)]
        if not np.isfinite(self._switched):
            return []
        remark = "one control step at full gain, disturbed at the bound"
        return [Fact("chattering band of s", self.sampled_bands, remark=remark)]

    def reserve(self, errors: OutputErrors, reference: Reference) -> list[Fact]:
        """Return the fact about the authority that is left on the reference beyond the switching gain, if it has one.

        Raises
        ------
        DesignError
            The feedforward and the gain together ask for more than the limits.
        """
        gain = self._switched
        if self.limits is None or not np.isfinite(gain):
            return []
        times = reference_times(reference)
        if isinstance(
            self.reaching, SuperTwisting
        ):  # its command has no bound: the rehearsal tells what it asks for
            return require_reserve(reference, self.limits, times, dt=self.dt)
        matrices = errors.pair.along(reference, times, errors.decoupling)
        need = np.stack([np.sum(np.abs(np.linalg.pinv(m)), axis=1) * gain for m in matrices], axis=1)
        return require_reserve(reference, self.limits, times, gain=need, dt=self.dt)


def _read_step(reaching: Law, boundary: Boundary, dt: float | None, *, needed: bool) -> float | None:
    """Return dt; raise `DesignError` where it is missing or too long for the slope of the boundary layer.

    Inside the layer the sampled surface obeys s+ = (1 - dt * slope) s: it grows from step to step for
    dt * slope > 2, and chatters at 2.
    """
    if not isinstance(boundary, (Sign, SaturationLayer, TanhLayer)):
        raise DesignError(
            f"the boundary is {boundary!r}: give Sign(), SaturationLayer(phi) or TanhLayer(phi)."
        )
    if dt is None:
        if needed or isinstance(reaching, SuperTwisting):
            raise DesignError("a law with memory is designed for one length of control steps: give dt, in s.")
        return None
    dt = read_positive(dt, "the control step dt", DesignError)
    slope = reaching.slope(boundary)
    if np.isfinite(slope) and slope * dt >= 2:
        raise DesignError(
            f"control steps of {dt:g} s are too long for the switching gain: gain * dt / phi = {slope * dt:.4g} "
            f"is not below 2; give dt < {2 / slope:.4g} s, a wider boundary layer or a smaller gain."
        )
    return dt
