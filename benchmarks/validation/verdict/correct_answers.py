"""What must pass: right answers in any frame, problem files with a known value, and the entries of a problem set."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import casadi as ca

import gnc_opt as go
from benchmarks.validation.problem_set.reader import build_problem
from benchmarks.validation.verdict.answers import Case, Rates, cart, one_phase, phase_of
from benchmarks.validation.verdict.non_minimal_extremals import (
    double_well,
    great_circle,
    one_switch,
    repelled,
)
from benchmarks.validation.verdict.statements import (
    FAMILY,
    Frame,
    Statement,
    build,
    frames,
    in_frame,
    solved,
    trajectory,
)
from gnc_opt.planning.solution.refinement_history import RefinementStatus
from gnc_opt.problem_files_and_examples import find_example
from problems import rendezvous

FILES = (
    *("bilimoria_wie", "brachistochrone", "bryson_denham", "delta3", "goddard", "hang_glider"),
    *("hypersensitive", "interior_point", "minimum_fuel", "moon_landing", "orbit_raising", "periodic"),
    *("robot_arm", "shuttle", "speed_limit", "van_der_pol", "zermelo"),
)
"""Of `problems`, with a reference each."""

AGREES = 1e-6
"""Relative difference from a set's reference within which an answer is taken for right."""


class NotRight(Exception):
    """The solver did not find the known answer, so that there is nothing right to check."""


def right(documents: Sequence[Mapping[str, Any]], seed: int) -> Iterator[Case]:
    """Yield the correct answers; ``documents`` is a set of `benchmarks.validation.problem_set.reader`, or empty."""
    for s in FAMILY:
        yield Case("right: refined", s.name, partial(_check_refined, s))
        for frame in frames(s, seed):
            yield Case("right: samples", f"{s.name}, {frame.name}", partial(_check_samples, s, frame))
    for name, make in _near_misses().items():
        yield Case("right: near misses", name, partial(_solved, make))
    for file in FILES:
        yield Case("right: problem files", file, partial(_of_file, file))
    yield Case("right: problem files", "rendezvous, case 3", _rendezvous)
    for document in documents:
        if isinstance(document.get("reference"), (int, float)) and not document.get("expect"):
            yield Case("right: problem set", str(document["name"]), partial(_of_set, document))


def _near_misses() -> dict[str, Callable[[], go.Problem]]:
    """Minima beside the extremals that are none, and limits in unusual places."""
    return {
        **{f"great circle, {arc} rad": partial(great_circle, arc) for arc in (1.0, 2.5, 3.0)},
        **{f"u^2 - x^2 over {last} s": partial(repelled, last, 0.3) for last in (1.0, 2.5, 3.0)},
        "in a double well before pi / k": partial(double_well, 1.0, 2.5),
        **{f"one switch, bend {bend}": partial(one_switch, bend) for bend in (0.2, 0.5, 0.8)},
        "final time on its bound": _farthest,
        "start in a range": _start_anywhere,
        "two equal carts": _two_carts,
        "convex beyond a wall: |a| >= 1": _wall,
        "strictly convex but weak": _weak,
        "time-switched dynamics": _switched,
        "friction at rest": _friction,
    }


def _check_refined(s: Statement) -> go.Verdict:
    return go.verify(solved(s))


def _check_samples(s: Statement, frame: Frame) -> go.Verdict:
    return go.verify_trajectory(build(s, frame), *in_frame(s, trajectory(solved(s)), frame))


def _solved(make: Callable[[], go.Problem]) -> go.Verdict:
    return _checked(go.solve(make(), tol=1e-8))


def _checked(solution: go.Solution) -> go.Verdict:
    """What refining itself says it did not resolve is not found: no answer that a verdict could fail wrongly."""
    verdict, history = go.verify(solution), solution.history
    ended = (RefinementStatus.CONVERGED, RefinementStatus.CONDITIONS_FAIL)
    if verdict.failed and history is not None and history.status not in ended:
        raise NotRight(f"refining ended as {history.status.value}; {verdict.failed[0].name} fails")
    return verdict


def _of_file(name: str) -> go.Verdict:
    module = find_example(name).module
    solution = go.solve(module.build(), tol=1e-8)
    if not module.REFERENCE.agrees(solution.objective):
        raise NotRight(f"objective {solution.objective:.10g}, known {module.REFERENCE.value:.10g}")
    return _checked(solution)


def _rendezvous() -> go.Verdict:
    solution = go.solve(rendezvous.build(3), mesh=rendezvous.MESH, tol=1e-8)
    known = rendezvous.REFERENCE[3, "printed"]["exact"].value
    if abs(solution.objective - known) > 1e-6:
        raise NotRight(f"objective {solution.objective:.10g}, known {known:.10g}")
    return _checked(solution)


def _of_set(document: Mapping[str, Any]) -> go.Verdict:
    solution = go.solve(
        build_problem(document), tol=1e-8, throw=False, options=go.SolverOptions(max_wall_time=60.0)
    )
    known = float(document["reference"])
    if not solution.status.solved or abs(solution.objective - known) > AGREES * max(1.0, abs(known)):
        raise NotRight(f"objective {solution.objective:.10g}, known {known:.10g}")
    return _checked(solution)


# --- limits in unusual places ------------------------------------------------------------------------------


def _farthest() -> go.Problem:
    """As far as possible in 2 s at most: 1 m."""
    problem, leg, _, _ = cart(1.0, (0.0, (0.1, 2.0)), end=(None, 0.0))
    leg.bounds(a=(-1.0, 1.0))
    problem.maximize(leg.final_state("q"))
    return problem


def _start_anywhere() -> go.Problem:
    """From rest anywhere between 0.5 m and 1 m: sqrt(2) s from the nearer end."""
    problem, leg, _, _ = cart(1.0, (0.0, (0.1, 10.0)), start=((0.5, 1.0), 0.0), end=(0.0, 0.0))
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    return problem


def _two_carts() -> go.Problem:
    """Two carts, one cost: they switch at the same time."""
    model = go.Model("carts")
    q, v = model.state("q", 2), model.state("v", 2)
    a = model.control("a", 2)
    model.ode({q: v, v: a})
    problem = go.Problem("two carts")
    leg = problem.phase("leg", model)
    leg.time(0.0, (0.1, 10.0))
    leg.initial(q=[1.0, 1.0], v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=([-1.0, -1.0], [1.0, 1.0]))
    problem.minimize(leg.final_time)
    return problem


def _wall() -> go.Problem:
    """Least square of a, kept at 1 or more: a = 1 throughout."""
    problem, leg, _, a = cart(1.0, (0.0, 1.0), end=((0.0, None), None))
    leg.bounds(a=(-3.0, 3.0))
    leg.path("wall", a**2, lower=1.0)
    leg.guess([0.0, 1.0], a=1.5)
    problem.minimize(leg.integral(a**2) - 0.1 * leg.final_state("v"))
    return problem


def _weak() -> go.Problem:
    """A small square of the control beside a large constant."""
    problem, leg, _, a = cart(1.0, (0.0, 1.0), end=(1.0, 0.0))
    leg.bounds(a=(-20.0, 20.0))
    problem.minimize(leg.integral(1e3 + 0.5 * a**2))
    return problem


def _switched() -> go.Problem:
    """Thrust that halves at 0.5 s, in two phases."""
    problem = go.Problem("switched")
    legs = [
        phase_of(problem, name, "q v", "a", lambda q, v, a, gain=gain: [v, gain * a], time)[0]
        for name, gain, time in (("full", 1.0, (0.0, 0.5)), ("half", 0.5, (0.5, 1.0)))
    ]
    legs[0].initial(q=0.0, v=0.0)
    legs[1].final(q=1.0, v=0.0)
    problem.link(legs[0], legs[1])
    problem.minimize(sum(leg.integral(leg.model.symbol("a") ** 2) for leg in legs))
    return problem


def _friction() -> go.Problem:
    """Coulomb friction, from rest to rest: v never changes its sign."""
    rates: Rates = lambda q, v, a: [v, a - 0.2 * ca.sign(v)]  # noqa: E731
    problem, leg, _, _ = one_phase("friction", "q v", "a", rates, (0.0, (0.1, 10.0)))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0), v=(0.0, None))
    problem.minimize(leg.final_time)
    return problem
