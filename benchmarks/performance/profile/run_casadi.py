"""Bare CasADi and IPOPT: Radau collocation on a uniform mesh, dynamics as an SX function, one solve."""

import casadi as ca
import numpy as np
from statement import IPOPT_OPTIONS, report


def solver_of(segments, degree):
    """Return a solver on segments x degree Radau points, with the end of each segment among them."""
    tau = np.append(0.0, ca.collocation_points(degree, "radau"))
    slopes, _, weights = ca.collocation_coeff(tau[1:].tolist())
    slopes, weights = np.array(slopes), np.ravel(np.array(weights))
    fractions = np.append(0.0, ((np.arange(segments)[:, None] + tau[1:]) / segments).ravel())
    points = segments * degree

    def solve(stated):
        n, m = len(stated.states), len(stated.controls)
        x, u, t = ca.SX.sym("x", n), ca.SX.sym("u", m), ca.SX.sym("t")
        p = ca.SX.sym("p", len(stated.parameters))
        values = stated.along(ca, t, ca.vertsplit(x), ca.vertsplit(u), ca.vertsplit(p) if p.numel() else [])
        along = ca.Function("along", [t, x, u, p], [ca.vertcat(*rows) for rows in values])
        X, U = ca.MX.sym("X", n, points + 1), ca.MX.sym("U", m, points)
        times, free = ca.MX.sym("times", 2), ca.MX.sym("free", p.numel())
        duration = times[1] - times[0]
        instants = times[0] + duration * ca.DM(fractions[1:]).T
        rates, paths, integrands = along.map(points)(instants, X[:, 1:], U, ca.repmat(free, 1, points))
        h = duration / segments
        rows, lower, upper = [], [], []
        for k in range(segments):
            here, there = slice(k * degree, (k + 1) * degree + 1), slice(k * degree, (k + 1) * degree)
            rows.append(ca.vec(X[:, here] @ slopes - h * rates[:, there]))
        lower, upper = [0.0] * (n * points), [0.0] * (n * points)
        if paths.numel():
            rows.append(ca.vec(paths))
            for ends, kept in zip(zip(*stated.path_bounds, strict=True), (lower, upper), strict=True):
                kept.extend(list(ends) * points)
        integrals = (
            h * (integrands @ ca.DM(np.tile(weights, segments))) if integrands.numel() else ca.MX(0, 1)
        )
        objective, events = stated.ends(
            ca, ca.vertsplit(times), ca.vertsplit(X[:, 0]), ca.vertsplit(X[:, -1]),
            ca.vertsplit(integrals) if integrals.numel() else [], ca.vertsplit(free) if free.numel() else [],
        )  # fmt: skip
        rows += [*events, duration]
        lower += [a for a, _ in stated.event_bounds] + [0.0]
        upper += [b for _, b in stated.event_bounds] + [np.inf]
        guess = [stated.line(share) for share in fractions]
        box = [[*stated.state_bounds] for _ in fractions]
        for place, ends in ((0, stated.initial), (-1, stated.final)):
            box[place] = [(max(a, c), min(b, d)) for (a, b), (c, d) in zip(box[place], ends, strict=True)]
        limits = [
            *(pair for column in box for pair in column), *(stated.control_bounds * points),
            stated.initial_time, stated.final_time, *stated.parameter_bounds,
        ]  # fmt: skip
        start = [
            *(v for states, _ in guess for v in states), *(v for _, controls in guess[1:] for v in controls),
            *stated.time_guess, *stated.parameter_guess,
        ]  # fmt: skip
        program = ca.nlpsol(
            "bare", "ipopt",
            {"x": ca.vertcat(ca.vec(X), ca.vec(U), times, free), "f": stated.sense * objective, "g": ca.vertcat(*rows)},
            {**IPOPT_OPTIONS, "expand": True},
        )  # fmt: skip
        found = program(
            x0=start, lbx=[a for a, _ in limits], ubx=[b for _, b in limits], lbg=lower, ubg=upper
        )
        if not program.stats()["success"]:
            raise RuntimeError(program.stats()["return_status"])
        return stated.sense * float(found["f"])

    return solve


if __name__ == "__main__":
    report({f"{k}x{n}": solver_of(k, n) for k, n in ((50, 4), (200, 3))})
