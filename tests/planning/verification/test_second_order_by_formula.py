"""Terms of the second-order conditions and of their searches on values chosen by hand."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.constructed_solutions import fake, interval

import gnc_opt as go
from gnc_opt.array_types import Array
from gnc_opt.planning.verification import active_limits_and_touch_points as limit_terms
from gnc_opt.planning.verification import bang_bang_second_order_conditions as bang_bang
from gnc_opt.planning.verification import critical_cone, reduced_hessian, singular_arcs
from gnc_opt.planning.verification import goh_transformation as goh
from gnc_opt.planning.verification import sufficient_conditions as sufficient
from gnc_opt.planning.verification import switching_time_optimality as switching
from gnc_opt.planning.verification import switching_time_variations as variations
from gnc_opt.planning.verification.hamiltonian_minimum import _MinimumSearch
from gnc_opt.planning.verification.switching_time_variations import Jump

INCONCLUSIVE = go.ConditionResult.INCONCLUSIVE


def test_the_largest_second_order_decrease_of_directions() -> None:
    """L = -0.04 a^2 - 0.02 b^2 - 5 c^4 - 7 d^2; d moves the ends to first order, c decreases to fourth order."""

    def integrate(amounts: Array) -> tuple[Array, Array]:
        a, b, c, d, *e = amounts
        return -0.04 * a**2 - 0.02 * b**2 - 5 * c**4 - 7 * d**2 - sum(0.01 * v**2 for v in e), (a**2 + d)[
            None
        ]

    def decrease(directions: Any, terms: float = 0.0, steps: Any = (1.0, 1.0, 1.0, 1.0)) -> Any:
        own = fake(
            jumps=[Jump("leg", 1.0, 0, -1.0, 1.0, 0.5), Jump("leg", 2.0, 1, -1.0, 1.0, 2.0)],
            integrate_lagrangian_changes=integrate,
            scales=fake(cost=4.0),
            solution=fake(
                objective=0.0, problem=None, phases={"leg": fake(controls=fake(labels=("u", "v")))}
            ),
        )
        columns = np.array([*directions, *(-np.array(d) for d in directions)], dtype=float).T
        return variations.ShiftedTrajectory._compute_second_order_cost_decrease(
            own, columns, np.full(columns.shape[1], terms), np.array(steps)
        )

    every = [[2, 0, 0, 0], [1, -2, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    found, _ = decrease(every)
    assert (found.value, found.where) == (pytest.approx(0.01), "switch of phase leg, u at t = 1 s by +0.01 s")
    found, _ = decrease(every[1:])
    assert found.value == pytest.approx(0.03 / 4)
    assert found.where == "switch of phase leg, v at t = 2 s by -0.04 s, phase leg, u at t = 1 s by +0.005 s"
    assert decrease(every[2:]) is None
    found, _ = decrease([[1e-4, 0, 0, 0, 1]], steps=np.ones(5))
    assert found.where == "free initial states, times and parameters, no switch"
    assert decrease(every[:1], 4 * 399.0)[1] and not decrease(every[:1], 4 * 401.0)[1]
    assert decrease(every[:1], 4 * 39900.0) is not None and decrease(every[:1], 4 * 40100.0) is None
    assert decrease(every[:1], steps=(0.5, 1.0, 1.0, 1.0))[0].value == pytest.approx(0.01 / 4)


def test_steps_around_a_shifted_jump(monkeypatch: pytest.MonkeyPatch) -> None:
    """u = t with a jump at 1 from 5 to -5, shifted to 0.95 and 1.05; cells of 0.5 s; times end at 2."""
    monkeypatch.setattr(variations, "subdivide_mesh_segments", lambda breaks: np.linspace(0.0, 2.0, 21))
    monkeypatch.setattr(variations, "find_costate_jumps", lambda s: {1.5: None})
    leg = fake(breaks=np.array([0.0, 1.0, 2.0]), applied=lambda t: t[None].copy())
    jump = Jump("leg", 1.0, 0, 5.0, -5.0, 0.06 / 0.02)
    shifts = np.array([0.95, 1.05, 1.0])
    times = np.array([[0.0, 0.0, 0.0], [2.0, 1.95, 2.0]])
    ramp = np.array([0.0, 2.0]), np.array([[0.0, 4.0]]), np.array([0.0, 1.0, 0.0])
    phase = variations._ShiftedPhase(fake(), fake(phase=leg), fake(), [(jump, shifts)], [ramp], times)
    whole = np.delete(np.linspace(0.0, 2.0, 21), 10)
    np.testing.assert_allclose(phase.mesh_cell_edges, np.sort([*whole, 0.94, 1.06, 1.95]))
    ends = phase.step_times
    np.testing.assert_allclose(ends[-1], times[1])
    np.testing.assert_allclose(ends[11:15], [[0.94] * 3, [0.95, 1.0, 1.0], [1.0, 1.05, 1.0], [1.06] * 3])
    assert np.count_nonzero(np.all(ends == 1.5, axis=1)) == 2
    np.testing.assert_array_equal(phase.steps_equal_in_all_columns[10:15], [True, False, False, False, True])
    before = phase.evaluate_shifted_controls(10)
    first = phase.evaluate_shifted_controls(11)
    second = phase.evaluate_shifted_controls(12)
    np.testing.assert_allclose(
        np.squeeze(before), [[0.9, 2.7, 0.9], [0.92, 2.76, 0.92], [0.94, 2.82, 0.94]], rtol=1e-8
    )
    np.testing.assert_allclose(first[1], [[0.945, 0.97 * 3, 0.97]], rtol=1e-8)
    np.testing.assert_allclose(second[1], [[-5.0, 5 + 1.025 * 2, 1.0]], rtol=1e-8)
    after = phase.evaluate_shifted_controls(14)
    np.testing.assert_allclose(after[2], [[1.1, 3.3, 1.1]], rtol=1e-8)


def test_negative_curvature_beyond_the_steep_limit_is_found() -> None:
    find = reduced_hessian._find_negative_curvature_direction
    for least, found in ((-1.1e4, True), (-0.9e4, False)):
        hessian = scipy.sparse.diags_array([3.0, least, 2e4, 1.0])
        direction = find(fake(invert_projected_hessian=lambda: lambda v: v), hessian)
        assert (direction is not None) is found
    assert find(fake(invert_projected_hessian=lambda: lambda v: 0 * v), hessian) is None
    direction = find(fake(invert_projected_hessian=lambda: lambda v: v), -hessian)
    np.testing.assert_allclose(np.abs(direction), [0.0, 0.0, 1.0, 0.0], atol=1e-9)


def test_segments_of_a_finer_mesh_and_junction_times(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks 1, 2, 3 are movable; only beside segment 2 is an arc, and a bang-bang switch is at 2."""
    coarse, fine = fake(breaks=(0.0, 0.5, 1.0)), fake(breaks=(0.0, 0.2, 0.5, 0.9, 1.0), movable=(1, 2, 3))
    np.testing.assert_array_equal(goh._map_refined_to_coarse_segments(coarse, fine), [0, 0, 1, 1])
    s = fake(phase=fake(mesh=fine, breaks=np.array([0.0, 1.0, 2.0, 3.0, 4.0])))
    part = fake(times=np.array([10, 11, 12, 13, 14]), collocation=fake(mesh=fine))
    monkeypatch.setattr(goh, "find_bound_to_bound_switches", lambda s: (np.array([2.0]), np.array([0])))
    for singular, expected in (
        ([0, 0, 1, 0], [13]),
        ([0, 1, 0, 0], [11]),
        ([0, 0, 0, 1], [13]),
        ([1, 0, 0, 0], [11]),
    ):
        found = goh._list_junction_time_variables(s, part, np.array([singular, [0, 0, 0, 0]], dtype=bool))
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("ends_singular", [True, False])
def test_goh_variables_of_a_phase_replace_its_singular_control(
    ends_singular: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two states, the first driven, at three boundaries; a control at four points; the junction time is fixed."""
    singular = np.array([[not ends_singular, ends_singular]])
    block = scipy.sparse.csc_array(np.arange(24.0).reshape(12, 2))
    monkeypatch.setattr(goh, "compute_variation_norm_weights", lambda transcription: np.full(12, 0.25))
    monkeypatch.setattr(goh, "_find_undetermined_singular_segments", lambda cone, s: singular)
    monkeypatch.setattr(goh, "_list_junction_time_variables", lambda s, part, singular: np.array([11]))
    monkeypatch.setattr(goh, "_build_integrated_control_variations", lambda *_: (block, np.array([8, 9])))
    monkeypatch.setattr(goh, "_find_states_driven_by_controls", lambda s, i: np.array([0]))
    monkeypatch.setattr(goh, "replace", lambda cone, **changes: fake(**changes))
    nodes, mesh = np.arange(6).reshape(2, 3), fake(segment_widths=np.array([0.36, 0.64]))
    parts = {"leg": fake(collocation=fake(boundary_states=nodes, mesh=mesh))}
    cone = fake(strong=np.eye(12, dtype=bool)[0], point=fake(transcription=fake(parts=parts)))
    found = goh.transform_to_goh_variables(cone, [fake(phase=fake(name="leg"))])
    np.testing.assert_array_equal(np.flatnonzero(found.strong), [0, 11])
    assert np.flatnonzero(cone.strong) == [0]
    unit = np.diag(np.where(np.arange(12) == 2, 1 / np.sqrt(0.32) if ends_singular else 2.0, 2.0))
    np.testing.assert_allclose(
        found.unit.toarray(), np.hstack([np.delete(unit, [8, 9], axis=1), block.toarray()])
    )
    singular[:] = False
    assert goh.transform_to_goh_variables(cone, [fake(phase=fake(name="leg"))]) is cone


def test_integrated_variations_of_a_control_are_derivatives_of_y() -> None:
    """y is a polynomial per segment; a column with y = 1 at one node has the slope of its Lagrange polynomial."""
    from testing.internals import get_collocation_rule

    mesh = fake(
        segments=3,
        degrees=(4, 4, 4),
        point_offsets=np.array([0, 4, 8, 12]),
        segment_widths=np.array([0.25, 0.25, 0.5]),
        breaks=(0.0, 0.25, 0.5, 1.0),
    )
    rule = get_collocation_rule("LG", 4)
    collocation = fake(mesh=mesh, collocation_rules=(rule,) * 3, point_controls=np.arange(2, 14)[None])
    block, places = goh._build_integrated_control_variations(
        20, fake(collocation=collocation), 0, np.array([True, True, False])
    )
    np.testing.assert_array_equal(places, np.arange(2, 10))
    # y = t^2 in shares of the phase at the nodes -1/3 and 1 of both segments; its norm includes y after the arc.
    nodes = np.array([1 / 12, 0.25, 1 / 3, 0.5])
    squares = np.array([0.125 * 1.5, 0.125 * 0.5, 0.125 * 1.5, 0.125 * 0.5 + 0.5])
    points = np.concatenate([0.125 + 0.125 * rule.points, 0.375 + 0.125 * rule.points])
    found = block.toarray() @ (np.sqrt(squares) * nodes**2)
    np.testing.assert_allclose(found[2:10], 2 * points, rtol=1e-12)
    np.testing.assert_array_equal(found[[0, 1, *range(10, 20)]], 0.0)


def test_first_order_arcs_are_determined_ones_with_enough_curvature() -> None:
    def arc(order: int, least: float, why: str = "", **place: Any) -> singular_arcs.SingularArc:
        return singular_arcs.SingularArc(
            "here", order, least, why, **({"channels": (0,), "samples": (1, 3)} | place)
        )

    s = fake(phase=fake(controls=fake(size=2)), times=np.zeros(4))
    for one, found in (
        (arc(1, 0.5), True),
        (arc(2, 0.5), False),
        (arc(1, 0.5, "why"), False),
        (arc(1, 0.1), False),
    ):
        expected = np.zeros((2, 4), dtype=bool)
        expected[0, 1:3] = found
        np.testing.assert_array_equal(singular_arcs.mask_first_order_singular_arcs(s, [one], 0.1), expected)
    hessian = np.zeros((3, 3, 2))
    hessian[0, 2] = hessian[2, 0] = [3.0, 1.0]
    hessian[2, 2] = 2.0
    s = fake(control_scale=np.array([2.0, 1.0, 5.0]), control_hessian=hessian, hamiltonian_scale=8.0)
    least = singular_arcs._compute_singular_curvature(s, np.array([0]), np.array([2]), np.array([0, 1]))
    assert least == pytest.approx(-(3.0**2) / 2.0 * 2.0**2 / 8.0)


def test_gains_count_beyond_rounding_and_errors_of_multipliers() -> None:
    own = fake(
        s=fake(hamiltonian=np.array([0.0, 5.0]), hamiltonian_term_magnitudes=np.array([0.0, 5.0])),
        chosen=np.array([0, 1]),
        cost_rate=2.0,
        _normalised_controls=np.zeros((1, 2)),
        _compute_largest_hamiltonian_change=lambda moves: 4.0 * np.sum(moves, axis=0),
    )
    better, least = np.full((1, 4), 0.5), 6e-7
    value = np.array([3.0, 5 - 1.01 * least, 5 - 0.99 * least, np.inf])
    gain, share = _MinimumSearch._compute_decrease(own, better, value, np.array([1, 1, 1, 0]))
    np.testing.assert_allclose(gain, [2.0, 1.01 * least, 0.0, 0.0], rtol=1e-6)
    np.testing.assert_allclose(share, gain / (2.0 + gain))
    large = np.array([-1e9, -1e9 + 1])
    own.s.hamiltonian = own.s.hamiltonian_term_magnitudes = np.array([-1e9 + 9e-4, 1e9])
    np.testing.assert_allclose(
        _MinimumSearch._compute_decrease(own, better[:, :2], large, np.array([0, 1]))[0],
        [0, 2e9 - 1],
    )


def test_limits_that_cost_and_their_gradients(monkeypatch: pytest.MonkeyPatch) -> None:
    """A path multiplier t and a state multiplier 1 e-7 (t > 2): densities times scales times 4 s over a cost of 2."""
    leg = fake(
        path_multiplier=lambda t: t[None],
        state_multiplier=lambda t: np.stack([6e-7 * (t > 2), 0 * t]),
        states=fake(size=2),
        x=lambda t: t,
        applied=lambda t: t,
        breaks=np.array([0.0, 1.0, 2.0, 4.0]),
    )
    scales = {"path_scale": np.array([0.5]), "state_scale": np.array([1.0, 3.0])}
    s = fake(phase=leg, span=4.0, cost_scale=2.0, **scales)
    times = np.array([0.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(
        limit_terms.mask_limits_with_multipliers(s, times), [[0, 1, 1, 1], [0, 0, 0, 1], [0, 0, 0, 0]]
    )
    leg.controls, leg.name, problem = fake(size=2), "leg", fake(phases={"leg": None})
    monkeypatch.setattr(limit_terms, "get_constraint_order", lambda problem, leg, row: fake(controls=[row]))
    held = limit_terms.mask_controls_set_by_active_limits(problem, s, times)
    np.testing.assert_array_equal(held, [[0, 1, 1, 1], [0, 0, 0, 1]])
    s.functions = fake(path_state_jacobian=lambda t, x, u: np.stack([[t, 0 * t]]))
    found = limit_terms.evaluate_active_limit_gradients(s, np.array([-1.0, 0.0, 1.0, 3.0, 4.0]))
    assert list(found) == [1.0, 3.0]
    np.testing.assert_allclose(found[1.0], [[2.0, 0.0]])
    np.testing.assert_allclose(found[3.0], [[18.0, 0.0], [1.2e-6, 0.0]])
    assert limit_terms.evaluate_active_limit_gradients(s, np.array([0.0, 1.0])) == {}
    assert len(limit_terms.evaluate_active_limit_gradients(s, np.linspace(0.0, 4.0, 102))) in (24, 25, 26)
    leg.lam = lambda t, side: np.stack(
        [[1.0, 2.0, 3.0][: t.size], 5 + (side == "left") * np.array([7e-7, 0.0])]
    )
    jumps = limit_terms.find_costate_jumps(s)
    assert list(jumps) == [1.0]
    np.testing.assert_allclose(jumps[1.0], [0.0, 7e-7], atol=1e-15)


def test_controls_at_a_bound_or_beside_a_multiplier(monkeypatch: pytest.MonkeyPatch) -> None:
    """Samples each second; the multiplier acts from 4 to 6 s on a control between its bounds from 2 s on."""
    t = np.arange(12.0)
    s = fake(
        times=t,
        u=np.where(t < 2, 1.0, 0.5)[None],
        state_multiplier=np.stack([(t >= 4) & (t <= 6), t < -1]).astype(float),
        mu=np.zeros((1, 12)),
        phase=fake(control_bounds=interval(-1.0, 1.0)),
    )
    monkeypatch.setattr(
        switching, "mask_controls_set_by_active_limits", lambda problem, s, times: (times == 11)[None]
    )
    held = switching._mask_constrained_controls(fake(), s, np.array([0.2, 1.2, 5.0, 8.9, 10.0, 7.4]))
    np.testing.assert_array_equal(held, [[False, True, False, True, True, True]])
    s.mu, s.state_multiplier = s.state_multiplier[:1], 0 * s.state_multiplier
    held = switching._mask_constrained_controls(fake(), s, np.array([1.2, 5.0]))
    np.testing.assert_array_equal(held, [[True, False]])
    for u, on in ((1.0, True), (-1.0 + 4e-7, True), (1.0 - 1e-5, False), (-0.5, False)):
        assert switching._is_control_at_bound(s, np.array([u]), 0) is on


def test_controls_at_bounds_with_nonzero_switching_functions() -> None:
    """Of four controls the second has a switching function of zero along 20 %, the third is between its bounds."""
    t = np.linspace(0.0, 1.0, 101)
    gradient = np.ones((4, 101))
    gradient[1, 40:60] = 1e-8
    gradient[3, 40] = 0.0
    at_upper = np.ones((4, 101), dtype=bool)
    at_upper[2, 40:60] = False
    s = fake(
        times=t,
        relative_control_gradient=0.5 * gradient,
        is_at_control_bounds=np.stack([~np.ones((4, 101), dtype=bool), at_upper]),
    )
    np.testing.assert_array_equal(sufficient.mask_bang_bang_controls(s), [True, False, False, True])


def test_lagrangian_of_two_linked_phases() -> None:
    """x(2) is linked to x(1) with the slope 2; nu = 3 of psi = (x1 + x2 + 1, x2^2), which has no reach."""
    amounts = np.array([[0.5, -0.25]])

    def leg(name: str, x: float, bounds: Any) -> Any:
        phase = fake(
            name=name,
            breaks=np.array([0.0, 1.0]),
            states=fake(size=1),
            x=lambda t: np.array([x]),
            final_bounds=bounds,
        )
        return fake(phase=phase, lam=np.array([[9.0, 4.0]]), state_scale=np.ones(1))

    def shift(s: Any, amounts: Array, q: Array) -> Any:
        def integrate_phase(begin: Array, cost: float) -> Any:
            return begin + amounts[:1] * (s.phase.name == "a"), np.zeros((0, 3)), 0.1 * amounts[0], []

        return fake(integrate_phase=integrate_phase, times=np.zeros((2, 3)), functions=fake(p=None))

    phases = {name: fake(start=None, end=fake(radius=np.array([0.5]))) for name in ("a", "b")}
    problem = fake(sense=-1.0, get_boundary_constraint_bounds=lambda: interval([3.0, -9.0], [3.0, 1.0]))
    own = fake(
        samples=[leg("a", 1.0, interval(1.0, 9.0)), leg("b", 1.0, interval(0.0, 5.0))],
        _shift_switching_times_of_phase=shift,
        solution=fake(
            parameter_values=np.zeros(0),
            phases=("a", "b"),
            need_problem=lambda _: problem,
            constraint_multipliers=np.array([3.0, 0.5]),
        ),
        _sum_variations_of_quantity=lambda kind, name, amounts, size: np.zeros((size, amounts.shape[1])),
        ends=fake(final_state={"a": np.array([1.0]), "b": np.array([4.0])}),
        scales=fake(
            cost=2.0,
            phases=phases,
            links={"b": {"a": np.array([[2.0]]), "c": None}},
            boundary={1.0: fake(gramian=np.diag([0.0625, 0.0]))},
        ),
    )

    def evaluate(function: Any, count: int, *arguments: Any) -> Array:
        first, second = arguments[1], arguments[7]
        return np.vstack([first + second + 1, second**2, 7 * second])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(variations, "evaluate_casadi_batch", evaluate)
        patch.setattr(variations, "get_endpoint_value_function", lambda problem: None)
        values, misses = variations.ShiftedTrajectory.integrate_lagrangian_changes(own, amounts)
    d = amounts[0]
    second = 1 + 2 * d
    np.testing.assert_allclose(values, 0.2 * d + 3 * d - 7 * 2 * d + 3 * 3 * d + 0.5 * (second**2 - 1))
    change = np.max(np.abs(second**2 - 1)) / 0.02 / 0.5
    np.testing.assert_allclose(misses, [d / 0.5, 3 * d / 0.25, (second**2 - 1) / change])


def test_variations_of_controls_inside_and_of_values_off_their_limits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of two controls and four times, one is at a bound and one held at a time; the last response is zero."""
    times = np.array([0.0, 1.0, 2.0, 3.0])
    response = np.stack([np.ones((2, 4)), np.zeros((2, 4))])
    monkeypatch.setattr(variations, "differentiate_final_state_by_controls", lambda s: (times, response))
    held = np.array([[False, False, True, False], [False] * 4])
    monkeypatch.setattr(variations, "mask_controls_set_by_active_limits", lambda problem, s, at: held)
    u = np.array([[0.0, 1.0 - 4e-3, 0.0, 0.0], [0.0] * 4])
    leg = fake(name="leg", applied=lambda t: u, control_bounds=interval([-1.0, -1.0], [1.0, 1.0]))
    deviation = np.array([[0.5, 0.5, 0.5, 0.25], [1.0, 2.0, 1.0, 1.0]])
    own = fake(phases={"leg": fake(deviation=deviation, start=fake(radius=np.array([2.0, 0.5])))})
    ((name, at, shape),) = variations._list_control_variations(fake(), fake(phase=leg, times=times), own)
    assert name == "leg" and at is times
    expected = np.array([[0.25, 0.0, 0.0, 0.0625], [1.0, 4.0, 1.0, 1.0]])
    np.testing.assert_allclose(shape, 0.02 * expected / 2.0)
    monkeypatch.setattr(variations, "_has_active_limits", lambda s: s.active)
    leg.x, leg.breaks = lambda t: np.array([0.0, 3.0]), np.array([1.0, 5.0])
    leg.initial_bounds, leg.duration_bounds = interval([0.0, 0.0], [9.0, 9.0]), interval(0.0, 9.0)
    leg.initial_time_bounds, leg.final_time_bounds = interval(1.0, 1.0), interval(0.0, 9.0)
    own.links, own.parameters = {"leg": {"": np.array([[1.0, 0.0], [0.0, 1.0]])}}, np.array([0.25])
    problem = fake(get_parameter_bounds=lambda: interval(0.0, 1.0))
    solution = fake(need_problem=lambda _: problem, parameter_values=np.array([0.5]))

    def found(**changes: Any) -> list[tuple[str, str, list[float]]]:
        s = fake(phase=fake(**(vars(leg) | changes)), span=4.0, active=changes.get("active", False))
        steps = variations._build_end_and_parameter_variations(solution, [s], own)
        return [(kind, phase, (step / 0.02).tolist()) for kind, phase, step in steps]

    parameter = ("parameters", "", [0.25])
    start = ("start", "leg", [0.0, 0.5])
    time = ("times", "leg", [0.0, 4.0])
    assert found() == [parameter, start, time]
    assert found(duration_bounds=interval(4 - 3e-6, 9.0)) == [parameter, start]
    assert found(active=True) == [parameter] and found(duration_bounds=interval(4.0, 9.0)) == [
        parameter,
        start,
    ]


def test_vector_controls_in_which_h_is_affine() -> None:
    """Controls f, s, n1, n2 and again s', n': H is affine in s (n1, n2), and only the length of n is limited."""
    places = {"s": slice(1, 2), "n": slice(2, 4), "r": slice(4, 5), "m": slice(5, 6)}
    first = fake(parts=("r", "m"), direction_norm_constraint_name="length of m")
    second = fake(parts=("s", "n"), direction_norm_constraint_name="length of n")
    pattern = ca.DM(6, 6)
    for i, j in ((1, 2), (2, 1), (1, 3), (3, 1), (0, 5), (4, 4)):
        pattern[i, j] = 1
    paths = ca.DM([[0, 0, 1, 1, 0, 0], [1, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 1]])

    def find(group: Any, **more: tuple[int, int]) -> Any:
        bends, limited = ca.DM(pattern), ca.DM(paths)
        for name, (i, j) in more.items():
            (bends if name == "bends" else limited)[i, j] = 1
        patterns = {"switching": ca.sparsify(bends).sparsity(), "paths": ca.sparsify(limited).sparsity()}
        functions = {k: fake(jac_sparsity=lambda *_, v=v: v) for k, v in patterns.items()}
        s = fake(
            phase=fake(
                controls=fake(size=6, slice=places.__getitem__),
                vector_controls=(first, second),
                path_labels=("length of n", "box", "length of m"),
            ),
            functions=fake(functions=functions),
        )
        return critical_cone.find_vector_control(s, np.array(group))

    assert find([1, 2, 3]) is second and find([0, 1, 2, 3]) is None
    assert find([4, 5]) is None  # curvature in its magnitude
    assert find([1, 2, 3], bends=(2, 2)) is None and find([1, 2, 3], bends=(2, 5)) is None
    assert find([1, 2, 3], bends=(5, 2)) is second
    assert find([1, 2, 3], limited=(1, 2)) is None and find([1, 2, 3], limited=(2, 1)) is None


def test_switching_functions_of_the_wrong_sign_between_adjacent_switches(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """At 1 s, between the switches at 0.5 and 2 s: u = 1 with a slope of 0.5 there, and more elsewhere."""
    s = fake(
        times=np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5]),
        u=np.array([[0.0] * 6, [0.0, 4.0, 4.0, 0.0, 0.0, 4.0]]),
        phase=fake(control_bounds=interval([0.0, 0.0], [1.0, 4.0])),
        control_scale=np.array([1.0, 2.0]),
        hamiltonian_scale=4.0,
    )
    slopes = np.array([[9.0] * 6, [-9.0, -1.0, 0.5, 1.0, 1.0, 9.0]])
    monkeypatch.setattr(bang_bang, "_evaluate_switching_functions", lambda s: slopes)
    assert bang_bang._compute_switching_sign_violation(s, 1, np.array([0.5, 1.0, 2.0]), 1.0) == pytest.approx(
        0.25
    )
    assert bang_bang._compute_switching_sign_violation(s, 1, np.array([1.0, 2.0]), 1.0) == pytest.approx(4.5)
    assert bang_bang._compute_switching_sign_violation(s, 1, np.array([0.5, 1.0]), 1.0) == pytest.approx(4.5)
