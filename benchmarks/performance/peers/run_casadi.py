"""Bare CasADi: collocation in a dozen lines, MX with the dynamics as an SX function, and SX throughout."""

import casadi as ca
import numpy as np
import plain


def solver_of(kind, segments, degree):
    def solve(case):
        tau, weights = np.polynomial.legendre.leggauss(degree)
        nodes = np.append(-1.0, tau)
        differentiation = np.array([[_slope(nodes, j, t) for j in range(degree + 1)] for t in tau])
        x, u = ca.SX.sym("x", 12), ca.SX.sym("u", 6)
        inputs = [plain.LIMITS[i] * u[i] for i in range(6)]
        states = [plain.SCALES[i] * x[i] for i in range(12)]
        f = plain.rates(states, inputs)
        rate = ca.Function(
            "rate", [x, u], [ca.vertcat(*(v / s for v, s in zip(f, plain.SCALES, strict=True)))]
        )
        X, end = kind.sym("X", 12, segments * (degree + 1)), kind.sym("end", 12)
        U, final_time = kind.sym("U", 6, segments * degree), kind.sym("tf")
        half = plain.GUESSED * final_time / (2 * segments)
        rows = []
        for k in range(segments):
            here = X[:, k * (degree + 1) : (k + 1) * (degree + 1)]
            after = X[:, (k + 1) * (degree + 1)] if k + 1 < segments else end
            values = rate.map(degree)(here[:, 1:], U[:, k * degree : (k + 1) * degree])
            rows.append(here @ differentiation.T - half * values)
            rows.append(after - here[:, 0] - half * (values @ weights))
        z = ca.vertcat(ca.vec(X), end, ca.vec(U), final_time)
        nlp = {"x": z, "f": final_time, "g": ca.vertcat(*(ca.vec(row) for row in rows))}
        quiet = {
            "ipopt.print_level": 0,
            "print_time": False,
            "ipopt.sb": "yes",
            "ipopt.tol": 1e-8,
            "expand": True,
        }
        program = ca.nlpsol("bare", "ipopt", nlp, quiet | {"ipopt.max_iter": 1000})
        scales = np.array(plain.SCALES)
        shares = np.append(((np.arange(segments)[:, None] + 0.5 * (nodes + 1)) / segments).ravel(), 1.0)
        start = np.stack([np.array(plain.line(case, s)) / scales for s in shares], axis=1)
        box = np.full(start.shape, np.inf)
        box[3:6] = 1.0
        lower, upper = -box, box.copy()
        lower[:, 0] = upper[:, 0] = start[:, 0]
        lower[:, -1] = upper[:, -1] = start[:, -1]
        n = 6 * segments * degree
        found = program(
            x0=np.concatenate([start.T.ravel(), np.full(n, 0.1), [1.0]]),
            lbx=np.concatenate([lower.T.ravel(), -np.ones(n), [1.0 / plain.GUESSED]]),
            ubx=np.concatenate([upper.T.ravel(), np.ones(n), [plain.LONGEST / plain.GUESSED]]),
            lbg=0,
            ubg=0,
        )
        if not program.stats()["success"]:
            raise RuntimeError(program.stats()["return_status"])
        return plain.GUESSED * float(found["f"])

    return solve


def _slope(nodes, j, t):
    others = np.delete(nodes, j)
    return sum(np.prod(t - np.delete(others, k)) for k in range(others.size)) / np.prod(nodes[j] - others)


if __name__ == "__main__":
    solver_of(ca.MX, 5, 3)(1)
    meshes = {"20x3": (20, 3), "60x4": (60, 4), "120x4": (120, 4)}
    plain.report(
        {
            f"{kind.__name__} {name}": solver_of(kind, *m)
            for kind in (ca.MX, ca.SX)
            for name, m in meshes.items()
        }
    )
