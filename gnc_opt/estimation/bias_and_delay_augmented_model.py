r"""Augmented model of a filter: the vehicle's states, sensor biases and delay lines.

1. *Biases*: constant or drifting errors of sensors, :math:`\dot b = w`.
2. *Delay lines*: for samples that are d control steps late, the outputs 1, ..., d steps ago, shifted at the
   end of each step (Simon, Optimal State Estimation, 2006, section 10.5).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.array_types import Array
from gnc_opt.control.sampled_data_discretization import count_steps_in_duration
from gnc_opt.errors import ArgumentError, DesignError, unknown_name_error
from gnc_opt.estimation.error_state_coordinates import (
    Space,
    build_euclidean_error_coordinates,
    build_stacked_error_coordinates,
)
from gnc_opt.estimation.measurement_model import Measurement
from gnc_opt.model.casadi_function_evaluation import take_runge_kutta_step
from gnc_opt.model.model_variables import Layout, Variable, evaluate_user_function_as_column
from gnc_opt.model.symbolic_dynamics_model import Model

_MAX_DELAYED_COMPONENTS = 200
"""Largest number of delayed components; the cost of the filter grows with the cube of its states."""


@dataclass(frozen=True)
class MeasurementChannel:
    """Measurement with its variable, error space, period and delay (control steps)."""

    measurement: Measurement
    variable: Variable
    space: Space
    period: int
    delay: int

    @property
    def name(self) -> str:
        return self.measurement.of

    @property
    def bias_state_name(self) -> str:
        """Name of the bias among the estimated states."""
        return f"{self.name}_bias"

    def get_delayed_state_name(self, steps: int) -> str:
        return f"{self.name}_{steps}_ago"

    @property
    def has_steps_without_measurement(self) -> bool:
        """Whether some control steps have no new sample."""
        return self.period > 1 or self.delay > 0


class AugmentedModel:
    """Model with sensor biases and delay lines for control steps of dt (s); ``vehicle``: the model's own states."""

    def __init__(self, model: Model, measurements: Sequence[Measurement], dt: float) -> None:
        self.model, self.dt = model, dt
        self.channels = tuple(_build_measurement_channel(model, m, dt) for m in measurements)
        parts = [(v, _build_state_error_coordinates(model, v)) for v in model.states.variables]
        for channel in self.channels:
            unit, name = channel.variable.unit, channel.name
            if channel.measurement.has_bias:
                parts.append(
                    (
                        Variable(channel.bias_state_name, channel.space.errors, unit),
                        build_euclidean_error_coordinates(channel.space.errors),
                    )
                )
            for k in range(1, channel.delay + 1):
                parts.append(
                    (Variable(channel.get_delayed_state_name(k), channel.variable.size, unit), channel.space)
                )
            names = [v.name for v, _ in parts]
            if len(set(names)) < len(names):
                raise ArgumentError(
                    f"the estimated bias or delay of '{name}' would be called like a state: rename that."
                )
        owner = f"the estimator of '{model.name}'"
        self.states = Layout("estimate", tuple(v for v, _ in parts), owner)
        self.errors = Layout("error", tuple(Variable(v.name, s.errors, v.unit) for v, s in parts), owner)
        self.space = build_stacked_error_coordinates([space for _, space in parts])
        self.vehicle = build_stacked_error_coordinates(
            [space for _, space in parts[: len(model.states.variables)]]
        )
        t, state, u, p = model.symbolic_arguments()
        slope = ca.substitute(ca.jacobian(model.state_derivative(), state), p, model.parameter_values)
        self._jacobian = ca.Function("A", [t, state, u], [slope])

    def build_state_flow_function(self, h: float) -> Any:
        """Return ``(t, x, u) -> x`` after h (s) by the classical Runge-Kutta method, for constant u."""
        model, n = self.model, self.model.states.size
        t, x, u = ca.SX.sym("t"), ca.SX.sym("x", self.states.size), ca.SX.sym("u", model.controls.size)

        def evaluate_dynamics(at: Any, vehicle_state: Any, u: Any) -> Any:
            return model.function(at, vehicle_state, u, model.parameter_values)

        vehicle_state, constant_states = ca.vertsplit(x, [0, n, self.states.size])
        after = take_runge_kutta_step(evaluate_dynamics, t, h, vehicle_state, [u] * 3)
        return ca.Function("flow", [t, x, u], [ca.vertcat(after, constant_states)])

    def discretize_error_dynamics(
        self, t: Any, x: Any, after: Any, u: Any, h: float, density: Any
    ) -> tuple[Any, Any, Any]:
        """Return F (n_errors, n_errors) of a step h (s), and noise terms: P becomes F (P + early) F' + late."""
        n = self.model.states.size
        start, end = x[:n], after[:n]
        middle = 0.5 * (start + end)
        A = self._jacobian(t + h / 2, middle, u)
        last, vehicle = self.vehicle.build_state_difference_jacobian(end), self.vehicle
        identity = ca.SX.eye(self.errors.size - vehicle.errors)
        unit, square = ca.SX.eye(n), A @ A
        change = unit + h * A + square @ (h**2 / 2 * unit + h**3 / 6 * A + h**4 / 24 * square)
        full = ca.diagcat(last @ change @ vehicle.build_state_retraction_jacobian(start), identity)
        change = unit + h / 2 * A + h**2 / 8 * square  # second order suffices for the noise
        half = ca.diagcat(last @ change @ vehicle.build_state_retraction_jacobian(middle), identity)
        return full, h / 6 * density, h / 6 * (4 * half @ density @ half.T + density)

    def find_constant_measurement_jacobian(self, channel: MeasurementChannel) -> Any:
        """Return the constant Jacobian (m, n_errors) of a measurement that is linear in the errors, else ``None``."""
        biased, m = channel.measurement.has_bias, channel.space.errors
        if channel.measurement.difference is not None:
            return None
        if channel.delay:
            names = [channel.get_delayed_state_name(channel.delay)]
        elif channel.name not in self.model.states or (biased and m != channel.space.size):
            return None
        else:
            names = [channel.name, *([channel.bias_state_name] if biased else [])]
        slope = ca.SX(m, self.errors.size)
        for name in names:
            slope[:, self.errors.slice(name)] = ca.SX.eye(m)
        return slope

    def build_undelayed_output_function(self, channel: MeasurementChannel) -> Any:
        """Return ``(t, x) -> y``: the sensor's output without noise and delay."""
        model = self.model
        time, xs, _, p = model.symbolic_arguments()
        t, x = ca.SX.sym("t"), ca.SX.sym("x", self.states.size)
        name = channel.name
        if name in model.states:
            y = x[model.states.slice(name)]
        else:
            values = ca.vertcat(t, x[: model.states.size], model.parameter_values)
            y = ca.substitute(model.output_expression(name), ca.vertcat(time, xs, p), values)
        if channel.measurement.has_bias:
            y = channel.space.retraction(y, x[self.states.slice(channel.bias_state_name)])
        return ca.Function("now", [t, x], [y])

    def build_delayed_output_function(self, channel: MeasurementChannel) -> Any:
        """Return ``(t, x) -> y``: the sensor's output at t (s) without noise."""
        if not channel.delay:
            return self.build_undelayed_output_function(channel)
        t, x = ca.SX.sym("t"), ca.SX.sym("x", self.states.size)
        return ca.Function(
            "observed", [t, x], [x[self.states.slice(channel.get_delayed_state_name(channel.delay))]]
        )

    @property
    def has_delay_lines(self) -> bool:
        return any(channel.delay for channel in self.channels)

    def build_delay_shift_function(self) -> Any:
        """Return ``(t, x) -> x`` with the delay lines shifted by one step."""
        t, x = ca.SX.sym("t"), ca.SX.sym("x", self.states.size)
        parts = {name: x[self.states.slice(name)] for name in self.states.names}
        new = dict(parts)
        for channel in self.channels:
            for k in range(1, channel.delay + 1):
                new[channel.get_delayed_state_name(k)] = (
                    self.build_undelayed_output_function(channel)(t, x)
                    if k == 1
                    else parts[channel.get_delayed_state_name(k - 1)]
                )
        return ca.Function("shift", [t, x], [ca.vertcat(*new.values())])

    def stack_initial_standard_deviations(self, states: Array, bias: str) -> Array:
        """Return the initial standard deviations (n_errors,) of states and biases; those of delay lines are 0."""
        sigma = np.zeros(self.errors.size)
        sigma[: states.size] = states
        for channel in self.channels:
            if channel.measurement.has_bias:
                place = self.errors.slice(channel.bias_state_name)
                sigma[place] = channel.measurement.read_noise_per_component(bias, channel.space.errors)
        return sigma

    def build_initial_augmented_state(self, t: float, x: Array) -> Array:
        """Return the initial augmented state (n_states,): zero bias, delay lines at the initial measurement."""
        initial = np.zeros(self.states.size)
        initial[: x.size] = x
        for channel in self.channels:
            for k in range(1, channel.delay + 1):
                initial[self.states.slice(channel.get_delayed_state_name(k))] = (
                    self.build_undelayed_output_function(channel)(t, initial).full()[:, 0]
                )
        return initial


def _build_state_error_coordinates(model: Model, variable: Variable) -> Space:
    """Return the space of a state, with the model's own difference and retraction."""
    states, errors = model.states, model.errors
    rows, error_rows = states.slice(variable.name), errors.slice(variable.name)

    def pad_variable_to_full_state(x: Any) -> Any:
        return ca.vertcat(ca.SX.zeros(rows.start), x, ca.SX.zeros(states.size - rows.stop))

    def compute_state_variable_error(x: Any, ref: Any) -> Any:
        return model.state_error_expression(pad_variable_to_full_state(x), pad_variable_to_full_state(ref))[
            error_rows
        ]

    def retract_state_variable(ref: Any, e: Any) -> Any:
        error = ca.vertcat(ca.SX.zeros(error_rows.start), e, ca.SX.zeros(errors.size - error_rows.stop))
        return model.retraction_expression(pad_variable_to_full_state(ref), error)[rows]

    return Space(
        variable.size, errors[variable.name].size, compute_state_variable_error, retract_state_variable
    )


def _build_measurement_channel(model: Model, measurement: Measurement, dt: float) -> MeasurementChannel:
    name = measurement.of
    if name in model.states:
        variable = model.states[name]
        space = _build_state_error_coordinates(model, variable)
    elif name in model.outputs:
        variable = model.outputs[name]
        if any(ca.which_depends(model.output_expression(name), model.symbols("control"))):
            raise DesignError(
                f"output '{name}' of model '{model.name}' depends on a control, which is unknown at that time: "
                "name one of states alone."
            )
        space = build_euclidean_error_coordinates(variable.size)
    else:
        raise unknown_name_error(
            "measurement", name, f"model '{model.name}'", [*model.states.names, *model.outputs.names]
        )
    if measurement.difference is not None:
        space = _set_measurement_residual_function(space, measurement.difference, name)
    for each in ("sigma", "bias", "bias_walk"):
        measurement.read_noise_per_component(each, space.errors)
    what = f"of the measurement of '{name}'"
    period = (
        1
        if measurement.period is None
        else count_steps_in_duration(measurement.period, dt, f"the period {what}")
    )
    if period < 1:
        raise ArgumentError(
            f"the period {what} is shorter than the control step of {dt:g} s: choose a multiple."
        )
    delay = count_steps_in_duration(measurement.delay, dt, f"the delay {what}")
    if delay * space.errors > _MAX_DELAYED_COMPONENTS:
        raise ArgumentError(
            f"the delay {what} is {delay} control steps, and the filter estimates {space.errors} of each: more than "
            f"{_MAX_DELAYED_COMPONENTS} take too long; give a longer control step, or a shorter delay."
        )
    return MeasurementChannel(measurement, variable, space, period, delay)


def _set_measurement_residual_function(space: Space, function: Callable[[Any, Any], Any], name: str) -> Space:
    x, ref = ca.SX.sym("x", space.size), ca.SX.sym("x_ref", space.size)
    remedy = f"return {space.errors} components of a sample and its prediction, lambda y, y_hat: ..."
    what = f"the difference of the measurement of '{name}'"
    if not ca.symvar(evaluate_user_function_as_column(function, (x, ref), space.errors, what, remedy)):
        raise ArgumentError(f"{what} does not depend on its arguments: {remedy}.")
    return Space(space.size, space.errors, function, space.retraction)
