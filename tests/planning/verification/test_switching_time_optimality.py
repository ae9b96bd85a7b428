"""Shifted switches: a switch beside an arc held by a state limit of second order."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing import constructed_solutions
from testing.models import dynamics, one_phase
from testing.wrong_solutions import double_integrator

import gnc_opt as go
from gnc_opt.array_types import Array
from gnc_opt.planning.problem.bounds import Interval
from gnc_opt.planning.verification.switching_time_optimality import (
    _compute_adjacent_arc_duration,
    find_control_jumps,
)
from gnc_opt.planning.verification.switching_time_variations import (
    Jump,
    ShiftedTrajectory,
    _draw_unit_directions,
    _find_directions_keeping_end_conditions,
    _has_active_limits,
    _list_free_variations,
    _scale_changes_at_active_limits,
    _ShiftedPhase,
)

HEIGHT = 0.25
"""Upper limit of q, below 1/3: the arc of least effort follows it from t = 3 HEIGHT on (Bryson and Denham, 1963)."""


def switched(share: float, time: float) -> go.Verdict:
    """Verdict on a bang-bang u beside the limited double integrator.

    J = int a^2 + (t - time) u dt - share / 2 (x(2) - 2 time + 2)^2: shifting the switch by d changes the cost by
    (1 - 2 share) d^2, so that the stated switch is a minimum below share = 1/2.
    """
    model = go.Model("cart and switch")
    x, q, v = model.state("x"), model.state("q"), model.state("v")
    u, a = model.control("u"), model.control("a")
    model.ode({x: u, q: v, v: a})
    problem, leg = one_phase("cart and switch", model, 0.0, 2.0)
    leg.initial(x=0.0, q=0.0, v=1.0)
    leg.final(q=0.0, v=-1.0)
    leg.bounds(u=(-1, 1), q=(None, HEIGHT))
    end = leg.final_state("x") - (2 * time - 2)
    problem.minimize(leg.integral(a**2) + leg.integral((model.time - time) * u) - share / 2 * end**2)
    entry = 3 * HEIGHT
    t = np.unique(np.concatenate([np.linspace(0, 2, 81), [time, entry, 2 - entry]]))
    t = np.sort(np.append(t, time))
    first = np.arange(t.size) <= np.searchsorted(t, time)
    s = np.minimum(np.minimum(t, 2 - t) / entry, 1.0)
    states = {
        "x": np.where(first, t, 2 * time - t),
        "q": HEIGHT * (1 - (1 - s) ** 3),
        "v": (1 - s) ** 2 * np.where(t > 1, -1, 1),
    }
    controls = {"u": np.where(first, 1.0, -1.0), "a": -2 * (1 - s) / entry}
    return go.verify_trajectory(problem, t, states, controls)


@pytest.mark.slow
@pytest.mark.parametrize("time", [0.5])
def test_a_switch_beside_an_arc_at_a_state_limit(time: float) -> None:
    assert switched(0.45, time).minimum
    assert not switched(0.55, time).ok


def coupled_touch(concavity: float, as_path: bool) -> go.Verdict:
    """Verdict on switches of two controls at 1 and 2 that raise q to a touch of its limit at 3.

    From rest, q rises to s1 s2 at t = s1 + s2 if the acceleration (u1 + u2) / 2 has its switches at s1 and s2. With
    J = int (t - 2) u1 + (t - 5 / 2) u2 - concavity / 2 x(4)^2 and the multiplier 1 of s1 s2 <= 2, steps (1, -2) d of
    the switches keep the limit to first order and change the Lagrangian by (3 - concavity / 2) d^2. At the fixed time
    3 it would be (5 / 2 - concavity / 2) d^2.
    """
    model = go.Model("two switches before a touch")
    q, v, x = model.state("q"), model.state("v"), model.state("x")
    u1, u2 = model.control("u1"), model.control("u2")
    model.ode({q: v, v: (u1 + u2) / 2, x: u1 / 2})
    problem, leg = one_phase("touch", model, 0.0, 4.0)
    leg.initial(q=0.0, v=0.0, x=1.0)
    leg.bounds(u1=(-1, 1), u2=(-1, 1))
    if as_path:
        leg.path("ceiling", q**2 / 4, upper=1.0)
    else:
        leg.bounds(q=(None, 2.0))
    running = leg.integral((model.time - 2) * u1) + leg.integral((model.time - 2.5) * u2)
    problem.minimize(running - concavity / 2 * leg.final_state("x") ** 2)
    t = np.sort(np.append(np.linspace(0, 4, 41), [1.0, 2.0]))
    count = np.arange(t.size)
    first, second = (count <= np.searchsorted(t, s) for s in (1.0, 2.0))
    states = {
        "q": np.where(first, t**2 / 2, np.where(second, t - 0.5, 2 - (t - 3) ** 2 / 2)),
        "v": np.where(first, t, np.where(second, 1.0, 3 - t)),
        "x": np.where(first, 1 + t / 2, 2 - t / 2),
    }
    return go.verify_trajectory(
        problem, t, states, {"u1": np.where(first, 1.0, -1.0), "u2": np.where(second, 1.0, -1.0)}
    )


def test_a_touch_moves_with_the_switches_before_it() -> None:
    right, wrong = (coupled_touch(concavity, as_path=True) for concavity in (5.9, 6.1))
    assert right["switching times"].result is not go.ConditionResult.FAIL
    assert wrong["switching times"].result is go.ConditionResult.FAIL


@pytest.mark.parametrize("as_path", [False, True])
def test_lagrangian_of_shifted_switches_before_a_touch(
    as_path: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Shifts d, e change it by d^2 + e^2 + d e - concavity / 2 d^2, and the peak of q by 2 d + e + d e.

    The path q^2 / 4 <= 1 has the same slope at the touch, and its curvature adds a quarter of the peak's square.
    """
    found: list[ShiftedTrajectory] = []
    monkeypatch.setattr(ShiftedTrajectory, "find_second_order_cost_decrease", lambda own: found.append(own))
    coupled_touch(5.0, as_path)
    amounts = 0.02 * np.array([[1.0, 0.0, 0.5, -1.0], [0.0, 1.0, -1.0, 0.5]])
    d, e = 0.02 * amounts * [[1.0], [2.0]]
    values, misses = found[0].integrate_lagrangian_changes(amounts)
    peak = 2 * d + e + d * e
    curved = peak**2 / 4 if as_path else 0.0
    np.testing.assert_allclose(values, d**2 + e**2 + d * e - 2.5 * d**2 + curved, rtol=1e-5)
    np.testing.assert_allclose(misses, [(peak + curved) / found[0].scales.cost], rtol=1e-5)


def test_the_place_counts_switches_and_names_the_second_order() -> None:
    """Rest to rest in minimum time has one switch."""
    model, *_ = dynamics("double integrator", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("rest to rest", model, initial=0.0, final=(0.1, 10.0))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    condition = go.verify(go.solve(problem))["switching times"]
    assert condition.where == "1 switch between control limits, tested by the second-order condition"


@pytest.mark.parametrize(
    ("name", "gap", "count"), [("a", 5e-7, 1), ("b", 0.0, 0), ("a", 2e-6, 0)], ids=["same", "other", "later"]
)
def test_a_jump_between_phases_is_that_of_one_control_at_one_time(name: str, gap: float, count: int) -> None:
    """Full thrust, then full brakes: a switch if the control is the same and at most 1e-9 of the phase is between."""
    problem = go.Problem("two legs")
    legs = []
    for label, control, begin in (("first", "a", 0.0), ("second", name, 1e3 + gap)):
        model, *_ = dynamics(label, "x", control, lambda x, u: {x: u})
        leg = problem.phase(label, model)
        leg.time(begin, begin + 1e3)
        leg.initial(x=0.0)
        leg.bounds(**{control: (-1.0, 1.0)})
        legs.append(leg)
    problem.maximize(legs[0].final_state("x") - legs[1].final_state("x"))
    solution = go.solve(problem, mesh="2x3", tol=None)
    jumps = find_control_jumps(solution.need_problem("verify"), list(solution.samples().values()))
    assert [jump.beyond for jump in jumps] == ["second"] * count


@pytest.mark.parametrize("unit", [1e-3, 1e3])
@pytest.mark.parametrize(("share", "count"), [(5e-4, 0), (2e-3, 1)])
def test_a_jump_is_larger_than_a_thousandth_of_the_range(unit: float, share: float, count: int) -> None:
    """u rises from 0 to 1, in other units, with a jump in the middle of the phase."""
    model, x, _u = dynamics("climb", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("climb", model, 0.0, 1.0)
    leg.bounds(u=(-unit, unit))
    problem.minimize(leg.integral(x**2))
    rise = lambda t, k: unit * np.array([(1 - share) * t + share * k])  # noqa: E731
    zero = lambda t, k: np.array([0 * t])  # noqa: E731
    bounds = constructed_solutions.interval(-unit, unit)
    s = constructed_solutions.samples(problem, zero, rise, zero, weights=(1.0,), control_bounds=bounds)
    found = find_control_jumps(problem, [s])
    assert [(jump.time, jump.shorter_arc) for jump in found] == [(0.5, 0.5)] * count
    for jump in found:
        assert jump.after - jump.before == pytest.approx(share * unit, rel=1e-6)


def coupled(coupling: float, what: str, others: int = 0) -> go.Verdict:
    """Verdict on two controls that switch at 1, coupled with an unknown of another kind by ``coupling``.

    Shifts of the switches by d and e change the cost by d^2 + e^2, the unknown's deviation k by k^2, and both by
    coupling k (d - e): the stated answer is a minimum below sqrt(2). ``others``: further controls, each with one switch
    at a time of its own; "switch": k is half a shift of the last one, so that the limit is 2.
    """
    model = go.Model("two switches")
    x, y, z = model.state("x"), model.state("y"), model.state("z")
    u, v, w = model.control("u"), model.control("v"), model.control("w")
    rates = {x: u, y: v, z: w}
    if what == "start":
        rates[model.state("q")] = 0.0
    if what == "dynamics":
        rates[model.state("q")] = model.parameter("k", 1.0)
    times = np.linspace(0.1, 0.9, others)
    more = [model.control(f"u{k}") for k in range(others)]
    rates |= {model.state(f"x{k}"): control for k, control in enumerate(more)}
    model.ode(rates)
    problem, leg = one_phase("two switches", model, 0.0, (1.0, 3.0) if what == "time" else 2.0)
    leg.initial(x=0.0, y=0.0, z=0.0, **{f"x{k}": 0.0 for k in range(others)})
    leg.final(z=1.0)
    leg.bounds(u=(-1, 1), v=(-1, 1), **{f"u{k}": (-1, 1) for k in range(others)})
    cost = leg.integral((model.time - 1) * (u + v) + w**2)
    unknown, shifts = 0.0, (leg.final_state("x") - leg.final_state("y")) / 2
    if what in ("cost", "dynamics"):
        unknown = problem.parameter("k", guess=1.0) - 1
    if what == "dynamics":
        leg.initial(q=0.0)
        unknown = leg.final_state("q") / 2 - 1
    if what == "start":
        unknown = leg.initial_state("q") - 3
    if what == "time":  # with what the time changes the cost of the switches and of w
        unknown = leg.final_time - 2
        cost += 2.25 * unknown + (1 - 1 / 8) * unknown**2
    for control, time in zip(more, times, strict=True):
        cost += leg.integral((model.time - time) * control)
    if others:
        unknown = (leg.final_state(f"x{others - 1}") - (2 * times[-1] - 2)) / 2
        shifts = leg.final_state("x") / 2
    problem.minimize(cost + (0.0 if others else unknown**2) + coupling * unknown * shifts)
    t = np.sort(np.concatenate([np.linspace(0, 2, 40), [1.0, 1.0], times, times]))
    after = np.append(False, np.diff(t) == 0)

    def switched(time: float) -> tuple[np.ndarray, np.ndarray]:
        before = (t < time) | ((t == time) & ~after)
        return np.where(before, t, 2 * time - t), np.where(before, 1.0, -1.0)

    at_one, own = switched(1.0), [switched(time) for time in times]
    states = {"x": at_one[0], "y": at_one[0], "z": t / 2}
    states |= {f"x{k}": path for k, (path, _) in enumerate(own)}
    states |= {"q": 3.0 + 0 * t if what == "start" else t} if what in ("start", "dynamics") else {}
    controls = {"u": at_one[1], "v": at_one[1], "w": 0.5 + 0 * t}
    controls |= {f"u{k}": values for k, (_, values) in enumerate(own)}
    p = {"k": 1.0} if what in ("cost", "dynamics") else None
    return go.verify_trajectory(problem, t, states, controls, p)


@pytest.mark.parametrize("what", ["cost", "dynamics", "start", "time"])
def test_switches_at_one_time_are_coupled_with_other_unknowns(what: str) -> None:
    assert coupled(1.3, what).minimum
    assert not coupled(1.55, what).ok


def test_one_of_two_switches_at_one_time_is_coupled_with_a_later_one() -> None:
    assert coupled(1.8, "", others=4).minimum
    assert not coupled(2.5, "", others=4).ok


def test_a_switch_at_the_end_of_a_phase_is_coupled_with_a_parameter() -> None:
    """A shift d costs d^2, the parameter's deviation k^2, both coupling d k: a minimum below 2."""

    def verdict(coupling: float) -> go.Verdict:
        model = go.Model("leg")
        x, z, u, w = model.state("x"), model.state("z"), model.control("u"), model.control("w")
        model.ode({x: u, z: w})
        problem = go.Problem("two legs")
        first, second = problem.phase("first", model), problem.phase("second", model)
        first.time(0.0, 1.0)
        second.time(1.0, 2.0)
        problem.link(first, second)
        first.initial(x=0.0, z=0.0)
        second.final(z=1.0)
        first.bounds(u=(-1, 1))
        second.bounds(u=(-1, 1))
        k = problem.parameter("k", guess=1.0) - 1
        rate = (model.time - 1) * u + w**2
        shift = second.final_state("x") / 2
        problem.minimize(first.integral(rate) + second.integral(rate) + k**2 + coupling * k * shift)
        t = np.linspace(0, 1, 21)
        return go.verify_trajectory(
            problem,
            {"first": t, "second": 1 + t},
            {"first": {"x": t, "z": t / 2}, "second": {"x": 1 - t, "z": 0.5 + t / 2}},
            {"first": {"u": 1 + 0 * t, "w": 0.5 + 0 * t}, "second": {"u": -1 + 0 * t, "w": 0.5 + 0 * t}},
            {"k": 1.0},
        )

    assert verdict(1.9).minimum
    assert not verdict(2.1).ok


def test_a_jump_to_other_bounds_at_a_boundary_is_no_switch() -> None:
    """A cart with |u| <= 2 up to x = 1/2 and |u| <= 1 from there to rest at x = 1 takes 1/2 + sqrt(3/2) s.

    Beyond the boundary -2 is not admissible, and both phases meet at one time: neither may vary alone.
    """
    problem, legs = go.Problem("two stages"), []
    for name, most, times in (("fast", 2.0, (0.0, (0.1, 10.0))), ("slow", 1.0, ((0.1, 10.0), (0.2, 20.0)))):
        model, *_ = dynamics(name, "x v", "u", lambda x, v, u: {x: v, v: u})
        legs.append(problem.phase(name, model))
        legs[-1].time(*times)
        legs[-1].bounds(u=(-most, most))
    legs[0].initial(x=0.0, v=0.0)
    legs[0].final(x=0.5)
    legs[1].initial(x=0.5)
    legs[1].final(x=1.0, v=0.0)
    problem.constrain("speed", legs[0].final_state("v") - legs[1].initial_state("v"), equals=0.0)
    problem.constrain("time", legs[0].final_time - legs[1].initial_time, equals=0.0)
    problem.minimize(legs[1].final_time)
    solution = go.solve(problem)
    assert solution.objective == pytest.approx(0.5 + np.sqrt(1.5), abs=1e-9)
    assert go.verify(solution).minimum


def test_a_switch_at_a_phase_boundary_is_no_unknown_of_the_second_order_condition() -> None:
    """Rest to rest over 1 m in minimum time: -1 for 1 s, 1 for 1 s, each in its own phase."""
    problem = go.Problem("push, brake")
    push, brake = (problem.phase(name, double_integrator()) for name in ("push", "brake"))
    push.time(0.0, (0.5, 1.5))
    brake.time((0.5, 1.5), (1.0, 3.0))
    push.initial(q=1.0, v=0.0)
    brake.final(q=0.0, v=0.0)
    for leg in (push, brake):
        leg.bounds(a=(-1.0, 1.0))
    problem.link(push, brake)
    problem.minimize(brake.final_time)
    t = {"push": np.linspace(0.0, 1.0, 3), "brake": np.linspace(1.0, 2.0, 3)}
    left = 2.0 - t["brake"]
    x = {"push": np.array([1 - t["push"] ** 2 / 2, -t["push"]]), "brake": np.array([left**2 / 2, -left])}
    verdict = go.verify_trajectory(problem, t, x, {"push": -np.ones(3), "brake": np.ones(3)})
    assert verdict.ok and verdict["switching times"].where == "1 switch between control limits"


def test_steps_are_small_where_ends_move_far() -> None:
    """Shifts (2, 1) keep the end and lower the cost; slopes of 4 and 8 reaches leave 1/40 and 1/80 of whole steps."""

    class ClosedForm(ShiftedTrajectory):
        control_variations = end_and_parameter_variations = ()  # type: ignore[assignment]

        def integrate_lagrangian_changes(self, amounts: Array) -> tuple[Array, Array]:
            first, second = amounts
            misses = np.arctan(4 * first - 8 * second) + 10 * (first**2 + second**2)
            return first**2 + second**2 - 3 * first * second, misses[None]

    leg: Any = SimpleNamespace(controls=SimpleNamespace(labels=("u", "v")))
    solution: Any = SimpleNamespace(phases={"leg": leg}, problem=None, objective=0.0)
    scales: Any = SimpleNamespace(cost=1.0)
    jumps = [Jump("leg", 1.0, channel, -1.0, 1.0, 1.0) for channel in (0, 1)]
    ends: Any = None
    found = ClosedForm(solution, [], ends, scales, jumps).find_second_order_cost_decrease()
    assert found is not None and found[0].value == pytest.approx((0.1 / 8) ** 2, rel=0.01)


def test_directions_cost_alike_and_their_terms_add_up() -> None:
    """L = s^2 + 4 r^2: a step of 1 in s costs as much as one of 1/2 in r, and both together twice of it."""
    directions, sizes = _draw_unit_directions(np.eye(2), np.array([1.0, 4.0, 5.0]))
    step = directions[0, 0]
    np.testing.assert_allclose(directions[:, :4] / step, [[1.0, 0.0, 1.0, 1.0], [0.0, 0.5, 0.5, -0.5]])
    np.testing.assert_allclose(directions[:, 5:], -directions[:, :5])
    np.testing.assert_allclose(sizes, 2.0 * np.array([1.0, 4.0]) @ directions**2)
    np.testing.assert_allclose(sizes[:4] / step**2, [2.0, 2.0, 4.0, 4.0])
    (s, r), _ = _draw_unit_directions(np.eye(2), np.array([0.0, 1.0, 0.0]))
    assert np.min(r**2 - s * r) < -0.03  # L = r^2 - s r decreases along s + r / 32


def test_values_at_a_limit_change_in_shares_of_their_reach() -> None:
    """Fixed, at the lower limit within 1e-6 of the reach, at the upper one, fixed without reach, and inside."""
    box = Interval(np.array([2.0, 0.0, -9.0, 4.0, 0.0]), np.array([2.0, 9.0, 5.0, 4.0, 9.0]))
    reach, unreached = np.array([0.5, 20.0, 0.25, 0.0, 2.0]), np.array([7.0, 7.0, 7.0, 3.0, 7.0])
    last = np.array([2.0, 1e-5, 5.0, 4.0, 1.0])
    values = np.stack([last + 1.0, last - 2.0, last], axis=1)
    found = _scale_changes_at_active_limits(values, box, reach, unreached)
    np.testing.assert_allclose(found, np.outer([2.0, 0.05, 4.0, 1.0 / 3.0], [1.0, -2.0, 0.0]), atol=1e-12)


@pytest.mark.parametrize(
    ("unit", "gap", "active"), [(1e-3, 1e-5, False), (1e3, 1e-7, True), (1e3, 1e-5, False)]
)
@pytest.mark.parametrize("falls", [False, True])
def test_a_state_path_is_active_at_an_end_within_a_millionth_of_its_range(
    unit: float, gap: float, active: bool, falls: bool
) -> None:
    """x t or x (1 - t) below a ceiling that is x gap above the largest value, at one end of the phase."""
    model, x, _u = dynamics("climb", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("climb", model, 0.0, 1.0)
    leg.path("ceiling", x, upper=unit * (1.0 + gap))
    problem.minimize(leg.integral(x))
    along = lambda t, k: unit * np.array([1.0 - t if falls else t])  # noqa: E731
    zero = lambda t, k: np.array([0 * t])  # noqa: E731
    s = constructed_solutions.samples(problem, along, zero, zero, weights=(1.0,))
    assert _has_active_limits(s) is active


def test_terms_of_active_limits_are_linear_in_what_they_limit() -> None:
    """x' = u, y' = 2 u; the multipliers 3 t of the path x u, 5 and 7 t of the states."""

    def stack(*rows: Any) -> Array:
        return np.stack([np.broadcast_to(row, (2,)) for row in rows])

    leg: Any = SimpleNamespace(
        states=SimpleNamespace(size=2),
        breaks=np.array([0.0, 2.0]),
        path_labels=("x u",),
        path_multiplier=lambda t: stack(3 * t),
        state_multiplier=lambda t: stack(5.0, 7 * t),
    )
    functions: Any = SimpleNamespace(
        evaluate_rates_paths_and_integrands=lambda t, x, u: stack(u[0], 2 * u[0], x[0] * u[0], t)
    )
    phase: Any = SimpleNamespace(
        samples=SimpleNamespace(phase=leg), functions=functions, _has_active_limits=True
    )
    t, y, u = np.array([1.0, 3.0]), np.array([[2.0, 4.0], [-1.0, 0.5], [9.0, 9.0]]), np.array([[1.0, 3.0]])
    found = _ShiftedPhase.evaluate_rates(phase, t, y, u)
    expected = [
        3 * 2 * 1 + 5 * 2 - 7,
        3 * 2 * 4 * 3 + 5 * 4 + 7 * 2 * 0.5,
    ]  # after the end, multipliers of the end
    np.testing.assert_allclose(found, [[1.0, 3.0], [2.0, 6.0], [1.0, 3.0], expected])
    has_limits = vars(_ShiftedPhase)["_has_active_limits"].func
    for mu, z in ((0, 0), (1, 0), (0, 1)):
        own = SimpleNamespace(mu=np.array([[0, mu]]), state_multiplier=np.array([[z, 0]]))
        assert has_limits(SimpleNamespace(samples=own)) is (mu + z > 0)


def test_directions_that_keep_the_ends_are_shifts_with_their_corrections() -> None:
    """Ends 2 s + 4 r + k and h, which no shift moves: s and r in steps that move the ends alike, k corrects them."""
    found = _find_directions_keeping_end_conditions(
        np.array([[2.0, 4.0], [0.0, 0.0]]), np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    )
    alone = found[:, 2:]
    np.testing.assert_allclose(np.abs(alone.T), [[0.0, 0.0, 0.0, 0.0, 1.0]], atol=1e-12)
    shifts, others = found[:2, :2], found[2:, :2]
    np.testing.assert_allclose(others, -np.array([[2.0, 4.0], [0.0, 0.0], [0.0, 0.0]]) @ shifts, atol=1e-12)
    np.testing.assert_allclose(np.abs(np.linalg.det(shifts)), 0.5, rtol=1e-12)
    np.testing.assert_allclose(shifts @ shifts.T, np.diag([1.0, 0.25]), atol=1e-12)


def test_steps_move_only_values_inside_their_limits() -> None:
    """The second value is within or beyond 1e-6 of its scale from its limit, the third is fixed."""
    box = Interval(np.array([0.0, 0.0, 1.0]), np.array([9.0, 9.0, 1.0]))
    rows = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0], [1.0, 0.0, 3.0], [0.0, 0.0, 0.0]])
    for second, count in ((5e-4, 1), (2e-3, 2)):
        found = _list_free_variations(
            "start", "leg", box, np.array([4.0, second, 1.0]), rows, np.full(3, 1e3)
        )
        assert [key[:2] for key in found] == [("start", "leg")] * count
        np.testing.assert_allclose([key[2] for key in found], 0.02 * rows[:count])


def test_the_shorter_arc_beside_a_jump_ends_at_a_jump_of_the_same_control_or_with_the_phase() -> None:
    def jump(time: float, channel: int = 0, beyond: str = "") -> Jump:
        return Jump("first", time, channel, -1.0, 1.0, beyond=beyond)

    jumps = [jump(3.0), jump(8.0), jump(2.5, channel=1), jump(10.0, beyond="second")]
    ends = {"first": (1.0, 10.0), "second": (10.0, 11.5)}
    assert [_compute_adjacent_arc_duration(one, jumps, ends) for one in jumps] == [2.0, 2.0, 1.5, 1.5]


@pytest.mark.parametrize(("least", "result"), [(-0.2, "FAIL"), (-0.01, "INCONCLUSIVE"), (0.01, "PASS")])
def test_small_curvature_in_a_skew_direction_of_simultaneous_switches(least: float, result: str) -> None:
    """Switches at 1 + s cost s.H s - 3 with the eigenvalues ``least``, 1 and 2000 of H, beside a regular control."""
    basis = np.linalg.qr(np.array([[1.0, 1.0, 0.0], [1.0, -1.0, 1.0], [1.0, 0.0, -1.0]]))[0]
    hessian = basis @ np.diag([least, 1.0, 2000.0]) @ basis.T
    model = go.Model("three switches")
    x, z, u, w = model.state("x", 3), model.state("z"), model.control("u", 3), model.control("w")
    model.ode({x: u, z: w})
    problem, leg = one_phase("three switches", model, 0.0, 2.0)
    leg.initial(x=np.zeros(3), z=0.0)
    leg.final(z=1.0)
    leg.bounds(u=(-np.ones(3), np.ones(3)))
    end = leg.final_state("x")
    curved = ca.dot(end, ca.mtimes(ca.DM((hessian - np.eye(3)) / 4), end))
    problem.minimize(leg.integral((model.time - 1) * ca.sum1(u) + w**2) + curved)
    t = np.concatenate([np.linspace(0.0, 1.0, 8), np.linspace(1.0, 2.0, 8)])
    push = np.where(np.arange(16) < 8, 1.0, -1.0) + np.zeros((3, 1))
    states = np.vstack([np.minimum(t, 2 - t) + np.zeros((3, 1)), t / 2])
    found = go.verify_trajectory(problem, t, states, np.vstack([push, 0.5 + 0 * t]))["switching times"]
    assert found.result is go.ConditionResult[result]
    assert found.where.count(" at t = 1 s") == (0 if result == "PASS" else 2)
