r"""Input-output linearisation: Lie derivatives, relative degree, decoupling matrix, zero dynamics (symbolic).

Along :math:`\dot x = f(t, x, u)` an output h(t, x) changes by
:math:`\dot h = \partial_t h + (\partial_x h) f`. Its relative degree r is the order of the first derivative that a
control enters; with f affine in u,

.. math:: h^{(r)} = a(t, x) + E(t, x)\, u .

Tracking errors :math:`e(x, x_r)` are differentiated along plant and reference (`PlantPair`): plain outputs,
:math:`e = h(x) - h(x_r)`, or rotations. (A. Isidori, Nonlinear Control Systems, 3rd ed., ch. 4 and 5.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
import scipy
from numpy.typing import ArrayLike

from gnc_opt.array_types import Array
from gnc_opt.control.reference_trajectory import Reference
from gnc_opt.errors import DesignError, unknown_name_error
from gnc_opt.model.model_variables import convert_to_sx_column
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.numerical_tolerances import ROUNDING, is_rank_deficient

Outputs: TypeAlias = str | Sequence[Any] | Mapping[str, Any]
"""Controlled outputs: one or several names, SX expressions of (t, x, p), or a mapping from names to these."""


@dataclass(frozen=True, eq=False)
class PlantPair:
    """Plant and reference with the same dynamics; f, f_ref (SX): dx/dt of each."""

    model: Model
    t: Any
    x: Any
    u: Any
    x_ref: Any
    u_ref: Any
    f: Any
    f_ref: Any

    @classmethod
    def from_affine_model(cls, model: Model) -> PlantPair:
        """Return the pair of a model; `DesignError` unless the controls enter dx/dt affinely."""
        t, x, u, p = model.symbolic_arguments()
        f = ca.substitute(model.state_derivative(), p, ca.DM(model.parameter_values))
        bent = [model.controls.labels[j] for j in range(u.numel()) if ca.depends_on(ca.jacobian(f, u), u[j])]
        if bent:
            raise DesignError(
                f"control '{bent[0]}' of model '{model.name}' does not enter its dynamics affinely: "
                "make it a state and its rate the control."
            )
        x_ref, u_ref = ca.SX.sym("x_ref", x.numel()), ca.SX.sym("u_ref", u.numel())
        f_ref = ca.substitute(f, ca.vertcat(x, u), ca.vertcat(x_ref, u_ref))
        return cls(model, t, x, u, x_ref, u_ref, f, f_ref)

    def compute_lie_derivative(self, e: Any) -> Any:
        """Return the time derivative of e(t, x, x_ref) along plant and reference, for constant u_ref."""
        return (
            ca.jtimes(e, self.t, ca.SX(1))
            + ca.jtimes(e, self.x, self.f)
            + ca.jtimes(e, self.x_ref, self.f_ref)
        )

    def replace_plant_by_reference_variables(self, expression: Any) -> Any:
        """Return an expression with the plant's variables replaced by the reference's."""
        return ca.substitute(expression, ca.vertcat(self.x, self.u), ca.vertcat(self.x_ref, self.u_ref))

    def build_function_of_plant_and_reference(self, *expressions: Any) -> Any:
        """Return the CasADi function ``(t, x, u, x_ref, u_ref) -> expressions``."""
        return ca.Function("pair", [self.t, self.x, self.u, self.x_ref, self.u_ref], list(expressions))

    def evaluate_expression_on_reference(
        self, reference: Reference, times: Array, expression: Any
    ) -> list[Array]:
        """Return the values of an expression on the reference at ``times`` (s)."""
        function = self.build_function_of_plant_and_reference(expression)
        points = ((t, reference.x(t), reference.u(t)) for t in times)
        return [np.asarray(function(t, x, u, x, u).full()) for t, x, u in points]


@dataclass(frozen=True, eq=False)
class OutputErrors:
    """Output errors: ``chains`` (e, de/dt, ...); the derivative of order r is ``drift + decoupling @ u``."""

    pair: PlantPair
    labels: tuple[str, ...]
    chains: tuple[Any, ...]
    drift: Any
    decoupling: Any

    @property
    def relative_degrees(self) -> tuple[int, ...]:
        """The relative degrees, one per component."""
        return tuple(chain.numel() for chain in self.chains)

    @property
    def n_outputs(self) -> int:
        return len(self.labels)

    @property
    def decoupling_determinant(self) -> Any:
        """det E, or (det E E^T)^(1/2) if there are more controls than outputs."""
        e = self.decoupling
        return ca.det(e) if e.shape[0] == e.shape[1] else ca.sqrt(ca.det(e @ e.T))


def lie_derivative(model: Model, expression: Any, order: int = 1) -> Any:
    """Return the time derivative of an expression of (t, x, p) along the model, SX of (t, x, u, p).

    Higher orders require that no control enters a lower derivative.

    Parameters
    ----------
    model : Model
    expression : casadi SX
        Expression of the model's time, states and parameters.
    order : int
        Order of the derivative, >= 1.

    Examples
    --------
    >>> print(lie_derivative(cart, q, 2))
    a
    """
    t, x, _, _ = model.symbolic_arguments()
    h = convert_to_sx_column(expression, "the expression to differentiate", failure=DesignError)
    for _ in range(order):
        h = ca.jtimes(h, t, ca.SX(1)) + ca.jtimes(h, x, model.state_derivative())
    return h


def output_errors(model: Model, reference: Reference, outputs: Outputs) -> OutputErrors:
    """Return output errors and their derivatives up to the relative degree, the input of `zero_dynamics`.

    Parameters
    ----------
    model : Model
    reference : Reference
        The relative degrees are determined near it.
    outputs : name, names, expressions or mapping
        See `Outputs`.

    Raises
    ------
    DesignError
        A control enters an output directly, non-affinely or not at all, or there are more outputs than controls.

    Examples
    --------
    >>> errors = output_errors(cart, go.Reference(solution), "q")
    >>> print(errors.relative_degrees)
    (2,)
    """
    pair = PlantPair.from_affine_model(model)
    return build_output_derivative_chains(pair, reference, build_output_error_expressions(pair, outputs))


def build_output_derivative_chains(
    pair: PlantPair, reference: Reference, expressions: Mapping[str, Any]
) -> OutputErrors:
    """Return the output errors of expressions of (t, x, x_ref), by name; raises as `output_errors`."""
    model = pair.model
    named = {
        label: row
        for name, e in expressions.items()
        for label, row in zip(_list_output_component_labels(name, e.numel()), ca.vertsplit(e), strict=True)
    }
    if len(named) > pair.u.numel():
        raise DesignError(
            f"model '{model.name}' has {pair.u.numel()} control{'s' * (pair.u.numel() > 1)} for "
            f"{len(named)} outputs ({', '.join(named)}): steer fewer, or a weighted sum of them."
        )
    chains, last = [], []
    for label, e in named.items():
        chain, rate = _differentiate_error_until_control_enters(pair, reference, label, e)
        chains.append(ca.vertcat(*chain))
        last.append(rate)
    rates = ca.vertcat(*last)
    zero_control = ca.DM.zeros(pair.u.numel())
    drift, decoupling = (
        ca.simplify(ca.densify(ca.substitute(value, pair.u, zero_control)))
        for value in (rates, ca.jacobian(rates, pair.u))
    )
    return OutputErrors(pair, tuple(named), tuple(chains), drift, decoupling)


def build_output_error_expressions(pair: PlantPair, outputs: Outputs) -> dict[str, Any]:
    """Return the error of each output, SX of (t, x, x_ref), by name."""
    if isinstance(outputs, Mapping):
        items: list[tuple[str, Any]] = list(outputs.items())
    else:
        listed = [outputs] if isinstance(outputs, (str, ca.SX)) else list(outputs)
        items = [(o, o) if isinstance(o, str) else (f"y{i}", o) for i, o in enumerate(listed)]
    if not items:
        raise DesignError("no outputs are given: name the states or outputs to steer.")
    return {name: _build_output_tracking_error(pair, name, output) for name, output in items}


def _build_output_tracking_error(pair: PlantPair, name: str, output: Any) -> Any:
    model = pair.model
    if isinstance(output, str):
        if output in model.states:
            return model.state_error_expression(pair.x, pair.x_ref)[model.errors.slice(output)]
        if output not in model.outputs:
            known = [*model.states.names, *model.outputs.names]
            raise unknown_name_error("state or output", output, f"model '{model.name}'", known)
        output = model.output_expression(output)
    h = convert_to_sx_column(output, f"output '{name}'", failure=DesignError)
    h = ca.substitute(h, model.symbols("parameter"), ca.DM(model.parameter_values))
    if ca.depends_on(h, pair.u):
        raise DesignError(
            f"output '{name}' contains a control, so that its relative degree is 0: choose an output of states."
        )
    return h - pair.replace_plant_by_reference_variables(h)


def _differentiate_error_until_control_enters(
    pair: PlantPair, reference: Reference, label: str, e: Any
) -> tuple[list[Any], Any]:
    """Return [e, de/dt, ...] without controls, and the first derivative that contains a control."""
    zero_control = ca.DM.zeros(pair.u.numel())
    chain = [e]
    for _ in range(pair.x.numel()):
        rate = pair.compute_lie_derivative(chain[-1])
        if _has_control_in_output_rate(pair, reference, chain[-1], rate):
            return chain, rate
        chain.append(ca.substitute(rate, pair.u, zero_control))
    raise DesignError(
        f"no control of model '{pair.model.name}' enters output '{label}' or any of its first "
        f"{pair.x.numel()} derivatives: its relative degree is not defined, steer another output."
    )


def _has_control_in_output_rate(pair: PlantPair, reference: Reference, e: Any, rate: Any) -> bool:
    """Return whether a control enters de/dt, tested numerically near the reference (terms may cancel)."""
    if not ca.depends_on(rate, pair.u):
        return False
    size = ca.fabs(ca.jacobian(e, pair.x)) @ ca.fabs(ca.jacobian(pair.f, pair.u))
    function = pair.build_function_of_plant_and_reference(ca.jacobian(rate, pair.u), size)
    random = np.random.default_rng(0)
    for t in np.linspace(reference.initial_time, reference.final_time, 5):
        x, u = reference.x(t), reference.u(t)
        nearby_state = x + 0.1 * random.uniform(-1, 1, x.size) * np.maximum(np.abs(x), 0.1)
        value, scale = (np.asarray(m.full()) for m in function(t, nearby_state, u, x, u))
        if np.any(np.abs(value) > ROUNDING * scale):
            return True
    return False


@dataclass(frozen=True)
class ZeroDynamics:
    """Dimension and eigenvalues (1/s) of the zero dynamics at one point; a proof only at equilibria."""

    dimension: int
    eigenvalues: Array

    @property
    def growth_rate(self) -> float:
        """Largest real part of the eigenvalues, 1/s; -inf without zero dynamics."""
        return float(np.max(self.eigenvalues.real, initial=-np.inf))


def zero_dynamics(errors: OutputErrors, t: float, x: ArrayLike, u: ArrayLike) -> ZeroDynamics:
    """Return the zero dynamics of outputs, linearised at (t, x, u).

    Let T e be the outputs and their derivatives in error coordinates (3 for a quaternion with a declared difference, 4
    without). The control that keeps the r-th derivatives at zero is -E^+ R e. The null space of T is therefore
    invariant under A - B E^+ R, whose eigenvalues there are returned.

    Parameters
    ----------
    errors : OutputErrors
        See `gnc_opt.control.input_output_linearization.output_errors`.
    t : float
        s.
    x : array (n_states,)
    u : array (n_controls,)

    Raises
    ------
    DesignError
        E is singular at this point.

    Examples
    --------
    If q + 2 v stays at zero, q obeys dq/dt = -q / 2:

    >>> errors = output_errors(cart, go.Reference(solution), {"mixed": q + 2 * v})
    >>> print(f"{zero_dynamics(errors, 0.5, [0.9, -0.5], [-1.0]).growth_rate:.3f}")
    -0.500
    """
    pair = errors.pair
    deviation = pair.model.state_error_expression(pair.x, pair.x_ref)
    rates = errors.drift + errors.decoupling @ pair.u
    function = pair.build_function_of_plant_and_reference(
        ca.jacobian(deviation, pair.x),
        ca.jacobian(pair.compute_lie_derivative(deviation), pair.x),
        ca.jacobian(pair.compute_lie_derivative(deviation), pair.u),
        ca.jacobian(ca.vertcat(*errors.chains), pair.x),
        ca.jacobian(rates, pair.x),
        errors.decoupling,
    )
    d, a, b, outputs, last, e = (np.asarray(m.full()) for m in function(t, x, u, x, u))
    singular = np.linalg.svd(e, compute_uv=False)
    if is_rank_deficient(singular):
        raise DesignError(
            f"the decoupling matrix is singular at t = {t:g} s (singular values {singular}): "
            "the outputs cannot be steered independently there."
        )
    to_state = np.linalg.pinv(d)
    still = scipy.linalg.null_space(outputs @ to_state)
    closed = (a - b @ np.linalg.pinv(e) @ last) @ to_state
    return ZeroDynamics(still.shape[1], np.linalg.eigvals(still.T @ closed @ still))


def get_output_component_setting(
    label: str, settings: Mapping[str, Any], errors: OutputErrors, where: str
) -> Any:
    """Return the entry of a mapping from outputs for one output component; ``None`` if missing."""
    known = [*errors.labels, *map(_get_output_name_of_component, errors.labels)]
    for key in settings:
        if key not in known:
            raise unknown_name_error("output", key, where, errors.labels)
    return settings.get(label, settings.get(_get_output_name_of_component(label)))


def _get_output_name_of_component(label: str) -> str:
    return label.partition("[")[0]


def _list_output_component_labels(name: str, size: int) -> list[str]:
    return [name] if size == 1 else [f"{name}[{i}]" for i in range(size)]
