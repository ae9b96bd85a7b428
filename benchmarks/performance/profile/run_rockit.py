"""rockit: Radau collocation with controls constant on each interval, its default, on uniform grids."""

import math

import casadi as ca
from rockit import DirectCollocation, FreeTime, Ocp
from statement import IPOPT_OPTIONS, limits_of, report


def solver_of(intervals, degree):
    """Return a solver on one grid."""

    def solve(stated):
        (start, _), (low, high) = stated.initial_time, stated.final_time
        first, last = stated.time_guess
        moving = stated.initial_time[0] != stated.initial_time[1]
        fixed = not moving and low == high
        ocp = Ocp(t0=FreeTime(first) if moving else start, T=low - start if fixed else FreeTime(last - first))
        x, u = [ocp.state() for _ in stated.states], [ocp.control() for _ in stated.controls]
        p = [ocp.variable() for _ in stated.parameters]
        rates, paths, integrands = stated.along(ca, ocp.t, x, u, p)
        for state, rate in zip(x, rates, strict=True):
            ocp.set_der(state, rate)
        objective, events = stated.ends(
            ca, (ocp.t0, ocp.tf), [ocp.at_t0(v) for v in x], [ocp.at_tf(v) for v in x],
            [ocp.integral(value) for value in integrands], p,
        )  # fmt: skip
        limited = [
            (x, stated.state_bounds), (u, stated.control_bounds), (paths, stated.path_bounds),
            (p, stated.parameter_bounds), (events, stated.event_bounds),
            ([ocp.at_t0(v) for v in x], stated.initial), ([ocp.at_tf(v) for v in x], stated.final),
            ([ocp.t0], [stated.initial_time] if moving else [(-math.inf, math.inf)]),
            ([ocp.tf], [(-math.inf, math.inf) if fixed else stated.final_time]),
        ]  # fmt: skip
        for rows, pairs in limited:
            for row, pair in zip(rows, pairs, strict=True):
                for limit in limits_of(row, pair):
                    ocp.subject_to(limit)
        if not fixed:
            ocp.subject_to(ocp.T >= 0)
        times, *rows = stated.guess_samples()
        for variables, group in zip((x, u), rows, strict=True):
            for variable, samples in zip(variables, group, strict=True):
                line = ca.interpolant("guess", "linear", [times], samples)
                ocp.set_initial(variable, line(ocp.t))
        for variable, value in zip(p, stated.parameter_guess, strict=True):
            ocp.set_initial(variable, value)
        ocp.add_objective(stated.sense * objective)
        ocp.solver("ipopt", {**IPOPT_OPTIONS, "expand": True})
        ocp.method(DirectCollocation(N=intervals, degree=degree, scheme="radau"))
        return stated.sense * float(ocp.solve().value(ocp.objective))

    return solve


if __name__ == "__main__":
    report({f"{k}x{n}": solver_of(k, n) for k, n in ((50, 4), (200, 3))})
