"""maptor: adaptive Radau collocation from ten intervals of degree 4, error tolerance 1e-6 (its default) and 1e-9."""

import logging
import math

import casadi as ca
import maptor
import numpy as np
from statement import IPOPT_OPTIONS, limits_of, report

INTERVALS, DEGREE = 10, 4


def solver_of(tolerance):
    """Return a solver to one error tolerance."""

    def solve(stated):
        problem = maptor.Problem(stated.name)
        leg = problem.set_phase(1)
        t = leg.time(initial=_range(stated.initial_time), final=_range(stated.final_time))
        ends = zip(stated.states, stated.initial, stated.final, stated.state_bounds, strict=True)
        x = [leg.state(name, *(_range(pair) for pair in pairs)) for name, *pairs in ends]
        bounded = zip(stated.controls, stated.control_bounds, strict=True)
        u = [leg.control(name, _range(pair)) for name, pair in bounded]
        bounded = zip(stated.parameters, stated.parameter_bounds, strict=True)
        p = [problem.parameter(name, boundary=_range(pair)) for name, pair in bounded]
        rates, paths, integrands = stated.along(ca, t, x, u, p)
        leg.dynamics(dict(zip(x, rates, strict=True)))
        integrals = [leg.add_integral(value) for value in integrands]
        objective, events = stated.ends(
            ca, (t.initial, t.final), [v.initial for v in x], [v.final for v in x], integrals, p
        )
        for rows, pairs, constrain in (
            (paths, stated.path_bounds, leg.path_constraints), (events, stated.event_bounds, leg.event_constraints),
        ):  # fmt: skip
            found = [limit for row, pair in zip(rows, pairs, strict=True) for limit in limits_of(row, pair)]
            if found:
                constrain(*found)
        problem.minimize(stated.sense * objective)
        leg.mesh(INTERVALS * [DEGREE], np.linspace(-1, 1, INTERVALS + 1))
        shares = [np.linspace(k, k + 1, DEGREE + 1) / INTERVALS for k in range(INTERVALS)]
        values = [[stated.line(share) for share in interval] for interval in shares]
        leg.guess(
            states=[np.array([states for states, _ in interval]).T for interval in values],
            controls=[np.array([controls for _, controls in interval[:-1]]).T for interval in values],
            initial_time=stated.time_guess[0],
            terminal_time=stated.time_guess[1],
        )
        if p:
            problem.parameter_guess(**dict(zip(stated.parameters, stated.parameter_guess, strict=True)))
        found = maptor.solve_adaptive(
            problem, error_tolerance=tolerance, nlp_options=IPOPT_OPTIONS, show_summary=False
        )
        if not found.status["success"]:
            raise RuntimeError(found.status["message"])
        return stated.sense * found.status["objective"]

    return solve


def _range(pair):
    """Return a pair as maptor takes it: a number, a pair with None for no limit, or None."""
    low, high = (value if math.isfinite(value) else None for value in pair)
    return low if low == high else (low, high)


if __name__ == "__main__":
    logging.disable()
    report({f"tolerance {tolerance:g}": solver_of(tolerance) for tolerance in (1e-6, 1e-9)})
