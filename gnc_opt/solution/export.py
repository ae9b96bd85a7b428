"""A phase as a table of pandas or a dataset of xarray, packages of the extra ``data``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import read_numbers
from gnc_opt.arrays import Array
from gnc_opt.extras import imported
from gnc_opt.model.layout import Variable
from gnc_opt.solution.phase_solution import PhaseSolution

PER_SEGMENT = 10
"""Intervals per segment where no times are given."""


def data_frame(leg: PhaseSolution, times: ArrayLike | None = None) -> Any:
    """Return states, flown controls and costates, one column per component, by time.

    Parameters
    ----------
    leg : PhaseSolution
    times : array (n_times,), optional
        s; default `PER_SEGMENT` intervals of every segment. Where a control jumps, the value after the jump is given.

    Returns
    -------
    pandas.DataFrame
        Columns such as ``r[0]`` and ``lam_r[0]``; ``attrs["units"]`` holds the unit of each.
    """
    pandas, t = imported("pandas", "data"), _times(leg, times)
    columns: dict[str, Array] = {}
    units = {"time": "s"}
    for variable, values in _quantities(leg, t):
        columns |= dict(zip(variable.labels, values, strict=True))
        units |= dict.fromkeys(variable.labels, variable.unit)
    frame = pandas.DataFrame(columns, index=pandas.Index(t, name="time"))
    frame.attrs = {"phase": leg.name, "units": units}
    return frame


def dataset(leg: PhaseSolution, times: ArrayLike | None = None) -> Any:
    """Return states, flown controls and costates as variables over time, vectors with a dimension for their components.

    Parameters
    ----------
    leg : PhaseSolution
    times : array (n_times,), optional
        As for `data_frame`.

    Returns
    -------
    xarray.Dataset
        Each variable with its unit as the attribute ``units``.
    """
    xarray, t = imported("xarray", "data"), _times(leg, times)
    variables = {}
    for variable, values in _quantities(leg, t):
        scalar = variable.size == 1
        dimensions = ("time",) if scalar else (f"{variable.name}_component", "time")
        variables[variable.name] = (dimensions, values[0] if scalar else values, {"units": variable.unit})
    return xarray.Dataset(variables, {"time": ("time", t, {"units": "s"})}, {"phase": leg.name})


def _quantities(leg: PhaseSolution, t: Array) -> Iterator[tuple[Variable, Array]]:
    """Yield everything that has a time history with its values (size, n_times)."""
    x, u, lam = leg.x(t), leg.flown(t), leg.lam(t)
    for state in leg.states.variables:
        yield state, x[leg.states.slice(state.name)]
    for control in leg.controls.variables:
        yield control, u[leg.controls.slice(control.name)]
    for composed in leg.composed_controls:
        yield composed.variable, np.atleast_2d(leg.flown_control(composed.name)(t))
    for state in leg.states.variables:
        signal = leg.costate(state.name)
        yield Variable(signal.name, state.size, signal.unit), lam[signal.rows]


def _times(leg: PhaseSolution, times: ArrayLike | None) -> Array:
    if times is None:
        return leg.sample_times(PER_SEGMENT)
    return np.atleast_1d(read_numbers(times, "the times"))
