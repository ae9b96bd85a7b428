"""What the cost amounts to: the yardstick where costates vanish."""

from __future__ import annotations

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.problem.functions import end_function
from gnc_opt.solution.samples import PhaseSamples
from gnc_opt.solution.solution import Solution


def cost_magnitude(solution: Solution, samples: list[PhaseSamples]) -> float:
    """Return the largest change of the cost when an end value, time, integral or parameter changes by its magnitude.

    A problem whose optimal cost is zero, or that is not unique, has costates that vanish up to rounding; offences
    in shares of those would compare noise with noise. This number has the unit of the cost and does not vanish
    with the costates.
    """
    problem = solution.problem
    assert problem is not None, "verify refuses solutions without a problem"
    values: list[Array] = []
    scales: list[Array] = []
    for s in samples:
        leg = s.leg
        integrands = np.abs(s.functions.integrands(s.times, s.x, s.u)) @ s.weights
        ends = (leg.x(leg.breaks[0]), leg.x(leg.breaks[-1], "left"))
        times = (np.array([leg.initial_time]), np.array([leg.final_time]))
        values += [*ends, *times, leg.integrals, leg.parameters]
        scales += [s.state_scale, s.state_scale, np.array([s.span]), np.array([s.span]), integrands]
        scales += [np.zeros(leg.parameters.size)]
    values.append(solution.parameter_values)
    scales.append(parameter_scale(solution))
    nu = np.zeros(solution.constraint_multipliers.size)

    def cost(arguments: list[Array]) -> float:
        return float(end_function(problem)(*arguments, nu)[0])

    base, largest = cost(values), 0.0
    for k, scale in enumerate(scales):
        for i in np.flatnonzero(scale > 0):
            shifted = values[k].copy()
            shifted[i] += scale[i]
            change = abs(cost([*values[:k], shifted, *values[k + 1 :]]) - base)
            largest = max(largest, change) if np.isfinite(change) else largest
    return largest


def parameter_scale(solution: Solution) -> Array:
    """Return the magnitude of each free parameter, or the range of its bounds where it vanishes (n_parameters,)."""
    problem = solution.problem
    assert problem is not None, "verify refuses solutions without a problem"
    box, size = problem.parameter_interval(), np.abs(solution.parameter_values)
    span = box.upper - box.lower
    return np.asarray(np.where(size > 1e-6, size, np.where(np.isfinite(span) & (span > 0), span, 1.0)))
