"""maptor: Legendre-Gauss-Radau collocation, adaptive to its standard tolerance, from 10 segments of degree 5."""

import casadi as ca
import maptor
import numpy as np
from statement import report

OPTIONS = {
    "ipopt.tol": 1e-8,
    "ipopt.print_level": 0,
    "print_time": False,
    "ipopt.sb": "yes",
    "ipopt.max_iter": 3000,
}
SEGMENTS, DEGREE = 10, 5


def _limits(low, high):
    """Return a fixed value, or limits with None for infinity; None without any."""
    if low == high:
        return low
    limits = tuple(float(v) if np.isfinite(v) else None for v in (low, high))
    return None if limits == (None, None) else limits


def adaptive(error):
    """Return a solver that refines the mesh to an error."""

    def solve(stated):
        problem = maptor.Problem(stated.name)
        phase = problem.set_phase(1)
        time = phase.time(initial=_limits(*stated.initial_time), final=_limits(*stated.final_time))
        p = [
            problem.parameter(name, boundary=_limits(*box))
            for name, box in zip(stated.parameters, stated.parameter_bounds, strict=True)
        ]
        x = [
            phase.state(name, initial=_limits(*first), final=_limits(*last), boundary=_limits(*box))
            for name, first, last, box in zip(
                stated.states, stated.initial, stated.final, stated.state_bounds, strict=True
            )
        ]
        u = [
            phase.control(name, boundary=_limits(*box))
            for name, box in zip(stated.controls, stated.control_bounds, strict=True)
        ]
        rates, paths, integrands = stated.along(ca, time, [1 * s for s in x], u, p)
        phase.dynamics(dict(zip(x, rates, strict=True)))
        _constrain(phase.path_constraints, paths, stated.path_bounds)
        integrals = [phase.add_integral(value) for value in integrands]
        objective, events = stated.ends(
            ca, (time.initial, time.final), [s.initial for s in x], [s.final for s in x], integrals, p
        )
        _constrain(phase.event_constraints, events, stated.event_bounds)
        problem.minimize(stated.sense * objective)
        phase.mesh([DEGREE] * SEGMENTS, list(np.linspace(-1.0, 1.0, SEGMENTS + 1)))
        nodes = [np.linspace(k / SEGMENTS, (k + 1) / SEGMENTS, DEGREE + 1) for k in range(SEGMENTS)]
        phase.guess(
            states=[np.array([stated.line(share)[0] for share in here]).T for here in nodes],
            controls=[np.array([stated.line(share)[1] for share in here[:-1]]).T for here in nodes],
            initial_time=stated.time_guess[0],
            terminal_time=stated.time_guess[1],
        )
        if p:
            problem.parameter_guess(**dict(zip(stated.parameters, stated.parameter_guess, strict=True)))
        found = maptor.solve_adaptive(problem, error_tolerance=error, nlp_options=OPTIONS, show_summary=False)
        if not found.status["success"]:
            raise RuntimeError(found.status["message"])
        return stated.sense * found.status["objective"]

    return solve


def _constrain(add, values, bounds):
    for value, (low, high) in zip(values, bounds, strict=True):
        if low == high:
            add(value == low)
            continue
        if np.isfinite(low):
            add(value >= low)
        if np.isfinite(high):
            add(value <= high)


if __name__ == "__main__":
    report({"adaptive, 1e-6": adaptive(1e-6)})
