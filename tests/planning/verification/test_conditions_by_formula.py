"""Terms of the first-order conditions on values chosen by hand: sizes, signs, scales and places."""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

import numpy as np
import pytest
from testing.constructed_solutions import fake, interval
from testing.internals import Ellipsoid, Scales

import gnc_opt as go
from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import NOTABLE, ROUNDING
from gnc_opt.planning.solution.defects_and_violations import Limits, Worst
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.state_and_control_scales import SPAN_MIN_SHARE
from gnc_opt.planning.verification import costate_conditions as costates
from gnc_opt.planning.verification import external_trajectory_check as external
from gnc_opt.planning.verification import feasibility, nonsmooth_points, optimality_check
from gnc_opt.planning.verification import minimum_principle as controls
from gnc_opt.planning.verification import solution_data_check as stored
from gnc_opt.planning.verification import sufficient_conditions as sufficient
from gnc_opt.planning.verification.feasibility import check_value_within_tolerance, combine_condition_results

PASS, FAIL, INCONCLUSIVE = go.ConditionResult.PASS, go.ConditionResult.FAIL, go.ConditionResult.INCONCLUSIVE


def labels(*names: str) -> Any:
    return fake(labels=names, units=("m",) * len(names), size=len(names))


def described(name: str = "leg") -> dict[str, Any]:
    """Descriptions of places that name all of their arguments."""
    return {
        "describe_time": lambda t, what="": f"t={t:g} {what}",
        "describe_sample": lambda j, what="": f"sample {j} {what}",
        "describe_segment": lambda k, what="": f"segment {k} {what}",
    }


def round_ellipsoid(*radius: float) -> Ellipsoid:
    return Ellipsoid(np.array(radius), np.eye(len(radius)), np.ones(len(radius)))


def scales(cost: float = 5.0, **own: Any) -> Any:
    return fake(cost=cost, phases={"leg": fake(**own)})


def test_results_from_a_value_and_from_two_certainties() -> None:
    assert [
        check_value_within_tolerance("c", Worst(v, "w"), 0.1, "m").result for v in (0.1, 0.1001, np.nan)
    ] == [PASS, FAIL, FAIL]
    found = {(p, f): combine_condition_results(p, f) for p in (False, True) for f in (False, True)}
    assert found == {
        (False, False): INCONCLUSIVE,
        (True, False): PASS,
        (False, True): FAIL,
        (True, True): FAIL,
    }


def test_control_bounds_in_shares_of_deviation_or_of_the_magnitude() -> None:
    """Control a exceeds its upper bound 1 by 0.5, b its lower bound -2 by 2, c is unbounded and constant."""
    u = np.array([[0.0, 1.5, 1.0], [-2.0, 0.0, -4.0], [7.0, 7.0, 7.0]])
    leg = fake(
        name="leg",
        u=fake(values=(u[:, :1], u[:, 1:])),
        control_bounds=interval([-1.0, -2.0, -np.inf], [1.0, 2.0, np.inf]),
        point_times=np.array([0.0, 1.0, 2.0]),
        controls=labels("a", "b", "c"),
    )
    s = fake(phase=leg, times=leg.point_times, **described())
    deviation = np.array([[0.1, 0.2, 0.1], [4.0, 1.0, 2.0], [0.0, 0.0, 0.0]])
    worst = feasibility._find_control_violation(s, scales(deviation=deviation))
    assert (worst.value, worst.where) == (pytest.approx(2.5), "t=1 a")  # 0.5 / 0.2
    worst = feasibility._find_control_violation(s, scales(deviation=0.0 * deviation))
    assert (worst.value, worst.where) == (pytest.approx(0.5 / SPAN_MIN_SHARE), "t=2 b")
    assert feasibility._find_control_violation(s, scales(deviation=9.0 + deviation)).where == "t=2 b"


def path_functions(values: Any) -> Any:
    """Two paths c = values with the gradients (3, 4 t) in two states and (0.6, -0.8 t) in one control."""

    def by_state(t: Array, x: Array, u: Array) -> Array:
        return np.array([[3 + 0 * t, 0 * t], [0 * t, 4 * t]])

    def by_control(t: Array, x: Array, u: Array) -> Array:
        return np.array([[6.0 + 0 * t], [np.where(t > 0, -8.0 * t, np.nan)]])

    return fake(path_constraints=values, path_state_jacobian=by_state, path_control_jacobian=by_control)


def test_changes_of_paths_by_states_and_controls() -> None:
    """hypot(3 * 2, 6 / 2) and hypot(4 t * 3, 8 t / 2); an infinite derivative does not count."""
    bounds = interval([-np.inf, -np.inf], [1e12, 100.0])
    t, x, u = np.array([0.0, 1.0]), np.zeros((2, 2)), np.zeros((1, 2))
    phase = fake(name="leg", path_bounds=bounds, vector_controls=())
    s = fake(phase=phase, functions=path_functions(None), times=t)
    own = scales(deviation=np.array([[0.25, 0.5]]), along=round_ellipsoid(2.0, 3.0))
    found = feasibility.compute_path_value_changes(s, own, t, x, u)
    np.testing.assert_allclose(found, [[np.hypot(6, 3)] * 2, [0.0, np.hypot(12, 4)]])
    limits = Limits(lambda *_: np.zeros(0), np.array([1, 0]), np.ones(2), np.array([100.0, 1e12]))
    at = np.array([1.0, 1.0]), x, u
    distances = feasibility._compute_limit_distances(s, own, limits, np.array([2.0, 0.5]), at)
    np.testing.assert_allclose(distances, [2.0 / np.hypot(12, 4), 0.0])
    unreached = np.array([0.0, 1.0]), x, u
    distances = feasibility._compute_limit_distances(s, own, limits, np.array([2.0, 3.0]), unreached)
    np.testing.assert_allclose(distances, [np.inf, (3.0 - 1e12 * ROUNDING) / np.hypot(6, 3)])


def test_cost_of_path_violations_counts_multipliers_of_the_violated_side() -> None:
    """Above the limit 1 by (0, 1, 3) at mu = (5, 2, 1), weights (1, 2, 1): 7 over 5; below by 2 at -3: 12 over 5."""
    values = np.array([[1.0, 2.0, 4.0], [0.0, -3.0, -3.0], [5.0, 5.0, np.nan]])
    s = fake(
        functions=fake(path_constraints=lambda *_: values),
        times=None,
        x=None,
        u=None,
        weights=np.array([1.0, 2.0, 1.0]),
        phase=fake(
            name="leg",
            path_bounds=interval([-np.inf, -1.0, 0.0], [1.0, 1.0, 9.0]),
            path_labels=("a", "b", "c"),
        ),
    )
    s.mu = np.array([[5.0, 2.0, 1.0], [0.0, -3.0, 4.0], [9.0, 9.0, 9.0]])
    worst = feasibility._find_costliest_path_constraint_violation(s, scales())
    assert (worst.value, worst.where) == (pytest.approx(12 / 5), "phase leg, b, effect on the cost")
    s.mu[1] = [0.0, 3.0, 3.0]
    worst = feasibility._find_costliest_path_constraint_violation(s, scales())
    assert (worst.value, worst.where) == (pytest.approx(7 / 5), "phase leg, a, effect on the cost")


def test_boundary_values_by_slope_curvature_and_price() -> None:
    """a e + b e^2 / 2 = excess: 3 at a = 2, b = 2 gives e = 1; without reach it is infinite; or by its price."""

    def violation(
        values: Any, price: float = 0.0, first: Any = (2.0, 4.0), second: Any = (2.0, 0.0)
    ) -> Worst:
        box, prices = interval([-1.0, 0.0], [1.0, 0.0]), np.array([-price, 0.0])
        changes = fake(gramian=np.diag(first) ** 2, curvature=np.array(second), terms=np.array([0.0, 1e12]))
        own = fake(cost=5.0, boundary={1.0: changes})
        return feasibility._find_boundary_violation(
            [("p", "m"), ("q", "")], np.array(values), prices, box, own
        )

    assert violation([4.0, 0.5]).value == pytest.approx(2 * 3 / (2 + 4))
    assert violation([-4.0, 0.5]).where == "p off by 3 m"
    assert (violation([1.0, -3.0]).value, violation([1.0, -3.0]).where) == (0.5, "q off by 2")
    assert violation([4.0, 0.0], price=20.0).value == pytest.approx(20 * 3 / 5)
    assert violation([4.0, 0.0], first=(0.0, 4.0), second=(0.0, 0.0)).value == np.inf
    assert violation([np.nan, 0.0]).value == np.inf
    assert violation([1.0, 0.9]).value == 0.0  # rounding of terms of 1e12
    assert violation([4.0, -4.0], first=(2.0, 6.0), second=(0.0, 0.0)).value == pytest.approx(
        np.hypot(1.5, 0.5)
    )


def test_distance_beyond_a_table_is_in_shares_of_its_axis() -> None:
    def outside(value: float, kind: str) -> Any:
        table = fake(grids=(np.array([0.0]), np.array([2.0, 3.0, 6.0])), outside=kind)
        return fake(table=table, axis=1, value=value)

    def check(*found: Any) -> go.Condition:
        return feasibility.check_table_ranges(fake(outside_tables=lambda: found))

    assert check().result is PASS
    assert check(outside(8.0, "hold"), outside(1.0, "hold")).value == pytest.approx(0.5)
    assert check(outside(8.0, "hold"), outside(1.0, "hold")).result is INCONCLUSIVE
    assert check(outside(8.0, "error"), outside(-2.0, "hold")).value == pytest.approx(1.0)
    assert check(outside(8.0, "error"), outside(-2.0, "hold")).result is FAIL


def test_complementarity_is_multiplier_times_room() -> None:
    values, box = np.array([[0.25, 0.25], [0.25, 0.25]]), interval([0.0, -np.inf], [1.0, np.inf])
    found = costates._compute_complementarity_products(
        np.array([[2.0, -2.0], [3.0, -3.0]]), values, box, np.array([[9.0], [0.5]])
    )
    np.testing.assert_allclose(found, [[2 * 0.75, 2 * 0.25], [1.5, 1.5]])
    found = costates._compute_complementarity_products(
        np.array([[2.0, -2.0]]), values[:1] + 1, interval([0.0], [1.0]), np.array([[0.5]])
    )
    np.testing.assert_allclose(found, [[0.5, 1.0]])


def test_multipliers_of_inactive_boundary_constraints() -> None:
    """Reach 1 + 2 / 2 = 2, over a cost of 5."""
    problem = fake(get_boundary_constraint_bounds=lambda: interval([0.0, -9.0], [9.0, 9.0]))
    solution = fake(
        need_problem=lambda _: problem,
        constraint_labels=("p", "q"),
        constraint_multipliers=np.array([2.0, -1.5]),
    )
    own = fake(cost=5.0, boundary={1.0: fake(gramian=np.eye(2), curvature=np.array([2.0, 2.0]))})
    ends = fake(constraints=np.array([8.0, 0.0]))
    worst = costates._check_boundary_multipliers(solution, ends, own)
    assert (worst.value, worst.where) == (pytest.approx(1.5 * 2 / 5), "multiplier of constraint q")
    solution.constraint_multipliers = np.array([2.0, -0.1])
    worst = costates._check_boundary_multipliers(solution, ends, own)
    assert (worst.value, worst.where) == (pytest.approx(2 * 1 / 5), "multiplier of constraint p")


def time_transversality(**changes: Any) -> Worst:
    """H of 2 at the start and 3 at the end of a phase from 1 to 5 s; the cost has the slopes 1.5 and -2.5."""
    values = {
        "duration_bounds": interval(1.0, 10.0),
        "duration": 4.0,
        "duration_multiplier": 0.0,
        "initial_time": 1.0,
        "final_time": 5.0,
        "initial_time_bounds": interval(0.0, 2.0),
        "final_time_bounds": interval(0.0, 9.0),
        "time_multipliers": np.zeros(2),
    }
    pushes = changes.pop("pushes", np.zeros(2))
    leg = fake(name="leg", **(values | changes))
    s = fake(phase=leg, span=4.0, hamiltonian=np.array([2.0, 9.0, 3.0]))
    ends = fake(initial_time={"leg": 1.5}, final_time={"leg": -2.5})
    return costates._check_time_transversality(s, ends, pushes, scales())


def test_transversality_of_free_times() -> None:
    """The gaps are 0.5 at the start and -0.5 at the end, times 4 s over a cost of 5."""
    assert (time_transversality().value, time_transversality().where) == (
        pytest.approx(0.4),
        "phase leg, H at its start",
    )
    worst = time_transversality(pushes=np.array([0.25, 0.5]))
    assert (worst.value, worst.where) == (pytest.approx(0.8), "phase leg, H at its end")
    worst = time_transversality(initial_time_bounds=interval(0.0, 1.0), final_time_bounds=interval(5.0, 9.0))
    assert worst.value == 0.0
    worst = time_transversality(initial_time_bounds=interval(1.0, 2.0), final_time_bounds=interval(5.0, 9.0))
    assert (worst.value, worst.where) == (pytest.approx(0.4), "phase leg, H at its start")
    stated = {"initial_time_bounds": interval(1.0, 1.0), "final_time_bounds": interval(5.0, 5.0)}
    worst = time_transversality(**stated, time_multipliers=np.array([0.5, 1.0]))
    assert (worst.value, worst.where) == (pytest.approx(1.2), "phase leg, H at its end")


def test_multiplier_of_the_duration_moves_both_ends_if_its_bound_is_active() -> None:
    """-0.5 closes the gaps of 0.5 and -0.5; it needs the lower bound of the duration."""
    assert time_transversality(
        duration_bounds=interval(4.0, 10.0), duration_multiplier=-0.5
    ).value == pytest.approx(0)
    worst = time_transversality(duration_multiplier=-0.75)
    assert (worst.value, worst.where) == (pytest.approx(0.6), "phase leg, multiplier of its duration")
    worst = time_transversality(duration_bounds=interval(1.0, 4.0), duration_multiplier=0.5)
    assert (worst.value, worst.where) == (pytest.approx(0.8), "phase leg, H at its start")


def test_impulses_of_state_bounds_between_segments(monkeypatch: pytest.MonkeyPatch) -> None:
    """Impulses 3 and -2 on a state between its bounds; densities of -1 and 0.5 beside make up for a part of them."""
    name = "integrate_multipliers_near_boundaries"
    monkeypatch.setattr(costates, name, lambda s, density: np.array([[-1.0, 0.5]]))
    leg = fake(
        name="leg",
        breaks=np.array([0.0, 1.0, 2.0, 3.0]),
        state_impulses=np.array([[7.0, 3.0, -2.0, 7.0]]),
        state_multipliers=None,
        states=labels("q"),
        state_bounds=interval(0.0, 10.0),
        x=lambda t: np.array([[4.0, 4.0]]),
    )
    s = fake(phase=leg, **described())
    worst = costates._check_costate_jumps_at_state_bounds(s, scales(along=round_ellipsoid(5.0)))
    assert (worst.value, worst.where) == (pytest.approx(2 * 5 / 5), "t=1 impulse on q")
    leg.x = lambda t: np.array([[10.0, 4.0]])
    worst = costates._check_costate_jumps_at_state_bounds(s, scales(along=round_ellipsoid(5.0)))
    assert (worst.value, worst.where) == (pytest.approx(1.5 * 4 / 5), "t=2 impulse on q")


def test_residual_of_the_adjoint_equation() -> None:
    """lam' + H_x + z = (2 - 0.5 + 1, 0): its integral 2.5 and its running one over each half, times radii (2, 1)."""
    ones = np.ones((1, 4))
    weights = 0.5 * np.ones(4)
    s = fake(
        phase=fake(name="leg"),
        times=None,
        x=None,
        u=None,
        lam=None,
        lam_rate=np.vstack([2 * ones, ones]),
        state_multiplier=np.vstack([ones, 0 * ones]),
        functions=fake(state_gradient=lambda t, x, u, lam, mu: np.vstack([-0.5 * ones, mu])),
        integrate_over_segments=lambda v: np.stack([v[:, :2] @ weights[:2], v[:, 2:] @ weights[2:]], axis=1),
        cumulative_integrals=lambda v: 1e3 * v,
        segment_maxima=lambda v: np.array([np.max(v[:2]), np.max(v[2:])]),
    )
    s.adjoint_residual = partial(PhaseSamples.adjoint_residual, s)
    own = scales(along=round_ellipsoid(2.0, 1.0))
    share, total = costates._evaluate_costate_residuals(s, -ones, own, 1e-8)
    np.testing.assert_allclose(total, [[2.5, 2.5], [0.0, 0.0]])
    np.testing.assert_allclose(share, [1.0, 1.0])
    np.testing.assert_allclose(
        costates._evaluate_costate_residuals(s, -ones, own, 1e-4)[0], 1e3 * 5 / 5 * 1e-2
    )
    share, total = costates._evaluate_costate_residuals(s, np.array([[-1.0, np.nan, -1.0, 3.0]]), own, 1e-8)
    np.testing.assert_allclose(share, [np.inf, np.hypot(5, 2) / 5])
    name = costates._find_state_of_costliest_gradient(
        fake(phase=fake(states=labels("q", "v"))), np.array([-2.0, 3.0]), np.array([2.0, 1.0])
    )
    assert name == "q"


def interior_controls(gradient: Any, curvature: Any, u: float = 0.5, **changes: Any) -> Any:
    """Constant gradient and curvature of H in two controls with bounds of -1 and 1 along 4 s in two segments."""
    t = np.linspace(0.0, 4.0, 9)
    row = np.ones(t.size)
    hessian = np.zeros((2, 2, t.size))
    hessian[[0, 1], [0, 1]] = np.outer(curvature, row)
    values = {
        "phase": fake(
            name="leg", control_bounds=interval([-1.0, -1.0], [1.0, 1.0]), controls=labels("a", "b")
        ),
        "times": t,
        "span": 4.0,
        "u": np.full((2, t.size), u),
        "control_gradient": np.outer(gradient, row),
        "control_hessian": hessian,
        "functions": fake(is_quadratic=True),
        "integrate_over_segments": lambda v: np.stack([2 * v[:, 0], 2 * v[:, -1]], axis=1),
        **described(),
    }
    return fake(**(values | changes))


def test_stationarity_in_shares_of_the_cost_of_each_control(monkeypatch: pytest.MonkeyPatch) -> None:
    """Loss 3 * 0.2 per second over min(2, 5) / 4; distance 3 / (20 * 0.2). The smaller one, integrated over 4 s."""
    monkeypatch.setattr(controls, "mask_controls_with_cost_curvature", lambda s: np.array([True, True]))
    own = scales(deviation=np.full((2, 9), 0.2), control_cost=np.array([2.0, 8.0]))
    s = interior_controls([-3.0, 0.0], [20.0, -1.0])
    np.testing.assert_allclose(controls.compute_hamiltonian_decrease_scales(s, own), [0.5, 1.25])
    np.testing.assert_allclose(controls._compute_control_distance_to_minimum(s, own)[:, 0], [0.75, np.inf])
    worst = controls.check_control_stationarity([s], own, 1e-5)
    assert (worst.value, worst.where.split(maxsplit=2)[2]) == (pytest.approx(0.75), "dH/du of a")
    worst = controls.check_control_stationarity([interior_controls([0.0, 3.0], [20.0, -1.0])], own, 1e-5)
    assert (worst.value, worst.where.split(maxsplit=2)[2]) == (pytest.approx(0.6 / 1.25), "dH/du of b")
    # A gradient that changes its sign at mid-time moves the states back.
    s = interior_controls([3.0, 0.0], [20.0, 1.0])
    s.control_gradient[0, 5:] *= -1
    assert controls.check_control_stationarity([s], own, 1e-5).value == pytest.approx(0.75 / 2)
    assert controls.check_control_stationarity([s], own, 0.64).value == pytest.approx(0.75 * 0.8)
    at_bound = interior_controls([-3.0, 0.0], [20.0, 1.0], u=1.0)
    assert controls.check_control_stationarity([at_bound], own, 1e-5).value == 0.0


def test_switching_functions_at_bounds_in_shares_of_the_cost() -> None:
    """At the upper bound a positive slope lowers H inwards: 3 * 0.2 * 4 s over a cost of 5."""
    own = scales(deviation=np.full((2, 9), 0.2))
    worst = controls.check_switching_signs([interior_controls([3.0, -9.0], [0.0, 0.0], u=1.0)], own)
    assert (worst.value, worst.where.split(maxsplit=2)[2]) == (pytest.approx(0.48), "switching function of a")
    worst = controls.check_switching_signs([interior_controls([3.0, -9.0], [0.0, 0.0], u=-1.0)], own)
    assert (worst.value, worst.where.split(maxsplit=2)[2]) == (pytest.approx(1.44), "switching function of b")
    assert (
        controls.check_switching_signs([interior_controls([3.0, -9.0], [0.0, 0.0], u=0.9)], own).value == 0.0
    )


def test_separable_controls_move_to_their_better_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        controls, "get_control_search_bounds", lambda s: (np.array([-1.0, -2.0]), np.array([3.0, 2.0]))
    )
    s = interior_controls([2.0, -4.0], [0.0, 0.0], functions=fake(separable_controls=np.array([True, True])))
    np.testing.assert_allclose(controls._compute_separable_hamiltonian_decrease(s), 2 * 1.5 + 4 * 1.5)
    s.functions.separable_controls = np.array([True, False])
    np.testing.assert_allclose(controls._compute_separable_hamiltonian_decrease(s), 3.0)
    sampled = controls._draw_separable_controls(s)
    np.testing.assert_allclose(sampled[0], -1 + 4 * controls.draw_low_discrepancy_points(9, 2)[0])
    np.testing.assert_allclose(sampled[1], 0.5)
    s.hamiltonian, s.x, s.lam = np.full(9, 10.0), None, None
    s.functions.hamiltonian = lambda t, x, u, lam: np.where(t < 1, np.nan, np.where(t < 3, 9.0, 1.0))
    gains = [fake(times=s.times, gain=s.times, share=0.1 * s.times)]
    monkeypatch.setattr(controls, "compute_joint_hamiltonian_decreases", lambda *_: (2 * gains, True))
    gain, share, searched = controls._search_hamiltonian_decreases(s, None, 5.0, 1e-5)
    np.testing.assert_allclose(gain, np.where(s.times < 3, 3.0, 9.0) + 2 * s.times)
    np.testing.assert_allclose(share, 0.1 * s.times)
    assert searched


def test_concave_kinks_keep_the_ratio_of_second_differences() -> None:
    """Second differences -2 at the larger step and -1 at the smaller one: a decrease of 2 in 5 + 2."""
    coarse = np.array([[1.0, 1.0, 1.0, 1.0], [-2.0, -3.0, -0.004, 4.0]])
    fine = np.array([[1.0, 1.0, 1.0, 1.0], [-1.0, -0.6, -0.004, 4.0]])
    assert nonsmooth_points._find_largest_cost_decrease_at_kink(coarse, fine, 5.0) == pytest.approx(2 / 7)
    np.testing.assert_array_equal(nonsmooth_points._mask_kinks(coarse, fine, 3.9), [True, False, True, True])
    fine[0, 0] = np.nan
    assert nonsmooth_points._find_largest_cost_decrease_at_kink(coarse, fine, 5.0) == 0.0
    coarse[0, 2] = -5.0
    np.testing.assert_array_equal(
        nonsmooth_points._mask_kinks(coarse, fine, 3.9), [False, False, False, True]
    )


def condition(name: str, result: Any, *, sufficient: bool = False, where: str = "w") -> go.Condition:
    return go.Condition(name, result, 1.0, 0.5, where, "m", sufficient=sufficient)


def test_combined_conditions_take_the_decisive_part() -> None:
    combine = optimality_check._combine_optimality_conditions
    found = combine(
        "c", [condition("c", PASS), condition("d", FAIL, where="there"), condition("e", INCONCLUSIVE)]
    )
    assert (found.name, found.result, found.where) == ("c", FAIL, "d: there")
    found = combine("c", [condition("d", PASS, where="there"), condition("c", PASS)])
    assert (found.name, found.result, found.where) == ("c", PASS, "w")
    assert combine("c", [condition("d", PASS), condition("c", PASS, sufficient=True)]).where == "w"
    found = combine(
        "c",
        [condition("d", INCONCLUSIVE, sufficient=True), condition("e", INCONCLUSIVE), condition("c", PASS)],
    )
    assert found.where == "e: w"
    arcs = condition(optimality_check.SINGULAR_ARCS, INCONCLUSIVE, where="arc")
    assert optimality_check._describe_undetermined_arcs(found, [arcs]).where == "e: w; singular arcs: arc"
    for parts in ([], [condition(optimality_check.SINGULAR_ARCS, PASS)]):
        assert optimality_check._describe_undetermined_arcs(found, parts) is found
    named = condition("c", FAIL, where="singular arcs: arc")
    assert optimality_check._describe_undetermined_arcs(named, [arcs]) is named


def test_results_that_other_theorems_change() -> None:
    for change, extra, expected in (
        (optimality_check._mark_inconclusive_by_convexity, True, INCONCLUSIVE),
        (optimality_check._resolve_condition_by_lower_bound, True, INCONCLUSIVE),
        (optimality_check._resolve_condition_by_lower_bound, False, PASS),
    ):
        found = change(condition("c", FAIL, sufficient=extra))
        assert found.result is expected and found.where.startswith("w; ")
        passed = condition("c", PASS, sufficient=extra)
        assert change(passed) is passed
    failed = condition("c", FAIL)
    assert optimality_check._mark_inconclusive_by_convexity(failed) is failed
    assert optimality_check._mark_condition_of_zero_duration_phase(failed, "leg") is failed
    marked = optimality_check._mark_condition_of_zero_duration_phase(condition("c", PASS), "leg")
    assert (marked.result, marked.where, marked.sufficient) == (INCONCLUSIVE, "phase leg has no length", True)
    assert np.isnan(marked.value)
    assert optimality_check._create_inconclusive_condition("c", "w", "m").tolerance == 0.0


def test_sampling_errors_grow_with_the_steps_and_vanish_with_them() -> None:
    """A growth of 4 per halving reduces 0.5 * 4^5 to the tolerance 0.5; defects may grow less; infinite: unknown."""
    failed = condition("stationarity", FAIL)
    check = external._is_failure_due_to_interpolation
    assert [check(failed, growth) for growth in (4.0, 3.99, np.inf)] == [True, False, False]
    slow = go.Condition("dynamics", FAIL, 15.9, 0.5, "w", "m")
    assert check(slow, 2.0) and not check(slow, 1.99)


def test_directions_of_zero_vectors_are_the_previous_ones() -> None:
    size = np.array([0.0, 2.0, 2e-6, 1.0, 0.0, 1.0])
    direction = np.array([[np.nan, 1.0, 5.0, 2.0, 9.0, np.inf], [0.0, 3.0, 5.0, 4.0, 9.0, 0.0]])
    found = external._fill_directions_of_zero_vectors(size, direction)
    np.testing.assert_array_equal(found, [[1, 1, 1, 2, 2, 2], [3, 3, 3, 4, 4, 4]])
    np.testing.assert_array_equal(
        external._fill_directions_of_zero_vectors(np.zeros(6), direction), np.array([[1.0] * 6, [0.0] * 6])
    )


def test_samples_at_nearly_one_time_are_one_or_a_jump() -> None:
    """Times 1e-10 of the duration apart: with equal controls the second is dropped, at a jump both get one time."""
    t = np.array([0.0, 1.0, 1.0 + 2e-10, 2.0, 2.0 + 2e-10, 4.0])
    u = np.array([[0.0, 1.0, 1.0005, 2.0, 0.0, 2.0], [3.0] * 6])
    found = external._remove_duplicate_samples(external.SampledPhase(t, 10 * t[None], u))
    np.testing.assert_array_equal(found.t, [0.0, 1.0, 2.0, 2.0, 4.0])
    np.testing.assert_array_equal(found.u, [[0.0, 1.0, 2.0, 0.0, 2.0], [3.0] * 5])
    np.testing.assert_array_equal(found.x, 10 * t[[0, 1, 3, 4, 5]][None])
    thinned = external._remove_every_second_sample(found)  # both sides of the jump stay
    np.testing.assert_array_equal(thinned.u[0], [0.0, 2.0, 0.0, 2.0])


def test_stored_costates_must_be_those_of_their_polynomials() -> None:
    """Differences 1 at a start, 2 at an end, 3 at a point, of costates of a state of 0.5 over a cost of 4."""
    values = {
        "start": np.array([[1.0, 2.0]]),
        "end": np.array([[3.0, 4.0]]),
        "points": np.array([[5.0, 6.0, 7.0]]),
    }
    leg = fake(
        name="leg",
        scheme="LG",
        states=labels("q"),
        breaks=np.array([0.0, 1.0, 2.0]),
        point_times=np.array([0.2, 0.8, 1.5]),
        lam_start=values["start"] + [[0.0, 1.0]],
        lam_end=values["end"] - [[2.0, 0.0]],
        point_costates=values["points"] + [[np.nan, 0.0, 3.0]],
        lam=lambda t, side=None: {"right": values["start"], "left": values["end"], None: values["points"]}[
            side
        ],
    )
    s = fake(phase=leg, state_scale=np.array([0.5]), cost_scale=4.0)
    worst = stored.compare_costates([s])
    assert (worst.value, worst.where) == (3 / 8, "phase leg, q, costate at point 3")
    leg.scheme = "LGR"
    worst = stored.compare_costates([s])
    assert (worst.value, worst.where) == (2 / 8, "phase leg, q, costate at the end of segment 1")
    leg.lam_end = values["end"]
    assert stored.compare_costates([s]).where == "phase leg, q, costate at the start of segment 2"


def test_change_of_the_cost_with_the_end_points() -> None:
    ends = fake(
        initial_state={"leg": np.array([1.0, 0.0])},
        final_state={"leg": np.array([0.0, -3.0])},
        initial_time={"leg": 0.0},
        final_time={"leg": 0.25},
    )
    s = fake(phase=fake(name="leg"), state_scale=np.array([5.0, 2.0]), span=4.0)
    assert stored._find_largest_endpoint_cost_change(s, ends) == 6.0
    ends.final_time["leg"] = -2.0
    assert stored._find_largest_endpoint_cost_change(s, ends) == 8.0


def test_initial_states_that_equations_determine() -> None:
    """Columns: initial x, v, final x, v. x0 = xf and 2 v0 = 1 determine v0, and x0 only with xf."""
    equal = np.array([[1.0, 0.0, -1.0, 0.0], [0.0, 2.0, 0.0, 0.0]])
    initial = np.array([0, 1])
    unique = sufficient._is_initial_state_unique
    assert not unique(equal, np.array([False, False, False, False]), initial)
    assert unique(equal, np.array([True, False, False, False]), initial)
    assert unique(equal, np.array([False, False, True, False]), initial)
    assert unique(equal, np.array([True, True, False, False]), initial)
    assert not unique(equal[:1], np.array([False, False, True, False]), initial)
    for matrix, full in (
        ([[1.0, 0.0], [0.0, 1e-12]], True),
        ([[1.0, 1e-12], [1.0, 2e-12]], True),
        ([[1.0, 2.0], [2.0, 4.0]], False),
        ([[1.0, 2.0]], False),
        ([[1.0], [0.0]], True),
        ([[1.0, 0.0], [1.0, 0.0]], False),
    ):
        assert sufficient._has_full_column_rank(np.array(matrix)) is full


def reported_cost(objective: float, **own: Any) -> Worst:
    """Cost 8 from integrals (2, 3) with weights (1, 2); a scan finds (2.5, 3)."""
    kept = fake(integrals=np.array([2.0, 3.0]), integral_weights=np.array([1.0, 2.0]))
    leg = fake(
        name="leg",
        integral_labels=("p", "q"),
        integrals=np.array([2.0, 3.0]),
        integral_weights=np.array([1.0, 2.0]),
    )
    for name, value in own.items():  # a scan of other integrals, or other stored numbers
        setattr(kept if name.startswith("kept_") else leg, name.removeprefix("kept_"), np.array(value))
    counts: list[Any] = []

    def integrands(t: Any, x: Any, u: Any) -> Array:
        return np.array([[2.0, -4.0], [1.0, 1.0]]) if x is None else np.array([[2.0 + x, 3.0], [1.5, 1.5]])

    def resample(*arguments: int) -> Any:
        counts.append(arguments)
        return fake(
            functions=s.functions,
            times=0,
            u=0,
            weights=np.array([1.0, 1.0]),
            x=-3.0 + own.get("peak", 0.5) / len(counts),
        )

    s = fake(
        phase=leg, functions=fake(integrands=integrands), times=0, x=None, u=0, weights=np.array([1.0, 1.0])
    )
    s.resample_at_even_times = resample
    stored_solution = fake(objective=objective, phases={"leg": kept})
    ends = fake(cost=8.0)
    found = feasibility.check_reported_cost(stored_solution, [s], ends, True, scales(4.0), 1e-5)
    return Worst(found.value, f"{found.where} {len(counts)}")


def test_cost_integrals_and_weights_in_shares_of_the_cost() -> None:
    assert reported_cost(8.0).where == "phase leg, peaks between the nodes of integral p 2"
    assert reported_cost(8.0).value == pytest.approx(0.25 / 4)
    assert reported_cost(9.0).value == pytest.approx(1 / 4)
    assert reported_cost(9.0).where == "objective = 9, recomputed 8 2"
    assert reported_cost(8e9).value == pytest.approx(8e9 / (SPAN_MIN_SHARE * 8e9), rel=1e-6)
    found = reported_cost(8.0, peak=-1.0)
    assert (found.value, found.where) == (0.5 / 4, "phase leg, peaks between the nodes of integral p 2")
    found = reported_cost(8.0, kept_integrals=[2.0, 5.0])
    assert (found.value, found.where) == (1.0, "phase leg, integral q 2")
    found = reported_cost(8.0, kept_integral_weights=[1.5, 2.0])
    assert (found.value, found.where) == (6 * 0.5 / 4, "phase leg, weight of integral p 2")


def test_stored_numbers_are_those_of_the_problem() -> None:
    names = dict.fromkeys(stored._PROBLEM_FIELDS, interval(1.0, 2.0)) | {"parameters": np.array([4.0])}
    checked = fake(need_problem=lambda _: fake(sense=1.0), phases={"leg": fake(**names)})

    def check(
        missing: Worst = feasibility.NO_VIOLATION, maximised: bool = False, **changes: Any
    ) -> go.Condition:
        return stored.check_stored_data(
            fake(maximised=maximised, phases={"leg": fake(**(names | changes))}), checked, missing, 1e-5
        )

    assert check().result is PASS
    assert check(maximised=True).value == np.inf
    found = check(path_bounds=interval(1.0, 4.0), parameters=np.array([5.0]))
    assert (found.value, found.where) == (0.5, "phase leg, path_bounds")
    assert check(Worst(0.6, "there"), path_bounds=interval(1.0, 4.0)).where == "there"


def test_angles_beyond_a_full_turn_and_their_slack() -> None:
    """The slack is a millionth of the period 4; an unrestricted control has no limit."""
    twin = fake(
        phases={
            "other": fake(numbers=fake(turns=None)),
            "leg": fake(numbers=fake(turns=fake(periods=np.array([4.0])))),
        }
    )
    problem = fake(phases={"leg": fake(numbers=fake(controls=interval(0.0, 4.0)))})
    for u, beyond in (
        ([0.0, 4 + 3e-6], False),
        ([-3e-6, 2.0], False),
        ([0.0, 4 + 5e-6], True),
        ([-5e-6, 2.0], True),
    ):
        assert external._do_angles_exceed_full_turn(problem, twin, {"leg": fake(u=np.array([u]))}) is beyond


def test_samples_of_variables_that_another_model_has_as_states() -> None:
    def layout(**slices: int) -> Any:
        places, begin = {}, 0
        for name, size in slices.items():
            places[name], begin = slice(begin, begin + size), begin + size
        return fake(names=tuple(slices), slice=places.__getitem__)

    given = fake(states=layout(q=1), controls=layout(a=2, w=1))
    other = fake(states=layout(q=1, w=1), controls=layout(a=2))
    samples = external.SampledPhase(np.arange(2.0), np.array([[1.0, 2.0]]), np.arange(6.0).reshape(3, 2))
    found = external._reorder_sampled_variables(samples, given, other)
    np.testing.assert_array_equal(found.x, [[1.0, 2.0], [4.0, 5.0]])
    np.testing.assert_array_equal(found.u, [[0.0, 1.0], [2.0, 3.0]])
    assert external._reorder_sampled_variables(samples, given, given) is samples


def worst_defect(
    residual: Any, tolerance: float = 1e-4, held: bool = False, jump: float = 0.0, scan: Any = None
) -> Worst:
    """Largest defect in one state of reach 2 along two segments of 1 s with the costate 3, for a cost of 5."""

    def sampled(values: Any) -> Any:
        v = np.array([values], dtype=float)
        return fake(
            phase=leg,
            functions=fake(),
            has_duration=True,
            segments=np.array([0, 0, 1, 1]),
            lam=np.full((1, 4), 3.0),
            u=None,
            residual=v,
            integrate_over_segments=lambda r: 0.5 * (r[..., ::2] + r[..., 1::2]),
            cumulative_integrals=lambda r: np.cumsum(r, axis=-1),
            segment_maxima=lambda r: np.maximum(r[..., ::2], r[..., 1::2]),
            resample_at_even_times=lambda count: sampled(values if scan is None else scan),
            **described(),
        )

    leg = fake(
        name="leg",
        breaks=np.array([0.0, 1.0, 2.0]),
        states=labels("q"),
        controls=labels("u", "w"),
        mesh=fake(segments=2),
        applied=fake(is_piecewise_constant=np.array([[held, False], [False, False]])),
        x=lambda t, side: np.array([[jump if side == "right" else 0.0]]),
        lam=lambda t, side: np.array([[3.0, 3.0]]),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(feasibility, "compute_dynamics_residual", lambda s, u: s.residual)
        patch.setattr(
            feasibility, "compute_propagation_errors", lambda leg, f, k: np.where(k == 1, np.nan, 0.5)[None]
        )
        return feasibility._find_worst_defect(
            sampled(residual), scales(along=round_ellipsoid(2.0)), tolerance
        )


def test_defects_over_and_inside_segments_and_their_costs() -> None:
    """Defects of 4 and 2 cost 3 * (4 + 2) of 5; those of opposite sign matter inside, by the root of the tolerance."""
    found = worst_defect([4.0, 4.0, 2.0, 2.0])
    assert (found.value, found.where) == (pytest.approx(18 / 5), "segment 1 effect on the cost")
    found = worst_defect([1.0, -1.0, -3.0, 3.0], tolerance=0.25)
    assert (found.value, found.where) == (pytest.approx(3 / 2 * 0.5), "segment 1 q")
    found = worst_defect([0.0, 0.0, 0.0, 0.0], scan=[-1.0, -1.0, 0.0, 0.0])
    assert (found.value, found.where) == (pytest.approx(0.5), "segment 0 q")
    found = worst_defect([0.0, 0.0, 0.0, 0.0], jump=6.0)
    assert (found.value, found.where) == (pytest.approx(3.0), "segment 0 q")
    found = worst_defect([1e-3, 1e-3, 0.0, 0.0])  # small ones are integrated again
    assert (found.value, found.where) == (pytest.approx(0.25), "segment 0 q")
    found = worst_defect([0.0, 0.0, 1e-3, 1e-3])  # unless that fails
    assert (found.value, found.where) == (pytest.approx(3e-3 / 5), "segment 1 effect on the cost")
    found = worst_defect([8.0, 8.0, 0.0, 0.0], held=True)
    assert (found.value, found.where) == (pytest.approx(1.5 / 5), "segment 0 effect on the cost")
    found = worst_defect([np.nan, 1.0, 0.0, 0.0])
    assert (found.value, found.where) == (np.inf, "segment 0 q")


def test_terms_of_a_sum() -> None:
    x, y = (sufficient.ca.SX.sym(name) for name in "xy")
    terms = list(sufficient._list_summands(3 * (x**2 - 2 * (y - x * y)) - -(x + x) / 4))
    at = sufficient.ca.Function("terms", [x, y], terms)(3.0, 5.0)
    assert [float(v) for v in at] == pytest.approx([27.0, -30.0, 90.0, 1.5])


def test_stationarity_in_parameters(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gradients (3, -1) of the end cost, (2, 1) along the phase, (1, 0) of atoms; p is free, q at its upper bound."""
    monkeypatch.setattr(
        costates, "_compute_contact_parameter_gradients", lambda s, ends: np.array([[0.25, 0.75], [0.0, 0.0]])
    )
    density = np.array([[1.0, 3.0], [0.5, 1.5]])
    s = fake(
        functions=fake(parameter_gradient=lambda *_: density),
        times=0,
        x=0,
        u=0,
        lam=0,
        mu=0,
        weights=np.array([0.5, 0.5]),
    )
    problem = fake(get_parameter_bounds=lambda: interval([0.0, 0.0], [9.0, 1.0]))
    solution = fake(
        need_problem=lambda _: problem,
        parameter_values=np.array([4.0, 1.0]),
        free_parameters=labels("p", "q"),
    )
    own = fake(cost=5.0, parameters=np.array([0.5, 2.0]))
    found = costates.check_parameter_stationarity(solution, [s], fake(parameters=np.array([3.0, -1.0])), own)
    assert (found.value, found.where) == (pytest.approx(6 * 0.5 / 5), "parameter p")
    found = costates.check_parameter_stationarity(solution, [s], fake(parameters=np.array([-3.0, 1.0])), own)
    assert (found.value, found.where) == (pytest.approx(2 * 1.0 / 5), "parameter q")  # it must fall to 0
    found = costates.check_parameter_stationarity(solution, [s], fake(parameters=np.array([-3.0, -3.0])), own)
    assert found.value == 0.0
    density[0] = -4e12 + 0.5, 4e12
    found = costates.check_parameter_stationarity(solution, [s], fake(parameters=np.array([-1.0, -3.0])), own)
    assert found.value == 0.0  # rounding of large terms
    density[0], solution.parameter_values[0] = (1.0, 3.0), 1e-10  # p can fall to 0 too
    found = costates.check_parameter_stationarity(solution, [s], fake(parameters=np.array([3.0, -1.0])), own)
    assert found.value == pytest.approx(6 * 1e-10 / 5)


def test_directions_of_the_transversality_conditions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gaps of (2, -3) at the start, explained by (0.5, 0), and of (0, 4) at the end, of states of radius (1, 2)."""
    pushes = {
        0: fake(gap=np.array([2.0, -3.0]), explained=np.array([0.5, 0.0]), drift=7.0),
        -1: fake(gap=np.array([0.0, 4.0]), explained=np.zeros(2), drift=8.0),
    }
    pushes[0].limits, pushes[-1].limits = interval([0.0, 0.0], [9.0, 9.0]), interval([0.0, 0.0], [9.0, 1.0])
    drifts: list[Any] = []
    monkeypatch.setattr(costates, "explain_transversality_residual", lambda s, at, ends: pushes[at])
    monkeypatch.setattr(
        costates,
        "_check_time_transversality",
        lambda s, ends, d, own: drifts.append(d.tolist()) or feasibility.NO_VIOLATION,
    )
    own = scales(start=round_ellipsoid(1.0, 2.0), end=round_ellipsoid(1.0, 2.0))
    effects: list[Any] = []
    own.estimate_control_change_by_costate_gap = lambda s, left: effects.append(left.tolist()) or 0.25
    s = fake(
        phase=fake(name="leg", states=labels("q", "v")),
        x=np.array([[5.0, 5.0], [0.0, 1.0]]),
        state_scale=np.ones(2),
    )
    found = costates.check_transversality([s], fake(), own)
    assert (found.value, found.where) == (pytest.approx(1.5 / 5), "phase leg, start, costate of q")
    assert drifts == [[7.0, 8.0]] and effects == [[0.0, 0.0]]
    pushes[-1].limits = interval([0.0, 0.0], [9.0, 9.0])
    found = costates.check_transversality([s], fake(), own)
    assert (found.value, found.where) == (pytest.approx(8 / 5), "phase leg, end, costate of v")
    own.estimate_control_change_by_costate_gap = lambda s, left: 2.0
    assert costates.check_transversality([s], fake(), own).value == 2.0


def test_a_costate_gap_moves_cheap_controls_by_its_response_over_the_curvature(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """H_uu = 4 over 2 s; deviations of 0.1. The second control is expensive, the third has no curvature."""
    module = sys.modules[Scales.__module__]
    times, ones = np.array([0.0, 1.0, 2.0]), np.ones((3, 3))
    monkeypatch.setattr(module, "mask_controls_with_cost_curvature", lambda s: np.ones(3, dtype=bool))
    monkeypatch.setattr(
        module, "differentiate_final_state_by_controls", lambda s: (times, np.stack([ones, ones * times]))
    )
    hessian = np.einsum("ij,k->ijk", np.diag([4.0, 4.0, 0.0]), np.ones(3))
    weights = np.array([1, 2, 1]) / 4
    s = fake(phase=fake(name="leg"), control_hessian=hessian, times=times, span=2.0, weights=weights)
    own = fake(
        cost=10.0, phases={"leg": fake(control_cost=np.array([1e-5, 1.0, 1e-5]), deviation=0.1 * ones)}
    )

    def effect(*gap: float) -> float:
        return Scales.estimate_control_change_by_costate_gap(own, s, np.array(gap))

    assert effect(0.01, 0.0) == pytest.approx(0.05) and effect(-0.02, 0.0) == pytest.approx(0.1)
    assert effect(0.0, 0.01) == pytest.approx(0.05 * np.sqrt(5 / 3))
    assert effect(0.0, 0.0) == 0.0 == effect(0.19 * NOTABLE, 0.0) and effect(0.21 * NOTABLE, 0.0) > NOTABLE
    own.phases["leg"].control_cost = np.array([1e-13, 1.0, 1e-5])
    assert effect(0.01, 0.0) == 0.0


def test_gains_of_controls_with_a_reference_of_their_distance_to_a_bound() -> None:
    """u = 1 - 5e-6 is at its bound for a reference of 10, not for the scale 0.2."""
    s = interior_controls([-3.0, 3.0], [0.0, 0.0], u=1 - 5e-6)
    loss, on_bound = controls._estimate_hamiltonian_decreases(s, np.full((2, 9), 0.2), np.full(2, 10.0))
    assert np.all(on_bound) and np.all(loss[0] == 0)
    np.testing.assert_allclose(loss[1], 0.6)
    loss, on_bound = controls._estimate_hamiltonian_decreases(s, np.full((2, 9), 0.2))
    assert not np.any(on_bound)
    np.testing.assert_allclose(loss[0], 3 * 5e-6, rtol=1e-6)


def test_lower_bounds_need_vanishing_costates_and_their_terms(monkeypatch: pytest.MonkeyPatch) -> None:
    """Costates of 1e-5 * 4 of an amount 8, a cost of 3e-10 over its bound, with the tolerance 1e-5."""
    monkeypatch.setattr(sufficient, "compute_cost_lower_bound", lambda problem: -2.0)

    def attains(
        lam: float = 1.9e-5, cost: float = 2.0 - 7e-10, excess: float = 0.0, sense: float = -1.0
    ) -> bool:
        monkeypatch.setattr(sufficient, "_compute_bound_excess", lambda solution: np.array([0.0, excess]))
        legs = [
            fake(lam=np.array([[0.0, 0.0]]), state_scale=np.ones(1)),
            fake(lam=np.array([[lam, -lam]]), state_scale=np.array([4.0])),
        ]
        solution = fake(need_problem=lambda _: fake(sense=sense))
        return sufficient.attains_lower_bound(solution, legs, cost, 8.0, 1e-5)

    assert attains() and attains(excess=0.9e-10)
    assert not attains(lam=2.1e-5) and not attains(cost=2.0 - 9e-10) and not attains(excess=1.1e-10)
    assert not attains(sense=1.0) and not attains(lam=np.nan)


def test_evidence_of_costates() -> None:
    """All zero ones exist only without an integral with a weight, if the cost does not depend on the ends."""

    def exist(lam: Any = 0.0, weight: float = 0.0, slope: float = 0.0) -> bool:
        leg = fake(
            name="leg", lam=fake(values=[np.array([[0.0, lam]])]), integral_weights=np.array([0.0, weight])
        )
        times = {"initial_time": {"leg": 0.0}, "final_time": {"leg": 0.0}}
        ends = fake(initial_state={"leg": np.array([slope])}, final_state={"leg": np.zeros(1)}, **times)
        return stored.has_costates([fake(phase=leg, state_scale=np.ones(1), span=2.0)], ends, 5.0)

    assert exist(1e-9) and exist() and exist(weight=1.0, slope=9.0)
    assert not exist(slope=1.0) and not exist(np.nan) and not exist(np.inf, 1.0)


def test_kinks_fail_if_the_cost_falls_and_are_else_inconclusive() -> None:
    """Only for a kink on which the trajectory stays, without another failure, is there no evidence against it."""
    checked = partial(nonsmooth_points.check_concave_kinks, falls=False)
    assert checked(None, True).result is PASS
    for jump in (False, True):
        point = nonsmooth_points.KinkPoint(0.5, "there", jump)
        assert checked(point, False, falls=True).result is FAIL
        for fails in (False, True):
            found = checked(point, fails)
            assert (found.result, found.value, found.where) == (INCONCLUSIVE, 0.5, "there")
            assert found.sufficient is (not jump and not fails)
