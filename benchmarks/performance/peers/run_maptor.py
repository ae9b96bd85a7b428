"""maptor: Legendre-Gauss-Radau collocation, on one mesh and adaptive."""

import maptor
import numpy as np
import plain

OPTIONS = {
    "ipopt.tol": 1e-8, "ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.max_iter": 1000
}  # fmt: skip


def problem_of(case, segments, degree):
    problem = maptor.Problem("rendezvous")
    phase = problem.set_phase(1)
    time = phase.time(initial=0.0, final=(1.0, plain.LONGEST))
    first, last = plain.ends(case)
    x = [
        phase.state(
            f"x{i}", initial=first[i], final=last[i], **({"boundary": (-1.0, 1.0)} if 3 <= i < 6 else {})
        )
        for i in range(12)
    ]
    u = [phase.control(f"u{i}", boundary=(-1.0, 1.0)) for i in range(6)]
    scaled = [limit * v for limit, v in zip(plain.LIMITS, u, strict=True)]
    phase.dynamics(dict(zip(x, plain.rates(x, scaled), strict=True)))
    problem.minimize(time.final)
    phase.mesh([degree] * segments, list(np.linspace(-1.0, 1.0, segments + 1)))
    shares = [np.linspace(k / segments, (k + 1) / segments, degree + 1) for k in range(segments)]
    states = [np.array([plain.line(case, s) for s in here]).T for here in shares]
    phase.guess(
        states=states,
        controls=[np.full((6, degree), 0.1)] * segments,
        initial_time=0.0,
        terminal_time=plain.GUESSED,
    )
    return problem


def fixed(segments, degree):
    def solve(case):
        return _time(
            maptor.solve_fixed_mesh(
                problem_of(case, segments, degree), nlp_options=OPTIONS, show_summary=False
            )
        )

    return solve


def adaptive(error):
    def solve(case):
        problem = problem_of(case, 20, 3)
        return _time(
            maptor.solve_adaptive(
                problem, error_tolerance=error, max_iterations=25, nlp_options=OPTIONS, show_summary=False
            )
        )

    return solve


def _time(found):
    if not found.status["success"]:
        raise RuntimeError(found.status["message"])
    return found.status["objective"]


if __name__ == "__main__":
    fixed(5, 3)(1)
    meshes = {f"{k}x{n}": fixed(k, n) for k, n in ((20, 3), (60, 4))}
    plain.report({**meshes, "adaptive, 1e-6": adaptive(1e-6)})
