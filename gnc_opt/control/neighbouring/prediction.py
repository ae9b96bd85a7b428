r"""Prediction: where a switching plan leads from any state, and the flight that ends where it should.

Between the switches the controls are constant and the states are integrated by the Runge-Kutta method of fourth order,
in a fixed number of steps per arc: a fixed number of operations. From a state x at t it gives

.. math:: \psi(\tau; t, x) = x(t_f) \ominus x_f, \qquad \nabla_\tau (\nu^T \psi),

:math:`\tau` the switch times and the end :math:`t_f`; what has passed at t changes nothing.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca

from gnc_opt.control.neighbouring.switching_plan import SwitchingPlan
from gnc_opt.control.steps import in_order


@dataclass(frozen=True)
class RegulatedEnd:
    """The last part of a flight, in which a regulator follows what is left of the plan.

    Attributes
    ----------
    length : float
        s.
    reserve : float
        Share of the planned controls that is left to it.
    """

    length: float
    reserve: float


@dataclass(frozen=True, eq=False)
class Prediction:
    """A switching plan as it is flown, symbolic.

    Attributes
    ----------
    plan : SwitchingPlan
    ending : RegulatedEnd
    steps : int
        Runge-Kutta steps per arc.
    """

    plan: SwitchingPlan
    ending: RegulatedEnd
    steps: int
    _unknowns: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_unknowns", self.plan.times.size)

    def controls(self, s: Any, tau: Any) -> Any:
        """Return the controls (SX) at a time s before the end."""
        late = s > tau[-1] - self.ending.length
        return self.plan.control(s, tau) * (1 - self.ending.reserve * late)

    def mean_controls(self, begin: Any, length: float, tau: Any) -> Any:
        """Return their mean (SX) over a step; after the end they keep the final state at rest."""
        late = _share(begin, length, tau[-1] - self.ending.length)
        over, rest = _share(begin, length, tau[-1]), self.plan.reference.tail_control
        before = self.plan.mean_control(begin, length, tau) * (1 - self.ending.reserve * late)
        return before * (1 - over) + ca.DM(rest) * over

    @cached_property
    def ends(self) -> Any:
        """``(t, x, tau, nu) -> (psi, gradient of nu' psi)``, columns."""
        model = self.plan.reference.model
        t, x, tau = ca.SX.sym("t"), ca.SX.sym("x", model.states.size), ca.SX.sym("tau", self._unknowns)
        nu, after = ca.SX.sym("nu", model.errors.size), x
        for begin, end in itertools.pairwise(self._edges(t, tau)):
            after = self._arc(begin, after, self.controls(0.5 * (begin + end), tau), end - begin)
        psi = model.error_expression(after, ca.SX(self.plan.final))
        return ca.Function("ends", [t, x, tau, nu], [psi, ca.jtimes(psi, tau, nu, True)])

    @cached_property
    def reference(self) -> Any:
        """``(t, tau) -> x``: the state at t from which the plan leads to its end; after the end, that."""
        t, tau = ca.SX.sym("t"), ca.SX.sym("tau", self._unknowns)
        x = ca.SX(self.plan.final)
        for begin, end in reversed(list(itertools.pairwise(self._edges(t, tau)))):
            x = self._arc(end, x, self.controls(0.5 * (begin + end), tau), begin - end)
        return ca.Function("reference", [t, tau], [x])

    def _edges(self, t: Any, tau: Any) -> list[Any]:
        """Return the times from t to the end between which the controls are constant."""
        end = ca.fmax(tau[-1], t)
        inner = [*ca.vertsplit(tau)[:-1], *([tau[-1] - self.ending.length] if self.ending.reserve else [])]
        return [t, *in_order([ca.fmin(ca.fmax(s, t), end) for s in inner]), end]

    @cached_property
    def _arc(self) -> Any:
        """``(t, x, u, length) -> x`` with constant controls."""
        model = self.plan.reference.model
        f, p = model.function, model.parameter_values
        t, x, u, length = (
            ca.SX.sym(n, size) for n, size in (("t", 1), ("x", model.states.size), ("u", model.controls.size), ("l", 1))
        )  # fmt: skip
        h, now, after = length / self.steps, t, x
        for _ in range(self.steps):
            k1 = f(now, after, u, p)
            k2 = f(now + h / 2, after + h / 2 * k1, u, p)
            k3 = f(now + h / 2, after + h / 2 * k2, u, p)
            k4 = f(now + h, after + h * k3, u, p)
            now, after = now + h, after + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return ca.Function("arc", [t, x, u, length], [after])


def _share(begin: Any, length: float, since: Any) -> Any:
    """Return which share of a step is later than a time."""
    return ca.fmin(1, ca.fmax(0, (begin + length - since) / length))
