r"""Fixed-step integration by the Runge-Kutta pair of Dormand and Prince, as symbolic expressions.

The fifth-order solution is propagated. The dense output is a polynomial of degree four through the values and rates at
both ends of a step; it has order four. The stability function, by which a step multiplies a mode
:math:`e^{\lambda t}`, :math:`z = \lambda h`, is

.. math:: R(z) = 1 + z + \frac{z^2}{2} + \frac{z^3}{6} + \frac{z^4}{24} + \frac{z^5}{120} + \frac{z^6}{600} .

Sources: Dormand and Prince, "A family of embedded Runge-Kutta formulae", J. Comp. Appl. Math. 6 (1), 1980, table 2;
within a step, Hairer, Norsett and Wanner, "Solving Ordinary Differential Equations I", 1993, section II.6.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple, TypeAlias

import casadi as ca

from gnc_opt.simulation.intersample_actuator_output import Input

NODES = (0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0)

STAGES: tuple[tuple[float, ...], ...] = (
    (),
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
"""Butcher tableau; the last row is the fifth-order solution (first same as last)."""

DENSE_WEIGHTS = (
    -12715105075 / 11282082432, 0.0, 87487479700 / 32700410799, -10690763975 / 1880347072,
    701980252875 / 199316789632, -1453857185 / 822651844, 69997945 / 29380423,
)  # fmt: skip
"""Weights of the polynomial nu^2 (1 - nu)^2 in the dense output."""


class IntegrationStep(NamedTuple):
    """Integration step: index, length (s), start (s), states at both ends, and rates at its stages."""

    number: int
    length: Any
    time: Any
    x: Any
    after: Any
    stages: list[Any]

    def interpolate_state(self, nu: float) -> tuple[Any, Any]:
        """Return the state and its rate at ``nu`` (0 to 1) of the step."""
        function = _build_dense_output_function(self.x.shape[0])
        state, rate = function(nu, self.x, self.length, *self.stages)
        return state, rate


Stepped: TypeAlias = Callable[[IntegrationStep], None]


def integrate_dormand_prince(
    f: Callable[[Any, Any, Any], Any],
    t: Any,
    x: Any,
    length: Any,
    steps: int = 1,
    u: Input | None = None,
    stepped: Stepped | None = None,
) -> Any:
    """Return the state (column) after ``length`` (s) of ``dx/dt = f(t, x, u)``, in equal steps."""
    h = length / steps
    rate = None
    for i in range(steps):
        start = t + i * h
        k = [f(start, x, None if u is None else u(i, 0.0)) if rate is None else rate]
        for node, row in zip(NODES[1:], STAGES[1:], strict=True):
            after = _build_runge_kutta_stage_function(row, x.shape[0])(x, h, *k)
            k.append(f(start + node * h, after, None if u is None else u(i, node)))
        if stepped is not None:
            stepped(IntegrationStep(i, h, start, x, after, k))
        x, rate = after, k[-1] if u is None else None
    return x


@cache
def _build_runge_kutta_stage_function(row: tuple[float, ...], n: int) -> Any:
    """Return the function of a stage's argument from x (n,), h and previous rates; CasADi inlines it fast."""
    x, h, *k = (ca.SX.sym("x", n), ca.SX.sym("h"), *(ca.SX.sym(f"k{i}", n) for i in range(len(row))))
    return ca.Function("stage", [x, h, *k], [x + h * _combine_runge_kutta_stages(row, k)])


@cache
def _build_dense_output_function(n: int) -> Any:
    """Return the function of the state (n,) and its rate within a step from nu, x, h and the rates of all stages."""
    nu, x, h = ca.SX.sym("nu"), ca.SX.sym("x", n), ca.SX.sym("h")
    k, remaining = [ca.SX.sym(f"k{i}", n) for i in range(len(STAGES))], 1 - nu
    mean = _combine_runge_kutta_stages(STAGES[-1], k[:-1])
    first = k[0] - mean
    last = mean - k[-1] - first
    bubble = _combine_runge_kutta_stages(DENSE_WEIGHTS, k)
    inner = last + remaining * bubble
    middle, middle_slope = first + nu * inner, inner - nu * bubble
    outer, outer_slope = mean + remaining * middle, remaining * middle_slope - middle
    return ca.Function("inside", [nu, x, h, *k], [x + h * (nu * outer), outer + nu * outer_slope])


def _combine_runge_kutta_stages(weights: tuple[float, ...], k: list[Any]) -> Any:
    terms = [w * rate for w, rate in zip(weights, k, strict=True) if w != 0.0]
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return total
