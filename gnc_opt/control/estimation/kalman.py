"""Kalman filters of a model: extended and unscented, on the right manifold, with biases, delays and gates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import expect, read_integer, read_label, read_positive
from gnc_opt.arrays import Array
from gnc_opt.control.dropout import HOLD
from gnc_opt.control.estimation.augmented import AugmentedModel
from gnc_opt.control.estimation.estimator import Estimator
from gnc_opt.control.estimation.filter import COVARIANCE, build_filter
from gnc_opt.control.estimation.linearization import Approximation, Regression, Tangent
from gnc_opt.control.estimation.measurement import Measurement
from gnc_opt.control.explanation import Explanation, Fact
from gnc_opt.control.limits import Limits, read_limits
from gnc_opt.control.linear.riccati import steady, unreached
from gnc_opt.errors import ArgumentError, DesignError
from gnc_opt.model.layout import Layout, as_vector
from gnc_opt.model.model import Model

Deviations: TypeAlias = Mapping[str, ArrayLike]
"""Standard deviations by the name of a state, one number or one per component of its error."""

_CONSISTENT = 1e-6
"""By how much the way there and back may miss the identity to first order."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FilterOptions:
    """What filters can be told beside the model and the numbers of its noise.

    Attributes
    ----------
    limits : tuple of two arrays (n_controls,) or numbers, optional
        Lower and upper limits of the actuators: the prediction takes the command within them.
    t0 : float
        Time of the first control step, s; matters for the first value of delayed measurements that depend on time.
    substeps : int
        Integration steps per control step, each of two Runge-Kutta steps.
    hold : int
        Control steps in a row that should have brought a sample and brought none for which the prediction is told;
        then what is no number, until the next sample is taken.
    name : str, optional
        For messages and reports; default "EKF" or "UKF".

    Examples
    --------
    >>> from gnc_opt.control import FilterOptions, Measurement
    >>> options = FilterOptions(substeps=2, hold=10, name="navigation")
    >>> about = {"sigma0": {"q": 0.1, "v": 0.02}, "dt": 0.1}
    >>> ekf = go.design_ekf(cart, [1, 0], [Measurement("q", 1e-3)], **about, options=options)
    >>> print(ekf.name)
    navigation
    """

    limits: Limits | None = None
    t0: float = 0.0
    substeps: int = 1
    hold: int = HOLD
    name: str | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class UnscentedOptions(FilterOptions):
    """What an unscented filter can be told.

    Attributes
    ----------
    kappa : float
        Spread of the points, which lie at sqrt(n + kappa) standard deviations of n errors; >= 0, so that no weight is
        negative. 0: the cubature filter; 3 - n fits the fourth moments of normal errors.

    Examples
    --------
    >>> from gnc_opt.control import Measurement, UnscentedOptions
    >>> about = {"sigma0": {"q": 0.1, "v": 0.02}, "dt": 0.1}
    >>> options = UnscentedOptions(kappa=1.0)  # 3 - n of two errors
    >>> ukf = go.design_ukf(cart, [1, 0], [Measurement("q", 1e-3)], **about, options=options)
    """

    kappa: float = 0.0


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
        Of the vehicle as the filter sees it.
    x0 : array (n_states,) or mapping by name
        Expected state at the first control step.
    measurements : sequence of Measurement
        Each of a state or an output of the model.
    sigma0 : mapping
        Standard deviation of the error of x0 of every state; 0: known exactly.
    dt : float
        Control step, s.
    process_noise : mapping, optional
        White noise on the rates of states: standard deviation that it adds to the state, unit per square root of a
        second; 0 for those left out.
    options : FilterOptions, optional
        Limits of the actuators, integration, lost samples, name.

    Returns
    -------
    Estimator

    Raises
    ------
    ArgumentError, DesignError, UnknownNameError, ModelError
        Bad numbers, unknown states, a measurement that depends on a control, a difference without a retraction or one
        that is not its inverse.

    Examples
    --------
    >>> from gnc_opt.control import Measurement
    >>> ekf = go.design_ekf(cart, [1, 0], [Measurement("q", 1e-3)], sigma0={"q": 0.1, "v": 0.02}, dt=0.1)
    >>> x, memory = ekf(0.0, [1.05], [0.0])
    >>> print(np.round(x, 3))  # the sample is a hundred times better than the guess
    [1.05 0.  ]
    """
    told = _read_options(options, "EKF")
    if isinstance(told, UnscentedOptions):
        raise ArgumentError("design_ekf() has no points to spread: give FilterOptions(...).")
    design = _Design(model, x0, measurements, (sigma0, process_noise or {}), dt, told)
    return design.estimator(Tangent(), "extended Kalman filter")


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
    """Return an unscented Kalman filter, which needs no derivatives; on the manifold as `design_ekf`.

    Parameters
    ----------
    model, x0, measurements, sigma0, dt, process_noise
        As for `design_ekf`.
    options : FilterOptions or UnscentedOptions, optional
        The latter to choose the spread of the points.

    Returns
    -------
    Estimator

    Raises
    ------
    ArgumentError, DesignError, UnknownNameError, ModelError
        As for `design_ekf`.

    Examples
    --------
    >>> from gnc_opt.control import Measurement
    >>> ukf = go.design_ukf(cart, [1, 0], [Measurement("q", 1e-3)], sigma0={"q": 0.1, "v": 0.02}, dt=0.1)
    >>> filtered = go.ClosedLoop(cart, go.output_feedback(regulator, ukf), sensors=loop.sensors)
    >>> print(filtered.simulate([1.05, 0.01], tf=8.0).miss("q") < 0.01)
    True
    """
    told = _read_options(options, "UKF")
    kappa = told.kappa if isinstance(told, UnscentedOptions) else 0.0
    spread = read_positive(kappa, "kappa of design_ukf()", or_zero=True)
    design = _Design(model, x0, measurements, (sigma0, process_noise or {}), dt, told)
    return design.estimator(Regression(spread), "unscented Kalman filter")


class _Design:
    """The arguments of a design, read."""

    def __init__(
        self,
        model: Model,
        x0: ArrayLike | Mapping[str, ArrayLike],
        measurements: Sequence[Measurement],
        deviations: tuple[Deviations, Deviations],
        dt: float,
        options: FilterOptions,
    ) -> None:
        expect(model, Model, "the model of an estimator", "give a Model")
        self.name = name = read_label(options.name, "estimator")
        model.derivative()
        self.model, self.dt = model, read_positive(dt, f"the control step of '{name}'")
        self.substeps = read_integer(options.substeps, f"substeps of '{name}'", 1)
        self.hold = read_integer(
            options.hold, f"the number of steps without samples that '{name}' bridges", 0
        )
        self.x0 = _read_state(model, x0, name)
        self.t0 = float(as_vector(options.t0, 1, f"t0 of '{name}'", ArgumentError)[0])
        _check_way_back(model, self.x0)
        given = [measurements] if isinstance(measurements, Measurement) else list(measurements)
        for each in given:
            expect(each, Measurement, f"one of the measurements of '{name}'", 'write Measurement("r", 0.1)')
        if not given:
            raise ArgumentError(f"'{name}' measures nothing: give at least one Measurement.")
        names = [each.of for each in given]
        for of in names:
            if names.count(of) > 1:
                raise ArgumentError(
                    f"'{name}' measures '{of}' twice: declare an output of the model for the second sensor."
                )
        self.augmented = AugmentedModel(model, given, self.dt)
        sigma0, process_noise = deviations
        missing = [n for n in model.states.names if n not in sigma0]
        if missing:
            raise ArgumentError(
                f"sigma0 of '{name}' does not tell how well '{missing[0]}' is known: give every state, 0 if exactly."
            )
        self.limits = read_limits(model, options.limits)
        self.sigma0 = self.augmented.spread(_deviations(model, sigma0, f"sigma0 of '{name}'"), "bias")
        noise = _deviations(model, process_noise, f"process_noise of '{name}'")
        self.noise = self.augmented.spread(noise, "bias_walk")

    def estimator(self, linearization: Approximation, title: str) -> Estimator:
        """Return the filter with this linearization."""
        augmented, model = self.augmented, self.model
        filter_ = build_filter(augmented, linearization, self.noise, self.limits, self.substeps, self.hold)
        first = np.zeros(filter_.memory.size)
        first[: augmented.states.size] = augmented.first(self.t0, self.x0)
        places = tuple(np.array(k, dtype=np.int64) for k in filter_.pattern.get_triplet())
        first[filter_.memory.slice(COVARIANCE)] = np.diag(self.sigma0**2)[places]
        for channel in augmented.channels:
            if channel.counted:
                first[filter_.memory.slice(f"{channel.name}_next")] = channel.delay
        x, x_ref = ca.SX.sym("x", model.states.size), ca.SX.sym("x_ref", model.states.size)
        return Estimator(
            name=self.name,
            update=filter_.update,
            predict=filter_.predict,
            first=first,
            states=model.states,
            errors=model.errors,
            measured=Layout("measurement", tuple(c.variable for c in augmented.channels), f"'{self.name}'"),
            commands=model.controls,
            places=(places[0], places[1]),
            memory=filter_.memory,
            error=ca.Function("error", [x, x_ref], [model.error_expression(x, x_ref)]),
            sizes={c.name: c.space.errors for c in augmented.channels},
            dt=self.dt,
            explanation=Explanation(f"{title} of '{model.name}'", tuple(self._facts())),
        )

    def _facts(self) -> list[Fact]:
        labels = self.augmented.errors.labels
        facts = [
            Fact("estimated", ", ".join(labels)),
            Fact("first sigma", self.sigma0),
            Fact("process noise", self.noise, "", "unit/s^0.5"),
        ]
        for channel in self.augmented.channels:
            m = channel.measurement
            when = f"every {channel.period * self.dt:g} s"
            late = f", {channel.delay * self.dt:g} s late" if channel.delay else ""
            gate = f", gate {m.gate:g}" if m.gate is not None else ""
            facts.append(
                Fact(
                    f"measurement of {channel.name}",
                    m.values("sigma", channel.space.errors),
                    channel.variable.unit,
                    f"sigma; {when}{late}{gate}",
                )
            )
        facts += self._steady_facts(labels)
        what = "steps in a row without a sample that are predicted; then no estimate"
        return [*facts, Fact("hold", str(self.hold), remark=what)]

    def _steady_facts(self, labels: tuple[str, ...]) -> list[Fact]:
        """Return what is not seen and the steady accuracy, of the linear model at the first state without command."""
        F, Q, H, R = self._linear()
        where = "by the linear model at the first state, no command"
        unseen = sorted(
            {label for mode in unreached(F.T, H.T, labels) for label in mode.states}, key=labels.index
        )
        facts = [Fact("not seen", ", ".join(unseen) or "nothing", remark=where)]
        if any(channel.period > 1 for channel in self.augmented.channels):
            return facts
        try:
            regulator = steady(F.T, H.T, Q, R, np.zeros((F.shape[0], H.shape[0])), labels, sampled=True)
        except (
            DesignError
        ):  # what is not seen, or what no noise moves: its variance has no steady value above zero
            return facts
        P = regulator.cost - regulator.cost @ H.T @ np.linalg.solve(
            H @ regulator.cost @ H.T + R, H @ regulator.cost
        )
        return [
            *facts,
            Fact("steady sigma", np.sqrt(np.maximum(np.diag(P), 0.0)), "", f"after an update, {where}"),
        ]

    def _linear(self) -> tuple[Array, Array, Array, Array]:
        """Return F and Q of one control step, H and R of all measurements, at the first state without command."""
        augmented, space, tangent = self.augmented, self.augmented.space, Tangent()
        x, first = ca.SX.sym("x", space.size), augmented.first(self.t0, self.x0)
        u = ca.SX.zeros(self.model.controls.size)
        shift, after = augmented.shift(), augmented.flow(self.dt)(self.t0, x, u)
        density = ca.diag(ca.SX(ca.DM(self.noise**2)))
        F, Q = augmented.transition(self.t0, x, after, u, self.dt, density)
        delays = tangent.fit(partial(shift, self.t0), space, space, x, None)[1]
        rows = [
            tangent.fit(partial(augmented.observed(c), self.t0), space, c.space, x, None)[1]
            for c in augmented.channels
        ]
        found = ca.Function("linear", [x], [F @ delays, Q, ca.vertcat(*rows)])(first)
        matrices = [np.asarray(m.full()) for m in found]
        sigma = np.concatenate([c.measurement.values("sigma", c.space.errors) for c in augmented.channels])
        return matrices[0], matrices[1], matrices[2], np.diag(sigma**2)


def _read_options(options: FilterOptions | None, name: str) -> FilterOptions:
    """Return the options with a name."""
    told = FilterOptions() if options is None else options
    expect(told, FilterOptions, f"the options of '{name}'", "give FilterOptions(...)")
    return replace(told, name=name) if told.name is None else told


def _read_state(model: Model, x0: ArrayLike | Mapping[str, ArrayLike], name: str) -> Array:
    """Return the expected state (n_states,)."""
    what = f"the first state of '{name}'"
    if isinstance(x0, Mapping):
        for key in x0:
            model.states.slice(key)
        x = model.states.stack(x0)
    else:
        x = as_vector(x0, model.states.size, what, ArgumentError)
    if not np.all(np.isfinite(x)):
        label = model.states.labels[int(np.flatnonzero(~np.isfinite(x))[0])]
        raise ArgumentError(f"{what} has no finite '{label}': give every state.")
    return x


def _deviations(model: Model, given: Deviations, what: str) -> Array:
    """Return standard deviations by name as (n_errors,); those left out are 0."""
    expect(given, Mapping, what, 'write {"r": 0.1, "v": 0.01}')
    found = np.zeros(model.errors.size)
    for name, value in given.items():
        model.states.slice(name)
        found[model.errors.slice(name)] = numbers = as_vector(
            value, model.errors[name].size, f"{what} for '{name}'", ArgumentError
        )
        if not np.all(np.isfinite(numbers) & (numbers >= 0)):
            raise ArgumentError(f"{what} for '{name}' is {numbers}: give finite numbers >= 0.")
    return found


def _check_way_back(model: Model, x0: Array) -> None:
    """Refuse a retraction that is not the way back of its difference, to first order at the first state."""
    x, e = ca.SX.sym("x", model.states.size), ca.SX.sym("e", model.errors.size)
    there = model.error_expression(model.moved_expression(x, e), x)
    both = ca.Function("both", [x, e], [there, ca.jacobian(there, e)])
    value, slope = (np.asarray(m.full()) for m in both(x0, np.zeros(model.errors.size)))
    miss = np.maximum(np.max(np.abs(slope - np.eye(model.errors.size)), axis=1), np.abs(value[:, 0]))
    bad = np.flatnonzero(~(miss <= _CONSISTENT))
    if bad.size:
        label = model.errors.labels[int(bad[0])]
        raise DesignError(
            f"the retraction of '{label}' in model '{model.name}' is not the way back of its difference: that between "
            f"retraction(x, e) and x misses e by {miss[bad[0]]:.2g} to first order."
        )
