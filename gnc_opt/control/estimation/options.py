"""What filters can be told beside the model and the numbers of its noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gnc_opt.arguments import expect
from gnc_opt.control.dropout import HOLD
from gnc_opt.control.limits import Limits


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
        Runge-Kutta steps of the prediction per control step.
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
    kappa : float, optional
        Of the transform of Julier and Uhlmann: points at sqrt(n + kappa) standard deviations of n errors; >= 0, so that
        no weight is negative. 0: the cubature filter. With n it takes more and more for noise what bends: what n
        directions leave is right for one of them with kappa = 3 - n. Default: points at sqrt(3), and what each
        direction leaves is added up, whatever n is.

    Examples
    --------
    >>> from gnc_opt.control import Measurement, UnscentedOptions
    >>> about = {"sigma0": {"q": 0.1, "v": 0.02}, "dt": 0.1}
    >>> options = UnscentedOptions(kappa=1.0)  # 3 - n of two errors
    >>> ukf = go.design_ukf(cart, [1, 0], [Measurement("q", 1e-3)], **about, options=options)
    """

    kappa: float | None = None


def read_options(options: FilterOptions | None, name: str) -> FilterOptions:
    """Return the options with a name."""
    told = FilterOptions() if options is None else options
    expect(told, FilterOptions, f"the options of '{name}'", "give FilterOptions(...)")
    return replace(told, name=name) if told.name is None else told
