"""yapss: Legendre-Gauss pseudospectral collocation, second derivatives by CasADi."""

import plain
import yapss


def solver_of(segments, degree):
    def solve(case):
        def objective(a):
            a.objective = a.phase[0].final_time

        def continuous(a):
            a.phase[0].dynamics[:] = plain.rates(a.phase[0].state, a.phase[0].control)

        problem = yapss.Problem(name="rendezvous", nx=[12], nu=[6])
        problem.functions.objective, problem.functions.continuous = objective, continuous
        box = problem.bounds.phase[0]
        first, last = plain.ends(case)
        box.initial_time.lower = box.initial_time.upper = 0.0
        box.final_time.lower, box.final_time.upper = 1.0, plain.LONGEST
        box.initial_state.lower[:] = box.initial_state.upper[:] = first
        box.final_state.lower[:] = box.final_state.upper[:] = last
        box.state.lower[3:6], box.state.upper[3:6] = [-1.0] * 3, [1.0] * 3
        box.control.lower[:], box.control.upper[:] = [-v for v in plain.LIMITS], list(plain.LIMITS)
        guess = problem.guess.phase[0]
        guess.time, guess.state = (0.0, plain.GUESSED), tuple(zip(first, last, strict=True))
        guess.control = tuple((0.1 * v, 0.1 * v) for v in plain.LIMITS)
        scale = problem.scale.phase[0]
        scale.control[:] = list(plain.LIMITS)
        scale.state[:] = scale.dynamics[:] = list(plain.SCALES)
        scale.time = plain.GUESSED
        problem.spectral_method = "lg"
        problem.derivatives.method, problem.derivatives.order = "auto", "second"
        problem.ipopt_options.print_level, problem.ipopt_options.sb = 0, "yes"
        problem.ipopt_options.max_iter, problem.ipopt_options.tol = 1000, 1e-8
        problem.mesh.phase[0].collocation_points = segments * [degree]
        problem.mesh.phase[0].fraction = segments * [1.0 / segments]
        found = problem.solve()
        if "Optimal" not in str(found.nlp_info.ipopt_status_message):
            raise RuntimeError(found.nlp_info.ipopt_status_message)
        return found.objective

    return solve


if __name__ == "__main__":
    solver_of(5, 3)(1)
    plain.report({f"{k}x{n}": solver_of(k, n) for k, n in ((20, 3), (60, 4), (120, 4))})
