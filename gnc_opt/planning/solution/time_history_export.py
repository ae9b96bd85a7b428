"""Time histories of a phase, for export to other packages and files."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import read_array
from gnc_opt.array_types import Array
from gnc_opt.model.tabular_data import TabularData
from gnc_opt.model.variables import Variable
from gnc_opt.planning.solution.phase_solution import PhaseSolution


def build_time_history(leg: PhaseSolution, times: ArrayLike | None = None) -> TabularData:
    """Return states, applied controls and costates by time.

    Parameters
    ----------
    times : array (n_times,), optional
        Times, s; default: ten intervals per segment. At a jump of a control its right limit is used.
    """
    t = leg.sample_times() if times is None else np.atleast_1d(read_array(times, "the times"))
    return TabularData(Variable("time", unit="s"), t, tuple(_time_histories(leg, t)), {"phase": leg.name})


def _time_histories(leg: PhaseSolution, t: Array) -> Iterator[tuple[Variable, Array]]:
    x, lam = leg.x(t), leg.lam(t)
    for state in leg.states.variables:
        yield state, x[leg.states.slice(state.name)]
    for control in leg.controls.variables:
        yield control, np.atleast_2d(leg.saturated_control(control.name)(t))
    for composed in leg.composed_controls:
        yield composed.variable, np.atleast_2d(leg.saturated_control(composed.name)(t))
    for state in leg.states.variables:
        signal = leg.costate(state.name)
        yield Variable(signal.name, state.size, signal.unit), lam[signal.rows]
