r"""Tracking error on the state manifold, and its linearised dynamics.

With the model's error :math:`e = d(x, x_r)` (subtraction unless `Model.difference` says otherwise),

.. math:: \dot e = \frac{\partial d}{\partial x} f(t, x, u) + \frac{\partial d}{\partial x_r} f(t, x_r, u_r)
   \approx A\, e + B\, (u - u_r), \qquad A = \left.\frac{\partial \dot e}{\partial x}\right|_r T, \quad
   B = \left.\frac{\partial \dot e}{\partial u}\right|_r,

where T, the pseudo-inverse of :math:`\partial d/\partial x`, maps an error to a change of the state.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.array_types import Array
from gnc_opt.errors import DesignError
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_batch
from gnc_opt.model.model_variables import Layout
from gnc_opt.model.symbolic_dynamics_model import Model


class ErrorDynamics:
    """Tracking errors of a model's states and their linearised dynamics along a reference.

    Attributes
    ----------
    model : Model
    errors : Layout
        Layout of e; its size is ``n_errors`` below.

    Examples
    --------
    >>> A, B = ErrorDynamics(cart).linearize(0.0, [1.0, 0.0], [0.0])
    >>> print(A.tolist(), B.tolist())
    [[0.0, 1.0], [0.0, 0.0]] [[0.0], [1.0]]
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.errors: Layout = model.errors
        _, xs, us, _ = model.symbolic_arguments()
        self._x, self._u = xs, us
        self._x_ref = ca.SX.sym("x_ref", model.states.size)

    def state_error_expression(self, x: Any, x_ref: Any) -> Any:
        """Return e as an SX expression of SX columns x and x_ref."""
        return self.model.state_error_expression(x, x_ref)

    def __call__(self, x: ArrayLike, x_ref: ArrayLike) -> Array:
        """Return e, (n_errors,) or (n_errors, n_times), for states of shape (n_states,) or (n_states, n_times)."""
        value = np.asarray(self._tracking_error_function(np.asarray(x), np.asarray(x_ref)).full())
        return value if max(np.ndim(x), np.ndim(x_ref)) == 2 else value[:, 0]

    def linearize(self, t: float, x_ref: ArrayLike, u_ref: ArrayLike) -> tuple[Array, Array]:
        """Return A (n_errors, n_errors) and B (n_errors, n_controls) at t (s), state x_ref and control u_ref."""
        columns = (np.asarray(v, dtype=float).reshape(-1, 1) for v in (x_ref, u_ref))
        a, b = self.linearize_error_dynamics_at_times(np.array([t], dtype=float), *columns)
        return a[0], b[0]

    def linearize_error_dynamics_at_times(
        self, times: Array, x_ref: Array, u_ref: Array
    ) -> tuple[Array, Array]:
        """Return A (n, n_errors, n_errors) and B (n, n_errors, n_controls) at n times, columns of x_ref and u_ref."""
        n, rows = self.model.states.size, self.errors.size
        p = self.model.parameter_values
        flat = evaluate_casadi_batch(
            self._tracking_error_jacobian_function, times.size, times[None], x_ref, u_ref, p
        )
        matrices = np.swapaxes(flat.T.reshape(times.size, -1, rows), 1, 2)
        jacobian, x_jacobian, u_jacobian = np.split(matrices, [n, 2 * n], axis=2)
        if n == rows and np.array_equal(jacobian, np.broadcast_to(np.eye(n), jacobian.shape)):
            return x_jacobian, u_jacobian
        return x_jacobian @ np.linalg.pinv(jacobian), u_jacobian

    def output_expression(self, name: str, t: Any, x: Any) -> Any:
        """Return an output as an SX expression of t and x; raise `DesignError` if it depends on a control."""
        time, xs, us, p = self.model.symbolic_arguments()
        y = self.model.output_expression(name)
        if any(ca.which_depends(y, us)):
            raise DesignError(
                f"output '{name}' of model '{self.model.name}' depends on a control: name one of states alone."
            )
        return ca.substitute(y, ca.vertcat(time, xs, p), ca.vertcat(t, x, self.model.parameter_values))

    def linearize_output(self, name: str, t: float, x_ref: ArrayLike, u_ref: ArrayLike) -> Array:
        """Return C (n_rows, n_errors), the Jacobian of output ``name`` in the errors, at t (s), x_ref, u_ref."""
        y = self.output_expression(name, self.model.time, self._x)
        slope = ca.Function("slope", [self.model.time, self._x], [ca.jacobian(y, self._x)])
        jacobian = self._tracking_error_jacobian_function(t, x_ref, u_ref, self.model.parameter_values).full()
        return np.asarray(slope(t, x_ref).full() @ np.linalg.pinv(jacobian[:, : self.model.states.size]))

    @cached_property
    def _tracking_error_function(self) -> Any:
        return ca.Function("e", [self._x, self._x_ref], [self.state_error_expression(self._x, self._x_ref)])

    @cached_property
    def _tracking_error_jacobian_function(self) -> Any:
        t, x, u, p = self.model.symbolic_arguments()
        x_ref, u_ref = self._x_ref, ca.SX.sym("u_ref", u.shape)
        f = self.model.state_derivative()
        f_ref = ca.substitute(f, ca.vertcat(x, u), ca.vertcat(x_ref, u_ref))
        e = self.state_error_expression(x, x_ref)
        rate = ca.jtimes(e, x, f) + ca.jtimes(e, x_ref, f_ref)
        outputs = [ca.jacobian(e, x), ca.jacobian(rate, x), ca.jacobian(rate, u)]
        on_reference = [ca.substitute(o, ca.vertcat(x, u), ca.vertcat(x_ref, u_ref)) for o in outputs]
        return ca.Function("jacobians", [t, x_ref, u_ref, p], [ca.densify(ca.horzcat(*on_reference))])
