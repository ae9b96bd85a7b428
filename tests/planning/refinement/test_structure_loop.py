"""Structures: detected in coarse solutions, corrected and optimised with their arcs."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.constructed_solutions import cart, interval, samples
from testing.internals import (
    ARC_MAX_DEGREE,
    ARC_MAX_SEGMENTS,
    FIRST_DEGREE,
    ArcMesh,
    PhaseSamples,
    PhaseStructure,
    SmoothControl,
    SubarcMesh,
    detect_control_structure,
)
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.array_types import Array
from gnc_opt.planning import ArcKind
from gnc_opt.planning.optimality.sampling_at_narrow_peaks import find_zero_times
from gnc_opt.planning.refinement.arcs import hamiltonian_convexity as b
from gnc_opt.planning.refinement.arcs import structure_detection as d
from gnc_opt.planning.refinement.arcs import structure_update as f
from gnc_opt.planning.refinement.arcs import switching_time_optimization as s
from problems.classics import van_der_pol

# Detection of arcs in coarse solutions, and the pieces of which a structure is made.


# Recognising a control structure from samples that are given by hand, step by step.


LOW, FREE, UP, SING = ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER, ArcKind.SINGULAR
LETTERS = {"l": LOW, "i": FREE, "u": UP, "s": SING, "r": ArcKind.RELEASED}
PER_SEGMENT = 4


def kinds(text: str) -> Any:
    return np.array([LETTERS[c] for c in text], dtype=object)


def text(labels: Any) -> str:
    return "".join({kind: c for c, kind in LETTERS.items()}[kind] for kind in labels)


def sampled(segments: int, breaks: Any = None, **more: Any) -> Any:
    """Four samples to a segment of 1 s, its ends among them; one control between -1 and 1."""
    edges = np.arange(segments + 1.0) if breaks is None else np.asarray(breaks, float)
    times = np.linspace(edges[:-1], edges[1:], PER_SEGMENT, axis=1).ravel()
    values = {
        "times": times,
        "segments": np.repeat(np.arange(segments), PER_SEGMENT),
        "control_scale": np.array([2.0]),
        "u": np.zeros((1, times.size)),
        "phase": SimpleNamespace(
            breaks=edges, control_bounds=interval(-1.0, 1.0), state_bounds=interval(-np.inf, np.inf)
        ),
        "x": np.zeros((1, times.size)),
        "state_scale": np.ones(1),
        "functions": SimpleNamespace(state_rates=lambda t, x, u: u),
    }
    return SimpleNamespace(**(values | more))


def singular(inside: list[float], gradient: list[float]) -> list[int]:
    """Segments by the share of their points at which the control is inside, and the largest switching function."""
    values = tuple(np.where(np.arange(10) < 10 * share, 0.0, 1.0)[None, :] for share in inside)
    there = sampled(len(inside))
    there.phase.u = SimpleNamespace(values=values)
    return d._find_singular_segments(
        there, 0, np.repeat(gradient, PER_SEGMENT) * np.tile([0.5, -1, 0.2, 0], len(inside))
    )


CART = cart()


def integrator(**bounds: Any) -> go.Problem:
    """x' = u, the integral of x: H is linear in u, and its switching function is lam."""
    model, x, _u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("integrator", model, 0.0, 8.0)
    problem.minimize(leg.integral(x))
    return problem


LINE = integrator()


def flight(u: Any, lam: Any, bounds: Any = (-1.0, 1.0), segments: int = 8, x: Any = None) -> PhaseSamples:
    return samples(
        LINE,
        x or (lambda t, k: [0.1 * t]),
        u,
        lam,
        weights=(0.0,),
        breaks=np.arange(segments + 1.0),
        degree=3,
        control_bounds=interval(*bounds),
    )


def test_curvature_distinguishes_linear_from_convex() -> None:
    """H'' = 1 over a range of 20, in shares of H of 54: 400 / 54."""
    found = samples(CART, control_bounds=interval(-10.0, 10.0))
    assert b.compute_hamiltonian_curvature(found) == pytest.approx(400 / found.hamiltonian_scale)
    assert b.mask_regular_controls(found).tolist() == [True] and b.mask_affine_controls(found).tolist() == [
        False
    ]
    concave = samples(CART, weights=(-0.5,), control_bounds=interval(-10.0, 10.0))
    assert b.mask_regular_controls(concave).tolist() == [False] == b.mask_affine_controls(concave).tolist()
    line = flight(lambda t, k: [0 * t], lambda t, k: [t])
    assert b.mask_regular_controls(line).tolist() == [False] and b.mask_affine_controls(line).tolist() == [
        True
    ]


def test_a_convex_control_is_at_a_bound_if_it_touches_and_is_pulled_there() -> None:
    """At 5, then at -5, its bounds; dH/du = a + lam_v is negative at the upper one, or positive at the lower one."""
    for lam, labels in ((-8.0, [UP, FREE]), (8.0, [FREE, LOW]), (0.0, [FREE, FREE])):
        found = samples(
            CART,
            u=lambda t, k: [5.0 - 10 * k + 0 * t],
            lam=lambda t, k, lam=lam: [0 * t, lam + 0 * t],
            control_bounds=interval(-5.0, 5.0),
        )
        rows = d._classify_nonlinear_arcs(found, 0)
        assert [set(rows[found.segments == k]) for k in (0, 1)] == [{label} for label in labels]
    neither = samples(CART, lam=lambda t, k: [0 * t, 0 * t], control_bounds=interval(-9.0, 9.0))
    assert set(d._classify_nonlinear_arcs(neither, 0)) == {FREE}


def test_a_root_lies_where_the_signs_differ_or_else_in_the_middle() -> None:
    def at(values: Callable[[Array], Array], left: float, right: float) -> float:
        ends = np.array([left]), np.array([right])
        return float(find_zero_times(lambda t: values(t)[None], np.array([0]), *ends)[0])

    assert all(at(lambda t, s=s: s * (t - 0.3), 0.0, 1.0) == pytest.approx(0.3, abs=1e-14) for s in (-1, 1))
    assert at(lambda t: t + 1, 0.0, 1.0) == 0.5 and at(lambda t: -t - 1, 2.0, 4.0) == 3.0
    assert at(lambda t: t, 0.0, 1.0) == 0.0
    assert at(lambda t: t - 1e6 - 0.3, 1e6, 1e6 + 1) == pytest.approx(1e6 + 0.3, abs=2e-8)


def test_the_structure_of_the_cart_has_all_rows() -> None:
    """A convex control within bounds, a mixed path at its limit late, a pure one, two states."""
    found = d.detect_control_structure(
        samples(
            CART,
            paths=lambda t, k: [-1.0 + 0 * t, 0 * t],
            path_bounds=interval([-5.0, -50.0], [100.0, np.inf]),
            control_bounds=interval(-20.0, 20.0),
            breaks=np.linspace(0, 1, 9),
        )
    )
    assert found.regular == (True, True, False, False, False) and (found.n_controls, found.n_paths) == (1, 2)
    assert found.arc_kind_matrix()[1:3].tolist() == [[FREE, LOW], [FREE, FREE]]
    crossing = (-1 + np.sqrt(1 + 4 * 11 / 6)) / 2  # 6 - 6 t - 6 t^2 = -5
    assert found.times[1] == pytest.approx(crossing, abs=0.02) and found.times[2] == 1.0


# The pieces of a control structure: vanishing and added arcs, and how finely each piece is
# solved.


def test_switches_are_found_at_the_zeros_of_the_switching_function() -> None:
    """Not halfway between samples: the costates of a coarse mesh know the switch better than its controls."""
    model, *_ = dynamics("double integrator", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("minimum time", model, 0.0, (0.1, 10.0))
    leg.initial(q=1.0, v=0.3)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    samples = go.solve(problem, mesh="5x4", tol=None).samples()["leg"]
    structure = detect_control_structure(samples)
    assert [piece[0] for piece in structure.kinds] == [LOW, UP]
    assert abs(samples.phase.costate("v")(structure.times[1])) < 1e-12  # dH/da
    assert structure.times[0] == 0.0 and structure.times[2] == pytest.approx(samples.phase.final_time)


def pursuit(x_unit: float, u_unit: float, t_unit: float, cost: float) -> go.Problem:
    """x' = u, |u| <= 2, min of half the integral of (x - sin t)^2, x(0) = 1, x(3) = 3/2, in other units."""
    model, x, _u = dynamics("pursuit", "x", "u", lambda x, u: {x: u / u_unit * x_unit / t_unit})
    problem, leg = one_phase("pursuit", model, 0.0, 3.0 * t_unit)
    leg.initial(x=1.0 * x_unit)
    leg.final(x=1.5 * x_unit)
    leg.bounds(u=tuple(sorted((-2.0 * u_unit, 2.0 * u_unit))))
    off = x / x_unit - ca.sin(model.time / t_unit)
    problem.minimize(0.5 * cost / t_unit * leg.integral(off**2))
    return problem


def regulator(x_unit: float, u_unit: float, t_unit: float, cost: float) -> go.Problem:
    """x' = u, |u| <= 1, half the integral of x^2 + u^2 over 4 s, x(0) = 3: a kink, in other units."""
    model, x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u / u_unit * x_unit / t_unit})
    problem, leg = one_phase("saturated regulator", model, 0.0, 4.0 * t_unit)
    leg.initial(x=3.0 * x_unit)
    leg.bounds(u=tuple(sorted((-1.0 * u_unit, 1.0 * u_unit))))
    problem.minimize(0.5 * cost / t_unit * leg.integral((x / x_unit) ** 2 + (u / u_unit) ** 2))
    return problem


@pytest.mark.slow
def test_the_structure_does_not_depend_on_units() -> None:
    """Same arcs, same passes, same mesh; the arcs of a control in a negative unit are upside down."""
    units = (0.1, -20.0, 0.05, 0.02)
    usual, other = (go.refine(go.solve(regulator(*u), tol=None)) for u in ((1.0,) * 4, units))
    upside_down = {LOW: UP, UP: LOW} if units[1] < 0 else {}
    for a, found in zip(usual.structure, other.structure, strict=True):
        assert found.kind is upside_down.get(a.kind, a.kind)
        assert (found.start, found.end) == pytest.approx(
            (a.start * units[2], a.end * units[2]), rel=1e-7, abs=1e-7
        )
    assert usual.history is not None and other.history is not None
    assert len(usual.history.passes) == len(other.history.passes)
    assert usual.phase().mesh.degrees == other.phase().mesh.degrees


def power_limited(unit: float) -> go.Problem:
    """Rest to rest over 1 m in 1 s with the least energy and a power a v of at most 3 W/kg, in another unit."""
    model, _q, v, a = dynamics("double integrator", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("power limit", model, 0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.guess(q=(0.0, 1.0), v=lambda t: 6 * t * (1 - t), a=lambda t: 6 - 12 * t)
    leg.path("power", unit * a * v, upper=3.0 * unit)
    problem.minimize(0.5 * leg.integral(a**2))
    return problem


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1e3])
def test_power_limit_is_found_though_at_rest_it_does_not_depend_on_the_control(unit: float) -> None:
    """Free, at the limit (v^2 / 2 grows by 3 t), free again with a linear control: lam_q is constant."""
    first = go.solve(power_limited(unit), mesh="12x4", tol=None)
    found = detect_control_structure(first.samples()["leg"])
    assert found.arc_kind_matrix()[found.n_controls].tolist() == [FREE, UP, FREE]
    solution = go.refine(first)
    assert solution.history is not None and solution.history.converged
    (active,) = [arc for arc in solution.structure if arc.channel == "power"]
    assert active.kind is UP and 0.05 < active.start < active.end < 0.6
    v = solution.state("v")
    for t in np.linspace(active.start, active.end, 7):
        assert v(t) ** 2 - v(active.start) ** 2 == pytest.approx(6.0 * (t - active.start), abs=1e-8)
    a, lam = solution.control("a"), solution.costate("q")
    for left, right in ((0.0, active.start), (active.end, 1.0)):
        middle = 0.5 * (left + right)
        assert a(middle) - 0.5 * (a(left) + a(right, "left")) == pytest.approx(0.0, abs=1e-6)
        assert (a(right, "left") - a(left)) / (right - left) == pytest.approx(lam(middle), rel=1e-6)
    verdict = go.verify(solution, tol=1e-7)
    assert verdict.ok, verdict.explain()


MESHES = ["8x4", "15x4", "40x3"]


@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize("units", [(1.0, 1.0, 1.0, 1.0), (40.0, -30.0, 10.0, 1e3)])
def test_a_singular_arc_is_found_to_a_segment_on_any_mesh(mesh: str, units: tuple[float, ...]) -> None:
    """Controls chatter beside its ends; the short bangs are not taken for arcs. The ends are 0.338 s and 2.531 s."""
    solution = go.solve(pursuit(*units), mesh=mesh, tol=None)
    structure = detect_control_structure(solution.samples()["leg"])
    bangs = [LOW, UP] if units[1] > 0 else [UP, LOW]
    assert [piece[0] for piece in structure.kinds] == [bangs[0], ArcKind.SINGULAR, bangs[1]]
    segment = 3.0 * units[2] / solution.phase().mesh.segments
    assert np.abs(np.array(structure.times[1:3]) - np.array([0.338, 2.531]) * units[2]).max() < segment


@pytest.mark.parametrize("mesh", MESHES)
def test_two_bangs_before_a_singular_arc_are_found_on_any_mesh(mesh: str) -> None:
    solution = go.solve(van_der_pol.build(), mesh=mesh, tol=None)
    (samples,) = solution.samples().values()
    structure = detect_control_structure(samples)
    assert [piece[0] for piece in structure.kinds] == [LOW, UP, ArcKind.SINGULAR]
    segment = 4.0 / samples.phase.mesh.segments
    assert np.abs(np.array(structure.times[1:3]) - van_der_pol.SWITCH_TIMES).max() < segment


# The structure loop by hand: plans, kinks, arcs that vanish or are missing, and how it ends.


RELEASED = ArcKind.RELEASED


def test_finer_pieces_get_points_first_as_many_as_there_are_decades_to_gain() -> None:
    assert SubarcMesh() == SubarcMesh(1, FIRST_DEGREE, 0, np.inf, ())
    assert SubarcMesh(1, 6).refine_to_reduce_errors(np.array([0.1])) == SubarcMesh(1, 9)
    assert SubarcMesh(2, 6).refine_to_reduce_errors(np.array([-1.0, 3.5])) == SubarcMesh(2, 10)
    assert SubarcMesh(1, 11).refine_to_reduce_errors(np.array([8.0])) == SubarcMesh(1, ARC_MAX_DEGREE)
    assert SubarcMesh(3, 7).refine_to_reduce_errors(np.array([0.0, -1.0, -9.0])) == SubarcMesh(3, 7)
    many = SubarcMesh(ARC_MAX_SEGMENTS + 5, ARC_MAX_DEGREE)
    assert many.refine_to_reduce_errors(np.full(many.segments, 5.0)) == many


def held_by(plan: ArcMesh) -> Any:
    asked: dict[str, Any] = {}
    leg = SimpleNamespace(numbers=SimpleNamespace(initial=SimpleNamespace(is_fixed=np.ones(1, dtype=bool))))
    problem = SimpleNamespace(
        phases={"leg": leg}, with_fixed_arcs=lambda name, **more: asked.update(more, name=name) or problem
    )
    assert plan.fix_arcs_in_problem(problem, "leg") is problem  # type: ignore[arg-type]
    return asked


def test_controls_paths_and_states_are_held_segment_by_segment() -> None:
    structure = PhaseStructure(
        (0.0, 1.0, 2.0, 3.0),
        ((LOW, FREE, FREE, FREE), (FREE, SING, UP, FREE), (FREE, UP, FREE, LOW)),
        regular=(True, False, True, False),
        n_controls=2,
        n_paths=1,
    )
    asked = held_by(ArcMesh(structure, (SubarcMesh(1), SubarcMesh(2, 6, 4), SubarcMesh(1))))
    assert asked["name"] == "leg"
    assert asked["arcs"].tolist() == [[LOW, RELEASED, RELEASED, RELEASED], [FREE, FREE, FREE, UP]]
    assert asked["paths"].tolist() == [[RELEASED, UP, UP, RELEASED]]
    assert asked["states"].tolist() == [[FREE, FREE, FREE, LOW]]
    assert asked["smooth"] == (SmoothControl(1, 1, 3, 4),)
    bang = held_by(ArcMesh.from_structure(PhaseStructure((0.0, 1.0, 2.0), ((LOW, FREE), (UP, FREE)), (), 1)))
    assert bang["paths"] is None and bang["states"] is None and bang["smooth"] == ()
    assert bang["arcs"].tolist() == [[LOW, UP]]


LEG: Any = SimpleNamespace(phase=SimpleNamespace(name="leg"))


def line(lam: Any, u: Any, **changes: Any) -> PhaseSamples:
    """x' = u with |u| <= 1 and H = lam u over 4 s; dH/du over its range of 2 in shares of |lam| at most."""
    model, x, _control = dynamics("integrator", "x", "u", lambda x, control: {x: control})
    problem, leg = one_phase("integrator", model, 0.0, 4.0)
    problem.minimize(leg.integral(x))
    return samples(
        problem,
        lambda t, k: [0 * t],
        u,
        lam,
        weights=(0.0,),
        breaks=np.arange(5.0),
        degree=3,
        control_bounds=interval(-1.0, 1.0),
        **changes,
    )


def rows(found: PhaseSamples, kinds: list[ArcKind]) -> Any:
    return np.array(kinds, dtype=object)[found.segments][None, :]


def plan_of(*subarc_meshes: SubarcMesh, kinds: Any = None) -> ArcMesh:
    n = len(subarc_meshes)
    structure = PhaseStructure(
        tuple(np.linspace(0, 1, n + 1)), kinds or ((LOW, FREE, FREE, FREE, FREE),) * n, (), 1, 2
    )
    return ArcMesh(structure, subarc_meshes)


def test_an_arc_is_inserted_where_the_switching_function_has_the_wrong_sign() -> None:
    """H = (t - 1) (t - 3) u at u = -1: the gain in H lies between 1 and 3 s, where u has to be 1."""
    found = line(lambda t, k: [(t - 1) * (t - 3)], lambda t, k: [0 * t - 1])
    plan = ArcMesh(PhaseStructure((0.0, 4.0), ((LOW, FREE),), (), 1), (SubarcMesh(4, 3),))
    structure, action = f._insert_arc_at_sign_violation(found, plan)
    assert structure is not None and [kinds[0] for kinds in structure.kinds] == [LOW, UP, LOW]
    assert structure.times == pytest.approx((0.0, 1.0, 3.0, 4.0), abs=0.05) and action.startswith("arc of u")
    right = ArcMesh(structure, (SubarcMesh(1, 3), SubarcMesh(2, 3), SubarcMesh(1, 3)))
    assert f._insert_arc_at_sign_violation(found, right) == (None, "")


def test_costates_count_in_shares_of_the_cost() -> None:
    """lam_q' = -1/2 along the second half: 1/4 of 12.25 that the states are worth."""

    def lam(t: Any, k: int) -> Any:
        return [-12 - 0.5 * k * (t - 0.5), -6 + 12 * t + 0.25 * k * (t - 0.5) ** 2]

    plan = plan_of(SubarcMesh(1, 4), SubarcMesh(1, 4))
    wrong = samples(CART, lam=lam)
    share = 0.25 / 12.25
    found = f.refine_arc_mesh_by_residuals(wrong, plan, 0.99 * share)
    assert found is not None and [r.degree for r in found.subarc_meshes] == [4, 7]
    assert f.refine_arc_mesh_by_residuals(wrong, plan, 1.01 * share) is None
    pushed = samples(CART, lam=lam, states=lambda t, k: [0.5 * k + 0 * t, 0 * t])
    assert f.refine_arc_mesh_by_residuals(pushed, plan, 1e-9) is None


@pytest.mark.parametrize(
    ("actions", "error", "of_objective", "nearby", "expected"),
    [
        (s.REFINED, 1e-8, 1e-8, True, True),
        (f"{s.REFINED}, {s.DEGREE_RAISED}", 1e-8, 1e-8, True, True),
        (s.REFINED, 1e-6, 1e-6, True, True),  # the tolerance
        (s.REFINED, 2e-6, 1e-8, True, False),
        (s.REFINED, 1e-8, 2e-6, True, False),
        (f"{s.KINKS_MOVED}, {s.REFINED}", 1e-8, 1e-8, True, False),
        ("arc removed", 1e-8, 1e-8, True, False),
        (s.REFINED, 1e-8, 1e-8, False, False),  # switching times are optimised beyond the tolerance
        (s.REFINED, 0.0, 0.0, False, True),
    ],
)
def test_a_structure_is_final_if_only_its_mesh_would_change(
    actions: str, error: float, of_objective: float, nearby: bool, expected: bool
) -> None:
    loop = s.StructureIteration(None, 1e-6, None, nearby, None, None, [])  # type: ignore[arg-type]
    found: Any = SimpleNamespace(objective_error=SimpleNamespace(relative_error=of_objective))
    record: Any = SimpleNamespace(error=error, actions=actions)
    assert loop._is_accuracy_sufficient(found, record) is expected


def test_the_iterate_with_the_least_error_of_the_objective_is_kept() -> None:
    """Errors of the objective within the tolerance of 1e-6 are equal; then the local errors decide."""

    def iterate(of_objective: float, error: float, solved: bool = True) -> Any:
        record = SimpleNamespace(solved=solved, error=error)
        objective = SimpleNamespace(relative_error=of_objective)
        return SimpleNamespace(record=record, solution=SimpleNamespace(objective_error=objective))

    def select(*iterates: Any, status: go.RefinementStatus = go.RefinementStatus.STALLED) -> int | None:
        return s._choose_best_iterate(list(iterates), status, 1e-6)

    worse = iterate(1e-5, 0.0)
    good = iterate(1e-7, 1e-3)
    better = iterate(5e-7, 1e-4)
    lost = iterate(0, 0, False)
    assert select() is None is select(lost)
    assert select(lost, worse, good) == 2 and select(good, worse, lost) == 0
    assert select(worse, good, better, lost) == 2 and select(better, good) == 0
    assert select(better, worse, lost, status=go.RefinementStatus.CONVERGED) == 1
