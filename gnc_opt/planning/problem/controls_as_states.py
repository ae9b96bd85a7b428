r"""Controls as states of a phase: rate limits, polynomials in time; time-dependent bounds.

A control a with a rate limit becomes a state with :math:`\dot a = r` and the control r. A polynomial of degree n
becomes a state with constant coefficients c, in Legendre polynomials of the fraction :math:`\tau` of the phase,

.. math:: \dot a = 2 \dot\tau \sum_{k=1}^n c_k P_k'(2 \tau - 1), \qquad \dot c = 0.

The fraction obeys :math:`\dot\tau = s, \dot s = 0, \tau(t_0) = 0, \tau(t_f) = 1`, where s is the inverse of the
duration. Polynomials and the fraction start again in each phase.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.polynomial import legendre

from gnc_opt.argument_checks import read_integer, read_variable_name
from gnc_opt.errors import ProblemError, unknown_name_error
from gnc_opt.model.model_variables import Symbol, Variable, convert_to_sx_column
from gnc_opt.model.split_and_magnitude_direction_controls import VectorControl
from gnc_opt.model.symbolic_dynamics_model import Model

FRACTION, FRACTION_RATE = "fraction", "fraction_rate"
"""Names of the states for the elapsed fraction of the phase and its rate, 1/s."""


class MutablePhase(Protocol):
    """Interface of a phase for the declarations in this module."""

    model: Model
    own_states: frozenset[str]

    @property
    def is_linked(self) -> bool: ...

    @property
    def label(self) -> str: ...

    @property
    def fraction(self) -> Any: ...

    def add_states(self, rates: Mapping[Symbol, Any], controls: Sequence[Symbol] = ()) -> None: ...

    def bounds(self, **ranges: Any) -> None: ...

    def initial(self, **values: Any) -> None: ...

    def final(self, **values: Any) -> None: ...

    def path(self, name: str, expression: Any, *, lower: Any = None, upper: Any = None) -> None: ...

    def drop_path(self, name: str) -> None: ...


def limit_control_rates(phase: MutablePhase, ranges: Mapping[str, Any]) -> None:
    """Convert controls to states of a phase, with rates in given ranges; see `Phase.rates`."""
    _require_at_least_one_control_name(phase, ranges, "rates(u=(-1, 1))")
    for name, limits in ranges.items():
        symbol = _get_control_symbol(phase, name, "rates")
        v = symbol.variable
        rate = _create_state_symbol(phase, f"{name}_rate", v.size, f"{v.unit}/s" if v.unit else "1/s")
        phase.add_states({symbol: rate}, [rate])
        phase.bounds(**{rate.variable.name: limits})


def make_polynomial_controls(phase: MutablePhase, degrees: Mapping[str, int]) -> None:
    """Convert controls to polynomials of time over a phase; see `Phase.polynomials`."""
    _require_at_least_one_control_name(phase, degrees, "polynomials(u=3)")
    for name, value in degrees.items():
        symbol = _get_control_symbol(phase, name, "polynomials")
        degree = read_integer(value, f"the degree of control '{name}' in {phase.label}", 0, ProblemError)
        v = symbol.variable
        phase.own_states |= {name, f"{name}_coefficients"}
        if degree == 0:
            phase.add_states({symbol: ca.SX.zeros(v.size)})
            continue
        coefficients = _create_state_symbol(phase, f"{name}_coefficients", v.size * degree, v.unit)
        place, table = 2.0 * phase.fraction - 1.0, ca.reshape(coefficients, v.size, degree)
        slopes = [
            _evaluate_polynomial(legendre.leg2poly(legendre.legder(row)), place)
            for row in np.eye(degree + 1)[1:]
        ]
        rate = 2.0 * phase.model.symbol(FRACTION_RATE) * (table @ ca.vertcat(*slopes))
        phase.add_states({symbol: rate, coefficients: ca.SX.zeros(v.size * degree)})


def add_elapsed_fraction_state(phase: MutablePhase) -> Any:
    """Return the symbol of the fraction of a phase, a state added at the first call; see `Phase.fraction`."""
    if FRACTION not in phase.model.states:
        fraction = _create_state_symbol(phase, FRACTION, 1, "")
        rate = _create_state_symbol(phase, FRACTION_RATE, 1, "1/s")
        phase.add_states({fraction: rate, rate: ca.SX.zeros(1)})
        phase.own_states |= {FRACTION, FRACTION_RATE}
        phase.initial(fraction=0.0)
        phase.final(fraction=1.0)
    return phase.model.symbol(FRACTION)


def _evaluate_polynomial(polynomial: Any, x: Any) -> Any:
    return sum((float(c) * x**k for k, c in enumerate(polynomial)), ca.SX.zeros(1))


def _require_at_least_one_control_name(phase: MutablePhase, by_name: Mapping[str, Any], example: str) -> None:
    if not by_name:
        name = example.partition("(")[0]
        raise ProblemError(f"{name}() of {phase.label} names no control: write {example}.")


def _get_control_symbol(phase: MutablePhase, name: str, what: str) -> Symbol:
    layout, composed = phase.model.controls, phase.model.composed_controls
    if name in phase.model.states:
        is_converted = f"{name}_rate" in phase.model.controls or f"{name}_coefficients" in phase.own_states
        why = (
            "has rates or a degree already: state them once"
            if is_converted
            else "is a state: give the names of controls"
        )
        raise ProblemError(f"{what}() of {phase.label} got '{name}', which {why}.")
    owner = next((c.name for c in composed.values() if name == c.name or name in c.parts), None)
    if owner is not None:
        raise ProblemError(
            f"{what}() of {phase.label} got '{name}', but '{owner}' is made of several controls: "
            "declare it with control()."
        )
    if name in phase.model.algebraic_equations:
        raise ProblemError(
            f"{what}() of {phase.label} got '{name}', which is an algebraic variable: limit other controls."
        )
    if phase.is_linked:
        raise ProblemError(
            f"{what}() of {phase.label} is called after link() or sequence(), which link states: call it before."
        )
    if name not in layout:
        raise unknown_name_error("control", name, f"{what}() of {phase.label}", layout.names)
    return phase.model.symbol(name)


def _create_state_symbol(phase: MutablePhase, name: str, size: int, unit: str) -> Symbol:
    model = phase.model
    for layout in (model.states, model.controls, model.parameters, model.outputs):
        if name in layout:
            raise ProblemError(
                f"{phase.label} needs the name '{name}', which its model has as {layout.kind}: rename that."
            )
    return Symbol(Variable(read_variable_name(name, f"variable of {phase.label}", ProblemError), size, unit))


def split_time_dependent_bounds(phase: MutablePhase, ranges: Mapping[str, Any]) -> dict[str, Any]:
    """Return ranges with None in place of time-dependent ends, which become path constraints of a phase."""
    constant = dict(ranges)
    for name, value in ranges.items():
        for end in ("lower", "upper"):
            phase.drop_path(f"{end} bound of {name}")
        if _is_callable_of_time(value):
            raise ProblemError(
                f"the bounds of '{name}' in {phase.label} are one function: write (lower, upper), or use path()."
            )
        if isinstance(value, tuple) and len(value) == 2:
            constant[name] = tuple(None if _is_callable_of_time(end) else end for end in value)
            for end, limit in zip(("lower", "upper"), value, strict=True):
                if _is_callable_of_time(limit):
                    _add_time_dependent_bound(phase, name, end, limit)
    return constant


def _is_callable_of_time(end: Any) -> bool:
    return callable(end) or (isinstance(end, ca.SX) and not end.is_constant())


def _add_time_dependent_bound(phase: MutablePhase, name: str, end: str, limit: Any) -> None:
    """Add the path constraint of one end of a range: an expression, or a function of time that returns one."""
    model, what = phase.model, f"the {end} bound of '{name}' in {phase.label}"
    composed = model.composed_controls.get(name)
    if isinstance(composed, VectorControl):
        bounded = model.symbol(composed.magnitude)
    else:
        bounded = model.symbol(name) if composed is None else model.output_expression(name)
    value = convert_to_sx_column(limit(model.time) if callable(limit) else limit, what, None, ProblemError)
    if value.shape[0] not in (1, bounded.shape[0]):
        sizes = "1" if bounded.shape[0] == 1 else f"1 or {bounded.shape[0]}"
        raise ProblemError(f"{what} has {value.shape[0]} components: give {sizes}.")
    phase.path(f"{end} bound of {name}", bounded - value, **{end: 0.0})
