"""The rendezvous as a bare CasADi script: what `benchmarks.performance.speed` measures the package against.

This is what a good engineer writes by hand for one problem: one SX function of the dynamics mapped over
the collocation points, Legendre-Gauss collocation in a dozen lines, the whole program given to `nlpsol`
with ``expand=True`` so that CasADi differentiates it. It has no names, costates, checks or verification, and it
shares no code with gnc_opt but the quadrature rule, the mesh's numbers and the start that it is handed.

Problem: time-optimal rendezvous and docking in 6 degrees of freedom, rotational equation as printed in
Mousavi & Esmailifar, J. Space Sci. Technol. & Appl. 1(2), 147-166, 2022. SI units.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

INITIAL_POSITIONS = {1: (20, 0, 0), 2: (20, 4, 0), 3: (20, 4, 4), 4: (20, 4, -5), 5: (25, -5, -5)}
FINAL_POSITION = (0, 0, -10)
TORQUE, FORCE = 50.0, 320.0
INERTIA = (5621.0, 4547.0, 2364.0)
MASS = 3200.0
ORBIT_RATE = float(np.sqrt(398600.4418e9 / (6378.137e3 + 580e3) ** 3))
N_STATES, N_CONTROLS = 12, 6


@dataclass(frozen=True)
class BareResult:
    """What the bare script found and what it took.

    Attributes
    ----------
    final_time : float
        s.
    iterations : int
    build_s, solve_s : float
        Wall time until `nlpsol` is ready, and of the call (s).
    function_s, linear_s : float
        Share of ``solve_s`` in functions and derivatives, and the rest (s).
    """

    final_time: float
    iterations: int
    build_s: float
    solve_s: float
    function_s: float
    linear_s: float

    @property
    def total_s(self) -> float:
        """Build and solve together (s)."""
        return self.build_s + self.solve_s


def dynamics() -> Any:
    """Return the SX function (x, u) -> dx/dt; x = (omega, sigma, v, s), u = (torque, force)."""
    omega, sigma, v, s = (ca.SX.sym(name, 3) for name in ("omega", "sigma", "v", "s"))
    torque, force = ca.SX.sym("torque", 3), ca.SX.sym("force", 3)
    inertia = ca.DM(INERTIA)
    cross, norm2 = ca.skew(sigma), ca.dot(sigma, sigma)
    rotation = ca.SX.eye(3) + (8 * cross @ cross - 4 * (1 - norm2) * cross) / (1 + norm2) ** 2
    w = rotation @ ca.DM([0, -ORBIT_RATE, 0])
    d_omega = (torque - ca.cross(omega, inertia * omega) - ca.cross(w, inertia * (omega + w))) / inertia
    d_sigma = 0.25 * ((1 - norm2) * ca.SX.eye(3) + 2 * cross + 2 * sigma @ sigma.T) @ omega
    coriolis = 2 * ORBIT_RATE * ca.vertcat(-v[2], 0, v[0])
    gradient = ORBIT_RATE**2 * ca.vertcat(0, s[1], -3 * s[2])
    d_v = rotation.T @ force / MASS - coriolis - gradient
    x, u = ca.vertcat(omega, sigma, v, s), ca.vertcat(torque, force)
    return ca.Function("dynamics", [x, u], [ca.vertcat(d_omega, d_sigma, d_v, v)])


def boundary_states(case: int) -> tuple[Array, Array]:
    """Return initial and final state, (12,) each."""
    initial, final = np.zeros(N_STATES), np.zeros(N_STATES)
    initial[9:] = INITIAL_POSITIONS[case]
    final[4] = np.tan(np.pi / 8)
    final[9:] = FINAL_POSITION
    return initial, final


def solve_bare(
    case: int,
    segments: int,
    rule: tuple[Array, Array, Array],
    start: Array,
    options: dict[str, Any],
    scales: tuple[Array, Array, float] | None = None,
) -> BareResult:
    """Build the program from nothing and solve it.

    Parameters
    ----------
    case : int
        1 to 5.
    segments : int
        Number of equal segments.
    rule : tuple
        Legendre-Gauss nodes (n,), weights (n,) and differentiation matrix (n, n + 1) on [-1, 1].
    start : array
        For each segment its start state, then state and control of every point; the last state; the final time.
    options : dict
        Of `nlpsol`.
    scales : tuple of (states (12,), controls (6,), float), optional
        Typical magnitudes of states, controls and the final time; 1 by default.
    """
    begin = time.perf_counter()
    _, weights, differentiation = rule
    n = weights.size
    x_scale, u_scale, t_scale = scales or (np.ones(N_STATES), np.ones(N_CONTROLS), 1.0)
    point_scale = np.concatenate([x_scale, u_scale])
    # One column per segment: its start state, then state and control of each point.
    scale = np.concatenate(
        [np.tile(np.concatenate([x_scale, np.tile(point_scale, n)]), segments), x_scale, [t_scale]]
    )
    z = ca.MX.sym("z", scale.size)
    physical = ca.DM(scale) * z
    columns = ca.reshape(physical[: -N_STATES - 1], -1, segments)
    final_time = physical[-1]
    points = ca.reshape(columns[N_STATES:, :], N_STATES + N_CONTROLS, n * segments)
    starts = columns[:N_STATES, :]
    ends = ca.horzcat(starts[:, 1:], physical[-N_STATES - 1 : -1])
    rates = dynamics().map(n * segments)(points[:N_STATES, :], points[N_STATES:, :])
    nodes = [starts, *(points[:N_STATES, j::n] for j in range(n))]
    half = final_time / (2 * segments)
    rows = []
    for i in range(n):
        slope = sum(differentiation[i, j] * nodes[j] for j in range(n + 1))
        rows.append(slope - half * rates[:, i::n])
    rows.append(ends - starts - half * sum(weights[j] * rates[:, j::n] for j in range(n)))
    defects = ca.vec(ca.vertcat(*rows)) / ca.DM(np.tile(x_scale, (n + 1) * segments))
    nlp = {"x": z, "f": final_time / t_scale, "g": defects}
    solver = ca.nlpsol("bare", "ipopt", nlp, {**options, "expand": True})
    lower, upper = _bounds(case, n, segments)
    build_s = time.perf_counter() - begin
    begin = time.perf_counter()
    result = solver(x0=start / scale, lbx=lower / scale, ubx=upper / scale, lbg=0, ubg=0)
    solve_s = time.perf_counter() - begin
    stats = solver.stats()
    function_s = sum(value for name, value in stats.items() if name.startswith("t_wall_nlp_"))
    return BareResult(
        float(result["x"][-1]) * t_scale,
        int(stats["iter_count"]),
        build_s,
        solve_s,
        function_s,
        solve_s - function_s,
    )


def _bounds(case: int, n: int, segments: int) -> tuple[Array, Array]:
    """Bounds of the variables in physical units."""
    x_max = np.full(N_STATES, np.inf)
    x_max[3:6] = 1.0
    u_max = np.repeat([TORQUE, FORCE], 3)
    segment = np.concatenate([x_max, np.tile(np.concatenate([x_max, u_max]), n)])
    upper = np.concatenate([np.tile(segment, segments), x_max, [100.0]])
    lower = -upper
    lower[-1] = 1.0
    initial, final = boundary_states(case)
    lower[:N_STATES] = upper[:N_STATES] = initial
    lower[-N_STATES - 1 : -1] = upper[-N_STATES - 1 : -1] = final
    return lower, upper
