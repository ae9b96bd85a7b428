"""The unit of a cost, where it can be told from what it is made of."""

from __future__ import annotations

import casadi as ca
import numpy as np

from gnc_opt.problem.problem import Problem


def cost_unit(problem: Problem) -> str:
    """Return the unit of a cost that is a sum or difference of times, end states or parameters of one unit, else "".

    A duration is in s, a final mass in the unit of the state. Integrals and products are not told: a factor may have
    any unit.
    """
    symbols, units = [problem.parameter_symbols()], list(problem.parameters.units)
    for leg in problem.phases.values():
        symbols += [leg.ends("initial"), leg.ends("final"), leg.initial_time, leg.final_time]
        units += [*leg.model.states.units, *leg.model.states.units, "s", "s"]
        symbols.append(leg.integral_symbols())
        units += [""] * leg.integral_symbols().shape[0]
    slopes = ca.jacobian(problem.cost, ca.vertcat(*symbols))
    if not slopes.is_constant():
        return ""
    weights = np.abs(ca.DM(slopes).full()[0])
    counted = {unit for unit, weight in zip(units, weights, strict=True) if weight}
    return counted.pop() if len(counted) == 1 and np.all((weights == 0) | (weights == 1)) else ""
