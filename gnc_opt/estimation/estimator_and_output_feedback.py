"""Estimator: a discrete-time filter as CasADi functions with memory, and output feedback of its estimate."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import StrictAttributes, read_float_array, require_type, suggest_keywords
from gnc_opt.array_types import Array
from gnc_opt.control.design_report import DesignReport
from gnc_opt.control.discrete_time_controller import Controller, initial_state_function, law_function
from gnc_opt.errors import ArgumentError, suggest_similar_name
from gnc_opt.estimation.kalman_filter import COVARIANCE
from gnc_opt.model.model_variables import Layout, read_state_vector


@dataclass(frozen=True, eq=False)
class Estimator(StrictAttributes):
    """Discrete-time filter: ``update(t, y, z) -> (x, z)``, then ``predict(t, u, z) -> z`` for the next control step.

    The memory z contains the prediction for time t; y are the samples, x the estimated states.

    Attributes
    ----------
    name : str
    update, predict : casadi.Function
        ``(t, y, z) -> (x, z)`` and ``(t, u, z) -> z``, columns. x is NaN after ``hold`` steps without a sample.
    first : array (n_memory,)
        Initial memory.
    states, errors, measured, commands : Layout
        Names, sizes and units of x, of its error, of y and of u.
    pattern : casadi.Sparsity
        Sparsity of the lower triangle of the error covariance, in the order of ``covariance``.
    memory : Layout
        ``<state>_hat``, ``<measurement>_bias_hat``, ..., ``covariance`` (nonzeros of its lower triangle), and for each
        measurement ``<measurement>_nis`` (sum of the normalised innovations squared), ``_taken`` and ``_refused``
        (counts).
    error : casadi.Function
        ``(x, x_ref) -> e``, the state error.
    sizes : mapping of str to int
        Number of error components of each measurement.
    dt : float
        Control step, s.
    explanation : DesignReport
    gates : mapping of str to float
        Probability that a valid sample passes, for each measurement with a gate.

    Examples
    --------
    >>> from gnc_opt.estimation import Measurement
    >>> ekf = go.design_ekf(cart, [1, 0], [Measurement("q", 1e-3)], sigma0={"q": 0.1, "v": 0.02}, dt=0.1)
    >>> _, memory = ekf(0.0, [1.05], [0.0])
    >>> print(np.round(ekf.estimate(memory), 3), np.round(np.sqrt(np.diag(ekf.covariance(memory))), 4))
    [1.05 0.  ] [0.0022 0.02  ]
    """

    name: str
    update: Any
    predict: Any
    first: Array
    states: Layout
    errors: Layout
    measured: Layout
    commands: Layout
    pattern: Any
    memory: Layout
    error: Any
    sizes: dict[str, int]
    dt: float
    explanation: DesignReport
    gates: dict[str, float] = field(default_factory=dict)

    def explain(self) -> DesignReport:
        """Return the design report."""
        return self.explanation

    def __call__(
        self, t: float, y: ArrayLike, u: ArrayLike, z: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Evaluate one step: return the estimated states (n_states,) at t and the memory (n_memory,) for the next step.

        Parameters
        ----------
        t : float
            Start of the step, s.
        y : array (n_measured,)
            Samples; NaN if missing.
        u : array (n_commands,)
            Command from t to the next step.
        z : array (n_memory,), optional
            Memory; default: the initial memory.
        """
        sample = read_state_vector(
            y, self.measured.size, f"the samples given to '{self.name}'", ArgumentError
        )
        command = read_state_vector(
            u, self.commands.size, f"the command given to '{self.name}'", ArgumentError
        )
        x, after = self.update(
            float(t), sample, self.first if z is None else self._select_estimator_memory_rows(z)
        )
        return np.asarray(x.full()[:, 0]), np.asarray(self.predict(float(t), command, after).full()[:, 0])

    def estimate(self, memory: ArrayLike) -> Array:
        """Return the predicted states from memories (n_memory,) or (n_memory, n), for the times of the memories."""
        rows = self._select_estimator_memory_rows(memory)
        return np.concatenate([rows[self.memory.slice(f"{name}_hat")] for name in self.states.names])

    def covariance(self, memory: ArrayLike) -> Array:
        """Return the covariance of the state errors, (n_errors, n_errors), for each memory (n_memory,)."""
        column = self._select_estimator_memory_rows(memory)[self.memory.slice(COVARIANCE)]
        rows, columns = (np.array(k, dtype=np.int64) for k in self.pattern.get_triplet())
        size, states = self.pattern.size1(), self.errors.size
        full = np.zeros((size, size, *column.shape[1:]))
        full[rows, columns] = full[columns, rows] = column
        own = full[:states, :states]
        return np.moveaxis(own, -1, 0) if column.ndim > 1 else own

    def _select_estimator_memory_rows(self, values: ArrayLike) -> Array:
        """Return the estimator's rows of a memory, the first ones in the memory of `output_feedback`."""
        what = f"the memory given to '{self.name}'"
        memory = read_float_array(values, what)
        if memory.ndim not in (1, 2) or memory.shape[0] < self.memory.size:
            raise ArgumentError(f"{what} has the shape {memory.shape}: it has {self.memory.size} rows.")
        return memory[: self.memory.size]


@suggest_keywords
def output_feedback(controller: Controller, estimator: Estimator) -> Controller:
    """Return a controller that feeds back the estimate of a filter.

    After more than ``hold`` steps without a sample the controller gets NaN, see `with_dropout_handling`.

    Parameters
    ----------
    controller : Controller
        Controller whose states are estimated.
    estimator : Estimator
        Its commands are a subset of the controller's; it assumes that they are applied without change.

    Returns
    -------
    Controller
        Its ``states`` are the measurements, in design order. Its memory is the estimator's, then the controller's.

    Raises
    ------
    ArgumentError
        Controller and estimator are not compatible.

    Examples
    --------
    >>> from gnc_opt.estimation import Measurement
    >>> ekf = go.design_ekf(cart, [1, 0], [Measurement("q", 1e-3)], sigma0={"q": 0.1, "v": 0.02}, dt=0.1)
    >>> law = go.output_feedback(regulator, ekf)
    >>> print(regulator.states.names, law.states.names)  # the speed is not measured any more
    ('q', 'v') ('q',)
    """
    require_type(
        controller, Controller, "the controller of output_feedback()", "give the result of a design function"
    )
    require_type(
        estimator,
        Estimator,
        "the estimator of output_feedback()",
        "give the result of design_ekf() or design_ukf()",
    )
    if controller.estimated is not None:
        raise ArgumentError(
            f"controller '{controller.name}' already includes an estimator: give the controller inside."
        )
    controller.step_length(estimator.dt)
    rows = _find_variable_row_indices(
        controller.states, estimator.states, "state", controller.name, estimator.name
    )
    sent = _find_variable_row_indices(
        estimator.commands, controller.commands, "command", estimator.name, controller.name
    )
    _require_distinct_memory_variables(controller, estimator)
    step, start = _combine_controller_with_estimator(controller, controller.step, estimator, rows, sent)
    unconstrained_law = (
        controller.unconstrained_law
        and _combine_controller_with_estimator(
            controller, controller.unconstrained_law, estimator, rows, sent
        )[0]
    )
    report, codegen_law = controller.explanation, controller.codegen_law
    return replace(
        controller,
        name=f"{controller.name}_{estimator.name}",
        step=step,
        start=start,
        states=estimator.measured,
        estimated=controller.states,
        memory=Layout(
            "memory",
            (*estimator.memory.variables, *controller.memory.variables),
            f"controller '{controller.name}' with '{estimator.name}'",
        ),
        dt=estimator.dt,
        explanation=DesignReport(
            f"{report.title}, with the {estimator.explanation.title}",
            (*report.facts, *estimator.explanation.facts),
        ),
        without_dropout_handling=None,
        codegen_law=None
        if codegen_law is None
        else replace(codegen_law, controller=output_feedback(codegen_law.controller, estimator)),
        unconstrained_law=unconstrained_law,
    )


def _combine_controller_with_estimator(
    controller: Controller, bare: Any, estimator: Estimator, fed: list[int], sent: list[int]
) -> tuple[Any, Any]:
    """Return law and initial memory of controller and estimator, for the controller's full or unconstrained law."""
    scalar = bare.is_a("SXFunction") and controller.start.is_a("SXFunction")
    kind = ca.SX if scalar else ca.MX
    size = estimator.memory.size
    t, y = kind.sym("t"), kind.sym("y", estimator.measured.size)
    r, z = kind.sym("r", controller.signals.size), kind.sym("z", size + controller.memory.size)
    estimator_memory, inner = ca.vertsplit(z, [0, size, size + controller.memory.size])
    x, after = estimator.update(t, y, estimator_memory)
    u, inner_after, *valid = bare(t, x[fed], r, inner)
    step = law_function(t, y, r, z, u, ca.vertcat(estimator.predict(t, u[sent], after), inner_after), *valid)
    x_first, _ = estimator.update(t, y, ca.DM(estimator.first))
    initial = ca.vertcat(ca.DM(estimator.first), controller.start(t, x_first[fed], r))
    return step, initial_state_function(t, y, r, initial)


def _find_variable_row_indices(layout: Layout, given: Layout, kind: str, whose: str, where: str) -> list[int]:
    rows: list[int] = []
    for v in layout.variables:
        if v.name not in given:
            raise ArgumentError(
                f"'{whose}' needs the {kind} '{v.name}', which '{where}' does not have: "
                f"{suggest_similar_name(v.name, given.names)}"
            )
        if given[v.name].size != v.size:
            raise ArgumentError(
                f"{kind} '{v.name}' has {v.size} components in '{whose}' and {given[v.name].size} in '{where}'."
            )
        place = given.slice(v.name)
        rows += range(place.start, place.stop)
    return rows


def _require_distinct_memory_variables(controller: Controller, estimator: Estimator) -> None:
    for name in estimator.memory.names:
        if name in controller.memory:
            raise ArgumentError(
                f"'{controller.name}' and '{estimator.name}' both have the memory '{name}': rename the state or output."
            )
