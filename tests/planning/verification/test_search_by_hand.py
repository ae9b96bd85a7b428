"""The search for the least Hamiltonian: its parts on an H that is known, with limits that are known."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from testing import constructed_solutions as by_hand
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.numerical_tolerances import EQUAL
from gnc_opt.planning.refinement.staged_refinement import guess_by_minimum_hamiltonian
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.verification import hamiltonian_minimum as least_hamiltonian
from gnc_opt.planning.verification.hamiltonian_minimum import (
    TRIALS,
    _MinimumSearch,
    compute_joint_hamiltonian_decreases,
    draw_low_discrepancy_points,
    get_control_search_bounds,
)

Array = NDArray[np.float64]


def coupled(cost: Any, *paths: tuple[Any, float, float], bounds: Any = None) -> go.Problem:
    """x' = u, y' = w at the integral of a cost in (t, x, u, w); paths in the same, between limits."""
    model, x, _y, u, w = dynamics("coupled", "x y", "u w", lambda x, y, u, w: {x: u, y: w})
    problem, leg = one_phase("coupled", model, 0.0, 2.0)
    for k, (path, low, high) in enumerate(paths):
        leg.path(f"c{k}", path(model.time, x, u, w), lower=low, upper=high)
    problem.minimize(leg.integral(cost(model.time, x, u, w)))
    return problem


OFFSET = np.array([2.0, 1.0])
BOX = by_hand.interval([-2.0, -1.0], [2.0, 3.0])


def flown(problem: go.Problem, u: float = 0.5, w: float = 1.0, **changes: Any) -> PhaseSamples:
    """Constant controls; costates (0.3, -0.2)."""
    return by_hand.samples(
        problem,
        lambda t, k: np.array([1 + u * t, w * t]),
        lambda t, k: np.array([u + 0 * t, w + 0 * t]),
        lambda t, k: np.array([0.3 + 0 * t, -0.2 + 0 * t]),
        weights=(1.0,),
        **({"breaks": (0.0, 0.5, 2.0), "control_bounds": BOX} | changes),
    )


def search(s: PhaseSamples, group: Any = (0, 1)) -> _MinimumSearch:
    return _MinimumSearch(s, np.array(group), np.arange(s.times.size), cost_rate=1e-6)


def bowl(t: Any, x: Any, u: Any, w: Any) -> Any:
    return 3 * (u - 1) ** 2 + (w - 2) ** 2 + u * w + t


def hamiltonian(u: Any, w: Any, t: Any) -> Any:
    return bowl(t, 0, u, w) + 0.3 * u - 0.2 * w


def test_limits_of_controls_and_well_beyond_what_occurs() -> None:
    """Twice the largest value, or the scale of one that is unbounded."""
    s = flown(coupled(bowl), u=-7.0, control_bounds=by_hand.interval([-np.inf, -1.0], [np.inf, np.inf]))
    lower, upper = get_control_search_bounds(s)
    np.testing.assert_allclose(lower, [-14.0, -1.0])
    np.testing.assert_allclose(upper, [14.0, 2.0])


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_lattice_is_of_powers_of_the_root(dimensions: int) -> None:
    """x^(d + 1) = x + 1; stretches of it fill the cube evenly."""
    points = draw_low_discrepancy_points(200, dimensions)
    assert points.shape == (dimensions, 200) and np.all((points >= 0) & (points < 1))
    root = max(np.roots([1.0, *np.zeros(dimensions - 1), -1.0, -1.0]).real)
    shares = root ** -(1.0 + np.arange(dimensions))
    np.testing.assert_allclose(points[:, 0], 0.5 * shares % 1.0, rtol=1e-9)
    np.testing.assert_allclose(points[:, 7], 7.5 * shares % 1.0, rtol=1e-9)
    np.testing.assert_allclose(np.mean(points, axis=1), 0.5, atol=0.02)


def test_value_slope_and_curvature_by_shares_of_the_range() -> None:
    """u = -2 + 4 a, w = -1 + 4 b."""
    s = flown(coupled(bowl))
    found, at = search(s), np.array([0, 7, 20])
    shares = np.array([[0.1, 0.5, 0.9], [0.2, 0.3, 0.4]])
    u, w = -2 + 4 * shares[0], -1 + 4 * shares[1]
    np.testing.assert_allclose(
        found.evaluate_hamiltonian(shares, at), hamiltonian(u, w, s.times[at]), rtol=1e-12
    )
    gradient, bends = found.evaluate_hamiltonian_derivatives(shares, at)
    np.testing.assert_allclose(
        gradient, 4 * np.array([6 * (u - 1) + w + 0.3, 2 * (w - 2) + u - 0.2]), rtol=1e-9
    )
    np.testing.assert_allclose(bends, np.tile(16 * np.array([[6.0, 1.0], [1.0, 2.0]]), (3, 1, 1)))
    np.testing.assert_allclose(found._normalised_controls, np.tile([[0.625], [0.5]], s.times.size))


def test_a_group_leaves_the_other_controls_as_flown() -> None:
    s = flown(coupled(bowl))
    found, at = search(s, [1]), np.array([3, 4])
    np.testing.assert_allclose(
        found.evaluate_hamiltonian(np.array([[0.0, 1.0]]), at),
        hamiltonian(0.5, np.array([-1.0, 3.0]), s.times[at]),
    )
    gradient, bends = found.evaluate_hamiltonian_derivatives(np.array([[0.0, 1.0]]), at)
    np.testing.assert_allclose(gradient, 4 * (2 * (np.array([[-1.0, 3.0]]) - 2) + 0.5 - 0.2))
    np.testing.assert_allclose(bends, [[[32.0]], [[32.0]]])


def test_a_control_without_a_range_stays() -> None:
    s = flown(coupled(bowl), control_bounds=by_hand.interval([0.5, -1.0], [0.5, 3.0]))
    found = search(s)
    assert np.all(found._normalised_controls[0] == 0.0)
    value = found.evaluate_hamiltonian(np.array([[0.9], [0.5]]), np.array([2]))
    np.testing.assert_allclose(value, hamiltonian(0.5, 1.0, s.times[[2]]))


MIXED = (lambda t, x, u, w: u + 2 * w, -3.0, 4.0)
"""2.5 as flown."""


@pytest.mark.parametrize(
    ("u", "w", "inside"), [(0.0, 2.0, True), (0.1, 2.0, False), (-1.0, -1.0, True), (-1.1, -1.0, False)]
)
def test_controls_beyond_a_mixed_path_are_not_admissible(u: float, w: float, inside: bool) -> None:
    """-3 <= u + 2 w <= 4; a path of states alone leaves no choice."""
    s = flown(coupled(bowl, MIXED, (lambda t, x, u, w: x, -9.0, 0.0)))
    value = search(s).evaluate_hamiltonian(np.array([[(u + 2) / 4], [(w + 1) / 4]]), np.array([5]))
    assert bool(np.isfinite(value[0])) is inside


def test_a_path_that_is_violated_leaves_room_to_what_is_flown() -> None:
    """u + 2 w = 2.5, 0.5 beyond its limit: to there others may go as well."""
    s = flown(coupled(bowl, (MIXED[0], -9.0, 2.0)))
    least, most = search(s)._path_constraint_limits[:, 0]
    slack = EQUAL * (s.path_scale[0] + 2.5)
    np.testing.assert_allclose(most, 2.5 + slack, rtol=0, atol=1e-13)
    np.testing.assert_allclose(least, -9.0 - slack, rtol=0, atol=1e-13)


def test_the_room_is_as_wide_for_what_is_negative() -> None:
    s = flown(coupled(bowl, (lambda t, x, u, w: -MIXED[0](t, x, u, w), -2.0, 9.0)))
    least, most = search(s)._path_constraint_limits[:, 0]
    slack = EQUAL * (s.path_scale[0] + 2.5)
    np.testing.assert_allclose(least, -2.5 - slack, rtol=0, atol=1e-13)
    np.testing.assert_allclose(most, 9.0 + slack, rtol=0, atol=1e-13)


def test_what_is_beyond_a_path_moves_to_it_the_shortest_way() -> None:
    """In shares (a, b) the path is u + 2 w = -4 + 4 a + 8 b: along (4, 8)."""
    s = flown(coupled(bowl, MIXED))
    found, at = search(s), np.array([1, 2, 3])
    shares = np.array([[0.5, 0.5, 0.5], [0.5, 0.9, 0.05]])
    moved = found._project_onto_path_constraints(shares, at)
    expected = shares.copy()
    over = -4 + 4 * shares[0] + 8 * shares[1]
    for j, beyond in ((1, over[1] - 4.0),):
        expected[:, j] -= np.array([4.0, 8.0]) * beyond / 80.0
    np.testing.assert_allclose(moved, expected, atol=1e-8)
    low = found._project_onto_path_constraints(np.array([[0.0], [0.0]]), np.array([0]))
    np.testing.assert_allclose(low[:, 0], np.array([4.0, 8.0]) / 80.0, atol=1e-8)
    free = search(flown(coupled(bowl)))
    assert free._project_onto_path_constraints(shares, at) is shares


def test_restoring_follows_a_curve_and_keeps_the_bounds() -> None:
    """Into u^2 + w^2 <= 4 from (1.5, 2) along the ray, by Newton's method from outside; w cannot exceed 3."""
    s = flown(coupled(bowl, (lambda t, x, u, w: u**2 + w**2, -1.0, 4.0)), u=0.0, w=0.5)
    shares = search(s)._project_onto_path_constraints(np.array([[3.5 / 4], [3.0 / 4]]), np.array([4]))
    u, w = 4 * shares[0, 0] - 2, 4 * shares[1, 0] - 1
    assert u**2 + w**2 == pytest.approx(4.0, abs=1e-6) and w / u == pytest.approx(4 / 3, abs=1e-6)
    far = flown(coupled(bowl, (lambda t, x, u, w: w + 0.01 * u, 3.5, 99.0)), u=2.0, w=3.0)
    least = search(far)._project_onto_path_constraints(np.array([[0.5], [0.5]]), np.array([4]))
    assert least[1, 0] == 1.0


@pytest.mark.parametrize(
    ("u", "w", "active", "sign"),
    [
        (0.0, 2.0, True, 1.0),  # on the upper limit, against which H pushes
        (-1.0, -1.0, False, -1.0),  # on the lower one, from which it pulls
        (0.5, 1.0, False, 1.0),  # between both
    ],
)
def test_multipliers_of_paths_that_h_pushes_against(u: float, w: float, active: bool, sign: float) -> None:
    """H = -u - 2 w falls along the path: its multiplier by shares is 1, upwards."""
    steep = coupled(lambda t, x, u, w: -u - 2 * w - 0.3 * u + 0.2 * w + 1e-3 * u * w, MIXED)
    s = flown(steep, u, w)
    found, at = search(s), np.array([6])
    shares = np.array([[(u + 2) / 4], [(w + 1) / 4]])
    gradient, _ = found.evaluate_hamiltonian_derivatives(shares, at)
    rows, mu = found._compute_path_multipliers(shares, at, gradient, np.ones((1, 2)))
    if not active:
        assert not np.any(rows) and not np.any(mu)
        return
    np.testing.assert_allclose(rows, [[[4.0, 8.0]]])
    assert mu[0, 0] == pytest.approx(sign, abs=5e-3)
    blocked, held = found._compute_path_multipliers(shares, at, gradient, np.array([[1.0, 0.0]]))
    np.testing.assert_allclose(blocked, [[[4.0, 0.0]]])
    assert held[0, 0] == pytest.approx(-gradient[0, 0] / 4.0)


def test_multipliers_at_the_lower_limit_push_downwards() -> None:
    s = flown(coupled(lambda t, x, u, w: u + 2 * w - 0.3 * u + 0.2 * w + 1e-3 * u * w, MIXED), -1.0, -1.0)
    found, at = search(s), np.array([6])
    shares = np.array([[0.25], [0.0]])
    gradient, _ = found.evaluate_hamiltonian_derivatives(shares, at)
    rows, mu = found._compute_path_multipliers(shares, at, gradient, np.ones((1, 2)))
    np.testing.assert_allclose(rows, [[[4.0, 8.0]]])
    assert mu[0, 0] == pytest.approx(-1.0, abs=5e-3)


def test_inactive_paths_have_no_share_in_the_multipliers_of_active_ones() -> None:
    """H = -0.1 u - w at u = 1, its limit: together with u + w, which is far below 99, its multiplier would be -0.9."""
    slope = coupled(
        lambda t, x, u, w: -0.4 * u - 0.8 * w + 1e-6 * u * w,
        (lambda t, x, u, w: u, -99.0, 1.0),
        (lambda t, x, u, w: u + w, -99.0, 99.0),
    )
    found, at, shares = search(flown(slope, 1.0, 1.0)), np.array([6]), np.array([[0.75], [0.5]])
    gradient, _ = found.evaluate_hamiltonian_derivatives(shares, at)
    rows, mu = found._compute_path_multipliers(shares, at, gradient, np.ones((1, 2)))
    np.testing.assert_allclose(rows, [[[4.0, 0.0], [0.0, 0.0]]])
    np.testing.assert_allclose(mu, [[0.1], [0.0]], atol=1e-5)


def test_step_of_newton_within_one_range() -> None:
    """To the minimum of a bowl; no farther than across the range, in its direction; not out of bounds."""
    s = flown(coupled(bowl))
    found, at = search(s), np.array([2])
    minimum = np.linalg.solve([[6.0, 1.0], [1.0, 2.0]], [6 - 0.3, 4 + 0.2])
    goal = (minimum + OFFSET) / 4
    shares = np.array([[0.6], [0.6]])
    np.testing.assert_allclose(found._compute_newton_step(shares, at)[:, 0], goal - shares[:, 0], rtol=1e-9)
    outside = np.array([[0.0], [0.9]])  # H falls towards larger u: nothing blocks
    assert np.all(np.abs(found._compute_newton_step(outside, at)) <= 1.0 + 1e-12)
    blocked = found._compute_newton_step(np.array([[1.0], [0.2]]), at)[:, 0]
    assert blocked[0] != 0.0  # H grows with u: away from the bound
    steep = flown(coupled(lambda t, x, u, w: -9 * u + w**2 + 1e-3 * u * w))
    held = search(steep)._compute_newton_step(np.array([[1.0], [0.2]]), at)[:, 0]
    assert held[0] == 0.0
    np.testing.assert_allclose(held[1], (0.1 - 1e-3 - (-1 + 0.8)) / 4, rtol=1e-9)
    across = search(steep)._compute_newton_step(np.array([[0.2], [0.2]]), at)[:, 0]
    assert np.max(np.abs(across)) == pytest.approx(1.0) and across[0] > 0


def test_negative_curvature_is_left_downhill() -> None:
    """H = -(u - 0.1)^2 / 2 + ...: from u = 0.5 its step is to larger u, of the same length as if it curved upwards."""
    s = flown(coupled(lambda t, x, u, w: -0.5 * (u - 0.1) ** 2 - 0.3 * u + w**2 + 1e-6 * u * w))
    step = search(s)._compute_newton_step(np.array([[0.625], [0.275]]), np.array([2]))[:, 0]
    assert step[0] == pytest.approx(0.4 / 4, rel=1e-4)


def test_descent_reaches_the_minimum_or_the_limit() -> None:
    s = flown(coupled(bowl))
    found = search(s)
    at = np.array([0, 9])
    shares, value = found.minimise_by_newton(np.array([[0.0, 1.0], [1.0, 0.0]]), at)
    minimum = np.linalg.solve([[6.0, 1.0], [1.0, 2.0]], [6 - 0.3, 4 + 0.2])
    np.testing.assert_allclose(shares, np.tile(((minimum + OFFSET) / 4)[:, None], 2), atol=1e-6)
    np.testing.assert_allclose(value, hamiltonian(*minimum, s.times[at]), rtol=1e-9)
    held = search(flown(coupled(bowl, (MIXED[0], -9.0, 2.6))))
    shares, value = held.minimise_by_newton(np.array([[0.5], [0.5]]), np.array([3]))
    # On u + 2 w = 2.6 the least of H: (6 (u - 1) + w + 0.3) = mu' / 1, (2 (w - 2) + u - 0.2) = mu' / ... / 2.
    system = np.array([[6.0, 1.0, 1.0], [1.0, 2.0, 2.0], [1.0, 2.0, 0.0]])
    u, w, _ = np.linalg.solve(system, [5.7, 4.2, 2.6])
    np.testing.assert_allclose(shares[:, 0], [(u + 2) / 4, (w + 1) / 4], atol=1e-4)
    assert value[0] == pytest.approx(hamiltonian(u, w, s.times[3]), rel=1e-6)


@pytest.mark.parametrize(
    ("cost", "one"),
    [
        (lambda t, x, u, w: (u - w) ** 2 + u**2, True),
        (lambda t, x, u, w: (u + w) ** 2, True),
        (lambda t, x, u, w: u * w, False),
        (lambda t, x, u, w: (u - w) ** 2 - 1e-3 * u**2, False),
        (lambda t, x, u, w: (u - w) ** 2 * (1.2 - t), False),
        (lambda t, x, u, w: (u - w) ** 2 + ca.fmax(u, 1.5), False),
        (lambda t, x, u, w: u**4 + (u - w) ** 2, False),
    ],
)
def test_only_a_convex_quadratic_function_has_one_minimum_for_sure(cost: Any, one: bool) -> None:
    """Convex at all times, and without steps or kinks elsewhere."""
    s = flown(coupled(cost))
    assert search(s).has_unique_minimum is one
    gains, searched = compute_joint_hamiltonian_decreases(s, 0.5 * s.control_span, 1.0, 1e-5)
    assert len(gains) == 1 and searched is not one


def test_gain_and_its_share_of_what_the_move_is_worth() -> None:
    """From (0.5, 1) to (1.5, 1): H falls by its difference; the span of u is worth its slope or curvature."""
    s = flown(coupled(bowl))
    found, at = search(s), np.arange(s.times.size)
    better = found._normalised_controls.copy()
    better[0] += 0.25
    value = found.evaluate_hamiltonian(better, at)
    gain, share = found._compute_decrease(better, value, at)
    before, after = hamiltonian(0.5, 1.0, s.times), hamiltonian(1.5, 1.0, s.times)
    np.testing.assert_allclose(gain, np.maximum(before - after, 0.0), atol=1e-12)
    span = s.control_span[0]
    worth = max(abs(6 * -0.5 + 1 + 0.3) * span, 0.5 * 6 * span**2)
    np.testing.assert_allclose(share, gain / (worth + gain), rtol=1e-9)
    np.testing.assert_allclose(
        found._compute_largest_hamiltonian_change(-7.0 * (better - found._normalised_controls)),
        worth,
        rtol=1e-9,
    )
    none, share = found._compute_decrease(found._normalised_controls, np.full(at.size, np.inf), at)
    assert not np.any(none) and not np.any(share)
    endless, share = found._compute_decrease(
        found._normalised_controls, np.full(at.size, -np.inf), at
    )  # a pole of H is no gain
    assert not np.any(endless) and not np.any(share)


def test_points_are_anywhere_or_off_in_one_channel() -> None:
    """Half of them are near the applied control, and half of both differ in u or in w alone; bounds are among them."""
    s = flown(coupled(bowl))
    found = search(s)
    shares, at = found._sample_trial_controls()[:2]
    n = s.times.size
    assert at.size == (TRIALS // n) * n and np.all(np.bincount(at) == TRIALS // n)
    assert np.min(shares) == 0.0 and np.max(shares) == 1.0
    moved = np.abs(shares - found._normalised_controls[:, at]) > 1e-12
    kind = np.arange(at.size) % 4
    assert np.all(np.sum(moved[:, kind >= 2], axis=0) <= 1)
    assert np.all(np.sum(moved[:, kind < 2], axis=0) == 2)
    counts = np.sum(moved[:, kind >= 2], axis=1)
    np.testing.assert_allclose(counts, np.full(2, at.size / 4), rtol=1e-3)
    # Distances from the applied control are log-uniform from 1e-8 of the range.
    near = np.log10(np.abs(shares - found._normalised_controls[:, at])[:, kind == 1])
    assert np.min(near) == pytest.approx(-8.0, abs=0.1)
    np.testing.assert_allclose(np.quantile(near, [0.25, 0.5], axis=1), [[-6.0] * 2, [-4.0] * 2], atol=0.1)
    # 0.05 of the range beyond each bound is clipped to it.
    for row in shares[:, kind == 0]:
        assert np.mean(row == 0.0) == pytest.approx(0.05 / 1.1, rel=0.05)
        assert np.mean(row == 1.0) == pytest.approx(0.05 / 1.1, rel=0.05)
        inner = row[(row > 0) & (row < 1)]
        assert np.mean(inner) == pytest.approx(0.5, abs=0.01)
    alone = search(s, [1])._sample_trial_controls()[0]
    assert alone.shape == (1, at.size)


def test_a_well_on_a_stretch_of_time_is_found_and_followed() -> None:
    """(u^2 - 1)^2 / 4 + c(t) u: near u = -1 as flown; near +1 it is lower in the second half of the phase only."""

    def cost(t: Any, x: Any, u: Any, w: Any) -> Any:
        return (u**2 - 1) ** 2 + 0.2 * (1 - t) * u - 0.3 * u + 1e-6 * u * w + w**2 + 0.2 * w

    problem = coupled(cost)
    s = flown(problem, -1.0, 0.0, breaks=(0.0, 1.0, 2.0))
    gains, searched = compute_joint_hamiltonian_decreases(s, 0.5 * s.control_span, 1.0, 1e-5)
    assert searched and len(gains) == 1
    (gain,) = gains
    # To first order in the tilt, the better well gains twice the tilt.
    late, early = gain.times > 1.2, gain.times < 0.8
    np.testing.assert_allclose(gain.gain[late], 0.4 * (gain.times[late] - 1), rtol=0.15, atol=0.01)
    assert np.max(gain.gain[early]) < 0.02
    assert gain.gain.shape == gain.share.shape == gain.times.shape
    assert np.all((gain.share >= 0) & (gain.share < 1)) and np.max(gain.share) > 1e-2
    calm, _ = compute_joint_hamiltonian_decreases(
        s, 0.5 * s.control_span, 1.0, 0.99
    )  # nothing beyond the tolerance: what was found is told as it is
    assert np.max(calm[0].gain) == pytest.approx(np.max(gain.gain), rel=0.1)
    assert np.argmax(calm[0].gain) >= np.sum(early)


def test_times_are_no_more_than_four_hundred() -> None:
    s = flown(coupled(bowl), breaks=tuple(np.linspace(0.0, 2.0, 41)))
    assert s.times.size > least_hamiltonian._MAX_TIMES
    (gain,), _ = compute_joint_hamiltonian_decreases(s, 0.5 * s.control_span, 1.0, 1e-5)
    assert gain.times.size == least_hamiltonian._MAX_TIMES
    assert gain.times[0] == 0.0 and gain.times[-1] == 2.0


def test_slopes_that_are_no_numbers_point_nowhere() -> None:
    """The root of u has an endless slope at its end, and none beyond it, where its values are no limit either."""
    root = coupled(
        lambda t, x, u, w: ca.sqrt(u + 2) + u * w + w**2, (lambda t, x, u, w: ca.sqrt(w) + u, -9.0, 0.0)
    )
    s = flown(root, -0.5, 0.25)
    found, at = search(s), np.array([3])
    gradient, bends = found.evaluate_hamiltonian_derivatives(np.array([[0.0], [0.5]]), at)
    assert gradient[0, 0] == 0.0 and np.isfinite(gradient[1, 0]) and bends[0, 0, 0] == 0.0
    assert found.evaluate_hamiltonian(np.array([[0.5], [0.1]]), at) == [np.inf]
    shares = np.array([[0.5, 0.9], [0.1, 0.5]])  # w = -0.6 and 1: the second one is beyond the path
    moved = found._project_onto_path_constraints(shares, np.array([3, 4]))
    np.testing.assert_array_equal(moved[:, 0], shares[:, 0])
    assert np.all(np.isfinite(moved)) and moved[0, 1] < 0.9


def test_a_bound_blocks_only_what_pushes_against_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """At u = -2 without a slope in u, the coupling to w still moves both."""
    curved = 16 * np.array([[2.0, 1.0], [1.0, 2.0]])
    slope = np.array([0.0, -8.0])
    monkeypatch.setattr(
        _MinimumSearch,
        "evaluate_hamiltonian_derivatives",
        lambda self, shares, at, mu=None: (slope[:, None], curved[None]),
    )
    found, at = search(flown(coupled(bowl))), np.array([2])
    step = found._compute_newton_step(np.array([[0.0], [0.25]]), at)[:, 0]
    np.testing.assert_allclose(step, -np.linalg.solve(curved, slope), rtol=1e-9)
    slope[0] = 1e-3
    np.testing.assert_allclose(
        found._compute_newton_step(np.array([[0.0], [0.25]]), at)[:, 0], [0.0, 0.25], rtol=1e-9
    )
    slope[0] = -1e-3
    np.testing.assert_allclose(
        found._compute_newton_step(np.array([[1.0], [0.25]]), at)[:, 0], [0.0, 0.25], rtol=1e-9
    )
    slope[0] = 1e-3
    away = found._compute_newton_step(np.array([[1.0], [0.25]]), at)[:, 0]
    np.testing.assert_allclose(away, -np.linalg.solve(curved, slope), rtol=1e-9)


def test_controls_without_bounds_are_searched_beyond_their_values() -> None:
    """Within the bounds; half a turn of 360 to both sides; twice the largest value; twice the scale."""
    s: Any = SimpleNamespace(
        phase=SimpleNamespace(control_bounds=by_hand.interval([-1.0, *[-np.inf] * 3], [2.0, *[np.inf] * 3])),
        angular_control_periods=np.array([0.0, 360.0, 0.0, 0.0]),
        u=np.array([[0.5, 1.0], [10.0, 30.0], [-4.0, 3.0], [0.1, 0.2]]),
        control_scale=np.array([1.0, 1.0, 1.0, 7.0]),
    )
    lower, upper = get_control_search_bounds(s)
    np.testing.assert_array_equal(lower, [-1.0, -170.0, -8.0, -14.0])
    np.testing.assert_array_equal(upper, [2.0, 210.0, 8.0, 14.0])


def test_guess_has_the_controls_of_least_hamiltonian() -> None:
    """H = (u^2 - 1)^2 + 0.1 u + (w - 1)^2 - 0.2 w + s(t) v, from the local minimum near u = 1: u is a root of
    4 u^3 - 4 u + 0.1, w = 1.1, v on the bound that the sign of s selects, r with no slope as before."""
    model, *_, u, w, _v, _r = dynamics(
        "two wells", "x y z q", "u w v r", lambda x, y, z, q, u, w, v, r: {x: u, y: w, z: v, q: r}
    )
    problem, leg = one_phase("two wells", model, 0.0, 2.0)
    problem.minimize(leg.integral((u**2 - 1) ** 2 + (w - 1) ** 2))
    own = by_hand.phase(
        problem,
        lambda t, k: np.array([t, t, 0 * t, 0 * t]),
        lambda t, k: np.array([1 + 0 * t, 1 + 0 * t, 0.5 + 0 * t, 0.25 + 0 * t]),
        lambda t, k: np.array([0.1 + 0 * t, -0.2 + 0 * t, t - 1.25, 0 * t]),
        breaks=np.linspace(0.0, 2.0, 9),
        control_bounds=by_hand.interval([-2.0, -2.0, -3.0, -1.0], [2.0, 2.0, 4.0, 1.0]),
    )
    found, t = guess_by_minimum_hamiltonian(by_hand.solution(problem, own)).phases[own.name], own.point_times
    clear = np.abs(t - 1.25) > 0.03
    np.testing.assert_allclose(found.u(t)[0], np.min(np.roots([4.0, 0.0, -4.0, 0.1]).real), rtol=1e-7)
    np.testing.assert_allclose(found.u(t)[1], 1.1, rtol=1e-7)
    np.testing.assert_allclose(found.u(t)[2, clear], np.where(t > 1.25, -3.0, 4.0)[clear])
    np.testing.assert_allclose(found.u(t)[3], 0.25)
