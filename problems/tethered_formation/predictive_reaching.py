r"""Model-predictive reaching: a sliding variable taken to zero by an actuator with limits of rate and travel.

The command is the rate v of an actuator whose position y is limited too; s is the sliding variable, f the part of its
rate that the next steps cannot change, g the effect of the command. Over N steps of length h

.. math::
   \min_{v_0 \dots v_{N-1}} \sum_{i=1}^{N} Q s_i^2 + \sum_{i=0}^{N-1} R (v_i - v_{eq})^2, \qquad
   s_{i+1} = s_i + h (f + g v_i), \quad y_{i+1} = y_i + h v_i, \quad
   |v_i| \le \bar v, \; |y_{i+1}| \le \bar y ,

with :math:`v_{eq} = -f / g`, which holds s where it is; v_0 is applied.

**Exact solution.** Because s_i is an affine function of y_i alone, the program has one state, and its value functions
:math:`V_i(y)` are convex and piecewise quadratic. Their derivatives :math:`p = V_i'(y)` are piecewise linear and
increasing, so that a list of knots (y, p) is all there is to know. One step back in time

* adds knots where the best rate :math:`v(p) = v_{eq} - h p / (2R)` meets its limits,
* moves every knot to the position that it came from, :math:`y \to y - h\, \mathrm{clip}(v(p))`,
* cuts the list at the limits of y, beyond which p is infinite,
* adds the derivative of the step's own cost, :math:`p \to p + 2 Q g s_i(y)`.

(The message passing of N. Johnson, J. Comput. Graph. Stat. 22(2), 2013, 246-260, for a control problem.) All of it is a
fixed number of elementary operations without branches: nothing iterates, nothing can fail to converge, and it
becomes flight code like any other law.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca

from gnc_opt.argument_checks import read_integer, read_positive_number
from gnc_opt.control.control_limits_and_authority import clip_to_limits
from gnc_opt.errors import DesignError

Knots: TypeAlias = list[Any]


@dataclass(frozen=True)
class PredictiveReaching:
    """Steer a sliding variable over a horizon, within the limits of rate and travel of the actuator.

    Attributes
    ----------
    steps : int
        N of the horizon.
    dt : float
        Length h of a control step, s.
    weight : float
        Q of the sliding variable squared.
    effort : float
        R of the rate beyond the equivalent one, squared.
    rate : float
        Limit of the command's magnitude.
    travel : float
        Limit of the position's magnitude.
    """

    steps: int
    dt: float
    weight: float
    effort: float
    rate: float
    travel: float

    def __post_init__(self) -> None:
        read_integer(self.steps, "the steps of the horizon of a reaching law", 1, DesignError)
        for name in ("dt", "weight", "effort", "rate", "travel"):
            read_positive_number(getattr(self, name), f"'{name}' of a predictive reaching law", DesignError)

    def gain(self, effect: float) -> float:
        """Return -v_0 / s away from the limits, for an effect g of the command on the rate of s.

        A Riccati recursion of N steps for the integrator s.
        """
        b, p = self.dt * effect, self.weight
        gain = 0.0
        for _ in range(self.steps):
            gain = p * b / (self.effort + p * b * b)
            p = self.weight + p * (1 - gain * b)
        return gain

    def command(self, s: Any, drift: Any, effect: Any, position: Any) -> Any:
        """Return v_0.

        Parameters
        ----------
        s : SX
            Sliding variable.
        drift, effect : SX
            f and g: ds/dt = f + g v; g is not zero.
        position : SX
            Of the actuator now. Beyond its limit (by a disturbance) it is brought back at the limit of the rate.
        """
        equivalent = -drift / effect
        bend = 2 * self.effort / self.dt  # p changes by this per unit of rate

        def best_rate(p: Any) -> Any:
            return clip_to_limits(equivalent - p / bend, -self.rate, self.rate)

        def own(y: Any, i: int) -> Any:
            """Derivative of Q s_i^2 with respect to y_i."""
            return 2 * self.weight * effect * (s + i * self.dt * drift + effect * (y - position))

        y: Knots = [ca.SX(-self.travel), ca.SX(self.travel)]
        p: Knots = [own(y_k, self.steps) for y_k in y]
        meets = [bend * (equivalent - self.rate), bend * (equivalent + self.rate)]
        for i in reversed(range(self.steps)):
            for p_new in meets:
                y_new = _interpolate(p_new, p, y)
                y, p = _insert(y_new, y), _insert(p_new, p)
            y = [y_k - self.dt * best_rate(p_k) for y_k, p_k in zip(y, p, strict=True)]
            if i > 0:
                low, high = (_interpolate(ca.SX(end), y, p) for end in (-self.travel, self.travel))
                y = [clip_to_limits(y_k, -self.travel, self.travel) for y_k in y]
                p = [clip_to_limits(p_k, low, high) + own(y_k, i) for y_k, p_k in zip(y, p, strict=True)]
        return ca.cse(self.limit(best_rate(_interpolate(position, y, p)), position))

    def limit(self, v: Any, position: Any) -> Any:
        """Return the rate within what the travel leaves in one step and, above all, within its own limit."""
        inside = clip_to_limits(v, (-self.travel - position) / self.dt, (self.travel - position) / self.dt)
        return clip_to_limits(inside, -self.rate, self.rate)


def _interpolate(at: Any, x: Knots, values: Knots) -> Any:
    """Return the value at a place, linear between knots with increasing x, constant outside; steps are allowed."""
    total = values[0]
    for k in range(len(x) - 1):
        width = x[k + 1] - x[k]
        wide = width > 0
        share = clip_to_limits((at - x[k]) / ca.if_else(wide, width, 1), 0, 1)
        total += ca.if_else(wide, share, at >= x[k]) * (values[k + 1] - values[k])
    return total


def _insert(value: Any, increasing: Knots) -> Knots:
    """Return an increasing list with one more value in its place."""
    inner = [ca.fmax(a, ca.fmin(value, b)) for a, b in itertools.pairwise(increasing)]
    return [ca.fmin(increasing[0], value), *inner, ca.fmax(increasing[-1], value)]
