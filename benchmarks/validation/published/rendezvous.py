"""Time-optimal rendezvous: the publication's minimum times beside ours, on its mesh and refined.

Mousavi and Esmailifar, J. Space Science, Technology and Applications 1 (2), 147-166, 2022. What its numbers are that
differ, other local minima, is found by `benchmarks.validation.rendezvous_minima`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import gnc_opt as go
from benchmarks.validation.published.comparison import Value
from benchmarks.validation.published.pareto import Front, certified
from benchmarks.validation.published.tracked import Rivals
from problems.rendezvous.model import (
    ALTITUDE,
    CASES,
    EQUATIONS,
    FINAL_POSITION,
    FINAL_SIGMA,
    INERTIA,
    MASS,
    MAX_FORCE,
    MAX_TORQUE,
    PAPER_MESH,
    build,
)
from problems.rendezvous.optimal import REFERENCE
from problems.rendezvous_tracking.control import SHOWN, Conditions, Tracking, plan

SHARES = (1.0, 0.95, 0.9, 0.85, 0.8, 0.7, 0.6)
"""Of the torques and forces, on the front."""


def values() -> Iterator[Value]:
    """Yield every computed quantity of the table; each equation is transcribed once."""
    yield from _data()
    problems = {equation: build(equation=equation) for equation in EQUATIONS}
    solutions = {
        (case, equation): go.solve(problem.with_initial(r_L=list(place)), mesh=PAPER_MESH, tol=None)
        for equation, problem in problems.items()
        for case, place in CASES.items()
    }
    yield from _size(solutions[1, EQUATIONS[0]])
    for (case, equation), solution in solutions.items():
        t_f = solution.objective
        yield Value(f"case {case}, {equation} equation: minimum time (s)", t_f)
        for key in ("paper GPM", "paper GPOPS"):
            if key in REFERENCE[case, equation]:
                yield Value(f"case {case}, {key}", t_f)


def _data() -> Iterator[Value]:
    yield Value("data: moments of inertia (kg m^2)", INERTIA)
    yield Value("data: mass (kg)", MASS)
    yield Value("data: limits of torque (N m) and force (N)", (MAX_TORQUE, MAX_FORCE))
    yield Value("data: altitude (km)", ALTITUDE / 1e3)
    yield Value("data: final sigma, y", FINAL_SIGMA[1])
    yield Value("data: final position (m)", FINAL_POSITION)
    yield Value("data: segments and points of each", (PAPER_MESH.segments, PAPER_MESH.degrees[0]))
    for case, place in CASES.items():
        yield Value(f"data: first position, case {case} (m)", place)
    yield Value("data: formula of the final sigma, y", FINAL_SIGMA[1])
    yield Value("the curves of figures 3 to 15", ())


def _size(solution: go.Solution) -> Iterator[Value]:
    """Yield the size of the program, counted from what is unknown and what has to hold."""
    leg = solution.phase()
    states, controls = leg.states.size, leg.controls.size
    points, segments = leg.mesh.size, leg.mesh.segments
    yield Value("variables of the programme", (points + segments + 1) * states + points * controls + 1)
    # collocation at every point, the end of every segment by quadrature; the ends themselves are fixed by bounds
    yield Value("constraints of the programme", (points + segments) * states)
    yield Value("nonzeros of its Jacobian", ())


def front() -> Front:
    """Return what less time costs: the share of the torques and forces with which case 1 takes so long."""

    def solve(share: float) -> go.Solution:
        torque, force = share * MAX_TORQUE, share * MAX_FORCE
        return go.solve(build(1).with_bounds(T_B=(-torque, torque), F_B=(-force, force)), tol=1e-8)

    def measure(solution: go.Solution) -> tuple[float, float]:
        most = float(np.max(np.abs(solution.phase().flown(np.linspace(0.0, solution.objective, 500))[:3])))
        return solution.objective, 100 * most / MAX_TORQUE

    published = (REFERENCE[1, "printed"]["paper GPM"].value, 100.0)
    return Front("authority (%)", certified(SHARES, solve, measure), published, "the paper's GPM")


def rivals() -> Rivals:
    """Return the refined plan and the one on the paper's mesh, both with a reserve of authority and a TVLQR."""
    conditions = Conditions()
    plans = {"refined plan, TVLQR": True, "plan on the paper's mesh, TVLQR": False}
    tracked = {name: Tracking(plan(refined=refined), conditions) for name, refined in plans.items()}
    first = next(iter(tracked.values()))
    states = first.reference.model.states
    target = first.reference.x(first.reference.final_time)
    measures = {what: (f"{label} ({unit})", factor) for what, (label, factor, unit) in SHOWN.items()}
    return Rivals(
        {name: (each.loop(each.tvlqr), each.initial) for name, each in tracked.items()},
        max(each.end for each in tracked.values()),
        conditions.dispersions,
        {name: target[states.slice(name)] for name in states.names},
        {**measures, "effort(F_B)": ("effort of the forces (N s)", 1.0)},
    )
