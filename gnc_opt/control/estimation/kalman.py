"""Kalman filters of a model: extended and unscented, on the right manifold, with biases, delays and gates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from numpy.typing import ArrayLike

from gnc_opt.arguments import read_positive
from gnc_opt.control.estimation.design import Deviations, FilterDesign
from gnc_opt.control.estimation.estimator import Estimator
from gnc_opt.control.estimation.linearization import Regression, Tangent
from gnc_opt.control.estimation.measurement import Measurement
from gnc_opt.control.estimation.options import FilterOptions, UnscentedOptions, read_options
from gnc_opt.errors import ArgumentError
from gnc_opt.model.model import Model
from gnc_opt.threads import one_thread


@one_thread()
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
    told = read_options(options, "EKF")
    if isinstance(told, UnscentedOptions):
        raise ArgumentError("design_ekf() has no points to spread: give FilterOptions(...).")
    design = FilterDesign(model, x0, measurements, (sigma0, process_noise), dt, told)
    return design.estimator(Tangent(), "extended Kalman filter")


@one_thread()
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
        The latter for the unscented transform with a kappa of one's own.

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
    told = read_options(options, "UKF")
    kappa = told.kappa if isinstance(told, UnscentedOptions) else None
    spread = None if kappa is None else read_positive(kappa, "kappa of design_ukf()", or_zero=True)
    design = FilterDesign(model, x0, measurements, (sigma0, process_noise), dt, told)
    return design.estimator(Regression(spread), "unscented Kalman filter")
