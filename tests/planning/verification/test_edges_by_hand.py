"""Corners of the verdict by hand: phases that begin late, few samples, missing numbers, and what is said of them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy
from numpy.typing import NDArray
from testing import constructed_solutions as by_hand
from testing.given_scales import given_scales
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.numerical_tolerances import NEGLIGIBLE, replace_zeros_by_one
from gnc_opt.planning import ConditionResult
from gnc_opt.planning.optimality import kkt_system as null_space
from gnc_opt.planning.optimality.cost_and_endpoint_scales import (
    average_violation_over_time,
    compute_integral_scales,
)
from gnc_opt.planning.optimality.kkt_system import NullSpace, are_extreme_eigenvalues_converged, run_lanczos
from gnc_opt.planning.optimality.multiplier_estimate import estimate_multipliers
from gnc_opt.planning.optimality.optimality_check_scales import EndPoints
from gnc_opt.planning.optimality.switching_time_problem import Switches, _find_switching_function_zeros
from gnc_opt.planning.optimality.trajectory_interpolation import (
    SampledPhase,
    _ControlFit,
    _find_control_kinks,
    _Jump,
    _refine_control_jump_times,
    fit_trajectory_polynomials,
)
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.transcription.transcription import transcribe_problem
from gnc_opt.planning.verification import external_trajectory_check, feasibility
from gnc_opt.planning.verification import minimum_principle as controls
from gnc_opt.planning.verification import singular_arcs as singular
from gnc_opt.planning.verification.bang_bang_second_order_conditions import (
    _find_worst_switching_function_sign,
    estimate_nearest_multipliers,
)
from gnc_opt.planning.verification.external_trajectory_check import (
    _build_sampled_solution,
    _read_finite_array,
    _remove_every_second_sample,
    _split_vector_controls,
)
from gnc_opt.planning.verification.feasibility import _find_bound_violation
from gnc_opt.planning.verification.goh_transformation import mask_zero_hamiltonian_curvature
from gnc_opt.planning.verification.reduced_hessian import _find_direction_of_least_curvature
from gnc_opt.planning.verification.solution_data_check import (
    find_nonfinite_stored_value,
    get_endpoint_gradients,
    has_costates,
    recompute_stored_data,
)

Array = NDArray[np.float64]


@pytest.mark.parametrize("begin", [0.0, 50.0, -3.0])
def test_what_is_brief_is_a_share_of_the_duration(begin: float) -> None:
    """A step in the middle of 2 s, averaged over 0.02 s."""
    times = begin + np.unique(np.append(np.linspace(0.0, 2.0, 401), 1.0))
    means = average_violation_over_time(times, (times >= begin + 1.0).astype(float)[None])[0]
    at = (times - begin - 1.0) / 0.02
    np.testing.assert_allclose(means[np.abs(at) > 0.8], np.clip(at + 0.5, 0, 1)[np.abs(at) > 0.8], atol=1e-9)
    assert means[np.argmin(np.abs(at))] == pytest.approx(0.5, abs=0.15)


def bang(
    begin: float = 0.0, late: float = 1.2, lam: Any = None, cost: float = 1.0, unit: float = 1.0
) -> PhaseSamples:
    """Three controls over 2 s: u switches at 0.7 s, w at ``late``, r rests on a bound."""
    model = go.Model("three")
    x = model.state("x", 3)
    u = [model.control(name) for name in "uwr"]
    model.ode({x: ca.vertcat(*u)})
    problem, leg = one_phase("three", model, begin, begin + 2.0)
    problem.minimize(leg.final_time)
    levels = np.array([[-1.0, 1.0, 1.0], [0.0, 0.0, 4.0], [2.0, 2.0, 2.0]]) * unit
    slopes = (lambda t: np.array([0.7 - t, 1.2 - t, -1 + 0 * t])) if lam is None else lam
    return by_hand.samples(
        problem,
        lambda t, k: np.array([t, t, t]) * unit,
        lambda t, k: np.tile(levels[:, [k]], t.size),
        lambda t, k: cost / unit * slopes(t - begin),
        weights=(),
        breaks=begin + np.array([0.0, 0.7, late, 2.0]),
        control_bounds=by_hand.interval([-unit, 0.0, -3 * unit], [unit, 4 * unit, 2 * unit]),
    )


@pytest.mark.parametrize("begin", [0.0, 1e4, -1.0])
def test_switches_are_simultaneous_to_a_ten_millionth_of_the_duration(begin: float) -> None:
    """2e-7 of 2 s, wherever these begin."""
    for apart, together in ((1e-7, True), (4e-7, False)):
        found = Switches.from_samples(bang(begin, 0.7 + apart))
        assert found.channels.tolist() == [0, 1] and bool(found.times[0] == found.times[1]) is together
        np.testing.assert_allclose(
            found.times - begin, [0.7, 0.7 + apart * (not together)], atol=3e-12 * max(1, begin)
        )


@pytest.mark.parametrize(("cost", "unit"), [(1.0, 1.0), (1e4, 1e-3), (1e-4, 1e3)])
@pytest.mark.parametrize("sample", [0, -1])
def test_a_switching_function_vanishes_at_an_end_in_shares_of_the_hamiltonian(
    cost: float, unit: float, sample: int
) -> None:
    """That of w over its range of 4; of u and r it does not."""

    def away(t: Array) -> Array:
        return t if sample == 0 else 2.0 - t

    base = bang(cost=cost, unit=unit, lam=lambda t: np.array([0.7 - t, 1.2 * away(t), -1 + 0 * t]))
    scale = base.hamiltonian_scale / cost
    for sign in (1.0, -1.0):
        for factor, vanishes in ((0.9, True), (1.2, False)):
            level = sign * factor * NEGLIGIBLE * scale / 4

            def lam(t: Array, level: float = level) -> Array:
                return np.array([0.7 - t, level + 1.2 * away(t), -1 + 0 * t])

            s = bang(cost=cost, unit=unit, lam=lam)
            assert _find_switching_function_zeros(s, sample).tolist() == ([1] if vanishes else [])
    still = bang(lam=lambda t: np.array([0.7 - t, 1.2 - t, 0 * t]))
    assert _find_switching_function_zeros(still, 0).tolist() == [2]
    given = replace(still.phase, control_bounds=by_hand.interval([-1.0, 0.0, 2.0], [1.0, 4.0, 2.0]))
    assert (
        _find_switching_function_zeros(PhaseSamples.from_phase(given, still.functions), 0).tolist() == []
    )  # it has no range


def test_slopes_beside_a_switch_are_taken_within_the_shorter_segment() -> None:
    """In a segment of 2e-5 s the switching function of w is three times as steep as in its neighbours."""
    for short_first in (True, False):
        edges = (
            np.array([0.0, 1.0 - 2e-5, 1.0, 2.0]) if short_first else np.array([0.0, 1.0, 1.0 + 2e-5, 2.0])
        )
        switch, brief = 1.0, 1
        model, *_ = dynamics("one", "x", "u", lambda x, u: {x: u})
        problem, leg = one_phase("one", model, 0.0, 2.0)
        problem.minimize(leg.final_time)
        s = by_hand.samples(
            problem,
            lambda t, k: np.array([t]),
            lambda t, k, e=edges, at=switch: np.array([(-1.0 if e[k] < at else 1.0) + 0 * t]),
            lambda t, k, b=brief, e=switch: np.array([(e - t) * (1.0 if k == b else 3.0)]),
            weights=(),
            breaks=edges,
            control_bounds=by_hand.interval(-1.0, 1.0),
        )
        worst = _find_worst_switching_function_sign(s)
        assert worst is not None and worst.where == "phase leg, t = 1 s, u"
        assert worst.slope == pytest.approx(2.0 * 2.0 / s.hamiltonian_scale, rel=1e-5), short_first


def test_rows_that_say_the_same_to_rounding_share_their_multiplier() -> None:
    """Two rows that differ by 1e-12 are one: each takes half."""
    rows = np.array([[1.0, 0.0], [1.0, 1e-12]])
    induced: Any = SimpleNamespace(
        unknowns=SimpleNamespace(free=np.array([True, True])),
        conditions=SimpleNamespace(
            active_limits=(np.array([True, True]), np.array([True, True])), multipliers=np.zeros(2)
        ),
    )
    multipliers = estimate_nearest_multipliers(np.array([4.0, 1.0]), rows, induced)[3]
    np.testing.assert_allclose(multipliers, [-2.0, -2.0], rtol=1e-6)


def test_lanczos_goes_on_past_a_vanishing_diagonal() -> None:
    """((0, 1), (1, 0)) from (1, 0): the first curvature is nothing, the second step finds both."""
    swap = np.array([[0.0, 1.0], [1.0, 0.0]])
    values, _ = run_lanczos(lambda v: swap @ v, np.array([1.0, 0.0]), 10)
    np.testing.assert_allclose(values, [-1.0, 1.0], atol=1e-12)
    nearly = np.diag([5.0, 1.0]) + 0.1 * NEGLIGIBLE * swap
    assert run_lanczos(lambda v: nearly @ v, np.array([1.0, 0.0]), 10)[0].size == 1
    # Where a later curvature is small beside the first, the first tells what counts.
    chain = np.diag([5.0, 1e-9, 3.0]) + np.diag([1.0, 1e-8], 1) + np.diag([1.0, 1e-8], -1)
    assert run_lanczos(lambda v: chain @ v, np.array([1.0, 0.0, 0.0]), 10)[0].size == 2


def test_least_direction_where_everything_curves_downwards() -> None:
    """All inverse curvatures beside the shift are negative: that nearest to zero is the most negative curvature."""
    hessian = scipy.sparse.csc_array(np.diag([-3.0, -2.0, -5.0]))
    every = scipy.sparse.eye_array(3, format="csc")
    space = NullSpace(every, np.zeros(0, dtype=int), np.ones(0), scipy.sparse.csc_array((0, 3)))
    direction = _find_direction_of_least_curvature(space, hessian, True)
    assert direction is not None
    # 1 / (-2 + 0.1) is the most negative: a curvature is found, not the least one; it is negative all the same.
    np.testing.assert_allclose(np.abs(direction), [0.0, 1.0, 0.0], atol=1e-6)
    up = _find_direction_of_least_curvature(space, scipy.sparse.csc_array(np.diag([3.0, 2.0, 5.0])), True)
    assert up is not None
    np.testing.assert_allclose(np.abs(up), [0.0, 1.0, 0.0], atol=1e-3)
    assert _find_direction_of_least_curvature(space, 1e9 * every, True) is None


def test_two_jumps_are_movable_in_their_order() -> None:
    """At the third and eighth of the breaks, however they are found."""
    t = np.array([0.0, 0.5, 1.0, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 4.5, 5.0, 5.5])
    u = np.select([np.arange(14) < 3, np.arange(14) < 11], [1.0, -2.0], 3.0)
    x = np.select([t <= 1.0, t <= 4.5], [t, 1.0 - 2 * (t - 1.0)], -6.0 + 3 * (t - 4.5))
    fitted = fit_trajectory_polynomials(SampledPhase(t, x[None], u[None]), lambda t, x, u: u + 0 * x)
    assert fitted.mesh.movable == (2, 9)
    np.testing.assert_allclose(fitted.u(np.array([0.9, 1.1, 4.4, 4.6]))[0], [1.0, -2.0, -2.0, 3.0])
    later = np.concatenate([t, [6.0, 6.0, 6.5, 7.0]])
    levels = np.concatenate([u, [3.0, -1.0, -1.0, -1.0]])
    ways = np.concatenate([x, [-1.5, -1.5, -2.0, -2.5]])
    assert fit_trajectory_polynomials(
        SampledPhase(later, ways[None], levels[None]), lambda t, x, u: u + 0 * x
    ).mesh.movable == (2, 9, 12)


def test_a_jump_is_placed_although_the_dynamics_end_beyond_some_times() -> None:
    """x' = u / (1 - x)^(1/2): where u = 2 lasts too long there is no root, and no number to compare with."""
    t = np.array([0.0, 0.2, 0.4, 0.6])
    switch, first, second = 0.26, 2.0, -1.0

    def way(s: Array) -> Array:
        return np.where(s < switch, first * s, first * switch + second * (s - switch))

    def rates(t: Array, x: Array, u: Array) -> Array:
        with np.errstate(invalid="ignore"):
            return u * np.sqrt(np.where(x < 0.7, 1.0, np.nan))

    u = np.where(t < switch, first, second)
    samples = SampledPhase(t, way(t)[None], u[None])
    jump = _Jump(1, 0.3, (0,))
    _refine_control_jump_times(samples, _ControlFit(samples, [jump]), [jump], rates)
    assert jump.time == pytest.approx(switch, abs=1e-7)


def test_misses_are_reported_in_their_units() -> None:
    """The worst in shares of its scale, with its excess in its own unit."""
    box = Interval(np.array([0.0, 0.0]), np.array([1.0, 1.0]))
    values, scale = np.array([1.5, -0.4]), np.array([10.0, 1.0])
    find = _find_bound_violation
    worst = find(values, box, scale, ["a", "b"], ["m", "kg"])
    assert worst.value == pytest.approx(0.4) and worst.where == "b off by 0.4 kg"
    assert find(values, box, scale, ["a", "b"], ["m", ""]).where == "b off by 0.4"
    assert find(np.array([0.5, 0.5]), box, scale, ["a", "b"], ["m", ""]).where == "no violation"
    gone = find(np.array([0.5, np.nan]), box, scale, ["a", "b"], ["m", ""])
    assert gone.value == np.inf and gone.where == "b is not finite"
    assert find(np.zeros(0), Interval(np.zeros(0), np.zeros(0)), np.zeros(0), [], []).value == 0.0
    zero = Interval(np.ones(1), np.ones(1))
    assert find(np.zeros(1), zero, np.zeros(1), ["a"], [""]).value == 1.0


@pytest.mark.parametrize(
    ("count", "growth", "result"),
    [
        (15, 9.0, ConditionResult.FAIL),
        (16, 9.0, ConditionResult.INCONCLUSIVE),
        (16, 3.9, ConditionResult.FAIL),
    ],
)
def test_failures_of_coarse_samples_grow_without_every_second_one(
    count: int, growth: float, result: ConditionResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fourfold or more, if eight samples are left."""
    condition = go.Condition("stationarity", ConditionResult.FAIL, 3e-3, 1e-5, "there", "meaning")
    verdict = go.Verdict("p", (condition,))
    coarse = go.Verdict("p", (replace(condition, value=growth * 3e-3),))
    monkeypatch.setattr(external_trajectory_check, "_build_sampled_solution", lambda *_: None)
    monkeypatch.setattr(external_trajectory_check, "verify", lambda *_, tol: coarse)
    t, given = np.linspace(0.0, 1.0, count), None
    samples = {
        "leg": SampledPhase(t, t[None], t[None]),
        "short": SampledPhase(t[:3], t[None, :3], t[None, :3]),
    }
    found = external_trajectory_check._mark_interpolation_errors_inconclusive(
        verdict, given, samples, given, 1e-5, 1
    )
    assert found.conditions[0].result is result


def test_every_second_sample_is_dropped_but_jumps_and_ends() -> None:
    t = np.array([0.0, 1.0, 2.0, 3.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0])
    thin = _remove_every_second_sample(SampledPhase(t, t[None], -t[None]))
    assert thin.t.tolist() == thin.x[0].tolist() == (-thin.u[0]).tolist() == [0, 2, 3, 3, 5, 7, 8]


def energetic(amount: float = 1.0) -> tuple[go.Solution, list[PhaseSamples]]:
    """`by_hand.cart` with its cost of 6, in some unit, and what the flight changes it by."""
    problem = by_hand.cart()
    leg = replace(by_hand.phase(problem), integrals=np.array([12.0]), integral_weights=np.array([0.5]))
    solution = recompute_stored_data(by_hand.solution(problem, leg))
    return solution, [replace(s, cost_magnitude=amount) for s in solution.samples().values()]


@pytest.mark.parametrize("amount", [0.5, 1.0, 30.0])
def test_the_objective_is_off_in_shares_of_what_the_flight_changes_it(amount: float) -> None:
    solution, samples = energetic(amount)
    ends = get_endpoint_gradients(solution)
    assert ends.cost == pytest.approx(6.0)
    for stored in (5.75, 6.25):
        off = feasibility.check_reported_cost(
            replace(solution, objective=stored), samples, ends, True, given_scales(samples, cost=amount), 1e-6
        )
        assert off.value == pytest.approx(0.25 / amount, rel=1e-6)
        assert off.where == f"objective = {stored:g}, recomputed 6"


@pytest.mark.parametrize(
    ("told", "what"), [(True, "weight of integral"), (True, "integral"), (False, "integral")]
)
def test_integrals_and_their_weights_are_recomputed(told: bool, what: str) -> None:
    """The integral of a^2 is 12, its weight 1 / 2: 0.3 of the one is worth 0.15, 0.1 of the other 1.2."""
    solution, samples = energetic(2.0)
    leg = solution.phase()
    changes = {
        "weight of integral": {"integral_weights": np.array([0.6])},
        "integral": {"integrals": np.array([12.3])},
    }
    wrong = replace(solution, phases={"leg": replace(leg, **changes[what])})
    found = feasibility.check_reported_cost(
        wrong, samples, get_endpoint_gradients(solution), told, given_scales(samples, cost=2.0), 1e-6
    )
    assert found.value == pytest.approx(0.6 if "weight" in what else 0.075, rel=1e-6)
    assert found.where.startswith(f"phase leg, {what} ")
    if what == "integral" and not told:
        lost = replace(solution, phases={"leg": replace(leg, integral_weights=np.array([np.nan]))})
        assert (
            feasibility.check_reported_cost(
                lost, samples, get_endpoint_gradients(solution), False, given_scales(samples), 1e-6
            ).value
            < 1e-9
        )


def test_singular_arcs_begin_at_their_first_sample_and_last_a_share() -> None:
    """u is without slope and curvature from 0.5 s of 2 s on."""
    model, x, _u = dynamics("one", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("one", model, 0.0, 2.0)
    problem.minimize(leg.integral(x))
    s = by_hand.samples(
        problem,
        lambda t, k: np.array([t]),
        lambda t, k: np.array([1.0 - k + 0 * t]),
        lambda t, k: np.array([k - 1.0 + 0 * t]),
        weights=(1.0,),
        breaks=(0.0, 0.5, 2.0),
        control_bounds=by_hand.interval(-1.0, 1.0),
    )
    singular = controls.mask_undetermined_controls(s, 1e-5)[0]
    condition = controls.check_singular_arcs([s], 1e-5, [singular], [np.zeros_like(singular)])
    assert condition.result is ConditionResult.INCONCLUSIVE and condition.sufficient
    assert condition.value == pytest.approx(0.75) and condition.tolerance == 1e-5
    assert condition.where == "from phase leg, t = 0.5 s, u, 75.0 % of the phase"
    none = controls.check_singular_arcs([], 1e-5, [], [])
    assert none.result is ConditionResult.PASS
    assert none.where == "no singular arc of higher order"
    assert none.sufficient


@pytest.mark.parametrize("unit", [1e-2, 1.0, 1e2])
@pytest.mark.parametrize(("slope", "bend", "alone"), [(0, 1e-6, True), (0, 1e-4, False), (1e-4, 0, False)])
def test_a_control_is_singular_without_slope_and_curvature_in_any_unit(
    unit: float, slope: float, bend: float, alone: bool
) -> None:
    """H = (1 + slope + lam) u + bend u^2 / 2 with lam = -1 and u = 0, for |u| <= 1, to 1e-5 of the change of u."""
    model, _x, u = dynamics("one", "x", "u", lambda x, u: {x: u / unit})
    problem, leg = one_phase("one", model, 0.0, 2.0)
    problem.minimize(leg.integral((1 + slope) * u / unit + 0.5 * bend * (u / unit) ** 2))
    s = by_hand.samples(
        problem,
        lambda t, k: np.array([1 + 0 * t]),
        lambda t, k: np.array([0 * t]),
        lambda t, k: np.array([-1 + 0 * t]),
        weights=(1.0,),
        breaks=(0.0, 0.5, 2.0),
        control_bounds=by_hand.interval(-unit, unit),
    )
    singular, _ = controls.mask_undetermined_controls(s, 1e-5)
    assert np.all(singular) if alone else not np.any(singular)


def test_a_missing_costate_among_zeros_is_none() -> None:
    """Of two phases one has zeros and one has nothing: neither is told."""
    problem = by_hand.cart()
    zero = by_hand.phase(problem, lam=lambda t, k: np.zeros((2, t.size)))
    gone = by_hand.phase(problem, lam=lambda t, k: np.full((2, t.size), np.nan))
    solution = by_hand.solution(problem, zero)
    ends = get_endpoint_gradients(solution)
    samples = {
        name: PhaseSamples.from_phase(leg, by_hand.functions(problem))
        for name, leg in (("z", zero), ("g", gone))
    }
    assert has_costates([samples["z"]], ends, 1.0)
    assert not has_costates([samples["z"], samples["g"]], ends, 1.0)
    assert not has_costates([samples["g"]], ends, 1.0)


def test_the_first_missing_number_has_its_place() -> None:
    problem = by_hand.cart()
    base = by_hand.phase(problem)
    assert find_nonfinite_stored_value(by_hand.solution(problem, base), True).value == 0.0

    def hole(t: Array, k: int) -> Array:
        return by_hand.rest(t, k) * (np.nan if k == 1 else 1.0)

    gone = by_hand.solution(problem, by_hand.phase(problem, hole))
    worst = find_nonfinite_stored_value(gone, False)
    assert worst.value == np.inf and worst.where == "phase leg, segment 2 (from t = 0.5), x is not finite"
    dual = by_hand.solution(problem, replace(base, lam_start=np.full_like(base.lam_start, np.nan)))
    assert find_nonfinite_stored_value(dual, False).value == 0.0
    assert find_nonfinite_stored_value(dual, True).where == "phase leg, lam_start is not finite"
    cost = by_hand.solution(problem, base, objective=float("nan"))
    assert find_nonfinite_stored_value(cost, False).where == "objective is not finite"


def test_integrals_without_integrands_have_no_span() -> None:
    model, *_ = dynamics("one", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("one", model, 0.0, 1.0)
    problem.minimize(leg.final_state("x"))
    one = (lambda t, k: np.array([t]),) * 3
    assert compute_integral_scales(by_hand.samples(problem, *one, weights=())).shape == (0,)


def test_a_trajectory_without_controls_needs_none() -> None:
    assert _read_finite_array([], (0, 5), "controls").shape == (0, 5)
    with pytest.raises(go.ProblemError, match=r"has shape \(1,\) where \(0, 5\)"):
        _read_finite_array([3.0], (0, 5), "controls")
    np.testing.assert_array_equal(_read_finite_array([1.0, 2.0], (1, 2), "x"), [[1.0, 2.0]])
    with pytest.raises(go.ProblemError, match="not every number is finite"):
        _read_finite_array([1.0, np.inf], (1, 2), "x")


@pytest.mark.parametrize("maximised", [False, True])
def test_a_trajectory_s_solution_knows_whether_its_cost_is_maximised(maximised: bool) -> None:
    model, *_ = dynamics("one", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("one", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-1.0, 1.0))
    (problem.maximize if maximised else problem.minimize)(leg.final_state("x"))
    t = np.linspace(0.0, 1.0, 5)
    sign = 1.0 if maximised else -1.0
    samples = {"leg": SampledPhase(t, sign * t[None], sign + 0 * t[None])}
    found = _build_sampled_solution(problem, samples, np.zeros(0), parts=1)
    assert found.maximised is maximised and found.objective == pytest.approx(sign)
    assert go.verify(found).ok


def test_both_ends_of_a_spectrum_must_have_settled() -> None:
    """((0, b), (b, c)): eigenvectors whose last components are known; in shares of the largest eigenvalue."""
    diagonal, beside = [0.0, 3.0], [1.0]
    values, vectors = np.linalg.eigh(np.array([[0.0, 1.0], [1.0, 3.0]]))
    worst, largest = np.max(np.abs(vectors[-1])), np.max(np.abs(values))
    for factor, settled in ((0.99, True), (1.01, False)):
        assert are_extreme_eigenvalues_converged(diagonal, beside, factor * 1e-4 * largest / worst) is settled


def test_rows_without_a_gradient_have_the_norm_of_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that what they curve by counts as it is; the others are scaled to unit gradients."""
    point: Any = SimpleNamespace(
        x=np.zeros(2),
        transcription=None,
        constraint_jacobian=scipy.sparse.csr_array(np.array([[0.0, 0.0], [3.0, 4.0]])),
    )
    monkeypatch.setattr(
        null_space, "compute_variation_norm_weights", lambda transcription: np.array([1.0, 4.0])
    )
    found = NullSpace.with_fixed_variables(point, np.array([False, False, True, True]))
    np.testing.assert_allclose(found.unit.diagonal(), [1.0, 0.5])
    np.testing.assert_allclose(found.norms, [1.0, np.sqrt(9 + 4)])
    np.testing.assert_allclose(found.jacobian.toarray(), [[0, 0], [3 / np.sqrt(13), 2 / np.sqrt(13)]])


def test_ones_take_the_place_of_nothing() -> None:
    np.testing.assert_array_equal(replace_zeros_by_one(np.array([0.5, 0.0, 2.0])), [0.5, 1.0, 2.0])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_multipliers_of_a_cost_that_falls_with_its_variables(sign: float) -> None:
    """Farthest in one direction in 1 s at |u| <= 1: the costate is minus the direction, the bound pushes along it."""
    model, *_ = dynamics("one", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("far", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(-sign * leg.final_state("x"))
    t = np.linspace(0.0, 1.0, 5)
    fitted = {
        "leg": fit_trajectory_polynomials(
            SampledPhase(t, sign * t[None], sign + 0 * t[None]), lambda t, x, u: u + 0 * x
        )
    }
    transcription = transcribe_problem(problem, {"leg": fitted["leg"].mesh}, "LG")
    found = estimate_multipliers(transcription, problem, fitted, np.zeros(0))
    part = transcription.parts["leg"].collocation
    np.testing.assert_allclose(found.lam_x[part.point_controls[0]] / part.quadrature_weights, sign, rtol=1e-6)
    assert found.lam_x[part.boundary_states[0, 0]] == pytest.approx(sign, rel=1e-6)


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e3])
def test_on_a_bound_is_a_millionth_of_the_range(unit: float) -> None:
    """w over its range of 4, in any unit; u rests on its own."""
    for off, told in ((3e-6, True), (5e-6, False)):
        s = bang(unit=unit)
        box = by_hand.interval([-unit, -off * unit, -3 * unit], [unit, (4.0 + off) * unit, 2 * unit])
        s = PhaseSamples.from_phase(replace(s.phase, control_bounds=box), s.functions)
        on_bound = np.any(s.is_at_control_bounds, axis=0)
        assert bool(np.all(on_bound[1])) is told and np.all(on_bound[[0, 2]])


def test_given_times_do_not_change_the_cost() -> None:
    """The final time is given, the initial one is not: it moves by the 2 s of the phase."""
    model, *_ = dynamics("one", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("times", model, (-9.0, 9.0), 2.0)
    problem.minimize(1000 * leg.final_time + 3 * leg.initial_time)
    base = by_hand.phase(
        problem,
        lambda t, k: np.array([0.1 * t]),
        lambda t, k: np.array([0.1 + 0 * t]),
        lambda t, k: np.array([t]),
        breaks=(0.0, 0.5, 2.0),
    )
    solution = recompute_stored_data(by_hand.solution(problem, base))
    found = EndPoints.from_solution(solution, list(solution.samples().values()))
    assert found.compute_endpoint_changes() == pytest.approx(6.0)


def test_derivatives_that_grow_too_large_are_not_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    model, x, _u = dynamics("one", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("one", model, 0.0, 2.0)
    problem.minimize(leg.integral(x**2))
    s = by_hand.samples(
        problem,
        lambda t, k: np.array([0 * t]),
        lambda t, k: np.array([0 * t]),
        lambda t, k: np.array([0 * t]),
        weights=(1.0,),
        breaks=(0.0, 2.0),
        control_bounds=by_hand.interval(-1.0, 1.0),
    )
    monkeypatch.setattr(singular, "MAX_INSTRUCTIONS", 0)
    (arc,) = singular.analyse_singular_arcs(problem, s, *controls.mask_undetermined_controls(s, 1e-5), 1e-5)
    assert (arc.order, arc.least) == (0, 0.0)
    assert arc.why == "the switching function has too large a derivative of order 0"


def test_a_verdict_is_kept_for_the_default_tolerance() -> None:
    problem = by_hand.cart()
    solution = by_hand.solution(problem, by_hand.phase(problem))
    first = go.verify(solution)
    assert not first.estimated
    assert go.verify(solution) is first and go.verify(solution, tol=1e-4) is not first


@pytest.mark.parametrize(("turn", "seen"), [(0.015, False), (0.03, True)])
def test_a_kink_is_seen_by_what_it_moves_in_one_interval(turn: float, seen: bool) -> None:
    """In 0.1 s by a thousandth of the range of 2."""
    t = np.linspace(0.0, 2.0, 21)
    u = t + turn * np.maximum(t - 1.03, 0.0)
    found = _find_control_kinks(t, u, 5, 2, 0.0)
    assert len(found) == seen
    for kink in found:
        assert kink.after == 15 and kink.time == pytest.approx(1.03, abs=1e-6)
        assert kink.channels == (2,) and kink.of_slope


@pytest.mark.parametrize("cost", [1.0, 1e3])
def test_straight_is_a_millionth_of_the_hamiltonian_over_the_range(cost: float) -> None:
    """bend u^2 / 2 over a range of 5."""
    for factor, told in ((0.9, True), (1.1, False), (-5.0, True)):
        bend = 0.0
        for _ in range(2):  # H's scale depends on the curvature only a little
            model, x, u = dynamics("one", "x", "u", lambda x, u: {x: u})
            problem, leg = one_phase("one", model, 0.0, 2.0)
            problem.minimize(leg.integral(cost * (x + bend * u**2 / 2)))
            s = by_hand.samples(
                problem,
                lambda t, k: np.array([t]),
                lambda t, k: np.array([1.0 + 0 * t]),
                lambda t, k: np.array([-cost + 0 * t]),
                weights=(1.0,),
                breaks=(0.0, 2.0),
                control_bounds=by_hand.interval(-1.0, 4.0),
            )
            bend = factor * 1e-6 * s.hamiltonian_scale / cost / 25
        assert bool(np.all(mask_zero_hamiltonian_curvature(s))) is told


def test_a_vector_of_size_zero_keeps_its_direction() -> None:
    model = go.Model("body")
    v = model.state("v", 2)
    force, _ = model.vector_control("F", 2)
    model.ode({v: force})
    _, leg = one_phase("push", model, 0.0, 1.0)
    given = np.array([[0.0, -3.0, 0.0, 4.0], [0.0, -4.0, 0.0, -3.0]])
    size, direction = _split_vector_controls(leg, {"F": given}, 4).values()
    np.testing.assert_allclose(size, [[0.0, 5.0, 0.0, 5.0]])
    np.testing.assert_allclose(direction, [[-0.6, -0.6, -0.6, 0.8], [-0.8, -0.8, -0.8, -0.6]])
    none = _split_vector_controls(leg, {"F": 0 * given}, 4).values()
    for found, expected in zip(none, ([[0.0] * 4], [[1.0] * 4, [0.0] * 4]), strict=True):
        np.testing.assert_allclose(found, expected)
