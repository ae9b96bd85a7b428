"""ASSET: Lobatto collocation in C++ with its own interior-point method."""

import asset_asrl as asset
import numpy as np
import plain

control = asset.OptimalControl


class Rendezvous(control.ODEBase):
    """The dynamics, controls in shares of their limits."""

    def __init__(self):
        arguments = control.ODEArguments(12, 6)
        x = [arguments.XVar(i) for i in range(12)]
        u = [limit * arguments.UVar(i) for i, limit in enumerate(plain.LIMITS)]
        super().__init__(asset.VectorFunctions.stack(list(plain.rates(x, u))), 12, 6)


def solver_of(scheme, segments, mode):
    def solve(case):
        shares = np.linspace(0.0, 1.0, 100)
        start = [np.array([*plain.line(case, s), s * plain.GUESSED, *(0.1,) * 6]) for s in shares]
        phase = Rendezvous().phase(scheme, start, segments)
        first, last = plain.ends(case)
        phase.setControlMode(mode)
        phase.addBoundaryValue("Front", range(13), [*first, 0.0])
        phase.addBoundaryValue("Back", range(12), last)
        for i in range(13, 19):
            phase.addLUVarBound("Path", i, -1.0, 1.0, 1.0)
        phase.addDeltaTimeObjective(1.0)
        phase.optimizer.set_PrintLevel(3)
        phase.optimizer.set_MaxIters(1000)
        phase.setThreads(1, 1)
        flag = phase.solve_optimize()
        if "CONVERGED" not in str(flag).upper() or "NOT" in str(flag).upper():
            raise RuntimeError(str(flag))
        return phase.returnTraj()[-1][12]

    return solve


if __name__ == "__main__":
    ways = {}
    for mode in ("BlockConstant", "NoSpline"):
        for scheme, segments in (("LGL3", 60), ("LGL5", 60), ("LGL3", 240), ("LGL5", 240)):
            ways[f"{scheme} {segments}, {mode}"] = solver_of(scheme, segments, mode)
    plain.report(ways)
