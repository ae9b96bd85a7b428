"""Parts of the verdict on trajectories that are given by hand, against figures worked out by hand."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from testing import constructed_solutions as by_hand
from testing.given_scales import given_scales
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.planning import ConditionResult, Verdict
from gnc_opt.planning.optimality.active_state_constraints import (
    PureStateConstraints,
    explain_costate_jumps,
    integrate_multipliers_near_boundaries,
)
from gnc_opt.planning.optimality.cost_and_endpoint_scales import (
    average_violation_over_time,
    compute_integral_scales,
    compute_parameter_scales,
)
from gnc_opt.planning.optimality.kkt_system import compute_quadrature_weights, compute_variation_norm_weights
from gnc_opt.planning.optimality.multiplier_estimate import (
    _choose_shooting_nodes,
    _mask_adjoint_equation_rows,
    _mask_adjoint_multipliers,
    _sample_trajectory_variables,
)
from gnc_opt.planning.optimality.optimality_check_scales import EndPoints
from gnc_opt.planning.optimality.switching_time_problem import Switches, SwitchingTimeProblem, SwitchUnknowns
from gnc_opt.planning.optimality.trajectory_interpolation import SampledPhase, fit_trajectory_polynomials
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.transcription.transcription import transcribe_problem
from gnc_opt.planning.verification import feasibility
from gnc_opt.planning.verification.bang_bang_second_order_conditions import estimate_nearest_multipliers
from gnc_opt.planning.verification.costate_conditions import _compute_wrong_sign_multipliers
from gnc_opt.planning.verification.critical_cone import (
    CriticalCone,
    _extend_active_limits_along_arcs,
    _list_nlp_variables_along_segments,
    _list_segment_states,
)
from gnc_opt.planning.verification.minimum_principle import mask_undetermined_controls
from gnc_opt.planning.verification.reduced_hessian import (
    Curvature,
    _describe_largest_variation_component,
    _explain_inconclusive_curvature,
    build_critical_cone,
)
from gnc_opt.planning.verification.singular_arcs import (
    analyse_singular_arcs,
    check_generalised_legendre_clebsch,
)
from gnc_opt.planning.verification.solution_data_check import (
    _compute_relative_difference,
    get_endpoint_gradients,
    has_costates,
    recompute_stored_data,
)

Array = NDArray[np.float64]


def plain(matrix: Any, cost: Any = None) -> go.Problem:
    """x' = matrix x + (0, u)."""
    model = go.Model("plain")
    x, u = model.state("x", 2), model.control("u")
    model.ode({x: ca.mtimes(ca.DM(matrix), x) + ca.vertcat(0, u)})
    problem, leg = one_phase("plain", model, 0.0, 2.0)
    problem.minimize(leg.final_state("x")[0] if cost is None else leg.integral(cost(model.time, x, u)))
    return problem


def arc(problem: go.Problem, **changes: Any) -> PhaseSamples:
    """x = (1 + t, 2 - t^2) and u = t over 2 s."""
    weights = (1.0,) * len(problem.get_phase().integrands)
    values = {"breaks": (0.0, 0.5, 2.0)} | changes
    return by_hand.samples(
        problem,
        lambda t, k: np.array([1 + t, 2 - t**2]),
        lambda t, k: np.array([t]),
        lambda t, k: np.array([3 - t, 1 + 2 * t]),
        weights=weights,
        **values,
    )


@pytest.mark.parametrize(
    ("origin", "off", "excused"), [(0.0, 5e-9, True), (0.0, 5e-7, False), (1e6, 5e-7, True)]
)
def test_times_of_trajectory_and_phase_agree_up_to_their_rounding(
    origin: float, off: float, excused: bool
) -> None:
    """12 digits of 1e6 s end at a microsecond."""
    problem = plain(np.zeros((2, 2)))
    leg = problem.get_phase()
    leg.time(origin, origin + 2.0)
    problem.stated_time_unit = "h"
    s = arc(problem, breaks=(origin, origin + 0.5, origin + 2.0))
    free = by_hand.interval(-np.inf, np.inf)
    phase = replace(s.phase, final_time=origin + 2.0 - off, final_time_bounds=free)
    solution = by_hand.solution(problem, phase)
    samples = [PhaseSamples.from_phase(phase, s.functions)]
    condition = feasibility.check_boundary_conditions(
        solution, samples, get_endpoint_gradients(solution), given_scales(samples), 1e-9
    )
    assert (condition.result is ConditionResult.PASS) is excused, condition
    if not excused:
        assert condition.value == pytest.approx((off - 1e-8) / 2.0, rel=1e-3)
        assert re.fullmatch("phase leg, end of the trajectory off by .* h", condition.where)


def test_no_singular_arc_asks_for_nothing() -> None:
    problem = plain(np.zeros((2, 2)), lambda t, x, u: u**2)
    s = arc(problem)
    arcs = analyse_singular_arcs(problem, s, *mask_undetermined_controls(s, 1e-5), 1e-5)
    condition = check_generalised_legendre_clebsch(arcs, 1e-5)
    assert (condition.result, condition.value, condition.tolerance) == (ConditionResult.PASS, 0.0, 0.0)


def test_multipliers_that_bounds_cannot_exert() -> None:
    """At the lower limit -1 is right and 1 is not, at the upper one conversely; a given value takes both."""
    box = by_hand.interval([0.0, 0.0, 0.0, 5.0], [1.0, 1.0, 1.0, 5.0])
    values, scale = np.array([0.9e-4, 1 - 0.9e-4, 0.5, 7.0]), np.full(4, 100.0)
    np.testing.assert_allclose(
        _compute_wrong_sign_multipliers(np.full(4, 2.0), values, box, scale), [2, 0, 2, 0]
    )
    np.testing.assert_allclose(
        _compute_wrong_sign_multipliers(np.full(4, -2.0), values, box, scale), [0, 2, 2, 0]
    )


def test_difference_in_shares_of_the_larger() -> None:
    a, b = np.array([1.0, 4.0, np.inf, np.inf, 0.0, -3.0]), np.array([1.0, 5.0, np.inf, 2.0, 0.0, 3.0])
    np.testing.assert_allclose(_compute_relative_difference(a, b), [0.0, 0.2, 0.0, np.inf, 0.0, 2.0])
    np.testing.assert_allclose(_compute_relative_difference(a[:2], a[:3]), [np.inf])
    assert _compute_relative_difference(np.array([np.nan]), np.array([1.0])) == [np.inf]


def test_spans_of_integrals() -> None:
    """t from 0 to 2 s: 2 above its least and below its largest value; 10 + t^2: 8/3 above, 16/3 below."""
    model, *_ = dynamics("clocks", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("clocks", model, 0.0, 2.0)
    t = model.time
    problem.minimize(
        leg.integral(t)
        + leg.integral(10 + t**2) ** 2
        + leg.integral(1 + 0 * t) ** 3
        + leg.integral(4 - t**2) ** 4
    )

    def samples(**changes: Any) -> PhaseSamples:
        signals = (lambda t, k: np.array([t]), lambda t, k: np.array([1 + 0 * t]), lambda t, k: np.array([t]))
        return by_hand.samples(problem, *signals, weights=(1.0,) * 4, breaks=(0.0, 0.5, 2.0), **changes)

    spans = dict(zip(problem.get_phase().integrands, compute_integral_scales(samples()), strict=True))
    assert list(spans.values()) == pytest.approx([2.0, 8 / 3, 0.0, 8 / 3], abs=1e-9)
    longer = samples(final_time_bounds=by_hand.interval(1.0, 3.0))
    assert compute_integral_scales(longer) == pytest.approx([2.0, 20 + 8 / 3, 2.0, 16 / 3], abs=1e-9)


def test_magnitudes_of_cost_constraints_and_parameters() -> None:
    """States move by 2 and 4 within the box flown, the final time by 2, and k, which has no range, by its size of 3."""
    model, *_ = dynamics("two", "x y", "u", lambda x, y, u: {x: 1.0, y: u})
    problem, leg = one_phase("two", model, 0.0, (1.0, 4.0))
    k = problem.parameter("k")
    problem.constrain("a", leg.initial_state("x") + 5 * leg.final_state("y"), upper=100.0)
    problem.constrain("b", 7 * leg.final_time, upper=100.0)
    problem.constrain("c", 0 * k + 11.0, upper=100.0)
    problem.minimize(leg.final_state("x") - 9 * k)
    signals = (
        lambda t, k: np.array([1 + t, 2 - t**2]),
        lambda t, k: np.array([-2 * t]),
        lambda t, k: np.array([3 - t, 1 + 2 * t]),
    )
    solution = recompute_stored_data(
        by_hand.solution(
            problem,
            by_hand.phase(problem, *signals, breaks=(0.0, 0.5, 2.0)),
            parameter_values=np.array([3.0]),
            parameter_multipliers=np.zeros(1),
            constraint_multipliers=np.zeros(3),
            constraint_labels=("a", "b", "c"),
        )
    )
    samples = list(solution.samples().values())
    np.testing.assert_allclose(samples[0].state_scale, [2.0, 4.0])
    found = EndPoints.from_solution(solution, samples).compute_endpoint_changes()
    np.testing.assert_allclose(found[[0, 1, 3]], [20.0, 14.0, 27.0])
    assert 0 < found[2] < 1e-3  # nothing changes it: a share of its size


def limited(**changes: Any) -> PhaseSamples:
    """x = (1 + t, 2 - t^2); x_0 reaches 1.5 at the first break."""
    return arc(plain([[0.2, 1.0], [-0.5, 0.4]]), **changes)


def test_sides_of_state_bounds_that_are_active() -> None:
    s = limited(state_bounds=by_hand.interval([-9.0, 1.75], [1.5, 9.0]))
    times = np.array([0.2, 0.5])
    at = times, s.phase.x(times), s.phase.applied(times)
    found = PureStateConstraints.from_states(s, s.phase.state_bounds, *at)
    np.testing.assert_array_equal(
        found.active, [[False, True], [False, False], [False, False], [False, True]]
    )
    np.testing.assert_allclose(found.directions[:, :, 0], [[1, 0, -1, 0], [0, 1, 0, -1]])


@pytest.mark.parametrize(
    ("jump", "left"), [((2.0, 0.0), (0.0, 0.0)), ((-2.0, 0.0), (-2.0, 0.0)), ((2.0, 1.0), (0.0, 1.0))]
)
def test_jumps_that_active_limits_explain(jump: tuple[float, float], left: tuple[float, float]) -> None:
    """lambda(t-) - lambda(t+) > 0 at an upper limit, in the component that is limited."""
    s = by_hand.samples(
        plain(np.zeros((2, 2))),
        lambda t, k: np.array([1 + t, 2 - t**2]),
        lambda t, k: np.array([t]),
        lambda t, k: np.array([3 - t, 1 + t]) - k * np.array(jump)[:, None],
        weights=(),
        breaks=(0.0, 0.5, 2.0),
        state_bounds=by_hand.interval([-9.0, -9.0], [1.5, 9.0]),
    )
    np.testing.assert_allclose(explain_costate_jumps(s)[0][:, 0], left, atol=1e-9)


@pytest.mark.parametrize(("jump", "left"), [(-1.5, 0.0), (-3.0, -1.0), (1.0, 0.0)])
def test_jumps_the_wrong_way_are_explained_by_a_density_beside_them(jump: float, left: float) -> None:
    """200 over half a hundredth of 2 s may be taken back: 2."""
    s = by_hand.samples(
        plain(np.zeros((2, 2))),
        lambda t, k: np.array([1 + t, 2 - t**2]),
        lambda t, k: np.array([t]),
        lambda t, k: np.array([3 - t - k * jump, 1 + t]),
        states=lambda t, k: np.array([200.0 + 0 * t, 0 * t]),
        weights=(),
        breaks=(0.0, 0.5, 2.0),
        state_bounds=by_hand.interval([-9.0, -9.0], [1.5, 9.0]),
    )
    np.testing.assert_allclose(explain_costate_jumps(s)[0][:, 0], [left, 0.0], atol=1e-9)


def test_induced_problem_in_closed_form() -> None:
    """x' = k u with one switch s, everything free: x_f = x_0 + k (2 s - t_0 - t_f), and the integral of x."""
    model = go.Model("integrator")
    x, u, k = model.state("x"), model.control("u"), model.parameter("k", 1.0)
    model.ode({x: k * u})
    problem = go.Problem("everything free")
    free_k = problem.parameter("k", lower=0.5, upper=5.0)
    leg = problem.phase("leg", model)
    leg.time((0.0, 0.5), (1.5, 3.0))
    leg.initial(x=(0.0, 1.0))
    leg.final(x=(-1.0, 5.0))
    leg.bounds(u=(-1.0, 1.0))
    first, last = leg.initial_state("x"), leg.final_state("x")
    problem.constrain("both", last * free_k - 2 * first * leg.final_time, upper=100.0)
    problem.minimize(leg.final_time**2 + leg.integral(x) * last)
    hand = {"t0": 0.2, "s": 1.0, "tf": 2.0, "x0": 0.7, "k": 1.5}
    signals = (
        lambda t, k: np.array([0.7 + 1.5 * np.minimum(t - 0.2, 1.8 - t)]),
        lambda t, k: np.array([1.0 - 2.0 * k + 0 * t]),
        lambda t, k: np.array([t - 1.0]),
    )
    base = by_hand.solution(
        problem,
        by_hand.phase(problem, *signals, breaks=(0.2, 1.0, 2.0)),
        parameter_values=np.array([1.5]),
        parameter_multipliers=np.zeros(1),
        constraint_multipliers=np.array([0.3]),
        constraint_labels=("both",),
    )
    solution = recompute_stored_data(base)
    samples, ends = list(solution.samples().values()), get_endpoint_gradients(solution)
    switches = {"leg": Switches.from_samples(samples[0])}
    unknowns = SwitchUnknowns.from_switches(solution, samples, switches)
    found = SwitchingTimeProblem.from_integrated_controls(
        solution, samples, ends, unknowns, {"leg": switches["leg"].build_piecewise_control((0,))}, 4
    )

    t0, s, tf, x0, factor = theta = [ca.SX.sym(name) for name in hand]
    end = x0 + factor * (2 * s - t0 - tf)
    up, down = s - t0, tf - s
    integral = x0 * (tf - t0) + factor * (up**2 / 2 + up * down - down**2 / 2)
    cost, both = tf**2 + integral * end, end * factor - 2 * x0 * tf
    rows = ca.vertcat(end, both, x0, t0, tf, tf - t0, factor)
    lagrangian = cost + 0.4 * end - 0.6 * both
    everything = ca.vertcat(*theta)
    exact = ca.Function(
        "exact",
        [everything],
        [
            ca.gradient(cost, everything),
            ca.jacobian(rows, everything),
            ca.hessian(lagrangian, everything)[0],
            rows,
        ],
    )
    gradient, jacobian, hessian, values = (v.full() for v in exact(list(hand.values())))
    size = float(samples[0].state_scale[0])
    scale = np.array([1.8, 1.8, 1.8, size, 0.45])
    np.testing.assert_allclose(unknowns.scale, scale)
    assert unknowns.labels[1].startswith("phase leg, switch of u at 1")
    assert unknowns.labels[-1] == "parameter k"
    assert np.all(unknowns.free)
    np.testing.assert_allclose(found.gradient, gradient.ravel() * scale, rtol=1e-9)
    conditions = found.conditions
    np.testing.assert_allclose(conditions.jacobian, jacobian * scale, atol=1e-9)
    np.testing.assert_allclose(conditions.values, values.ravel(), atol=1e-9)
    np.testing.assert_allclose(conditions.limits.lower[[0, 2, 3, 4, 6]], [-1.0, 0.0, 0.0, 1.5, 0.5])
    np.testing.assert_allclose(conditions.limits.upper[[0, 1, 2, 3, 4, 6]], [5.0, 100.0, 1.0, 0.5, 3.0, 5.0])
    # lambda_f - d(cost + nu both)/dx_f, nu, -(lambda_0 + d(...)/dx_0), and nothing of times and parameters.
    area = float(ca.Function("area", [everything], [integral])(list(hand.values())))
    expected = [1.0 - (area + 0.3 * 1.5), 0.3, -(-0.8 + 0.3 * -4.0), 0, 0, 0, 0]
    np.testing.assert_allclose(conditions.multipliers, expected, atol=1e-9)
    curved, terms = found.compute_lagrangian_hessian(np.array([0.4, -0.6, 9.0, 9.0, 9.0, 9.0, 9.0]))
    np.testing.assert_allclose(curved, hessian * np.outer(scale, scale), atol=1e-8)
    assert terms >= np.linalg.norm(curved) * (1 - 1e-9)


def test_multipliers_nearest_to_the_solutions_own() -> None:
    """Two unknowns vary; of four conditions one is not at a limit, and one is changed by what is given only."""
    jacobian = np.array([[3.0, 4.0, 7.0], [1.0, 0.0, 0.0], [0.0, 0.0, 2.0], [6.0, 8.0, 0.0]])
    at_lower, at_upper = np.array([True, False, True, False]), np.array([True, False, False, True])
    induced: Any = SimpleNamespace(
        unknowns=SimpleNamespace(free=np.array([True, True, False])),
        conditions=SimpleNamespace(
            active_limits=(at_lower, at_upper), multipliers=np.array([1.0, 5.0, 5.0, 0.5])
        ),
    )
    active, rows, norms, multipliers = estimate_nearest_multipliers(
        np.array([-9.0, -12.0, 4.0]), jacobian, induced
    )
    np.testing.assert_array_equal(active, [0, 3])
    np.testing.assert_allclose(rows, [[0.6, 0.8], [0.6, 0.8]])
    np.testing.assert_allclose(norms, [5.0, 10.0])
    # Both together explain 15; the guesses of 5 each lack 5, which both share.
    np.testing.assert_allclose(multipliers, [7.5, 7.5])


def free_cart() -> go.Problem:
    model, q, *_ = dynamics("cart", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem = go.Problem("cart")
    k = problem.parameter("k", lower=0.0, upper=5.0)
    leg = problem.phase("leg", model)
    leg.time((0.0, 1.0), (1.0, 9.0))
    problem.constrain("length", leg.integral(q) ** 2, upper=50.0)
    problem.minimize(leg.final_time + k)
    return problem


def test_variables_of_the_program_at_a_trajectory() -> None:
    """q = t^3, v = 3 t^2, a = 6 t from 0.5 s to 2.5 s, the integral of q, and k = 3."""
    problem, t = free_cart(), np.linspace(0.5, 2.5, 6)
    fitted = fit_trajectory_polynomials(
        SampledPhase(t, np.array([t**3, 3 * t**2]), (6 * t)[None]), lambda t, x, u: np.array([x[1], u[0]])
    )
    transcription = transcribe_problem(problem, {"leg": fitted.mesh}, "LG")
    x = _sample_trajectory_variables(transcription, problem, {"leg": fitted}, np.array([3.0]))
    (part,) = transcription.parts.values()
    collocation = part.collocation
    points = 0.5 + 2 * collocation.normalised_point_times
    np.testing.assert_allclose(x[collocation.boundary_states], [t**3, 3 * t**2], atol=1e-12)
    np.testing.assert_allclose(x[collocation.point_states], [points**3, 3 * points**2], atol=1e-12)
    np.testing.assert_allclose(x[collocation.point_controls], [6 * points], atol=1e-12)
    np.testing.assert_allclose(x[part.times], [0.5, 2.5])
    np.testing.assert_allclose(x[transcription.parameter_indices], [3.0])
    np.testing.assert_allclose(x[transcription.integral_places], [(2.5**4 - 0.5**4) / 4], rtol=1e-9)
    exact = _mask_adjoint_equation_rows(transcription, {"leg": np.zeros(0, dtype=int)})
    weights = compute_quadrature_weights(transcription)[0]
    assert np.all(exact[collocation.point_states]) and np.all(exact[collocation.boundary_states[:, 1:-1]])
    assert np.sum(exact) == 2 * (points.size + 4)
    for places in (collocation.point_states, collocation.point_controls):
        np.testing.assert_allclose(np.sum(weights[places], axis=1), 1.0)
    assert np.sum(weights == 1.0) == weights.size - 3 * points.size


@pytest.mark.parametrize(("rate", "expected"), [(20.0, [2, 7]), (47.0, [*range(2, 12, 2)]), (7.0, [])])
def test_costates_begin_anew_after_a_growth_of_ten_thousand(rate: float, expected: list[int]) -> None:
    """x' = k x in segments of 0.1 s: k = 20 grows by exp(10) in five, k = 47 by exp(9.4) in two."""
    model, *_ = dynamics("one", "x", "u", lambda x, u: {x: rate * x + u})
    problem, _ = one_phase("unstable", model, 0.0, 1.2)

    class Ramp:
        breaks = np.linspace(0.0, 1.2, 13)

        def __call__(self, t: Any) -> Any:
            return np.array([t])

    fitted: Any = SimpleNamespace(x=Ramp(), u=Ramp())
    nodes = _choose_shooting_nodes(problem, "leg", fitted, np.zeros(0))
    np.testing.assert_array_equal(nodes, expected)


@pytest.mark.parametrize("restarts", [[], [1], [2], [2, 1]])
def test_the_adjoint_equation_determines_the_costates_but_for_one_at_each_restart(
    restarts: list[int],
) -> None:
    """Its matrix is square and regular without the costates at the ends of the phase and of the parts."""
    problem, breaks = free_cart(), {"leg": np.array(restarts, dtype=int)}
    transcription = transcribe_problem(problem, {"leg": go.Mesh((0.0, 0.25, 0.5, 1.0), (3, 4, 3))}, "LG")
    rows, columns = transcription.constraints.jacobian_pattern
    jacobian = np.zeros((transcription.n_constraints, transcription.n_variables))
    jacobian[rows, columns] = transcription.evaluate_nlp_first_derivatives(
        problem, np.ones(transcription.n_variables)
    )[2]
    exact, basis = (
        _mask_adjoint_equation_rows(transcription, breaks),
        _mask_adjoint_multipliers(transcription, breaks),
    )
    assert np.sum(exact) == np.sum(basis) == 2 * (3 + 4 + 3 + 2 - len(restarts))
    assert np.linalg.cond(jacobian[np.ix_(basis, exact)]) < 100
    first = transcription.parts["leg"].collocation.first_row
    ends = np.cumsum([8, 10, 8])[[2, *(k - 1 for k in restarts)]]  # rows of whole segments stand last
    np.testing.assert_array_equal(
        np.flatnonzero(~basis[first : first + 26]), np.sort([ends - 2, ends - 1], axis=None)
    )


@pytest.mark.parametrize("scheme", ["LG", "LGR", "LGL"])
def test_nodes_of_a_segment_in_order_and_once(scheme: Any) -> None:
    mesh = go.Mesh((0.0, 0.25, 1.0), (3, 4))
    transcription = transcribe_problem(free_cart(), {"leg": mesh}, scheme)
    collocation = next(iter(transcription.parts.values())).collocation
    times = np.full(transcription.n_variables, np.nan)
    times[collocation.boundary_states] = mesh.breaks
    times[collocation.point_states] = collocation.normalised_point_times
    for k, degree in enumerate(mesh.degrees):
        nodes = _list_segment_states(collocation, k)
        assert nodes.shape == (2, degree + {"LG": 2, "LGR": 1, "LGL": 0}[scheme])
        assert np.all(np.diff(times[nodes], axis=1) > 0)
        np.testing.assert_allclose(times[nodes[:, [0, -1]]], [mesh.breaks[k : k + 2]] * 2)


def test_states_and_controls_of_each_segment_are_lines_of_their_own() -> None:
    """A control whose push comes to zero at the end of its arc is held by the other nodes of its segment alone."""
    mesh = go.Mesh((0.0, 0.25, 1.0), (3, 4))
    transcription = transcribe_problem(free_cart(), {"leg": mesh}, "LG")
    collocation = next(iter(transcription.parts.values())).collocation
    lines = [
        list(map(int, line))
        for line in _list_nlp_variables_along_segments(SimpleNamespace(transcription=transcription))[0]
    ]
    controls = [list(map(int, collocation.point_controls[0, a:b])) for a, b in ((0, 3), (3, 7))]
    states = [list(map(int, row)) for k in range(2) for row in _list_segment_states(collocation, k)]
    assert sorted(lines) == sorted(states + controls)


def test_arcs_on_a_limit_are_held_throughout() -> None:
    """What is doubtful is held where it is at the value of a pushed node of its own line."""
    lines = [np.array([0, 1, 2, 3]), np.array([4, 5]), np.array([6, 7])]
    values = np.array([1.0, 1.0, -1.0, 0.5, 1.0, 1.0, 2.0, 2.0])
    pushed = np.array([True, False, False, False, False, False, True, False])
    held, doubtful = pushed.copy(), np.array([False, True, True, False, True, True, False, False])
    _extend_active_limits_along_arcs(lines, values, pushed, held, doubtful)
    np.testing.assert_array_equal(held, [True, True, False, False, False, False, True, False])
    np.testing.assert_array_equal(doubtful, [False, False, True, False, True, True, False, False])


def test_metric_of_variations_is_an_integral() -> None:
    """Along the phase weights add up to 1; inner boundaries count by what lies beside them, ends and parameters 1."""
    mesh = go.Mesh((0.0, 0.25, 0.5, 1.0), (3, 4, 2))
    transcription = transcribe_problem(free_cart(), {"leg": mesh}, "LG")
    weights = compute_variation_norm_weights(transcription)
    (part,) = transcription.parts.values()
    collocation = part.collocation
    for places in (collocation.point_states, collocation.point_controls):
        np.testing.assert_allclose(np.sum(weights[places], axis=1), 1.0)
    np.testing.assert_allclose(weights[collocation.boundary_states], [[1.0, 0.25, 0.375, 1.0]] * 2)
    np.testing.assert_allclose(weights[transcription.parameter_indices], 1.0)


def test_what_is_brief_counts_by_its_mean() -> None:
    """Over a hundredth of 2 s: a step of 1 at 0.5 s is a ramp of that width, and what is constant stays so."""
    s = arc(plain(np.zeros((2, 2))))
    step = (s.segments == 1).astype(float)
    means = average_violation_over_time(s.times, np.array([step, 3.0 + 0 * step]))
    expected = np.clip((s.times - 0.5) / 0.02 + 0.5, 0.0, 1.0)
    np.testing.assert_allclose(means[0], expected, atol=1e-9)
    np.testing.assert_allclose(means[1], 3.0)


def test_what_multipliers_push_beside_a_boundary() -> None:
    """Densities 2 before and 3 after it, over half a hundredth of 2 s; of two signs the larger one."""
    s = arc(plain(np.zeros((2, 2))), degree=4)
    before = np.repeat([True, False], 4)
    found = integrate_multipliers_near_boundaries(
        s, np.array([np.where(before, 2.0, 3.0), np.where(before, -5.0, 4.0)])
    )
    np.testing.assert_allclose(found, [[0.03], [-0.05]])
    short = arc(plain(np.zeros((2, 2))), degree=4, breaks=(0.0, 0.004, 2.0))
    np.testing.assert_allclose(
        integrate_multipliers_near_boundaries(short, np.where(before, 5.0, 1.0)[None]), [[0.02]]
    )


def test_steps_of_free_parameters() -> None:
    """A tenth of a range, or the size, or 1."""
    problem = plain(np.zeros((2, 2)))
    for name, limits in (("a", (-1.0, 3.0)), ("b", (0.0, None)), ("c", (None, None)), ("d", (2.0, 2.0))):
        problem.parameter(name, lower=limits[0], upper=limits[1])
    solution = by_hand.solution(problem, parameter_values=np.array([0.5, -7.0, 0.0, 2.0]))
    np.testing.assert_allclose(compute_parameter_scales(solution), [0.4, 7.0, 1.0, 2.0])


def test_a_copy_of_a_solution_has_no_verdict() -> None:
    problem = plain(np.zeros((2, 2)))
    solution = by_hand.solution(problem, arc(problem).phase)
    first = Verdict("first", ())
    assert solution.verdict is None
    with_one = solution.with_verdict(first)
    assert with_one.verdict is first and solution.verdict is None and replace(with_one).verdict is None


@pytest.mark.parametrize(
    ("costates", "weight", "amount", "told"),
    [
        (1e-9, 0.0, 1.0, True),
        (0.0, 0.0, 1.0, False),
        (0.0, 0.0, 3e5, True),
        (0.0, 2.0, 1.0, True),
        (np.nan, 2.0, 1.0, False),
    ],
)
def test_costates_may_vanish_where_nothing_of_the_cost_is_at_the_ends(
    costates: float, weight: float, amount: float, told: bool
) -> None:
    """The cost changes by the final x_0, which moves by 2: nothing beside 3e5, where a ten-thousandth does."""
    problem = plain(np.zeros((2, 2)))
    base = arc(problem)
    leg = by_hand.phase(
        problem,
        lambda t, k: np.array([1 + t, 2 - t**2]),
        lambda t, k: np.array([t]),
        lambda t, k: np.array([costates + 0 * t, 0 * t]),
        breaks=(0.0, 0.5, 2.0),
    )
    ends = get_endpoint_gradients(by_hand.solution(problem, base.phase))
    s = PhaseSamples.from_phase(replace(leg, integral_weights=np.array([weight])), base.functions)
    assert has_costates([s], ends, amount) is told


def test_place_of_a_variation_is_where_a_control_varies_most() -> None:
    """Or the variable that varies most, if that is none; controls of other phases vary less."""
    mesh = go.Mesh((0.0, 0.25, 1.0), (3, 4))
    transcription = transcribe_problem(free_cart(), {"leg": mesh}, "LG")
    solution: Any = SimpleNamespace(
        problem=None,
        phases={
            "leg": SimpleNamespace(
                initial_time=2.0, duration=4.0, controls=SimpleNamespace(labels=("a",)), name="leg"
            )
        },
    )
    point: Any = SimpleNamespace(
        transcription=transcription, variables=SimpleNamespace(labels=transcription.variable_labels)
    )
    collocation = next(iter(transcription.parts.values())).collocation
    direction = np.full(transcription.n_variables, 0.1)
    direction[collocation.point_controls[0, 2]], direction[collocation.point_controls[0, 5]] = 0.5, -0.9
    time = 2.0 + 4.0 * collocation.normalised_point_times[5]
    describe = _describe_largest_variation_component
    assert describe(point, solution, direction) == f"phase leg, t = {time:.6g} s, a"
    direction[transcription.parameter_indices] = -1.0
    label = transcription.variable_labels[transcription.parameter_indices[0]]
    assert describe(point, solution, direction) == label


def test_doubt_says_whether_it_is_flat() -> None:
    for value, flat in ((-5e-4, False), (-5e-5, True), (0.0, True)):
        curvature = Curvature(value, -1.0, np.zeros(1), 0.0)
        text = _explain_inconclusive_curvature(curvature, 1e-4)
        assert ("cannot be distinguished from zero" in text) is flat
    curvature = Curvature(-5e-4, -1e-7, np.zeros(1), 0.0)
    text = _explain_inconclusive_curvature(curvature, 1e-4)
    assert "cannot be distinguished from zero" in text
    up = Curvature(2e-6, 0.5, np.zeros(1), 0.0)
    assert (
        up.is_positive and not replace(up, value=5e-7).is_positive and not replace(up, share=5e-7).is_positive
    )


@pytest.mark.parametrize(("side", "expected"), [(1.0, [0.5, 0.0, 0.5]), (-1.0, [0.0, 1.0, 1.0])])
def test_how_far_a_variation_leads_beyond_active_limits(side: float, expected: list[float]) -> None:
    """x_0 reaches its limit of 3 at 2 s, x_1 is at or below its own from 1 s on, and x_0 - 2 u + t - 1 is at 0.

    They change by 4 - t: 2 of 4 at the end; 3 t; and 4 - 3 t, from 4 to -2.
    """
    problem = plain(np.zeros((2, 2)))
    leg = problem.get_phase()
    x, u = leg.model.symbol("x"), leg.model.symbol("u")
    leg.path("mixed", x[0] - 2 * u + leg.model.time - 1, lower=0.0, upper=9.0)
    s = arc(problem, state_bounds=by_hand.interval([-9.0, 1.0], [3.0, 9.0]), breaks=(0.0, 1.0, 2.0), degree=4)
    assert s.functions.path_constraints(s.times, s.x, s.u) == pytest.approx(0.0, abs=1e-12)
    transcription = transcribe_problem(problem, {"leg": s.phase.mesh}, "LG")
    collocation = next(iter(transcription.parts.values())).collocation
    scales = 2.0 + np.arange(transcription.n_variables)
    direction = np.zeros(transcription.n_variables)

    def states(t: Array) -> Array:
        return np.array([4 - t, 3 * t])

    direction[collocation.boundary_states] = states(np.array([0.0, 1.0, 2.0]))
    points = 2 * collocation.normalised_point_times
    direction[collocation.point_states] = states(points)
    direction[collocation.point_controls] = points
    point: Any = SimpleNamespace(transcription=transcription, scaling=SimpleNamespace(variables=scales))
    cone = CriticalCone(point, np.zeros(0, dtype=bool), np.zeros(0, dtype=bool))
    found = cone._compute_largest_limit_violation(s, side * direction / scales)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    small = cone._compute_largest_limit_violation(s, 1e-3 * side * direction / scales)
    assert np.all(small <= np.array(expected) + 1e-9), "a limit that it hardly moves along is not left"


@pytest.mark.parametrize(("unit", "gap", "beyond"), [(1e3, 1e-7, 1.0), (1e3, 1e-5, 0.0), (1e-3, 1e-5, 0.0)])
def test_a_variation_leaves_limits_that_are_active_within_a_millionth_of_the_range(
    unit: float, gap: float, beyond: float
) -> None:
    """x = t, in other units, below a bound and a path constraint that are x gap above its largest value."""
    model, x, _u = dynamics("climb", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("climb", model, 0.0, 1.0)
    most = unit * (1.0 + gap)
    leg.bounds(x=(-9.0 * unit, most))
    leg.path("ceiling", x, upper=most)
    problem.minimize(leg.integral(x))
    signals = (lambda t, k: unit * np.array([t]), lambda t, k: unit + 0 * t, lambda t, k: 1.0 - t)
    bounds = by_hand.interval(-9.0 * unit, most)
    flown = by_hand.solution(problem, by_hand.phase(problem, *signals, state_bounds=bounds))
    (s,) = samples = list(flown.samples().values())
    cone = build_critical_cone(flown, samples, 0.0)
    collocation, direction = cone.point.transcription.parts["leg"].collocation, np.zeros(cone.point.x.size)
    for places in (collocation.point_states, collocation.boundary_states):
        direction[places] = unit / cone.point.scaling.variables[places]
    np.testing.assert_allclose(
        cone._compute_largest_limit_violation(s, direction), [beyond, beyond], atol=1e-9
    )


def test_a_limit_is_reached_in_shares_of_what_its_row_varies_by() -> None:
    """-1000 q at its limit of -1000 to 5e-4: a multiplier holds the end, though no entry of the row is positive."""
    model, _q, _v, a = dynamics("cart", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("cart", model, 0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(v=0.0)
    problem.constrain("far enough", -1000 * leg.final_state("q"), upper=-1000.0)
    problem.minimize(0.5 * leg.integral(a**2))
    t, way = np.linspace(0.0, 1.0, 5), 1 + 5e-7
    states = {"q": way * (3 * t**2 - 2 * t**3), "v": way * (6 * t - 6 * t**2)}
    verdict = go.verify_trajectory(problem, t, states, {"a": way * (6 - 12 * t)})
    assert verdict.ok, verdict.explain()
