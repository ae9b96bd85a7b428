"""Every condition of the verdict sees what it should see: a solution that is wrong by one part in a thousand."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from testing.models import dynamics, one_phase
from testing.wrong_solutions import (
    added,
    bang_bang,
    ceiling,
    design_problem,
    designed,
    energy,
    failed,
    forged,
    free_time,
    hilltop,
    mixed_limit,
    moved,
    nothing_to_gain,
    nowhere_to_go,
    one_switch,
    scaled,
    shifted,
    singular,
    singular_problem,
    two_valleys,
    upper,
    with_leg,
)

import gnc_opt as go
from gnc_opt.planning.optimality.active_state_constraints import explain_costate_jumps
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.solution.defects_and_violations import integrate_dynamics
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.verification.minimum_principle import check_singular_arcs, mask_undetermined_controls

SMALL = 1e-3

Q, V, A = 0, 1, 0


@dataclass(frozen=True)
class Case:
    """A condition, a mistake of relative size e that it must see, a correct solution, and the wrong one."""

    condition: str
    what: str
    correct: Callable[[], go.Solution]
    wrong: Callable[[go.Solution, float], go.Solution]

    def __str__(self) -> str:
        return f"{self.condition}: {self.what}"


def without_time(solution: go.Solution, e: float) -> go.Solution:
    """The optimum for a final time that is off by e, passed off as that for a free one."""
    right = free_time()
    late = free_time(float(right.phase().final_time) * (1 + e))
    leg = right.phase()
    return replace(
        with_leg(late, final_time_bounds=leg.final_time_bounds, duration_bounds=leg.duration_bounds),
        problem=right.problem,
    )


def hidden_by_duration(solution: go.Solution, e: float) -> go.Solution:
    """The same, with a multiplier of a limit on the duration that the problem does not have."""
    late = without_time(solution, e)
    gap = -1.0 - float(late.hamiltonian(late.phase().final_time, side="left"))
    return with_leg(late, duration_multiplier=gap)


def fixed_end_passed_off_as_free(solution: go.Solution, e: float) -> go.Solution:
    """nu on an inactive constraint takes up a costate that should vanish: q_f <= 5 does not hold q_f at 1."""
    return replace(solution, constraint_multipliers=solution.constraint_multipliers + e * 12.0)


CASES = [
    Case("dynamics", "position off between two nodes", energy, lambda s, e: added(s, "x", Q, e, 1, 2)),
    Case("dynamics", "jump between two segments", energy, lambda s, e: added(s, "x", Q, e, 1)),
    Case("dynamics", "control off in a segment", energy, lambda s, e: added(s, "u", A, 20 * e, 1)),
    Case(
        "limits",
        "speed limit just below the top speed",
        energy,
        lambda s, e: with_leg(s, state_bounds=upper(s.phase().state_bounds, V, 1.5 - 10 * e)),
    ),
    Case(
        "limits",
        "parameter beyond its limit",
        designed,
        lambda s, e: replace(s, problem=design_problem(1.5 * (1 - e))),
    ),
    Case(
        "limits",
        "limit just below the top speed",
        energy,
        lambda s, e: with_leg(s, path_bounds=upper(s.phase().path_bounds, 0, 1.5 * (1 - e))),
    ),
    Case(
        "boundary conditions",
        "final position off",
        energy,
        lambda s, e: with_leg(s, final_bounds=shifted(s.phase().final_bounds, e)),
    ),
    Case(
        "boundary conditions",
        "final time that is not the trajectory's",
        bang_bang,
        lambda s, e: replace(with_leg(s, final_time=2.0 * (1 + e)), objective=2.0 * (1 + e)),
    ),
    Case("cost", "objective off", energy, lambda s, e: replace(s, objective=s.objective * (1 + e))),
    Case("cost", "integral off", energy, lambda s, e: forged(s, integrals=s.phase().integrals * (1 + e))),
    Case(
        "cost",
        "weight of an integral off",
        energy,
        lambda s, e: forged(s, integral_weights=s.phase().integral_weights * (1 + e)),
    ),
    Case(
        "cost",
        "limit that the problem does not have",
        energy,
        lambda s, e: forged(s, state_bounds=upper(s.phase().state_bounds, V, 5 * (1 + e))),
    ),
    Case("stationarity", "costate off in a segment", energy, lambda s, e: scaled(s, "lam", 1 + e, 1)),
    Case(
        "stationarity", "costate bent between two nodes", energy, lambda s, e: added(s, "lam", V, 6 * e, 1, 2)
    ),
    Case(
        "stationarity",
        "jump of a costate whose state no constraint holds",
        ceiling,
        lambda s, e: added(s, "lam", V, 6 * e, 1),
    ),
    Case("stationarity", "costates too large for the cost", bang_bang, lambda s, e: scaled(s, "lam", 1 + e)),
    Case("stationarity", "final time not optimal", free_time, without_time),
    Case("stationarity", "final time not optimal, hidden by a multiplier", free_time, hidden_by_duration),
    Case(
        "stationarity",
        "costate shifted: a switch at another time",
        bang_bang,
        lambda s, e: added(s, "lam", V, e),
    ),
    Case("stationarity", "costate too large for the control", energy, lambda s, e: scaled(s, "lam", 1 + e)),
    Case(
        "stationarity",
        "path multiplier off",
        mixed_limit,
        lambda s, e: with_leg(s, path_multipliers=s.phase().path_multipliers * (1 + e)),
    ),
    Case(
        "stationarity",
        "jump at a limit too large: its size is free, the control's answer is not",
        ceiling,
        lambda s, e: scaled(s, "lam", 1 + e, 0),
    ),
    Case(
        "minimum principle",
        "the shallower of two valleys",
        lambda: two_valleys(-SMALL),
        lambda s, e: two_valleys(e),
    ),
    Case(
        "active set",
        "multiplier of a control between its bounds",
        energy,
        lambda s, e: with_leg(s, control_multipliers=moved(s.phase().control_multipliers, (A, 7), 12 * e)),
    ),
    Case(
        "active set",
        "multiplier of a bound that pushes outwards",
        bang_bang,
        lambda s, e: with_leg(s, control_multipliers=-e * s.phase().control_multipliers),
    ),
    Case(
        "active set",
        "impulse of a bound that is not active",
        energy,
        lambda s, e: with_leg(s, state_impulses=moved(s.phase().state_impulses, (V, 2), 6 * e)),
    ),
    Case("active set", "boundary constraint that is not active", energy, fixed_end_passed_off_as_free),
    Case("second order", "a maximum of H, barely curved", lambda: hilltop(-SMALL), lambda s, e: hilltop(e)),
    Case(
        "second order",
        "a maximum over the switch time",
        lambda: one_switch(1 - SMALL),
        lambda s, e: one_switch(1 + e),
    ),
    Case(
        "second order",
        "a singular arc that pulses leave at a gain",
        energy,
        lambda s, e: replace(singular(), problem=singular_problem(-e)),
    ),
    Case("active set", "a switch too late", lambda: one_switch(0.5), lambda s, e: one_switch(0.5, 1 + e)),
    Case("active set", "costates reversed", bang_bang, lambda s, e: scaled(s, "lam", -e)),
    Case(
        "stationarity",
        "parameter off",
        designed,
        lambda s, e: replace(s, parameter_values=s.parameter_values * (1 + e)),
    ),
]


@pytest.mark.parametrize("wrong", CASES, ids=str)
def test_condition_sees_what_it_should_and_others_do_not(wrong: Case) -> None:
    correct = wrong.correct()
    before = go.verify(correct)
    assert before.minimum, before.explain()
    verdict = go.verify(wrong.wrong(correct, SMALL))
    found = {c.name for c in verdict.failed}
    assert wrong.condition in found


def test_errors_too_small_for_a_segment_add_up_in_the_cost() -> None:
    """A constant control error of 3e-5 m/s^2 is 5e-6 of the speed in each of four segments, and 2e-5 at the end."""
    assert "dynamics" in failed(added(energy(), "u", A, 3e-4))


@pytest.mark.parametrize("scheme", ["LG", "LGL"])
@pytest.mark.parametrize("path", [False, True])
def test_jumps_of_the_right_sign_at_an_active_limit_are_right(scheme: str, path: bool) -> None:
    """A path constraint has no field for impulses: its activity and the sign of the jump are what counts."""
    if path and scheme == "LG":
        pytest.skip(
            "LG does not enforce path constraints at segment boundaries, so that this mesh is too coarse"
        )
    solution = ceiling(scheme, path=path)  # type: ignore[arg-type]
    verdict = go.verify(solution)
    assert verdict.minimum, verdict.explain()
    jump = solution.costate("q")(0.3, "left") - solution.costate("q")(0.3)
    assert jump == pytest.approx(200 / 9, rel=1e-5)


@pytest.mark.parametrize("path", [False, True])
def test_jump_of_the_wrong_sign_or_at_a_limit_that_is_not_active_is_not_explained(path: bool) -> None:
    right = ceiling("LGR", path=path)
    leg, s = right.phase(), samples_of(right)
    assert (
        np.max(np.abs(explain_costate_jumps(s)[0])) < 1e-4
    )  # 1e-11 in shares of the cost would be too much to ask
    box = leg.path_bounds if path else leg.state_bounds
    reversed_sign = Interval(
        np.where(np.isfinite(box.upper), box.upper, box.lower), np.full(box.upper.size, np.inf)
    )
    absent = shifted(box, 0.01)
    for wrong in (reversed_sign, absent):
        changed = with_leg(right, **{"path_bounds" if path else "state_bounds": wrong})
        rest = explain_costate_jumps(samples_of(changed))[0]
        assert rest[0] == pytest.approx([200 / 9, 200 / 9], rel=1e-4)
        assert go.verify(changed)["stationarity"].result is go.ConditionResult.FAIL


EDGES = (0.299, 0.3002, 0.6998, 0.701)


def test_limit_reached_within_a_segment_is_no_adjoint_violation() -> None:
    """Polynomials cannot follow the jump at 0.3 s within (0.299, 0.3002) s; a multiplier of the limit explains it."""
    verdict = go.verify(ceiling(breaks=EDGES, degree=12))
    assert verdict.minimum, verdict.explain()


@pytest.mark.parametrize("weight", [1e3])
@pytest.mark.parametrize("unit", [1.0, 0.02, -50.0])
def test_limit_reached_within_a_segment_in_other_units(weight: float, unit: float) -> None:
    """The jump is explained whatever the units of the cost and the state."""
    model, _q, _v, a = dynamics("double integrator", "q v", "a", lambda q, v, a: {q: v * unit, v: a})
    problem, leg = one_phase("ceiling", model, 0.0, 1.0)
    leg.initial(q=0.0, v=1.0)
    leg.final(q=0.0, v=-1.0)
    leg.bounds(q=(None, 0.1 * unit) if unit > 0 else (0.1 * unit, None))
    problem.minimize(0.5 * weight * leg.integral(a**2))
    mesh = go.Mesh((0.0, *EDGES, 1.0), (10,) * 5)
    solution = go.solve(problem, mesh=mesh, options=go.SolverOptions(tolerance=1e-11), tol=None)
    verdict = go.verify(solution)
    assert verdict.ok, verdict.explain()


def test_impulses_push_inwards_where_a_bound_is_only_touched_in_a_segment() -> None:
    """The state varies by 3e-9 over (0.2995, 0.3005) s; costates must not be shifted as on an arc along the bound."""
    leg = ceiling(breaks=(0.2995, 0.3005, 0.6995, 0.7005)).phase()
    assert np.min(leg.state_impulses[Q, 1:-1]) > -1e-6
    assert np.min(leg.state_multipliers[Q]) > -1e-6
    assert leg.lam(0.0)[Q] == pytest.approx(200 / 9, rel=1e-4)
    assert leg.lam(0.5)[Q] == pytest.approx(0.0, abs=1e-3)


def test_limit_reached_within_a_segment_excuses_nothing_else() -> None:
    right = ceiling(breaks=EDGES, degree=10)
    leg = right.phase()
    for wrong in (
        added(right, "lam", V, 6 * SMALL, 1),  # a jump of the other costate
        added(right, "lam", V, 6 * SMALL, 1, 2),  # a bend of it that no push causes
        with_leg(right, state_bounds=shifted(leg.state_bounds, 0.01)),  # a limit that is not reached
    ):
        assert failed(wrong) & {"stationarity", "active set"}


def test_costates_that_vanish_are_checked_by_what_the_cost_amounts_to() -> None:
    """Shares of rounding are no shares of the cost; a costate that is worth a thousandth of the cost is."""
    right = nothing_to_gain()
    assert go.verify(right).ok, go.verify(right).explain()
    assert failed(added(right, "lam", Q, 1e-14)) == set()
    assert "stationarity" in failed(added(right, "lam", Q, 1e-3))


@pytest.mark.parametrize("start", [0.0, 5.0])
def test_nothing_is_claimed_about_a_phase_without_length(start: float) -> None:
    solution = nowhere_to_go(start)
    verdict, leg = go.verify(solution), solution.phase()
    assert verdict.ok and not verdict.minimum, verdict.explain()
    assert verdict["stationarity"].result is go.ConditionResult.INCONCLUSIVE
    assert "duration of the phase is zero" in verdict["stationarity"].meaning
    assert verdict["boundary conditions"].result is go.ConditionResult.PASS
    late = replace(leg, initial_time=leg.initial_time + 0.01, final_time=leg.final_time + 0.01)
    missed = go.verify(replace(solution, phases={leg.name: late}))["boundary conditions"]
    assert missed.value == pytest.approx(0.01, rel=1e-3), "relative to 1 s"


def samples_of(solution: go.Solution) -> PhaseSamples:
    leg = solution.phase()
    return PhaseSamples.from_phase(leg, solution.phase_functions(leg.name))


def test_every_condition_of_the_verdict_has_a_wrong_solution() -> None:
    """Of those that can fail; 'singular arcs' can only be inconclusive."""
    names = {c.name for c in go.verify(bang_bang()).conditions}
    assert names - {"kinks", "switching times"} == {case.condition for case in CASES}


def test_barely_curved_hamiltonian_is_distinguished_from_a_singular_one() -> None:
    """u^2 over the square of its range must be worth a share of what the control can do that is above the tolerance."""
    for curvature, result in ((1e-3, go.ConditionResult.PASS), (1e-13, go.ConditionResult.INCONCLUSIVE)):
        verdict = go.verify(hilltop(-curvature))
        assert verdict["second order"].result is result
        assert ("singular" in verdict["second order"].where) is (result is not go.ConditionResult.PASS)


@pytest.mark.parametrize(
    ("condition", "wrong", "where"),
    [
        (
            "stationarity",
            lambda: added(energy(), "lam", V, 6 * SMALL, 1, 2),
            "phase leg, segment 2 (0.25 to 0.5 s), adjoint equation of v",
        ),
        (
            "stationarity",
            lambda: with_leg(energy(), final_bounds=free_end(energy(), V)),
            "phase leg, end, costate of v",
        ),
        (
            "stationarity",
            lambda: with_leg(energy(), initial_bounds=free_end(energy(), Q)),
            "phase leg, start, costate of q",
        ),
    ],
)
def test_place_of_the_worst_violation(condition: str, wrong: Callable[[], go.Solution], where: str) -> None:
    found = go.verify(wrong())[condition]
    assert (found.result, found.where) == (go.ConditionResult.FAIL, where)


def free_end(solution: go.Solution, row: int) -> Interval:
    """The final values of the solution, one of them free."""
    box = solution.phase().final_bounds
    free = np.arange(box.lower.size) == row
    return Interval(np.where(free, -9.0, box.lower), np.where(free, 9.0, box.upper))


def test_hamiltonian_is_off_where_the_costates_are() -> None:
    """H = a^2 / 2 + lam_v a + ... changes by 1 % of lam . f in one of four segments only."""
    condition = go.verify(scaled(energy(), "lam", 1.01, 1))["stationarity"]
    assert condition.result is go.ConditionResult.FAIL
    assert 0.25 <= float(condition.where.split("t = ")[1].split(" s")[0]) <= 0.5


def carried(current: float, start: float = 0.0) -> go.Problem:
    """x' = u + current (t - start), from 0 to 1 in 1 s with the least energy: u = 1 - current / 2, lam = -u."""
    model = go.Model("carried")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u + current * (model.time - start)})
    problem, leg = one_phase("carried", model, start, start + 1.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    problem.minimize(leg.integral(u**2 / 2))
    return problem


@pytest.mark.parametrize("start", [-2.0])
def test_hamiltonian_follows_its_explicit_dependence_on_time(start: float) -> None:
    """dH/dt = current lam = -current (1 - current / 2): constant it is not."""
    solution = go.solve(carried(0.5, start), mesh="3x4", tol=None)
    assert go.verify(solution, tol=1e-9).minimum
    drift = solution.hamiltonian(start + 1.0, side="left") - solution.hamiltonian(start)
    assert drift == pytest.approx(-0.5 * 0.75, rel=1e-9)
    still = replace(solution, problem=carried(0.0, start))
    assert {"dynamics"} <= failed(still) and "stationarity" not in failed(still)
    other = replace(solution, problem=carried(1.0, start))
    assert go.verify(other)["stationarity"].value == pytest.approx(0.0, abs=1e-9)  # H of that model, that is


def test_controls_that_one_of_two_mixed_constraints_forbids_are_no_choice() -> None:
    """`mixed_limit` with a second limit, u - x >= -5, which is never reached."""
    model, x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("two mixed limits", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.path("far", u - x, lower=-5.0)
    leg.path("limit", u + x, upper=1.0)
    problem.minimize(leg.integral(0.5 * (u - 2) ** 2))
    solution = go.solve(problem, mesh="4x6", options=go.SolverOptions(tolerance=1e-11), tol=None)
    assert solution.state("x")(1.0) == pytest.approx(1 - np.exp(-1.0), abs=1e-8)
    verdict = go.verify(solution)
    assert verdict.minimum, verdict.explain()


@pytest.mark.parametrize("opens", [0.8, 9.0])
def test_better_control_counts_from_when_it_is_admissible(opens: float) -> None:
    """Two valleys at u = 1 and, deeper, u = -1, which u + 4 t >= opens - 1 allows from t = opens / 4 on."""
    model, _x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("opening valley", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-2.0, 2.0))
    leg.path("gate", u + 4 * model.time, lower=opens - 1 if opens < 2 else 0.5)
    if opens > 2:
        leg.path("wall", u, lower=0.5)
    problem.minimize(leg.integral((u**2 - 1) ** 2 + 0.1 * u))
    box = Interval(np.array([-2.0]), np.array([2.0]))
    one = go.solve(problem.with_bounds(u=(0.4, 2.0)), mesh="3x4", tol=None)
    found = failed(replace(with_leg(one, control_bounds=box), problem=problem))
    assert found == ({"minimum principle"} if opens < 2 else set())


def test_push_of_one_path_constraint_among_several() -> None:
    """The ceiling after a speed limit that is never reached: only its own gradient pushes the costates."""
    right = ceiling("LGR", path=True)
    problem = go.Problem("ceiling and speed")
    model = right.need_problem("copy").get_phase().model
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(q=0.0, v=1.0)
    leg.final(q=0.0, v=-1.0)
    leg.path("speed", model.symbol("v"), upper=5.0)
    leg.path("ceiling", model.symbol("q"), upper=0.1)
    problem.minimize(0.5 * leg.integral(model.symbol("a") ** 2))
    mesh = go.Mesh((0.0, 0.3, 0.7, 1.0), (5, 5, 5))
    solution = go.solve(problem, mesh=mesh, scheme="LGR", options=go.SolverOptions(tolerance=1e-11), tol=None)
    verdict = go.verify(solution)
    assert verdict.minimum, verdict.explain()


@pytest.mark.parametrize("unit", [1e-4, 1e4, -1.0])
def test_whether_a_limit_is_reached_does_not_depend_on_units(unit: float) -> None:
    """A jump at a ceiling, or a floor, is right; at one that is a hundredth further away it is not."""
    model, _q, _v, a = dynamics("double integrator", "q v", "a", lambda q, v, a: {q: v * unit, v: a})

    def problem(height: float) -> go.Problem:
        result, leg = one_phase("ceiling", model, 0.0, 1.0)
        leg.initial(q=0.0, v=1.0)
        leg.final(q=0.0, v=-1.0)
        leg.bounds(q=(None, height * unit) if unit > 0 else (height * unit, None))
        result.minimize(0.5 * leg.integral(a**2))
        return result

    mesh = go.Mesh((0.0, 0.3, 0.7, 1.0), (5, 5, 5))
    right = go.solve(problem(0.1), mesh=mesh, options=go.SolverOptions(tolerance=1e-11), tol=None)
    verdict = go.verify(right)
    assert verdict.minimum, verdict.explain()
    higher = with_leg(right, state_bounds=problem(0.101).get_phase().numbers.states)
    assert "stationarity" in failed(replace(higher, problem=problem(0.101)))


@pytest.mark.parametrize(("lower", "upper"), [(-0.99, 1.0), (-1.0, 0.99)])
def test_multiplier_of_a_control_beyond_its_limit_is_not_complementary(lower: float, upper: float) -> None:
    box = Interval(np.array([lower]), np.array([upper]))
    assert "active set" in failed(with_leg(bang_bang(), control_bounds=box))


def test_share_and_name_of_the_singular_control_beside_a_regular_one() -> None:
    """u = -1 until x = 0 at 0.5 s of 2 s, then singular; w is regular throughout."""
    model = go.Model("two integrators")
    y, w = model.state("y"), model.control("w")
    x, u = model.state("x"), model.control("u")
    model.ode({y: w, x: u})
    problem, leg = one_phase("singular beside regular", model, 0.0, 2.0)
    leg.initial(x=0.5, y=0.0)
    leg.final(y=1.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(x**2 + w**2))
    solution = go.solve(problem, mesh=go.Mesh((0.0, 0.25, 0.5, 0.75, 1.0), (4,) * 4), tol=None)
    samples = list(solution.samples().values())
    singular = [mask_undetermined_controls(samples[0], 1e-4)[0]]
    told = np.zeros((2, samples[0].times.size), dtype=bool)
    condition = check_singular_arcs(samples, 1e-4, singular, [told])  # H alone determines nothing there
    assert condition.result is go.ConditionResult.INCONCLUSIVE
    assert condition.value == pytest.approx(0.75, abs=0.03)
    assert ", u, " in condition.where
    told[:] = True
    assert check_singular_arcs(samples, 1e-4, singular, [told]).result is go.ConditionResult.PASS
    told[1, samples[0].times > 1.0] = False
    assert check_singular_arcs(samples, 1e-4, singular, [told]).value == pytest.approx(0.5, abs=1e-6)
    assert go.verify(solution, tol=1e-4)["second order"].result is go.ConditionResult.PASS


def test_controls_that_gain_only_together_are_tried_together() -> None:
    """H = 1 + u w at u = w = 0: no control alone changes it, (1, -1) makes it 0."""
    model, _x, u, w = dynamics("saddle", "x", "u w", lambda x, u, w: {x: 0 * u})
    problem, leg = one_phase("saddle", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-1.0, 1.0), w=(-1.0, 1.0))
    problem.minimize(leg.integral(1 + u * w))
    pinned = go.solve(problem.with_bounds(u=(0.0, 0.0), w=(0.0, 0.0)), mesh="2x3", tol=None)
    box = Interval(-np.ones(2), np.ones(2))
    condition = go.verify(replace(with_leg(pinned, control_bounds=box), problem=problem))["minimum principle"]
    assert condition.result is go.ConditionResult.FAIL
    assert condition.value == pytest.approx(0.2, rel=1e-6)  # 1 beside what the ranges are worth


def test_propagation_flies_what_respects_the_bounds() -> None:
    """Cell by cell: v += a h, q += v h + a h^2 / 2. The polynomial, which overshoots, meets its own end better."""
    problem = bang_bang().need_problem("copy").with_fixed_arcs(arcs=None)
    solution = go.solve(problem, mesh="7x3", tol=None)
    leg = solution.phase()
    jumps = leg.applied.jump_times
    assert jumps.size > 8
    assert leg.applied.is_piecewise_constant.any()
    assert not leg.applied.is_piecewise_constant.all()
    q, v = 1.0, 0.0
    for left, right in itertools.pairwise(jumps):
        inner = np.linspace(left, right, 2001)[1:-1]
        a, h = float(np.mean(leg.applied(inner))), right - left
        q, v = q + v * h + a * h**2 / 2, v + a * h
    miss = max(abs(q), abs(v))
    assert "dynamics" in failed(solution)
    assert integrate_dynamics(leg, solution.phase_functions("leg")).error == pytest.approx(
        [q, v], abs=0.02 * miss
    )
