"""Design of extended and unscented Kalman filters, with a report of their properties."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import (
    read_display_name,
    read_integer,
    read_positive_number,
    require_type,
    suggest_keywords,
)
from gnc_opt.array_types import Array
from gnc_opt.control.control_limits_and_authority import read_control_limits
from gnc_opt.control.design_report import DesignReport, ReportEntry
from gnc_opt.control.riccati import find_uncontrollable_modes, solve_algebraic_riccati
from gnc_opt.errors import ArgumentError, DesignError
from gnc_opt.estimation.bias_and_delay_augmented_model import AugmentedModel
from gnc_opt.estimation.estimator_and_output_feedback import Estimator
from gnc_opt.estimation.jacobian_and_sigma_point_linearization import (
    Approximation,
    SigmaRegression,
    TangentModel,
)
from gnc_opt.estimation.kalman_filter import COVARIANCE, KalmanFilter
from gnc_opt.estimation.measurement_model import FilterOptions, Measurement, read_filter_options
from gnc_opt.model.model_variables import (
    Layout,
    format_names_with_units,
    read_state_vector,
    read_vector,
)
from gnc_opt.model.symbolic_dynamics_model import Model
from gnc_opt.numerical_tolerances import EQUAL
from gnc_opt.threads_and_package_versions import limit_to_one_thread


@limit_to_one_thread()
@suggest_keywords
def design_ekf(
    model: Model,
    x0: ArrayLike | Mapping[str, ArrayLike],
    measurements: Sequence[Measurement],
    *,
    sigma0: Deviations,
    dt: float,
    process_noise: Deviations | None = None,
    options: FilterOptions | None = None,
) -> Estimator:
    """Return an extended Kalman filter; multiplicative for states with a difference and a retraction.

    Parameters
    ----------
    model : Model
        Dynamics model of the filter.
    x0 : array (n_states,) or mapping by name
        Expected initial state, at the first control step.
    measurements : sequence of Measurement
        Measurements of states or outputs of the model.
    sigma0 : mapping
        Standard deviation of the initial error of every state; 0 if it is known exactly.
    dt : float
        Control step, s.
    process_noise : mapping, optional
        White noise on the rates of states: the standard deviation added to the state, in its unit per square root of a
        second; default 0.
    options : FilterOptions, optional
        Actuator limits, integration, lost samples, name.

    Raises
    ------
    ArgumentError, DesignError, UnknownNameError, ModelError
        Invalid numbers, unknown states, a measurement of controls, or a difference without an inverse retraction.

    Examples
    --------
    >>> ekf = go.design_ekf(cart, [1, 0], [Measurement("q", 1e-3)], sigma0={"q": 0.1, "v": 0.02}, dt=0.1)
    >>> x, memory = ekf(0.0, [1.05], [0.0])
    >>> print(np.round(x, 3))  # the sample is a hundred times better than the guess
    [1.05 0.  ]
    """
    chosen = read_filter_options(options, "EKF")
    design = FilterDesign(model, x0, measurements, (sigma0, process_noise), dt, chosen)
    return design.build_kalman_estimator(TangentModel(), "extended Kalman filter")


@limit_to_one_thread()
@suggest_keywords
def design_ukf(
    model: Model,
    x0: ArrayLike | Mapping[str, ArrayLike],
    measurements: Sequence[Measurement],
    *,
    sigma0: Deviations,
    dt: float,
    process_noise: Deviations | None = None,
    options: FilterOptions | None = None,
) -> Estimator:
    """Return an unscented Kalman filter, which needs no derivatives; multiplicative as in `design_ekf`.

    Parameters
    ----------
    model, x0, measurements, sigma0, dt, process_noise, options
        See `design_ekf`.

    Raises
    ------
    ArgumentError, DesignError, UnknownNameError, ModelError
        See `design_ekf`.

    Examples
    --------
    >>> ukf = go.design_ukf(cart, [1, 0], [Measurement("q", 1e-3)], sigma0={"q": 0.1, "v": 0.02}, dt=0.1)
    >>> filtered = go.ClosedLoop(cart, go.output_feedback(regulator, ukf), sensors=loop.sensors)
    >>> print(filtered.simulate([1.05, 0.01], tf=8.0).miss("q") < 0.01)
    True
    """
    chosen = read_filter_options(options, "UKF")
    design = FilterDesign(model, x0, measurements, (sigma0, process_noise), dt, chosen)
    return design.build_kalman_estimator(SigmaRegression(), "unscented Kalman filter")


Deviations: TypeAlias = Mapping[str, ArrayLike]
"""Standard deviations by name of the state, one number or one per error component."""


class FilterDesign:
    """Design data of a filter; ``sigma0``, ``noise`` (n_errors,): initial deviations and noise densities."""

    def __init__(
        self,
        model: Model,
        x0: ArrayLike | Mapping[str, ArrayLike],
        measurements: Sequence[Measurement],
        deviations: tuple[Deviations, Deviations | None],
        dt: float,
        options: FilterOptions,
    ) -> None:
        require_type(model, Model, "the model of an estimator", "give a Model")
        self.name = name = read_display_name(options.name, "estimator")
        model.state_derivative()
        self.model, self.dt = model, read_positive_number(dt, f"the control step of '{name}'")
        self.substeps = read_integer(options.substeps, f"substeps of '{name}'", 1)
        self.hold = read_integer(
            options.hold, f"the number of steps without samples that '{name}' bridges", 0
        )
        self.x0 = _read_initial_filter_state(model, x0, name)
        self.t0 = float(read_vector(options.t0, 1, f"t0 of '{name}'", ArgumentError)[0])
        if not np.isfinite(self.t0):
            raise ArgumentError(f"t0 of '{name}' is {self.t0:g}: give a finite time in s.")
        _check_retraction_inverts_difference(model, self.x0)
        sensors = measurements if isinstance(measurements, Sequence) else [measurements]
        for each in sensors:
            require_type(
                each, Measurement, f"one of the measurements of '{name}'", 'write Measurement("r", 0.1)'
            )
        if not sensors:
            raise ArgumentError(f"'{name}' measures nothing: give at least one Measurement.")
        names = [each.of for each in sensors]
        for of in names:
            if names.count(of) > 1:
                raise ArgumentError(
                    f"'{name}' measures '{of}' twice: declare an output of the model for the second sensor."
                )
        self.augmented = AugmentedModel(model, sensors, self.dt)
        sigma0, process_noise = deviations
        read = _read_standard_deviations(model, sigma0, f"sigma0 of '{name}'")
        missing = [n for n in model.states.names if n not in sigma0]
        if missing:
            raise ArgumentError(
                f"sigma0 of '{name}' has no entry for state '{missing[0]}': give every state, 0 if it is known exactly."
            )
        self.limits = read_control_limits(model, options.limits)
        self.sigma0 = self.augmented.stack_initial_standard_deviations(read, "bias")
        noise = _read_standard_deviations(
            model, {} if process_noise is None else process_noise, f"process_noise of '{name}'"
        )
        self.noise = self.augmented.stack_initial_standard_deviations(noise, "bias_walk")

    def build_kalman_estimator(self, linearization: Approximation, title: str) -> Estimator:
        """Return the filter with this linearization."""
        augmented, model = self.augmented, self.model
        filter_ = KalmanFilter(augmented, linearization, self.noise, self.limits, self.substeps, self.hold)
        first = np.zeros(filter_.memory.size)
        first[: augmented.states.size] = augmented.build_initial_augmented_state(self.t0, self.x0)
        rows, columns = (np.array(k, dtype=np.int64) for k in filter_.pattern.get_triplet())
        first[filter_.memory.slice(COVARIANCE)] = np.diag(self.sigma0**2)[rows, columns]
        for channel in augmented.channels:
            if channel.has_steps_without_measurement:
                first[filter_.memory.slice(f"{channel.name}_next")] = channel.delay
        x, x_ref = ca.SX.sym("x", model.states.size), ca.SX.sym("x_ref", model.states.size)
        return Estimator(
            name=self.name,
            update=filter_.measurement_update_function,
            predict=filter_.time_update_function,
            first=first,
            states=model.states,
            errors=model.errors,
            measured=Layout("measurement", tuple(c.variable for c in augmented.channels), f"'{self.name}'"),
            commands=model.controls,
            pattern=filter_.pattern,
            memory=filter_.memory,
            error=ca.Function("error", [x, x_ref], [model.state_error_expression(x, x_ref)]),
            sizes={c.name: c.space.errors for c in augmented.channels},
            gates={c.name: c.measurement.gate for c in augmented.channels if c.measurement.gate is not None},
            dt=self.dt,
            explanation=DesignReport(f"{title} of '{model.name}'", tuple(self._build_filter_design_report())),
        )

    def _build_filter_design_report(self) -> list[ReportEntry]:
        labels = self.augmented.errors.labels
        facts = [
            ReportEntry("estimated", format_names_with_units(self.augmented.errors.variables)),
            ReportEntry("initial standard deviation", self.sigma0),
            ReportEntry("process noise", self.noise, "", "in the units of the states per s^0.5"),
        ]
        for channel in self.augmented.channels:
            m = channel.measurement
            when = f"every {channel.period * self.dt:g} s"
            late = f", {channel.delay * self.dt:g} s late" if channel.delay else ""
            gate = f", gate {m.gate:g}" if m.gate is not None else ""
            facts.append(
                ReportEntry(
                    f"measurement of {channel.name}",
                    m.read_noise_per_component("sigma", channel.space.errors),
                    channel.variable.unit,
                    f"sigma; {when}{late}{gate}",
                )
            )
        facts += self._report_steady_state_accuracy(labels)
        what = "consecutive steps without a sample; after that no estimate"
        return [*facts, ReportEntry("hold", str(self.hold), remark=what)]

    def _report_steady_state_accuracy(self, labels: tuple[str, ...]) -> list[ReportEntry]:
        """Return the unobservable states and the steady-state accuracy of the model linearised at the initial state."""
        F, Q, H, R = self._linearize_at_initial_state()
        where = "model linearised at the initial state, zero command"
        unobservable = sorted(
            {label for mode in find_uncontrollable_modes(F.T, H.T, labels) for label in mode.states},
            key=labels.index,
        )
        facts = [ReportEntry("unobservable states", ", ".join(unobservable) or "none", remark=where)]
        if any(channel.period > 1 for channel in self.augmented.channels):
            return facts
        try:
            regulator = solve_algebraic_riccati(
                F.T, H.T, Q, R, np.zeros((F.shape[0], H.shape[0])), labels, sampled=True
            )
        except DesignError:  # unobservable or noise-free states have no positive steady variance
            return facts
        P = regulator.cost - regulator.cost @ H.T @ np.linalg.solve(
            H @ regulator.cost @ H.T + R, H @ regulator.cost
        )
        return [
            *facts,
            ReportEntry(
                "steady-state standard deviation",
                np.sqrt(np.maximum(np.diag(P), 0.0)),
                "",
                f"after an update, {where}",
            ),
        ]

    def _linearize_at_initial_state(self) -> tuple[Array, Array, Array, Array]:
        """Return F and Q of one control step, H and R of all measurements, at the initial state with zero command."""
        augmented, space, tangent = self.augmented, self.augmented.space, TangentModel()
        x, first = ca.SX.sym("x", space.size), augmented.build_initial_augmented_state(self.t0, self.x0)
        u = ca.SX.zeros(self.model.controls.size)
        shift, after = (
            augmented.build_delay_shift_function(),
            augmented.build_state_flow_function(self.dt)(self.t0, x, u),
        )
        density = ca.diag(ca.SX(ca.DM(self.noise**2)))
        F, early, late = augmented.discretize_error_dynamics(self.t0, x, after, u, self.dt, density)
        delays = tangent.fit_linear_model(partial(shift, self.t0), space, space, x, None)[1]
        rows = []
        for channel in augmented.channels:
            observed, direct = (
                partial(augmented.build_delayed_output_function(channel), self.t0),
                augmented.find_constant_measurement_jacobian(channel),
            )
            rows.append(
                tangent.fit_linear_model(observed, space, channel.space, x, None)[1]
                if direct is None
                else direct
            )
        outputs = [F @ delays, F @ early @ F.T + late, ca.vertcat(*rows)]
        values = ca.Function("linear", [x], outputs)(first)
        matrices = [np.asarray(m.full()) for m in values]
        sigma = np.concatenate(
            [c.measurement.read_noise_per_component("sigma", c.space.errors) for c in augmented.channels]
        )
        return matrices[0], matrices[1], matrices[2], np.diag(sigma**2)


def _read_initial_filter_state(model: Model, x0: ArrayLike | Mapping[str, ArrayLike], name: str) -> Array:
    what = f"the initial state of '{name}'"
    if isinstance(x0, Mapping):
        for key in x0:
            model.states.slice(key)
        x = model.states.stack(x0)
    else:
        x = read_state_vector(x0, model.states.size, what, ArgumentError)
    if not np.all(np.isfinite(x)):
        label = model.states.labels[int(np.flatnonzero(~np.isfinite(x))[0])]
        raise ArgumentError(f"{what} has no finite '{label}': give every state.")
    return x


def _read_standard_deviations(model: Model, by_name: Deviations, what: str) -> Array:
    """Return standard deviations by name as (n_errors,); those left out are 0."""
    require_type(by_name, Mapping, what, 'write {"r": 0.1, "v": 0.01}')
    deviations = np.zeros(model.errors.size)
    for name, value in by_name.items():
        model.states.slice(name)
        deviations[model.errors.slice(name)] = numbers = read_vector(
            value, model.errors[name].size, f"{what} for '{name}'", ArgumentError
        )
        if not np.all(np.isfinite(numbers) & (numbers >= 0)):
            raise ArgumentError(f"{what} for '{name}' is {numbers}: give finite numbers >= 0.")
    return deviations


def _check_retraction_inverts_difference(model: Model, x0: Array) -> None:
    """Raise an error if a retraction is not the inverse of its difference, to first order at the initial state."""
    x, e = ca.SX.sym("x", model.states.size), ca.SX.sym("e", model.errors.size)
    difference = model.state_error_expression(model.retraction_expression(x, e), x)
    value_and_slope = ca.Function("both", [x, e], [difference, ca.jacobian(difference, e)])
    value, slope = (np.asarray(m.full()) for m in value_and_slope(x0, np.zeros(model.errors.size)))
    miss = np.maximum(np.max(np.abs(slope - np.eye(model.errors.size)), axis=1), np.abs(value[:, 0]))
    wrong = np.flatnonzero(~(miss <= EQUAL))
    if wrong.size:
        label = model.errors.labels[int(wrong[0])]
        raise DesignError(
            f"the retraction of '{label}' in model '{model.name}' is not the inverse of its difference: that of "
            f"retraction(x, e) and x differs from e by {miss[wrong[0]]:.2g} to first order."
        )
