"""Dense samples of a phase, what they are measured by, and what is found beyond limits: by hand, in closed form."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.constructed_solutions import cart, costates, functions, interval, phase, push, rest, samples
from testing.internals import integrate_dynamics, unbounded_interval
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.array_types import Array
from gnc_opt.numerical_tolerances import GONE
from gnc_opt.planning import PhaseSolution
from gnc_opt.planning.solution import defects_and_violations as limits
from gnc_opt.planning.solution.defects_and_violations import (
    Limits,
    find_limit_violations,
    find_worst_defect,
)
from gnc_opt.planning.solution.phase_trajectory_samples import (
    SAMPLES_BEYOND_POINTS,
    PhaseSamples,
    choose_segment_sample_points,
)

CART = cart()


@pytest.fixture(scope="module")
def right() -> PhaseSamples:
    return samples(CART)


def stepped(t: Array, k: int) -> Array:
    """Two rows that jump at the boundary between segments."""
    return np.array([t + 10 * k, 5 - t + 0 * k])


def test_times_and_weights_of_the_samples(right: PhaseSamples) -> None:
    places, weights = choose_segment_sample_points(4)
    n = 4 + SAMPLES_BEYOND_POINTS
    assert places.size == n + 2 and choose_segment_sample_points(60)[0].size == 64 + 2
    assert right.times.size == 2 * (n + 2) and right.segments.tolist() == [0] * (n + 2) + [1] * (n + 2)
    assert right.times[[0, n + 1, n + 2, -1]].tolist() == [0.0, 0.5, 0.5, 1.0]
    assert right.times[1 : n + 1] == pytest.approx(0.25 * (1 + places[1:-1]))
    assert right.weights[[0, n + 1, n + 2, -1]].tolist() == [0.0] * 4
    assert right.weights.sum() == pytest.approx(1.0) and right.weights[1] == pytest.approx(0.25 * weights[1])
    assert right.segment_starts.tolist() == [0, n + 2]
    assert right.span == 1.0
    assert right.weights @ right.times**9 == pytest.approx(0.1, rel=1e-13)


def test_hamiltonian_and_its_derivatives(right: PhaseSamples) -> None:
    """H = a^2 / 2 + lam_q v + lam_v a; with a = -lam_v it is constant: -18 + 12 (-v + ...) = -18."""
    assert right.hamiltonian == pytest.approx(-18.0)
    assert right.control_gradient[0] == pytest.approx(0.0, abs=1e-12)
    assert right.control_hessian == pytest.approx(np.ones((1, 1, right.times.size)))
    with_mu = samples(CART, paths=lambda t, k: [2 + 0 * t, 3 + t])
    assert with_mu.mu == pytest.approx(np.vstack([2 + 0 * with_mu.times, 3 + with_mu.times]))
    assert with_mu.control_gradient[0] == pytest.approx(2.0)
    assert samples(CART, states=lambda t, k: [t, 2 * t]).state_multiplier[1] == pytest.approx(2 * right.times)


def test_samples_keep_off_the_ends_of_segments_where_rates_jump(right: PhaseSamples) -> None:
    """Friction at rest must not depend on how an end is rounded."""
    model, _q, _v, a = dynamics("friction", "q v", "a", lambda q, v, a: {q: v, v: a - 0.1 * ca.sign(v)})
    problem, leg = one_phase("friction", model, 0.0, 1.0)
    problem.minimize(leg.integral(a**2))
    rough = samples(problem, weights=(1.0,), breaks=(0.0, 0.25, 1.0))
    inside = np.diff(rough.times_inside_segments)
    assert np.all(inside > 0)
    n = rough.phase.mesh.degrees[0] + SAMPLES_BEYOND_POINTS
    ends = rough.times_inside_segments[[0, n + 1, n + 2, -1]]
    assert ends == pytest.approx(
        [GONE * 0.25, 0.25 - GONE * 0.25, 0.25 + GONE * 0.75, 1 - GONE * 0.75], abs=1e-12
    )
    assert rough.times_inside_segments[1 : n + 1] == pytest.approx(rough.times[1 : n + 1])
    assert rough.x == pytest.approx(np.array(rest(rough.times_inside_segments, 0)), abs=1e-12)
    assert right.times_inside_segments is right.times


def test_integrals_per_segment() -> None:
    uneven = samples(CART, breaks=(1.0, 1.5, 4.0))
    values = np.vstack([uneven.times, -2 + 0 * uneven.times])
    integrals = np.array([[0.625, 6.875], [1.0, 5.0]])
    assert uneven.integrate_over_segments(np.abs(values)) == pytest.approx(integrals)


def test_a_defect_is_an_integral_and_a_jump_counts_for_the_segment_before() -> None:
    drifting = samples(CART, lambda t, k: rest(t, k) + np.array([[0.0], [3.0]]) * t)
    worst = find_worst_defect(drifting)  # 3 s^-1 missing in v over half a second, v up to 3.375; q' lacks 3 t
    size = drifting.state_scale
    assert worst.value == pytest.approx(max(1.5 / size[1], (1.5 - 0.375) / size[0]))
    assert worst.where == "phase leg, segment 1 (0 to 0.5 s), v" if 1.5 / size[1] > 1.125 else worst.where
    for height, size in ((0.125, 1.125), (-0.125, 0.875)):
        jump = samples(
            CART,
            lambda t, k, h=height: rest(t, k) + np.array([[h * (k > 0)], [0.0]]),
            breaks=(0, 0.25, 0.5, 1),
        )
        found = find_worst_defect(jump)
        assert found.value == pytest.approx(0.125 / size) and found.where.startswith("phase leg, segment 1")
    assert find_worst_defect(samples(CART)).value < 1e-14
    assert find_worst_defect(samples(CART, breaks=(0.0, 1.0))).value < 1e-14


def test_a_terminal_miss_is_that_of_the_flown_control() -> None:
    """Cut off at 5 N, the push lacks 1/24 N s on either side: v ends where it should, q short of it."""
    cut = samples(CART, control_bounds=interval(-5.0, 20.0), breaks=(0.0, 0.5, 1.0))
    run = integrate_dynamics(cut.phase, cut.functions)
    assert run.states[:, -1] - [1.0, 0.0] == pytest.approx(run.error)
    whole = samples(CART)
    assert np.max(np.abs(integrate_dynamics(whole.phase, whole.functions).error) / whole.state_scale) < 1e-10


def test_propagation_follows_the_control_from_the_initial_state() -> None:
    off = phase(CART, lambda t, k: rest(t, k) + np.array([[1.0], [0.0]]) * (1 - t) * t)
    run = integrate_dynamics(off, functions(CART))
    assert run.times.tolist() == [0.0, 0.5, 1.0]
    assert run.states == pytest.approx(rest(run.times, 0), abs=1e-10) and run.error == pytest.approx(
        0, abs=1e-10
    )
    late = phase(CART, lambda t, k: rest(t, k) + np.array([[0.5], [0.0]]) * t)
    assert integrate_dynamics(late, functions(CART)).error == pytest.approx([-0.5, 0.0], abs=1e-10)


def test_the_flown_control_respects_its_bounds() -> None:
    bounded = phase(CART, control_bounds=interval(-5.0, 5.0))
    assert 1.4 < integrate_dynamics(bounded, functions(CART)).states[1].max() < 1.5


def test_what_runs_away_is_given_up() -> None:
    model = go.Model("unstable")
    x, still, u = model.state("x"), model.state("still"), model.control("u")
    model.ode({x: 60 * x + u, still: 0 * u})
    problem, leg = one_phase("unstable", model, 0.0, 1.0)
    problem.minimize(leg.integral(u**2))
    run = integrate_dynamics(
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
    assert integrate_dynamics(slow, functions(problem)).states[0] == pytest.approx(
        np.exp([0.0, 9.0, 18.0]), rel=1e-8
    )


def identity(t: Array, x: Array, u: Array) -> Array:
    return x


def test_finite_limits_one_side_each() -> None:
    found = Limits.from_interval(identity, interval([-np.inf, 0.0, 1.0], [2.0, np.inf, 3.0]))
    assert found.rows.tolist() == [1, 2, 0, 2] and found.sides.tolist() == [-1, -1, 1, 1]
    assert found.values.tolist() == [0, 1, 2, 3]
    assert Limits.from_interval(identity, unbounded_interval(0)).rows.size == 0
    chosen = found.select_limits(np.array([3, 0, 3]))
    assert (chosen.rows.tolist(), chosen.sides.tolist(), chosen.values.tolist()) == (
        [2, 1, 2],
        [1, -1, 1],
        [3, 0, 3],
    )
    x = np.array([[5.0, 0.0], [-1.0, np.nan], [2.0, 4.0]])
    assert found.compute_limit_excess(np.zeros(2), x, x).tolist() == [[1, np.inf], [-1, -3], [3, -2], [-1, 1]]


def test_violations_are_peaks_found_between_samples() -> None:
    """q = sin(20 t) / 2 has its peaks at odd multiples of pi / 40; at most 0.4 is allowed, at least -0.45."""
    wavy = samples(CART, lambda t, k: [0.5 * np.sin(20 * t), 0 * t], breaks=(0.0, 0.9), degree=30)
    found = find_limit_violations(wavy, Limits.from_interval(lambda t, x, u: x[:1], interval(-0.45, 0.4)))
    high = found.limits.sides > 0
    assert np.sort(found.times[high]) == pytest.approx(np.pi / 40 * np.array([1, 5, 9]), abs=1e-6)
    assert np.sort(found.times[~high]) == pytest.approx(np.pi / 40 * np.array([3, 7, 11]), abs=1e-6)
    assert found.excess[high] == pytest.approx(0.1, abs=1e-10) and found.excess[~high] == pytest.approx(
        0.05, abs=1e-10
    )
    assert found.x[0] == pytest.approx(0.5 * np.sin(20 * found.times), abs=1e-9)
    assert found.u[0] == pytest.approx(6 - 12 * found.times)
    assert found.describe_violation(int(np.flatnonzero(high)[0])) == "0.5 (at most 0.4)"
    assert found.describe_violation(int(np.flatnonzero(~high)[0])) == "-0.5 (at least -0.45)"


def test_only_the_highest_of_each_limit_are_returned() -> None:
    assert limits._select_largest_violation_peaks(
        np.array([0, 1, 0, 0, 0, 0, 0]), np.array([3.0, 9, 1, 2, 7, 8, 5])
    ).tolist() == [5, 4, 6, 0, 3, 1]
    many = samples(CART, lambda t, k: [np.sin(60 * t), 0 * t], degree=40)
    found = find_limit_violations(many, Limits.from_interval(lambda t, x, u: x[:1], interval(-np.inf, 0.5)))
    assert found.times.size == limits.PEAKS_PER_LIMIT


def test_a_limit_that_is_kept_is_not_violated_and_rounding_is_no_violation() -> None:
    for upper, count in ((1.5, 0), (1.5 - 1e-13, 0), (1.5 - 1e-9, 1), (0.0, 1)):
        found = find_limit_violations(
            samples(CART, breaks=(0.0, 1.0)), Limits.from_interval(identity, interval([-9, -9], [9, upper]))
        )
        assert found.times.size == count
    unlimited = Limits.from_interval(identity, unbounded_interval(2))
    assert find_limit_violations(samples(CART), unlimited).times.size == 0


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
        np.concatenate([0.25 * (1 + leg.collocation_rules[0].points) + k / 2 for k in (0, 1)])
    )
    assert leg.sample_times().size == 21 and leg.sample_times(3).tolist() == pytest.approx(
        np.linspace(0, 1, 7)
    )
    with pytest.raises(ValueError, match="integer >= 1"):
        leg.sample_times(0)


def test_the_side_of_a_signal_at_a_jump() -> None:
    leg = phase(CART, stepped, lambda t, k: t + k, stepped)
    for signal in (leg.state("q"), leg.costate("q")):
        assert signal(0.5) == pytest.approx(10.5) and signal(0.5, "left") == pytest.approx(0.5)


def test_a_vector_has_a_row_for_each_component() -> None:
    model = go.Model("plane")
    r, u = model.state("r", 2, unit="m"), model.control("u", 2)
    model.ode({r: u})
    problem, leg = one_phase("plane", model, 0.0, 1.0)
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
