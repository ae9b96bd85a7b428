"""yapss: LGL collocation on 50 segments of degree 6 (the fine mesh of its examples), derivatives by CasADi."""

import yapss
import yapss.math
from statement import report


def solver_of(segments, degree):
    """Return a solver on one mesh."""

    def solve(stated):
        def objective(a):
            a.objective = _ends(a)[0]

        def discrete(a):
            a.discrete[:] = _ends(a)[1]

        def continuous(a):
            leg = a.phase[0]
            t = leg.time
            rates, paths, integrands = stated.along(
                yapss.math, t, leg.state, leg.control, a.parameter if stated.parameters else []
            )
            leg.dynamics[:] = [0 * t + value for value in rates]
            if paths:
                leg.path[:] = paths
            if integrands:
                leg.integrand[:] = [0 * t + value for value in integrands]

        def _ends(a):
            leg = a.phase[0]
            return stated.ends(
                yapss.math, (leg.initial_time, leg.final_time), leg.initial_state, leg.final_state,
                leg.integral if stated.integrals else [], a.parameter if stated.parameters else [],
            )  # fmt: skip

        problem = yapss.Problem(
            name=stated.name, nx=[len(stated.states)], nu=[len(stated.controls)], nq=[len(stated.integrals)],
            nh=[len(stated.path_bounds)], ns=len(stated.parameters), nd=len(stated.event_bounds),
        )  # fmt: skip
        problem.functions.objective, problem.functions.continuous = objective, continuous
        if stated.event_bounds:
            problem.functions.discrete = discrete
            problem.bounds.discrete.lower[:], problem.bounds.discrete.upper[:] = zip(
                *stated.event_bounds, strict=True
            )
        box, guess = problem.bounds.phase[0], problem.guess.phase[0]
        box.initial_time.lower, box.initial_time.upper = stated.initial_time
        box.final_time.lower, box.final_time.upper = stated.final_time
        for kept, pairs in (
            (box.initial_state, stated.initial), (box.final_state, stated.final), (box.state, stated.state_bounds),
            (box.control, stated.control_bounds), (box.path, stated.path_bounds),
        ):  # fmt: skip
            if pairs:
                kept.lower[:], kept.upper[:] = zip(*pairs, strict=True)
        if stated.parameters:
            problem.bounds.parameter.lower[:], problem.bounds.parameter.upper[:] = zip(
                *stated.parameter_bounds, strict=True
            )
            problem.guess.parameter = tuple(stated.parameter_guess)
        guess.time, guess.state, guess.control = map(tuple, stated.guess_samples())
        problem.sense = "minimize" if stated.sense > 0 else "maximize"
        problem.spectral_method = "lgl"
        problem.derivatives.method, problem.derivatives.order = "auto", "second"
        problem.ipopt_options.print_level, problem.ipopt_options.sb = 0, "yes"
        problem.ipopt_options.max_iter, problem.ipopt_options.tol = 3000, 1e-8
        problem.mesh.phase[0].collocation_points = segments * [degree]
        problem.mesh.phase[0].fraction = segments * [1.0 / segments]
        found = problem.solve()
        message = str(found.nlp_info.ipopt_status_message)
        if "Optimal" not in message and "Acceptable" not in message:
            raise RuntimeError(message)
        return found.objective

    return solve


if __name__ == "__main__":
    report({"50x6": solver_of(50, 6)})
