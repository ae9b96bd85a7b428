"""Dense samples of a phase, what they are measured by, and what is found beyond limits: by hand, in closed form."""

from __future__ import annotations

from dataclasses import astuple, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.constructed_solutions import cart, costates, functions, interval, phase, push, rest, samples
from testing.internals import Interval, Worst, free, propagate, state_magnitudes

import gnc_opt as go
from gnc_opt.arrays import Array
from gnc_opt.planning import PhaseSolution
from gnc_opt.planning.solution import quality as limits
from gnc_opt.planning.solution.quality import (
    DISTANCE_MIN_SCALE_SHARE,
    NOTHING,
    WIDTHS,
    Limits,
    Violations,
    _to_nearest_allowed,
    _unit,
    bound_violations,
    measure_quality,
    path_violations,
    violations,
    worst_bound_violation,
    worst_defect,
    worst_index,
    worst_path_violation,
    worst_terminal_error,
)
from gnc_opt.planning.solution.samples import EDGE, EXTRA, EdgeSegment, PhaseSamples, sampling_rule

CART = cart()


@pytest.fixture(scope="module")
def right() -> PhaseSamples:
    return samples(CART)


def stepped(t: Array, k: int) -> Array:
    """Two rows that jump at the boundary between segments."""
    return np.array([t + 10 * k, 5 - t + 0 * k])


# --- where and how densely --------------------------------------------------------------------------------


def test_times_and_weights_of_the_samples(right: PhaseSamples) -> None:
    rule = sampling_rule(4)
    n = 4 + EXTRA
    assert rule.n == n and sampling_rule(60).n == 64
    assert right.times.size == 2 * (n + 2) and right.segments.tolist() == [0] * (n + 2) + [1] * (n + 2)
    assert right.times[[0, n + 1, n + 2, -1]].tolist() == [0.0, 0.5, 0.5, 1.0]
    assert right.times[1 : n + 1] == pytest.approx(0.25 * (1 + rule.points))
    assert right.weights[[0, n + 1, n + 2, -1]].tolist() == [0.0] * 4
    assert right.weights.sum() == pytest.approx(1.0) and right.weights[1] == pytest.approx(
        0.25 * rule.weights[0]
    )
    assert np.flatnonzero(right.at_end).tolist() == [n + 1, 2 * n + 3]
    assert right.span == 1.0
    assert right.weights @ right.times**9 == pytest.approx(0.1, rel=1e-13)


def test_at_a_boundary_each_segment_has_its_own_limit() -> None:
    jumping = samples(CART, stepped, lambda t, k: t - k, lambda t, k: stepped(t, k) * 2)
    for values in (jumping.x, jumping.lam_polynomial / 2):
        assert values[0][jumping.segments == 0].max() <= 0.5 + 1e-12
        assert values[0][jumping.segments == 1].min() >= 10.5 - 1e-12
    assert jumping.u_polynomial[0][jumping.at_end] == pytest.approx([0.5, 0.0])
    assert jumping.u[0][jumping.at_end] == pytest.approx([0.5, 0.0])
    assert jumping.x_rate[:, jumping.at_end] == pytest.approx(np.array([[1.0, 1.0], [-1.0, -1.0]]), abs=1e-12)
    assert jumping.lam_rate[0] == pytest.approx(2.0, abs=1e-12)


def test_flown_controls_are_within_bounds_and_polynomials_need_not_be() -> None:
    over = samples(CART, control_bounds=interval(-5.0, 5.0))
    assert over.u.max() == 5.0 and over.u.min() == -5.0 and over.u_polynomial.max() == pytest.approx(6.0)


def test_edges_have_their_own_costates_and_violations(right: PhaseSamples) -> None:
    here = right.segments == 1
    anew = EdgeSegment(1, np.full((2, int(here.sum())), 7.0), np.array([0.25, 0.5]))
    edged = replace(right, edges=(anew,))
    assert np.all(edged.lam[:, here] == 7.0)
    assert np.array_equal(edged.lam[:, ~here], right.lam_polynomial[:, ~here])
    assert np.array_equal(edged.lam_polynomial, right.lam_polynomial)
    assert edged.adjoint_residual[:, 1].tolist() == [0.25, 0.5]
    assert edged.adjoint_residual[:, 0] == pytest.approx(0.0, abs=1e-12)


# --- derivatives and multipliers along the phase ----------------------------------------------------------


def test_hamiltonian_and_its_derivatives(right: PhaseSamples) -> None:
    """H = a^2 / 2 + lam_q v + lam_v a; with a = -lam_v it is constant: -18 + 12 (-v + ...) = -18."""
    assert right.hamiltonian == pytest.approx(-18.0)
    assert right.control_gradient[0] == pytest.approx(0.0, abs=1e-12)
    assert right.control_hessian == pytest.approx(np.ones((1, 1, right.times.size)))
    with_mu = samples(CART, paths=lambda t, k: [2 + 0 * t, 3 + t])
    assert with_mu.mu == pytest.approx(np.vstack([2 + 0 * with_mu.times, 3 + with_mu.times]))
    assert with_mu.control_gradient[0] == pytest.approx(2.0)
    assert samples(CART, states=lambda t, k: [t, 2 * t]).state_multiplier[1] == pytest.approx(2 * right.times)


def test_adjoint_residual_is_the_integral_of_what_is_missing() -> None:
    """lam_q' = -1/2 where 0 is right, over half a second; v is 3/2 at most, and 12 m of q the largest worth."""
    wrong = samples(CART, lam=lambda t, k: [-12 - 0.5 * t, -6 + 12 * t + 0.25 * t**2])
    worth = wrong.cost_scale
    assert worth == pytest.approx(12.5)
    assert wrong.adjoint_residual == pytest.approx(np.array([[0.25, 0.25], [0.0, 0.0]]) / worth, abs=1e-12)
    pushed = samples(
        CART,
        states=lambda t, k: [0.5 + 0 * t, 0 * t],
        lam=lambda t, k: [-12 - 0.5 * t, -6 + 12 * t + 0.25 * t**2],
    )
    assert pushed.adjoint_residual == pytest.approx(0.0, abs=1e-12)


# --- yardsticks -------------------------------------------------------------------------------------------


def test_sizes_of_states_are_shared_by_the_components_of_a_vector() -> None:
    model = go.Model("two")
    r, s = model.state("r", 2), model.state("s")
    u = model.control("u")
    model.ode({r: [u, 0 * u], s: u})
    problem = go.Problem("two")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    problem.minimize(leg.integral(u**2))
    tiny = phase(problem, lambda t, k: [-4 * t, t, 1e-9 * t], lambda t, k: [0 * t], lambda t, k: [0 * t] * 3)
    assert state_magnitudes(tiny) == pytest.approx([4.0, 4.0, 1.0])


@pytest.mark.parametrize(
    ("bounds", "expected"),
    [
        (interval(-10.0, 20.0), 30.0), (interval(-10.0, np.inf), 6.0), (free(1), 6.0), (interval(0.0, 0.0), 1.0)
    ],
)  # fmt: skip
def test_sizes_of_controls_are_ranges_or_what_they_reach(bounds: Interval, expected: float) -> None:
    found = samples(CART, u=lambda t, k: 0 * t if bounds.fixed[0] else 6 - 12 * t, control_bounds=bounds)
    assert found.control_scale == pytest.approx([expected])


def test_what_states_are_worth(right: PhaseSamples) -> None:
    assert right.state_scale == pytest.approx([1.0, 1.5]) and right.cost_scale == pytest.approx(12.0)
    assert replace(right, cost_magnitude=1e6).cost_scale == pytest.approx(100.0)
    nothing = samples(CART, lam=lambda t, k: [0 * t, 0 * t])
    assert nothing.cost_scale == 1.0 and replace(nothing, cost_magnitude=2.0).cost_scale == pytest.approx(
        2e-4
    )


def test_what_the_hamiltonian_is_made_of(right: PhaseSamples) -> None:
    """|lam_q v| + |lam_v a| + |a^2 / 2| at the ends: 0 + 36 + 18."""
    assert right.hamiltonian_scale == pytest.approx(54.0)
    idle = samples(CART, u=lambda t, k: 0 * t, lam=lambda t, k: [0 * t, 0 * t], breaks=(0.0, 1.0, 4.0))
    # A control without range that does nothing has the span of what would move v by 72 in 4 s as the flight does: half
    # of that, either way, is worth (18/2)^2 / 2. Where nothing moves either, the span is 1.
    assert idle.hamiltonian_scale == pytest.approx(40.5)
    still = samples(
        CART, x=lambda t, k: [0 * t, 0 * t], u=lambda t, k: 0 * t, lam=lambda t, k: [0 * t, 0 * t]
    )
    assert still.hamiltonian_scale == pytest.approx(0.125)
    assert replace(idle, cost_magnitude=8e6).hamiltonian_scale == pytest.approx(1e-4 * 8e6 / 4)
    assert idle.span == 4.0


def test_another_cost_magnitude_keeps_only_what_does_not_depend_on_it(right: PhaseSamples) -> None:
    names = [name for name, kind in vars(PhaseSamples).items() if isinstance(kind, cached_property)]
    names.remove("_bending")  # no numbers, but what they are made of
    for name in ("_bending", *names):  # all known beforehand
        getattr(right, name)
    kept, anew = right.with_cost_magnitude(1e6), replace(right, cost_magnitude=1e6)
    assert kept.x is right.x and kept.cost_magnitude == 1e6
    for name in names:
        np.testing.assert_array_equal(getattr(kept, name), getattr(anew, name), err_msg=name)
    assert kept.cost_scale != right.cost_scale
    assert kept._bending is right._bending


# --- what controls are worth --------------------------------------------------------------------------------


def test_a_control_is_worth_half_its_span_times_the_steepest_slope(right: PhaseSamples) -> None:
    """Half of 12 times 6 of the cost's own slope, or of the costate's; what both together leave is nothing."""
    assert right.control_span == pytest.approx([12.0]) and right.cost_slope[0] == pytest.approx(
        6 - 12 * right.times
    )
    assert right.switching == pytest.approx(np.zeros((1, right.times.size)), abs=1e-12)
    assert right.joint_worth == pytest.approx(36.0) and right.control_worth == pytest.approx([36.0])
    pulled = samples(CART, u=lambda t, k: 0 * t, lam=lambda t, k: [0 * t, 5 + 0 * t])
    assert pulled.control_span == pytest.approx([5.0])  # as far as the costate moves it against H's curvature
    assert pulled.joint_worth == pytest.approx(2.5 * 5.0)
    bent = samples(
        CART, u=lambda t, k: 0 * t, lam=lambda t, k: [0 * t, 0 * t], control_bounds=interval(-4.0, 2.0)
    )
    assert bent.joint_worth == pytest.approx(0.5 * 3.0 * 3.0)  # a^2 / 2 over half the range
    worthless = replace(bent, cost_magnitude=1e6)
    assert worthless.least_worth == pytest.approx(100.0) == worthless.joint_worth
    assert bent.least_worth == 1e-9


def axes(weight: float = 1.0) -> go.Problem:
    """x' = p_0, y' = p_1 + s: a vector and a number, which cost p_0^2 + weight p_1^2 + s."""
    model = go.Model("axes")
    x, y = model.state("x"), model.state("y")
    p, s = model.control("p", 2), model.control("s")
    model.ode({x: p[0], y: p[1] + s})
    problem = go.Problem("axes")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    problem.minimize(leg.integral(p[0] ** 2 + weight * p[1] ** 2 + s))
    return problem


def test_components_share_what_they_are_worth_and_small_ones_have_a_hundredth_of_all() -> None:
    """Half spans of 2, 2 and 1: 4, 4 w and 1 (of slopes or curvatures of 2, 2 w and 1)."""
    box = interval([-2.0, -2.0, -1.0], [2.0, 2.0, 1.0])
    for weight, slope, expected in ((0.25, 1.0, [4.0, 4.0, 1.0]), (0.25, 0.01, [4.0, 4.0, 0.05])):
        problem = axes(weight)
        found = samples(
            problem, lambda t, k: [t, 0 * t], lambda t, k: [0 * t, 0 * t, 0 * t], lambda t, k: [0 * t, 0 * t],
            weights=(1.0,), control_bounds=box,
        )  # fmt: skip
        if slope < 1:  # s is hardly worth anything
            functions_ = found.functions
            scaled = replace(found, functions=replace(functions_, weights=np.array([1.0])))
            assert scaled.joint_worth == pytest.approx(4.0 + 1.0 + 1.0)
            continue
        assert found._single_worths == pytest.approx([4.0, 1.0, 1.0])
        assert found.joint_worth == pytest.approx(6.0)
        assert found.control_worth == pytest.approx(expected)
    tiny = samples(
        axes(), lambda t, k: [t, 0 * t], lambda t, k: [0 * t, 0 * t, 0 * t], lambda t, k: [0 * t, 0 * t],
        weights=(1.0,), control_bounds=interval([-20.0, -20.0, -1.0], [20.0, 20.0, 1.0]),
    )  # fmt: skip
    assert tiny.joint_worth == pytest.approx(801.0) and tiny.control_worth == pytest.approx(
        [400.0, 400.0, 8.01]
    )


def test_where_costates_vanish_controls_are_worth_the_terms_that_cancel() -> None:
    """At q = 3 costates of nothing: q^2 / 2 would make T 3 of lam_q and T^2 3 of lam_v in T = 2 s, for half of 2 m/s^2.

    Not if they are there, however small they are beside that: then they say what a control is worth. Another state
    with its costate and a control that does nothing change nothing; only the middles of segments are looked at.
    """
    model = go.Model("cart")
    q, v, y = model.state("q"), model.state("v"), model.state("y")
    a, idle = model.control("a"), model.control("idle")
    model.ode({q: -v, v: -a, y: 0 * idle})
    problem = go.Problem("rest")
    leg = problem.phase("leg", model)
    leg.time(0.0, 2.0)
    problem.minimize(leg.integral(-0.5 * q**2))

    def at(lam: float) -> PhaseSamples:
        return samples(
            problem, lambda t, k: [3 + (t - 0.25) * (t - 1.25), 0 * t, 1 + 0 * t], lambda t, k: [0 * t, 0 * t],
            lambda t, k: [lam + 0 * t, -lam + 0 * t, 7 + 0 * t], weights=(1.0,), breaks=(0.0, 0.5, 2.0),
            control_bounds=interval([-1.0, -1.0], [1.0, 1.0]),
        )  # fmt: skip

    assert at(0.0)._balanced_slopes == pytest.approx([12.0, 0.0])
    assert at(0.0).joint_worth == pytest.approx(12.0)
    assert at(5e-4)._balanced_slopes == pytest.approx([12.0, 0.0], rel=1e-3)
    assert at(0.01)._balanced_slopes.tolist() == [0.0, 0.0] and at(0.01).joint_worth == pytest.approx(0.01)


def test_costates_of_quick_states_are_no_rounding_beside_a_long_phase() -> None:
    """y' = 50 (a - y) with the cost y + a^2 / 2, for 1000 s: lam = 1 / 50 and a = -1, so that H curves by 1 in a.

    The rate of lam is 1 - 50 lam: its terms cancel, and over 1000 s each would make 1000 of it; but lam answers in
    0.02 s.
    """
    model = go.Model("lag")
    y, a = model.state("y"), model.control("a")
    model.ode({y: 50 * (a - y)})
    problem = go.Problem("rest")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1000.0)
    problem.minimize(leg.integral(y + 0.5 * a**2))
    found = samples(
        problem, lambda t, k: [-1 + 0 * t], lambda t, k: [-1 + 0 * t], lambda t, k: [0.02 + 0 * t],
        weights=(1.0,), breaks=(0.0, 400.0, 1000.0), control_bounds=interval([-2.0], [2.0]),
    )  # fmt: skip
    assert found._balanced_slopes.tolist() == [0.0]
    assert found.joint_worth == pytest.approx(0.5)  # costates move it by 1, at the slope 1 of either term


def test_controls_without_bounds_have_their_own_reach() -> None:
    found = samples(
        axes(), lambda t, k: [t, t], lambda t, k: [0.5 + 0 * t, -4 * t, 6 * t], lambda t, k: [0 * t, 0 * t],
        weights=(1.0,), control_bounds=interval([-np.inf] * 3, [np.inf, np.inf, 9.0]),
    )  # fmt: skip
    assert found.control_scale == pytest.approx([0.5, 4.0, 6.0])


def test_path_constraints_that_hardly_move_are_measured_by_what_could_move_them() -> None:
    """At q = 1/2 and a = 4, their sizes: -2 q and q - a by both; what is far off by rounding, nothing by one."""
    model = go.Model("cart")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a})
    problem = go.Problem("paths")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    for label, value in (("down", -2 * q), ("far", 1e9 + 0 * q), ("none", 0 * q), ("both", q - a)):
        leg.path(label, value, upper=9e9)
    problem.minimize(leg.integral(a**2))
    found = samples(
        problem,
        lambda t, k: [0.5 + 0 * t, 0 * t],
        lambda t, k: 4 + 0 * t,
        lambda t, k: [0 * t, 0 * t],
        weights=(1.0,),
    )
    assert found.state_scale == pytest.approx([0.5, 1.0]) and found.control_scale == pytest.approx([4.0])
    assert found.path_scale == pytest.approx([1e-4 * 1.0, 100.0, 1.0, 1e-4 * 4.5])


def test_a_box_about_the_flight_is_as_wide_as_the_spans(right: PhaseSamples) -> None:
    least, most = right.flown_box
    assert least == pytest.approx([0.0, 0.0]) and most == pytest.approx([1.0, 1.5])
    found = samples(
        axes(), lambda t, k: [0.001 * t, 5 - 2 * t], lambda t, k: [0 * t] * 3, lambda t, k: [0 * t] * 2,
        weights=(1.0,), control_bounds=interval([-2.0] * 3, [2.0] * 3),
    )  # fmt: skip
    span = found.state_scale
    assert span == pytest.approx([0.001, 2.0])
    still = replace(found)
    object.__setattr__(still, "state_scale", np.array([0.5, 2.0]))  # cached
    least, most = still.flown_box
    assert least == pytest.approx([0.001 - 0.5, 3.0]) and most == pytest.approx([0.5, 5.0])


def test_ends_are_measured_by_the_ranges_of_controls() -> None:
    found = samples(CART, control_bounds=interval(-0.1, 0.1))
    assert found.end_scale == pytest.approx([0.5 * 0.2, 0.2])


@pytest.mark.parametrize(
    ("initial", "final", "duration", "told"),
    [
        ((0, 0), (1, 1), (-9, 9), True), ((0, 0), (1, 2), (-9, 9), False), ((-1, 0), (1, 1), (-9, 9), False),
        ((-1, 0), (0, 2), (1, 1), True), ((-1, 0), (1, 2), (0, 1), False),
    ],
)  # fmt: skip
def test_constants_in_the_cost_count_where_the_duration_is_free(
    initial: Any, final: Any, duration: Any, told: bool
) -> None:
    """The integrand a^2 of 9 all along, by half, and nothing else that H consists of."""
    found = samples(
        CART, u=lambda t, k: 3 + 0 * t, lam=lambda t, k: [0 * t, 0 * t], initial_time_bounds=interval(*initial),
        final_time_bounds=interval(*final), duration_bounds=interval(*duration), control_bounds=interval(2.9, 3.1),
    )  # fmt: skip
    assert found.lasts_as_told is told
    assert found.hamiltonian_scale == pytest.approx(0.1 * 3.0 if told else 4.5)


def test_each_integrand_counts_above_its_own_least() -> None:
    """4 u^2 + 2 (x + 3)^2 with u = 1 + t and x = t: from 4 to 16 and from 18 to 32, of which 12 and 14 count."""
    model = go.Model("two costs")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("two costs")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    problem.minimize(4 * leg.integral(u**2) + 2 * leg.integral((x + 3) ** 2))
    at = (problem, lambda t, k: [t], lambda t, k: 1 + t, lambda t, k: 0 * t)
    assert samples(*at, weights=(4.0, 2.0)).hamiltonian_scale == pytest.approx(26.0)
    free_end = samples(*at, weights=(4.0, 2.0), final_time_bounds=interval(0.5, 2.0))
    assert free_end.hamiltonian_scale == pytest.approx(48.0)


# --- where rates jump, and directions of nothing ------------------------------------------------------------


def test_samples_keep_off_the_ends_of_segments_where_rates_jump(right: PhaseSamples) -> None:
    """Friction at rest must not depend on how an end is rounded."""
    model = go.Model("friction")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a - 0.1 * ca.sign(v)})
    problem = go.Problem("friction")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    problem.minimize(leg.integral(a**2))
    rough = samples(problem, weights=(1.0,), breaks=(0.0, 0.25, 1.0))
    inside = np.diff(rough.times_within)
    assert np.all(inside > 0)
    n = rough.leg.mesh.degrees[0] + EXTRA
    ends = rough.times_within[[0, n + 1, n + 2, -1]]
    assert ends == pytest.approx(
        [EDGE * 0.25, 0.25 - EDGE * 0.25, 0.25 + EDGE * 0.75, 1 - EDGE * 0.75], abs=1e-12
    )
    assert rough.times_within[1 : n + 1] == pytest.approx(rough.times[1 : n + 1])
    assert rough.x == pytest.approx(np.array(rest(rough.times_within, 0)), abs=1e-12)
    assert right.times_within is right.times


def test_a_direction_is_idle_where_its_vector_has_no_magnitude() -> None:
    model = go.Model("thrust")
    x, other = model.state("x", 2), model.control("other")
    thrust, magnitude = model.vector_control("T", 2)
    model.ode({x: thrust + other})
    problem = go.Problem("thrust")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.norm_bounds(T=(0.0, 4.0))
    problem.minimize(leg.integral(magnitude))
    box = leg.numbers.controls

    def u(t: Array, k: int) -> Any:
        return [0 * t, 2.0 * k + 3e-6 * (t < 0.25), 1 + 0 * t, 0 * t]

    found = samples(
        problem, lambda t, k: [t, t], u, lambda t, k: [0 * t, 0 * t], weights=(1.0,), breaks=(0.0, 0.25, 0.5, 1.0),
        control_bounds=interval([-1.0, 0.0, -1.0, -1.0], [1.0, 4.0, 1.0, 1.0]),
        composed_controls=tuple(model.composed_controls.values()),
    )  # fmt: skip
    assert box.upper.size == 4
    at_rest = found.segments == 0
    assert found.idle.tolist() == [[False] * at_rest.size] * 2 + [list(at_rest)] * 2


def test_which_paths_depend_on_controls_and_how_large_they_are(right: PhaseSamples) -> None:
    assert right.pure_paths.tolist() == [1]
    # The control goes from 6 to -6, the position from 0 to 1; where the limits are does not matter.
    assert right.path_scale == pytest.approx([12.0, 1.0])
    unlimited = samples(CART, path_bounds=interval([-np.inf, -np.inf], [5.0, np.inf]))
    assert unlimited.path_scale == pytest.approx([12.0, 1.0])
    lower = samples(CART, path_bounds=interval([-7.0, -0.5], [5.0, 0.5]))
    assert lower.path_scale == pytest.approx([12.0, 1.0])
    still = samples(
        CART, lambda t, k: [0 * t, 0 * t], lambda t, k: 0 * t, path_bounds=interval([0, 0], [0, 0])
    )
    # Nothing moves: 1e-4 of what the spans of controls and states could move.
    assert still.path_scale == pytest.approx([2e-4, 1e-4])


@pytest.mark.parametrize(
    ("length", "duration", "final", "has"),
    [
        (1e-10, (0.0, np.inf), (0.0, np.inf), False), (1e-8, (0.0, np.inf), (0.0, np.inf), True),
        (1e-6, (0.0, 10.0), (0.0, np.inf), False), (1e-4, (0.0, 10.0), (0.0, np.inf), True),
        (1e-6, (0.0, np.inf), (0.0, 10.0), False), (1e-6, (0.0, 100.0), (0.0, 0.01), True),
        (1e-10, (1e-12, np.inf), (0.0, np.inf), True), (1e-10, (0.0, np.inf), (1e-12, np.inf), True),
    ],
)  # fmt: skip
def test_a_phase_at_the_lower_end_of_its_duration_has_no_length(
    length: float, duration: Any, final: Any, has: bool
) -> None:
    short = samples(
        CART, breaks=(0.0, length), duration_bounds=interval(*duration), final_time_bounds=interval(*final)
    )
    assert short.has_length is has


def test_places_in_words(right: PhaseSamples) -> None:
    assert right.place(0) == "phase leg, t = 0 s" and right.place(-1, "v") == "phase leg, t = 1 s, v"
    assert right.place_at(1 / 3, "q") == "phase leg, t = 0.333333 s, q"
    assert right.segment_place(1, "q") == "phase leg, segment 2 (0.5 to 1 s), q"


# --- integrals --------------------------------------------------------------------------------------------


def test_integrals_from_the_start_and_per_segment() -> None:
    uneven = samples(CART, breaks=(1.0, 1.5, 4.0))
    assert uneven.integral_from_start(uneven.times**2) == pytest.approx((uneven.times**3 - 1) / 3, abs=1e-12)
    values = np.vstack([uneven.times, -2 + 0 * uneven.times])
    assert uneven.per_segment(values) == pytest.approx(np.array([[0.625, 6.875], [1.0, 5.0]]))


# --- quality ----------------------------------------------------------------------------------------------


def test_worse_and_worst() -> None:
    one, two, lost = Worst(1.0, "a"), Worst(2.0, "b"), Worst(np.nan, "c")
    assert one.or_worse(two) is two and two.or_worse(one) is two and one.or_worse(Worst(1.0, "d")) is one
    assert one.or_worse(lost) is lost and lost.or_worse(two) is lost
    assert worst_index(np.array([[1.0, 5.0, 2.0], [3.0, 4.0, 0.0]])) == (0, 1)
    assert worst_index(np.array([[1.0, 5.0], [np.nan, 4.0]])) == (1, 0)
    assert (NOTHING.value, NOTHING.where) == (0.0, "nowhere")


def test_a_defect_is_an_integral_and_a_jump_counts_for_the_segment_before() -> None:
    drifting = samples(CART, lambda t, k: rest(t, k) + np.array([[0.0], [3.0]]) * t)
    worst = worst_defect(drifting)  # 3 s^-1 missing in v over half a second, v up to 3.375; q' lacks 3 t
    size = drifting.state_scale
    assert worst.value == pytest.approx(max(1.5 / size[1], (1.5 - 0.375) / size[0]))
    assert worst.where == "phase leg, segment 1 (0 to 0.5 s), v" if 1.5 / size[1] > 1.125 else worst.where
    for height, size in ((0.125, 1.125), (-0.125, 0.875)):
        jump = samples(
            CART,
            lambda t, k, h=height: rest(t, k) + np.array([[h * (k > 0)], [0.0]]),
            breaks=(0, 0.25, 0.5, 1),
        )
        found = worst_defect(jump)
        assert found.value == pytest.approx(0.125 / size) and found.where.startswith("phase leg, segment 1")
    assert worst_defect(samples(CART)).value < 1e-14
    assert worst_defect(samples(CART, breaks=(0.0, 1.0))).value < 1e-14


def test_bounds_of_states_and_controls_are_judged_in_shares_of_their_size() -> None:
    """v peaks at 3/2 between the samples, a tenth beyond 1.4, 1/15 of its size; a begins at 6, in a range of 20."""
    over = worst_bound_violation(samples(CART, state_bounds=interval([-9, -9], [9, 1.4])))
    assert over.value == pytest.approx(0.1 / 1.5) and over.where == "phase leg, t = 0.5 s, v"
    under = worst_bound_violation(samples(CART, control_bounds=interval(-5.0, 15.0)))
    assert under.value == pytest.approx(1.0 / 20.0) and under.where == "phase leg, t = 1 s, a"
    both = samples(CART, control_bounds=interval(-5.0, 15.0), state_bounds=interval([-9, -9], [9, 1.4]))
    assert worst_bound_violation(both).where.endswith("v")
    assert worst_bound_violation(samples(CART, state_bounds=interval([0, 0], [1, 1.5]))).value < 1e-12


def test_path_constraints_are_judged_by_the_distance_to_what_they_allow() -> None:
    """q reaches 1 where 0.9 is allowed: 0.1 of its size of 1. v + a begins at 6, 1 beyond 5.

    There the gradient is (1.5, 6) in scaled v and a.
    """
    pure = samples(CART, path_bounds=interval([-np.inf, -50.0], [np.inf, 0.9]))
    found = worst_path_violation(pure)
    assert (
        found.value == pytest.approx(0.1, rel=1e-6)
        and found.where == "phase leg, t = 1 s, pure = 1 (at most 0.9)"
    )
    mixed = samples(CART, path_bounds=interval([-np.inf, -np.inf], [5.0, np.inf]))
    assert worst_path_violation(mixed).value == pytest.approx(1 / np.hypot(1.5, 6.0), rel=1e-6)
    lower = samples(CART, path_bounds=interval([-5.0, -np.inf], [np.inf, np.inf]))
    found = worst_path_violation(lower)
    assert found.value == pytest.approx(1 / np.hypot(1.5, 6.0), rel=1e-6)
    assert found.where.endswith("mixed = -6 (at least -5)")
    assert worst_path_violation(samples(CART)) is NOTHING


def test_a_terminal_miss_is_that_of_the_flown_control() -> None:
    """Cut off at 5 N, the push lacks 1/24 N s on either side: v ends where it should, q short of it."""
    cut = samples(CART, control_bounds=interval(-5.0, 20.0), breaks=(0.0, 0.5, 1.0))
    found = worst_terminal_error(cut)
    run = propagate(cut.leg, cut.functions)
    assert run.states[:, -1] - [1.0, 0.0] == pytest.approx(run.error)
    i = int(np.argmax(np.abs(run.error) / [1.0, 1.5]))
    assert found.value == pytest.approx(abs(run.error[i]) / [1.0, 1.5][i])
    assert f"{'qv'[i]} misses by {abs(run.error[i]):.3g} {['m', 'm/s'][i]}" in found.where
    assert worst_terminal_error(samples(CART)).value < 1e-10


def test_three_figures_of_all_phases() -> None:
    wrong = samples(CART, state_bounds=interval([-9, -9], [9, 1.4]))
    found = measure_quality([samples(CART), wrong, samples(CART)])
    assert found.max_bound_violation == pytest.approx(0.1 / 1.5) and found.bound_location.endswith("v")
    assert found.max_defect < 1e-12 and found.propagation_error < 1e-9
    cut = samples(CART, control_bounds=interval(-5.0, 20.0), breaks=(0.0, 0.5, 1.0))
    found = measure_quality([samples(CART), cut])
    assert (found.propagation_error, found.propagation_location) == astuple(worst_terminal_error(cut))


# --- propagation ------------------------------------------------------------------------------------------


def test_propagation_follows_the_control_from_the_initial_state() -> None:
    off = phase(CART, lambda t, k: rest(t, k) + np.array([[1.0], [0.0]]) * (1 - t) * t)
    run = propagate(off, functions(CART), control="polynomial")
    assert run.times.tolist() == [0.0, 0.5, 1.0]
    assert run.states == pytest.approx(rest(run.times, 0), abs=1e-10) and run.error == pytest.approx(
        0, abs=1e-10
    )
    late = phase(CART, lambda t, k: rest(t, k) + np.array([[0.5], [0.0]]) * t)
    assert propagate(late, functions(CART)).error == pytest.approx([-0.5, 0.0], abs=1e-10)


@pytest.mark.parametrize("control", ["flown", "polynomial"])
def test_only_the_flown_control_respects_its_bounds(control: Any) -> None:
    bounded = phase(CART, control_bounds=interval(-5.0, 5.0))
    run = propagate(bounded, functions(CART), control=control)
    assert (
        run.states[1].max() == pytest.approx(1.5, abs=1e-9)
        if control == "polynomial"
        else 1.4 < run.states[1].max() < 1.5
    )


def test_what_runs_away_is_given_up() -> None:
    model = go.Model("unstable")
    x, still, u = model.state("x"), model.state("still"), model.control("u")
    model.ode({x: 60 * x + u, still: 0 * u})
    problem = go.Problem("unstable")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    problem.minimize(leg.integral(u**2))
    run = propagate(
        phase(problem, lambda t, k: [1 + 0 * t, 0 * t], lambda t, k: 0 * t, lambda t, k: [t, t]),
        functions(problem),
    )
    assert np.isnan(run.states[0, 1:]).all() and run.states[0, 0] == 1.0 and run.error[0] == np.inf
    slow = phase(
        problem,
        lambda t, k: [1 + 0 * t, 0 * t],
        lambda t, k: 0 * t,
        lambda t, k: [t, t],
        breaks=(0.0, 0.15, 0.3),
    )
    assert propagate(slow, functions(problem)).states[0] == pytest.approx(np.exp([0.0, 9.0, 18.0]), rel=1e-8)


# --- limits -----------------------------------------------------------------------------------------------


def identity(t: Array, x: Array, u: Array) -> Array:
    return x


def test_finite_limits_one_side_each() -> None:
    found = Limits.of(identity, interval([-np.inf, 0.0, 1.0], [2.0, np.inf, 3.0]))
    assert found.rows.tolist() == [1, 2, 0, 2] and found.sides.tolist() == [-1, -1, 1, 1]
    assert found.values.tolist() == [0, 1, 2, 3]
    assert Limits.of(identity, free(0)).rows.size == 0
    chosen = found.some(np.array([3, 0, 3]))
    assert (chosen.rows.tolist(), chosen.sides.tolist(), chosen.values.tolist()) == (
        [2, 1, 2],
        [1, -1, 1],
        [3, 0, 3],
    )
    x = np.array([[5.0, 0.0], [-1.0, np.nan], [2.0, 4.0]])
    assert found.excess(np.zeros(2), x, x).tolist() == [[1, np.inf], [-1, -3], [3, -2], [-1, 1]]
    wide = np.tile(x[:, :1], 4)
    assert found.excess_pairwise(np.zeros(4), wide, wide).tolist() == [1, -1, 3, -1]
    assert found.excess_pairwise(np.zeros(4), wide * np.nan, wide).tolist() == [np.inf] * 4


def test_violations_are_peaks_found_between_samples() -> None:
    """q = sin(20 t) / 2 has its peaks at odd multiples of pi / 40; at most 0.4 is allowed, at least -0.45."""
    wavy = samples(CART, lambda t, k: [0.5 * np.sin(20 * t), 0 * t], breaks=(0.0, 0.9), degree=30)
    found = violations(wavy, Limits.of(lambda t, x, u: x[:1], interval(-0.45, 0.4)))
    high = found.limits.sides > 0
    assert np.sort(found.times[high]) == pytest.approx(np.pi / 40 * np.array([1, 5, 9]), abs=1e-6)
    assert np.sort(found.times[~high]) == pytest.approx(np.pi / 40 * np.array([3, 7, 11]), abs=1e-6)
    assert found.excess[high] == pytest.approx(0.1, abs=1e-10) and found.excess[~high] == pytest.approx(
        0.05, abs=1e-10
    )
    assert found.x[0] == pytest.approx(0.5 * np.sin(20 * found.times), abs=1e-9)
    assert found.u[0] == pytest.approx(6 - 12 * found.times)
    assert found.value(int(np.flatnonzero(high)[0])) == "0.5 (at most 0.4)"
    assert found.value(int(np.flatnonzero(~high)[0])) == "-0.5 (at least -0.45)"


def test_only_the_highest_of_each_limit_are_returned() -> None:
    assert limits._highest(np.array([0, 1, 0, 0, 0, 0, 0]), np.array([3.0, 9, 1, 2, 7, 8, 5])).tolist() == [
        5,
        4,
        6,
        0,
        3,
        1,
    ]
    many = samples(CART, lambda t, k: [np.sin(60 * t), 0 * t], degree=40)
    found = violations(many, Limits.of(lambda t, x, u: x[:1], interval(-np.inf, 0.5)))
    assert found.times.size == limits.PEAKS_PER_LIMIT


def test_a_limit_that_is_kept_is_not_violated_and_rounding_is_no_violation() -> None:
    for upper, count in ((1.5, 0), (1.5 - 1e-13, 0), (1.5 - 1e-9, 1), (0.0, 1)):
        found = violations(
            samples(CART, breaks=(0.0, 1.0)), Limits.of(identity, interval([-9, -9], [9, upper]))
        )
        assert found.times.size == count
    assert violations(samples(CART), Limits.of(identity, free(2))).times.size == 0


def test_what_is_no_number_is_infinitely_beyond() -> None:
    def lost(t: Array, x: Array, u: Array) -> Array:
        return np.where(t > 0.7, np.nan, x[:1])

    found = violations(samples(CART), Limits.of(lost, interval(-9.0, 9.0)))
    assert np.isinf(found.excess).any() and np.all(found.times[np.isinf(found.excess)] > 0.7)


# --- distances --------------------------------------------------------------------------------------------


def beyond(excess: float, bounds: Interval, row: int = 0) -> Violations:
    side = 1.0
    chosen = Limits(identity, np.array([row]), np.array([side]), bounds.upper[[row]])
    return Violations(chosen, np.zeros(1), np.array([excess]), np.zeros((2, 1)), np.zeros((1, 1)))


@pytest.mark.parametrize(
    ("width", "share"),
    [(50.0, 0.2), (0.1, 0.2), (1e-2, 0.2), (1e-3, 2.0), (1e-4, 20.0), (2e-5, 100.0), (0.0, 0.2), (1e-6, 0.2)],
)
def test_a_bound_is_judged_by_its_own_width_where_that_is_small(width: float, share: float) -> None:
    """2 beyond, of a size of 10: a fifth; of a width of w sizes, 0.2 in `WIDTHS` w, and never in less than
    `DISTANCE_MIN_SCALE_SHARE`."""
    bounds = interval([0.0, 0.0], [10 * width, 1.0])
    found = bound_violations(beyond(2.0, bounds), bounds, np.array([10.0, 1.0]))
    assert found == pytest.approx([share], rel=1e-9)
    assert share == 0.2 or share == pytest.approx(0.2 / max(WIDTHS * width, DISTANCE_MIN_SCALE_SHARE))


def circle(sense: float, radius: float, at: float = 0.0) -> tuple[go.Problem, Any]:
    """A path constraint on (q - at)^2 + v^2, with the states along the line v = 0."""
    model = go.Model("plane")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a})
    problem = go.Problem("plane")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    square = (q - at) ** 2 + v**2
    leg.path("circle", square, **({"upper": radius**2} if sense > 0 else {"lower": radius**2}))
    problem.minimize(leg.integral(a**2))
    return problem, leg


@pytest.mark.parametrize(
    ("sense", "radius", "where", "depth"), [(1, 0.5, 1.0, 0.5), (-1, 0.5, 0.2, 0.3), (-1, 0.5, -0.1, 0.4)]
)
def test_depth_beyond_a_circle_is_the_distance_to_it(
    sense: float, radius: float, where: float, depth: float
) -> None:
    problem, leg = circle(sense, radius)
    found = samples(problem, lambda t, k: [1.0 + 0 * t, 0 * t], lambda t, k: 0 * t, weights=(1.0,))
    chosen = Limits.of(found.functions.paths, leg.path_interval())
    point = Violations(
        chosen,
        np.array([0.5]),
        np.array([sense * (where**2 - radius**2)]),
        np.array([[where], [0.0]]),
        np.zeros((1, 1)),
    )
    assert path_violations(point, found) == pytest.approx([depth], rel=1e-6)


@pytest.mark.parametrize("limit", [-1.0, 1.0])
def test_what_sits_on_its_limit_keeps_it(limit: float) -> None:
    """limit + max(q - limit, 0)^2 <= limit: below it the value is the limit. From limit + 3/2, of a span of 2."""
    model = go.Model("line")
    q, a = model.state("q"), model.control("a")
    model.ode({q: a})
    problem = go.Problem("line")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.path("above", limit + ca.fmax(q - limit, 0) ** 2, upper=limit)
    problem.minimize(leg.integral(a**2))
    found = samples(
        problem, lambda t, k: [limit + 2 * t], lambda t, k: 0 * t, lambda t, k: 0 * t, weights=(1.0,)
    )
    limits_ = Limits.of(found.functions.paths, leg.path_interval())
    point = Violations(
        limits_, np.array([0.75]), np.array([2.25]), np.array([[limit + 1.5]]), np.zeros((1, 1))
    )
    assert path_violations(point, found) == pytest.approx([0.75], rel=1e-6)


def test_at_the_centre_of_a_circle_the_nearest_sample_shows_the_way_out() -> None:
    problem, leg = circle(-1, 0.5)
    found = samples(problem, lambda t, k: [1.0 + t, 0 * t], lambda t, k: 0 * t, weights=(1.0,))
    centre = Violations(
        Limits.of(found.functions.paths, leg.path_interval()),
        np.array([0.5]), np.array([0.25]), np.zeros((2, 1)), np.zeros((1, 1)),
    )  # fmt: skip
    assert path_violations(centre, found) == pytest.approx([0.5 / 1.0], rel=1e-6)
    lost = Violations(
        centre.limits, centre.times, np.array([np.inf]), np.full((2, 1), np.nan), np.zeros((1, 1))
    )
    assert path_violations(lost, found).tolist() == [np.inf]


def test_the_way_to_the_nearest_sample_that_is_allowed() -> None:
    """From (3, 0) and (3, 4), both within the circle about (3, 0) with a radius of 5, to samples at (3, 6 to 8)."""
    problem, leg = circle(-1, 5.0, at=3.0)
    found = samples(problem, lambda t, k: [3 + 0 * t, 6 + 2 * t], lambda t, k: 0 * t, weights=(1.0,))
    inside = Violations(
        Limits.of(found.functions.paths, leg.path_interval()).some(np.zeros(2, dtype=int)),
        np.array([0.0, 0.5]), np.array([25.0, 9.0]), np.array([[3.0, 3.0], [0.0, 4.0]]), np.zeros((1, 2)),
    )  # fmt: skip
    assert _to_nearest_allowed(inside, found) == pytest.approx(np.array([[0, 0], [1, 1], [0, 0]]), abs=1e-12)
    lost = samples(problem, lambda t, k: [3 + t, 0 * t], lambda t, k: 0 * t, weights=(1.0,))
    assert not _to_nearest_allowed(inside, lost).any()


def test_what_nothing_can_restore_counts_in_shares_of_its_values() -> None:
    """1 + q^2 is 2 to 5 along the flight, and never at most 1/2: 4 too much at a span of 3."""
    problem, _ = circle(1, 0.5)
    leg = problem.get_phase()
    leg.path("never", 1 + leg.model.symbol("q") ** 2, upper=0.5)
    found = samples(problem, lambda t, k: [1 + t, 0 * t], lambda t, k: 0 * t, weights=(1.0,))
    never = Limits(found.functions.paths, np.array([1]), np.array([1.0]), np.array([0.5]))
    point = Violations(never, np.array([1.0]), np.array([4.0]), np.array([[2.0], [0.0]]), np.zeros((1, 1)))
    assert path_violations(point, found) == pytest.approx([4.0 / 3.0])


def test_directions_have_length_one_however_long_they_were() -> None:
    found = _unit(np.array([[3e200, 3e-200, 0.0, np.nan, 0.3], [4e200, -4e-200, 0.0, 1.0, 0.4]]))
    assert found == pytest.approx(np.array([[0.6, 0.6, 0, 0, 0.6], [0.8, -0.8, 0, 0, 0.8]]))


# --- signals of a phase -----------------------------------------------------------------------------------


def test_signals_are_numbers_or_vectors_by_what_is_asked() -> None:
    leg: PhaseSolution = phase(CART, control_bounds=interval(-5.0, 5.0))
    q = leg.state("q")
    assert isinstance(q(0.5), float) and q(0.5) == pytest.approx(0.5)
    assert np.shape(q([0.5])) == (1,) and np.shape(q([0.0, 0.5])) == (2,)
    assert (q.name, q.unit, q.labels) == ("q", "m", ("q",))
    lam = leg.costate("v")
    assert (lam.name, lam.unit) == ("lam_v", "1/(m/s)") and lam(0.25) == pytest.approx(-3.0)
    assert leg.control("a")(0.0) == pytest.approx(6.0) and leg.saturated_control("a")(0.0) <= 5.0
    assert leg.duration == 1.0 and leg.breaks.tolist() == [0.0, 0.5, 1.0]
    assert leg.point_times == pytest.approx(
        np.concatenate([0.25 * (1 + leg.rules[0].points) + k / 2 for k in (0, 1)])
    )
    assert leg.sample_times().size == 21 and leg.sample_times(3).tolist() == pytest.approx(
        np.linspace(0, 1, 7)
    )


def test_the_side_of_a_signal_at_a_jump() -> None:
    leg = phase(CART, stepped, lambda t, k: t + k, stepped)
    for signal in (leg.state("q"), leg.costate("q")):
        assert signal(0.5) == pytest.approx(10.5) and signal(0.5, "left") == pytest.approx(0.5)


def test_a_vector_has_a_row_for_each_component() -> None:
    model = go.Model("plane")
    r, u = model.state("r", 2, unit="m"), model.control("u", 2)
    model.ode({r: u})
    problem = go.Problem("plane")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    problem.minimize(leg.integral(u[0] ** 2 + u[1] ** 2))
    found = phase(
        problem, lambda t, k: [t, 2 * t], lambda t, k: [1 + 0 * t, 2 + 0 * t], lambda t, k: [0 * t, 0 * t]
    )
    assert found.state("r")(0.5) == pytest.approx([0.5, 1.0]) and np.shape(found.state("r")([0.5])) == (2, 1)
    assert found.costate("r").unit == "1/(m)" and found.costate("r").labels == ("r[0]", "r[1]")


def test_multipliers_along_the_phase() -> None:
    leg = phase(CART, paths=lambda t, k: [t, t**2], states=lambda t, k: [t**3, 1 + 0 * t])
    t = np.linspace(0, 1, 5)
    assert leg.path_multiplier(t) == pytest.approx(np.vstack([t, t**2]))
    assert leg.state_multiplier(t) == pytest.approx(np.vstack([t**3, 1 + 0 * t]))
    assert leg.control_multiplier(t).shape == (1, 5)
    assert costates(t, 0).shape == (2, 5) and push(t, 0).shape == (1, 5)
