"""verify_trajectory: closed forms pass at the accuracy of their samples, what is wrong fails, mistakes are named."""

import itertools
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from testing.models import dynamics, one_phase
from testing.wrong_solutions import design_problem, double_integrator

import gnc_opt as go
from problems.classics import interior_point, zermelo

Array = NDArray[np.float64]
Trajectory = tuple[Array, Any, Any]


def least_energy(most: float | None = None, time: float = 1.0) -> go.Problem:
    problem, leg = one_phase("least energy", double_integrator(), 0.0, time)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    if most is not None:
        leg.bounds(a=(-most, most))
    problem.minimize(leg.integral(leg.model.symbol("a") ** 2))
    return problem


def smooth(n: int = 41) -> Trajectory:
    """a = 6 - 12 t."""
    t = np.linspace(0.0, 1.0, n)
    return t, {"q": 3 * t**2 - 2 * t**3, "v": 6 * t - 6 * t**2}, {"a": 6 - 12 * t}


def least_time() -> go.Problem:
    problem, leg = one_phase("least time", double_integrator(), 0.0, (0.1, 10.0))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    return problem


def two_pulses(t: Array, switch: float = 1.0, force: float = 1.0) -> tuple[Array, Array]:
    """From rest at 1 m to rest at 0 with the accelerations -force and, after the switch, force * s / (t_f - s)."""
    brake = 2 / switch - force  # comes to rest at 0: v_s = -force s, q_s = 1 - force s^2 / 2
    after = t > switch
    x = np.where(
        after,
        [
            1 - force * switch**2 / 2 - force * switch * (t - switch) + brake * (t - switch) ** 2 / 2,
            -force * switch + brake * (t - switch),
        ],
        [1 - force * t**2 / 2, -force * t],
    )
    return x, np.where(after, brake, -force)


def failed(problem: go.Problem, trajectory: Trajectory, **options: Any) -> set[str]:
    return {c.name for c in go.verify_trajectory(problem, *trajectory, **options).failed}


def test_smooth_closed_form_passes_to_rounding() -> None:
    """The samples' polynomials are the solution's, and least squares finds the costates 12 and 12 t - 6 (times 2)."""
    verdict = go.verify_trajectory(least_energy(), *smooth(), tol=1e-10)
    assert verdict.minimum and verdict.estimated, verdict.explain()
    assert "multipliers estimated" in verdict.explain()


def test_conditions_without_a_margin_have_the_value_and_the_tolerance_zero() -> None:
    t, x, u = smooth(9)
    right, wrong = (
        go.verify_trajectory(least_energy(), t, x, {"a": factor * u["a"]}) for factor in (1.0, 1.01)
    )
    t = np.array([0.0, 0.5, 1.0, 1.0, 1.5, 2.0])
    bang = go.verify_trajectory(least_time(), t, two_pulses(t)[0], np.array([-1, -1, -1, 1, 1, 1]))
    for verdict in (right, wrong, bang):
        *first, kinks, _, _ = verdict.conditions
        assert [c.tolerance for c in first] == 7 * [1e-5] and not any(c.sufficient for c in first)
        assert (kinks.result.value, kinks.value, kinks.tolerance) == ("PASS", 0.0, 0.0)
        assert not kinks.sufficient
    for condition in (right["switching times"], bang["switching times"], bang["second order"]):
        assert (condition.result.value, condition.value, condition.tolerance) == ("PASS", 0.0, 0.0)
        assert condition.sufficient
    for condition in wrong.conditions[-2:]:
        assert np.isnan(condition.value) and (condition.tolerance, condition.sufficient) == (0.0, True)


def test_switch_between_samples_is_found_by_the_states() -> None:
    """No sample is at the switch, 1 s, nor is it said where it is."""
    t = np.sort(np.concatenate([[0.0, 2.0], np.random.default_rng(0).uniform(0.0, 2.0, 30)]))
    verdict = go.verify_trajectory(least_time(), t, *two_pulses(t), tol=1e-8)
    assert verdict.minimum, verdict.explain()


def test_switch_at_a_time_given_twice() -> None:
    """The first samples are close to the limit of the start, which must not have multipliers there."""
    s = np.linspace(0.0, 1.0, 300) ** 3
    t, problem = np.append(s, 1 + s), least_time()
    problem.phases["leg"].bounds(q=(0.0, 1.0))
    verdict = go.verify_trajectory(problem, t, two_pulses(t)[0], np.repeat([-1.0, 1.0], 300))
    assert verdict.minimum, verdict.explain()


def test_kinks_between_samples_are_found_where_both_sides_meet() -> None:
    """The force is at its limit m = 4.5 up to s and from 1 - s on, and linear in between; no sample is there.

    The distance of 1 asks for 3 - (1 - 2 s)^2 = 12 / m.
    """
    most = 4.5
    s = (1 - np.sqrt(3 - 12 / most)) / 2
    t = np.linspace(0.0, 1.0, 60)
    slope = most / (0.5 - s)

    def first_half(t: Array) -> Array:
        late = np.maximum(t - s, 0.0)
        return np.array([most * t**2 / 2 - slope * late**3 / 6, most * t - slope * late**2 / 2])

    there, back = first_half(np.minimum(t, 0.5)), first_half(np.minimum(1 - t, 0.5))
    x = np.where(t <= 0.5, there, [1 - back[0], back[1]])
    a = np.clip(slope * (0.5 - t), -most, most)
    assert x[0, -1] == pytest.approx(1.0) and first_half(np.array([0.5]))[0, 0] == pytest.approx(0.5)
    verdict = go.verify_trajectory(least_energy(most), t, x, a)
    assert verdict.ok, verdict.explain()


def test_trigonometric_closed_form_passes_at_the_accuracy_of_its_samples() -> None:
    """Zermelo's heading is an arctangent of time: errors of the fourth order in the sampling interval."""
    final = zermelo.REFERENCE.value
    worst = []
    for n in (41, 81):
        t = np.linspace(0.0, final, n)
        exact = zermelo.closed_form(t)
        verdict = go.verify_trajectory(zermelo.build(), t, exact.states, exact.controls)
        assert verdict.ok, verdict.explain()
        worst.append(verdict["dynamics"].value)
    assert 8 < worst[0] / worst[1] < 64


@pytest.mark.slow
def test_several_phases_and_a_parameter() -> None:
    solution = go.solve(interior_point.build(), tol=1e-8)
    times = {name: np.linspace(leg.initial_time, leg.final_time, 61) for name, leg in solution.phases.items()}
    x = {name: leg.x(times[name]) for name, leg in solution.phases.items()}
    u = {name: leg.applied(times[name]) for name, leg in solution.phases.items()}
    verdict = go.verify_trajectory(interior_point.build(), times, x, u)
    assert verdict.ok, verdict.explain()
    assert go.verify_trajectory(design_problem(), *smooth(), p={"k": 1.5}, tol=1e-8).ok
    assert failed(design_problem(), smooth(), p=[1.501]) == {"stationarity"}


EPS = 1e-3


def late(n: int = 21) -> Trajectory:
    t, x, u = smooth(n)
    return 1.001 * t, x, u


def other_minimum() -> Trajectory:
    """The states of another control: a = 6 - 12 t + eps (1 - 6 t + 6 t^2), which does not change the end."""
    t, x, u = smooth()
    dv, dq = EPS * (t - 3 * t**2 + 2 * t**3), EPS * (t**2 / 2 - t**3 + t**4 / 2)
    return t, {"q": x["q"] + dq, "v": x["v"] + dv}, {"a": u["a"] + EPS * (1 - 6 * t + 6 * t**2)}


def shifted(kind: int, name: str) -> Trajectory:
    trajectory = smooth()
    trajectory[kind][name] = trajectory[kind][name] + EPS
    return trajectory


@pytest.mark.parametrize(
    ("wrong", "sees"),
    [
        (other_minimum, "stationarity"),
        (late, "boundary conditions"),
        (lambda: shifted(1, "v"), "dynamics"),
        (lambda: shifted(2, "a"), "dynamics"),
    ],
)
def test_wrong_by_a_thousandth_fails(wrong: Callable[[], Trajectory], sees: str) -> None:
    assert sees in failed(least_energy(), wrong())


def test_small_controls_of_slow_motions_are_not_rounding() -> None:
    """Over 1 au in a year: at most 7e-15 au/s^2."""
    year = 3e7
    for right, (t, x, u) in ((True, smooth()), (False, other_minimum())):
        states = {"q": x["q"], "v": x["v"] / year}
        verdict = go.verify_trajectory(least_energy(time=year), year * t, states, {"a": u["a"] / year**2})
        assert verdict.minimum is right, verdict.explain()


def test_defects_that_cancel_between_times_given_twice_are_inconclusive() -> None:
    """As inside the segments of another tool, at whose ends the states are accurate."""
    even = np.linspace(0.0, 1.0, 61)
    for t, word in ((np.sort(np.append(even, even[12:-1:12])), "INCONCLUSIVE"), (even, "FAIL")):
        v = 6 * t - 6 * t**2 + 1e-4 * np.sin(5 * np.pi * t) ** 2
        verdict = go.verify_trajectory(
            least_energy(), t, {"q": 3 * t**2 - 2 * t**3, "v": v}, {"a": 6 - 12 * t}
        )
        assert verdict["dynamics"].result.value == word and not verdict.ok


@pytest.mark.slow
def test_feasible_switch_at_the_wrong_time_fails() -> None:
    """Weaker braking after an earlier switch keeps all limits and takes longer: no multipliers explain it."""
    switch, force = 0.98, 1.0
    brake = 2 / switch - force
    t = np.linspace(0.0, switch + force * switch / brake, 16)
    assert brake > 1  # keeps no limit, so that bounds must see it
    assert "limits" in failed(least_time(), (t, *two_pulses(t, switch)))
    switch = 1.02
    brake = 2 / switch - force
    t = np.linspace(0.0, switch + force * switch / brake, 16)
    assert brake < 1
    assert not go.verify_trajectory(least_time(), t, *two_pulses(t, switch)).ok


@pytest.mark.slow
def test_limit_crossed_by_the_control_fails() -> None:
    assert "limits" in failed(least_energy(5.99), smooth())


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"t": np.linspace(0, 1, 5)[::-1]}, "decrease"),
        ({"t": np.zeros(5)}, "two or more"),
        ({"t": [0.0, 0.5, 0.5, 0.5, 1.0]}, "more than twice"),
        ({"t": [0.0, 0.0, 0.5, 0.7, 1.0]}, "at an end"),
        ({"t": np.linspace(0, 1, 6)}, "one column per time"),
        ({"x": np.zeros((3, 5))}, r"shape \(3, 5\) where \(2, 5\)"),
        ({"x": {"q": np.zeros(5)}}, "state 'v'.* is missing"),
        ({"x": {"q": np.zeros(5), "w": np.zeros(5)}}, "no state 'w'"),
        ({"u": {"b": np.zeros(5)}}, "no control 'b'"),
        ({"u": [0, 0, np.nan, 0, 0]}, "not every number is finite"),
        ({"u": "fast"}, "fast"),
        ({"p": [1.0]}, "1 values: give 0"),
        ({"p": {"mass": 1.0}}, "no free parameter 'mass'"),
        ({"t": {"legs": np.linspace(0, 1, 5)}, "x": {}, "u": {}}, "no phase 'legs'"),
    ],
)
def test_mistakes_are_named(change: dict[str, Any], says: str) -> None:
    usual: dict[str, Any] = {"t": np.linspace(0, 1, 5), "x": np.zeros((2, 5)), "u": np.zeros(5), "p": None}
    with pytest.raises(go.ProblemError, match=says):
        go.verify_trajectory(least_energy(), **(usual | change))


def test_missing_parameters_and_phases_are_named() -> None:
    with pytest.raises(go.ProblemError, match=r"free parameter 'k'.* is missing"):
        go.verify_trajectory(design_problem(), *smooth())
    with pytest.raises(go.ProblemError, match="there are several"):
        go.verify_trajectory(interior_point.build(), *smooth())


def three_arcs(*durations: float) -> tuple[Array, Array]:
    """Times of arcs one after the other, both ends of each included, and which arc each is of."""
    ends = np.cumsum([0.0, *durations])
    times = np.concatenate([np.linspace(a, b, 11) for a, b in itertools.pairwise(ends)])
    return times, np.repeat(np.arange(len(durations)), 11)


def speed_limited(unit: float, *, in_time: bool) -> go.Problem:
    """Rest to rest over one unit, at no more than 1.3: with the least effort in 1 s, or in the least time."""
    model, _q, _v, a = dynamics("cart", "q v", "a", lambda q, v, a: {q: v, v: a})
    problem, leg = one_phase("speed limited", model, 0.0, (0.1, 9.0) if in_time else 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=unit, v=0.0)
    leg.bounds(v=(None, 1.3 * unit))
    if in_time:
        leg.bounds(a=(-8.0 * unit, 8.0 * unit))
    problem.minimize(leg.final_time if in_time else leg.integral((a / unit) ** 2))
    return problem


@pytest.mark.parametrize("unit", [1.0, 1e4, 1e-4])
def test_an_arc_given_with_both_its_ends_twice_is_a_minimum(unit: float) -> None:
    """The control has kinks there and no jumps, so that these times are none to be optimised."""
    rise = 1.5 * (1 - 1 / 1.3)  # the area under the speed is 1
    t, arc = three_arcs(rise, 1 - 2 * rise, rise)
    left = np.choose(arc, [1 - t / rise, 0 * t, 1 - (1 - t) / rise])  # how far from the limit
    way = np.choose(arc, [rise / 3 * (left**3 - 1), -rise / 3 + 0 * t, -rise / 3 * (1 + left**3)])
    states = [unit * (1.3 * (t + way)), unit * 1.3 * (1 - left**2)]
    force = unit * 2.6 / rise * left * np.choose(arc, [1, 0, -1])
    verdict = go.verify_trajectory(speed_limited(unit, in_time=False), t, states, force)
    assert verdict.minimum, verdict.explain()


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1e4])
def test_switches_onto_a_limit_and_off_it_are_variables_too(unit: float) -> None:
    """The control is on a bound, then where the limit wants it, then on the other bound."""
    rise = 1.3 / 8
    last = 1 / 1.3 + rise
    t, arc = three_arcs(rise, last - 2 * rise, rise)
    way = np.choose(arc, [4 * t**2, 1.3 * (t - rise / 2), 1 - 4 * (last - t) ** 2])
    speed = np.choose(arc, [8 * t, 1.3 + 0 * t, 8 * (last - t)])
    force = unit * np.choose(arc, [8.0, 0.0, -8.0])
    problem = speed_limited(unit, in_time=True)
    verdict = go.verify_trajectory(problem, t, [unit * way, unit * speed], force)
    assert verdict.minimum, verdict.explain()
    slow = 1.001  # takes its time
    late = go.verify_trajectory(problem, slow * t, [unit * way, unit * speed / slow], force / slow**2)
    assert not late.ok and late["dynamics"].result is go.ConditionResult.PASS


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1e4])
@pytest.mark.parametrize("share", [1.0, 0.8])
def test_a_mixed_constraint_that_holds_all_along_determines_the_control(share: float, unit: float) -> None:
    """As far as possible with x + u <= 1: riding on the limit is best, and the limit never moves."""
    model, x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("mixed", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(0.0, 2.0 * unit))
    leg.path("sum", x + u, upper=unit)
    problem.maximize(leg.final_state("x"))
    t = np.linspace(0.0, 1.0, 41)
    rest = np.exp(-share * t)
    verdict = go.verify_trajectory(problem, t, unit * (1 - rest), unit * share * rest)
    assert verdict.minimum is (share == 1.0), verdict.explain()
    assert verdict.ok is (share == 1.0)


def one_state(rates: Callable[[Any, Any], Any], **bounds: tuple[float, float]) -> tuple[go.Problem, go.Phase]:
    model, *_ = dynamics("one state", "x", "u", lambda x, u: {x: rates(x, u)})
    problem = go.Problem("one state")
    leg = problem.phase("leg", model)
    leg.bounds(**bounds)
    return problem, leg


@pytest.mark.parametrize("price", [0.3, 30.0])
def test_bounds_that_leave_one_way_only_push_the_right_way(price: float) -> None:
    """x' = u <= 1 from 0 to 1 in 1 s is u = 1 whatever it costs: its costate may be anything that is low enough."""
    problem, leg = one_state(lambda x, u: u, u=(-1.0, 1.0))
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    u, x = leg.model.symbol("u"), leg.model.symbol("x")
    problem.minimize(leg.integral(u**2 + price * x))
    t = np.linspace(0.0, 1.0, 31)
    assert go.verify_trajectory(problem, t, t, 1 + 0 * t).ok


def test_a_limit_is_active_up_to_a_singular_arc() -> None:
    """u = -1 until x = 0 at 1 s; the switching function is below 1e-5 at the last samples before."""
    problem, leg = one_state(lambda x, u: u, u=(-1.0, 1.0))
    leg.time(0.0, 2.0)
    leg.initial(x=1.0)
    problem.minimize(leg.integral(ca.sin(leg.model.symbol("x")) ** 2))
    s, bang = np.linspace(0.0, 1.0, 401), np.repeat([1.0, 0.0], 401)
    t = np.append(s, 1 + s)
    assert go.verify_trajectory(problem, t, bang * (1 - t), -bang).minimum


@pytest.mark.slow
def test_costates_faster_than_the_states() -> None:
    """x' = -u sqrt(x), u <= 1, empties from 1 to 0.01 in 1.8 s: lam = -1 / sqrt(x), though x is a parabola."""
    problem, leg = one_state(lambda x, u: -u * ca.sqrt(x), u=(0.0, 1.0))
    leg.time(0.0, (0.1, 50.0))
    leg.initial(x=1.0)
    leg.final(x=0.01)
    problem.minimize(leg.final_time)
    for u, right in ((1.0, True), (0.9, False)):
        t = np.linspace(0.0, 1.8 / u, 61)
        verdict = go.verify_trajectory(problem, t, (1 - u * t / 2) ** 2, u + 0 * t)
        assert verdict.ok is right, verdict.explain()


@pytest.mark.parametrize("bend", [0.5, -0.5, -1.5])
def test_a_free_constant_that_is_stated_as_a_state_counts_as_a_variable(bend: float) -> None:
    """x' = u + k, k' = 0: (1 - k)^2 + bend (k - 1/2)^2 + k is stationary at k = 1/2 and least there for bend > -1."""
    model, _x, _k, u = dynamics("drift", "x k", "u", lambda x, k, u: {x: u + k, k: 0 * k})
    problem, leg = one_phase("drift", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    end = leg.final_state("k")
    problem.minimize(leg.integral(u**2) + bend * (end - 0.5) ** 2 + end)
    t = np.linspace(0.0, 1.0, 21)
    verdict = go.verify_trajectory(problem, t, [t, 0.5 + 0 * t], 0.5 + 0 * t)
    assert verdict.minimum if bend > -1 else [c.name for c in verdict.failed] == ["second order"]


@pytest.mark.parametrize("bend", [2.0, -3.0])
def test_a_free_constant_beside_a_switch(bend: float) -> None:
    """Rest to rest over 1 with the push k takes 2 / sqrt(k); k - 1 + bend (k - 1)^2 on top is stationary at 1."""
    model, *_ = dynamics("push", "q v k", "u", lambda q, v, k, u: {q: v, v: k * u, k: 0 * k})
    problem, leg = one_phase("push", model, 0.0, (0.1, 20.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.bounds(u=(-1.0, 1.0))
    end = leg.final_state("k")
    problem.minimize(leg.final_time + end - 1 + bend * (end - 1) ** 2)
    s = np.linspace(0.0, 1.0, 21)
    t, u_given = np.append(s, 1 + s), np.repeat([1.0, -1.0], 21)
    states = [np.append(s**2 / 2, 1 - (1 - s) ** 2 / 2), np.append(s, 1 - s), 1 + 0 * t]
    verdict = go.verify_trajectory(problem, t, states, u_given)
    assert verdict.minimum if bend > 0 else [c.name for c in verdict.failed] == ["second order"]


@pytest.mark.slow
def test_vector_control_by_its_own_name() -> None:
    """From rest at the origin to (3, 4) at rest with a force of at most 1: full force, turned round half-way."""
    model = go.Model("body")
    r, v = model.state("r", 2), model.state("v", 2)
    force, _ = model.vector_control("F", 2)
    model.ode({r: v, v: force})
    problem, leg = one_phase("to a place and stop", model, 0.0, (0.1, 10.0), name="there and stop")
    leg.initial(r=[0.0, 0.0], v=[0.0, 0.0])
    leg.final(r=[3.0, 4.0], v=[0.0, 0.0])
    leg.norm_bounds(F=(0.0, 1.0))
    problem.minimize(leg.final_time)
    half = np.sqrt(5.0)
    t = np.concatenate([np.linspace(0.0, half, 11), np.linspace(half, 2.0 * half, 11)])
    sign = np.repeat([1.0, -1.0], 11)
    speed = np.minimum(t, 2.0 * half - t)
    way = np.where(sign > 0, t**2 / 2.0, 5.0 - (2.0 * half - t) ** 2 / 2.0)
    along = np.array([[0.6], [0.8]])
    states, wrong = {"r": along * way, "v": along * speed}, np.array([[0.8], [0.6]])
    assert go.verify_trajectory(problem, t, states, {"F": along * sign}).ok
    assert not go.verify_trajectory(problem, t, states, {"F": wrong * sign}).ok
    with pytest.raises(go.ProblemError, match=r"control 'F' .* has shape"):
        go.verify_trajectory(problem, t, states, {"F": sign})


@pytest.mark.parametrize(
    ("samples", "off", "word"), [(33, 0.0, "inconclusive"), (65, 0.0, "ok"), (33, 0.02, "NOT ok")]
)
def test_errors_of_interpolation_are_no_failures(samples: int, off: float, word: str) -> None:
    """Least of the integral of x^2 + u^2 with x' = u over 8 s: x = cosh(T - t) / cosh(T), u = x'.

    Few samples leave errors that grow where half of them are left out; those of another trajectory do not.
    """
    model, x, u = dynamics("leak", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("regulator", model, 0.0, 8.0)
    leg.initial(x=1.0)
    leg.bounds(u=(-10.0, 10.0))
    problem.minimize(leg.integral(x**2 + u**2))
    t = np.linspace(0.0, 8.0, samples)
    rate = 1.0 + off
    states = np.cosh(rate * (8.0 - t)) / np.cosh(rate * 8.0)
    controls = -rate * np.sinh(rate * (8.0 - t)) / np.cosh(rate * 8.0)
    verdict = go.verify_trajectory(problem, t, {"x": states}, {"u": controls})
    assert verdict.outcome.startswith(word)
    assert (word == "inconclusive") == any("samples are too coarse" in c.where for c in verdict.conditions)


@pytest.mark.parametrize("miss", [(1e-4, 0.0), (1e-4, -2e-4)])
def test_a_missed_end_counts_the_same_as_final_value_and_as_constraint(miss: tuple[float, float]) -> None:
    t = np.linspace(0.0, 1.0, 41)
    q, v = 1.0 + miss[0], miss[1]
    x = {"q": (3 * q - v) * t**2 + (v - 2 * q) * t**3, "v": 2 * (3 * q - v) * t + 3 * (v - 2 * q) * t**2}
    found = []
    for constrained in ((), ("q",), ("q", "v")):
        problem, leg = one_phase("least energy", double_integrator(), 0.0, 1.0)
        leg.initial(q=0.0, v=0.0)
        for name, value in (("q", 1.0), ("v", 0.0)):
            if name in constrained:
                problem.constrain(name, leg.final_state(name), equals=value)
            else:
                leg.final(**{name: value})
        problem.minimize(leg.integral(leg.model.symbol("a") ** 2))
        verdict = go.verify_trajectory(problem, t, x, {"a": 2 * (3 * q - v) + 6 * (v - 2 * q) * t})
        condition = verdict["boundary conditions"]
        place = condition.where.replace("constraint ", "").replace("phase leg, end, ", "")
        found.append((condition.value, condition.result.value, place.partition(" m")[0]))
    assert found[0][1] == "FAIL"
    assert {row[1:] for row in found} == {found[0][1:]}
    np.testing.assert_allclose([row[0] for row in found], found[0][0], rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("periods", "passes"), [(1, False), (10, True)])
def test_fast_deviations_of_a_control_displace_nothing(periods: int, passes: bool) -> None:
    """The integral of a deviation counts, by as much with denser samples: about 2 d / w for d cos(w t)."""
    rate, size = 2.0 * np.pi * periods, 1e-4 * np.sqrt(12.0)  # of the root mean square of 6 - 12 t
    values = []
    for n in (61, 121) if periods == 1 else (121, 241):
        t, x, u = smooth(n)
        x = {
            "q": x["q"] + size * (1 - np.cos(rate * t)) / rate**2,
            "v": x["v"] + size * np.sin(rate * t) / rate,
        }
        verdict = go.verify_trajectory(least_energy(), t, x, {"a": u["a"] + size * np.cos(rate * t)})
        assert (verdict["stationarity"].result.value == "PASS") == passes
        values.append(verdict["stationarity"].value)
    np.testing.assert_allclose(values, 2e-4 / rate, rtol=0.5)
    assert values[1] == pytest.approx(values[0], rel=1e-3)


@pytest.mark.parametrize(("start", "passes"), [(1.0, True), (1.01, False)])
def test_a_price_of_the_start(start: float, passes: bool) -> None:
    """Energy 1 / (3 - t_0) of a way of 1 until t = 3, less t_0 / 4: the best start is at 1 s."""
    model, *_, u = dynamics("mover", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("late", model, (0.0, 2.0), 3.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    problem.minimize(leg.integral(u**2) - leg.initial_time / 4)
    t = np.linspace(start, 3.0, 21)
    speed = 1.0 / (3.0 - start)
    verdict = go.verify_trajectory(problem, t, {"x": speed * (t - start)}, {"u": np.full(21, speed)})
    assert verdict.ok == passes
    assert passes or "stationarity" in {c.name for c in verdict.failed}


def limit(leg: go.Phase, name: str, upper: float, kind: str) -> None:
    """Limit a state by its bounds or by a path constraint."""
    if kind == "bounds":
        leg.bounds(**{name: (None, upper)})
    else:
        leg.path("limit", leg.model.symbol(name), upper=upper)


@pytest.mark.parametrize("kind", ["bounds", "path"])
def test_a_limit_active_along_the_phase_determines_the_trajectory(kind: str) -> None:
    """q' = v <= 1 from v = 1: v = 1 maximises q(1), with the multiplier 1 and a switching function of zero."""
    problem, leg = one_phase("fast", double_integrator(), 0.0, 1.0)
    leg.initial(q=0.0, v=1.0)
    leg.bounds(a=(-1.0, 1.0))
    limit(leg, "v", 1.0, kind)
    problem.maximize(leg.final_state("q"))
    t = np.linspace(0.0, 1.0, 61)
    assert go.verify_trajectory(problem, t, {"q": t, "v": 1 + 0 * t}, {"a": 0 * t}).minimum


def touch_threshold(height: float, cells: int = 400) -> float:
    """Largest k for which int a^2 - k I^2, I = int sin(2 pi t) q, is convex where q(1/2) = h is the maximum of q.

    Antisymmetric variations with dq(1/2) = 0 move the maximum: the multiplier eta adds eta dv(1/2)^2 / (2 |a(1/2)|).
    """
    t, width = np.linspace(0.0, 0.5, 2001), 0.5 / cells
    middles = (np.arange(cells) + 0.5) * width
    moved = np.maximum(t - middles[:, None], 0.0) * width
    by_integral = 2 * np.trapezoid(np.sin(2 * np.pi * t) * moved, t, axis=1)
    eta, push = 96 - 384 * height, 24 * height - 4
    hessian = 2 * width * np.eye(cells) + eta / (2 * push) * width**2
    matrix = np.block([[hessian, moved[:, -1:]], [moved[:, -1:].T, np.zeros((1, 1))]])
    return float(1 / (by_integral @ np.linalg.solve(matrix, np.append(by_integral, 0.0))[:-1]))


@pytest.mark.parametrize("kind", ["bounds", "path"])
@pytest.mark.parametrize("share", [0.97, 1.03])
def test_the_time_of_a_touch_point_is_a_variable(share: float, kind: str) -> None:
    """q'' = a from v = 1 to v = -1 with q <= h = 0.2 touches once, at 1/2; -k I^2 makes that a saddle for large k."""
    height = 0.2
    problem, leg = one_phase("touch", double_integrator(), 0.0, 1.0)
    leg.initial(q=0.0, v=1.0)
    leg.final(q=0.0, v=-1.0)
    limit(leg, "q", height, kind)
    a, q = (leg.model.symbol(name) for name in "aq")
    share_of_first_mode = leg.integral(ca.sin(2 * np.pi * leg.model.time) * q)
    problem.minimize(leg.integral(a**2) - share * touch_threshold(height) * share_of_first_mode**2)
    t = np.linspace(0.0, 1.0, 81)
    cubic = np.polynomial.Polynomial([0.0, 1.0, 12 * height - 4, 4 - 16 * height])
    before, sign = np.minimum(t, 1 - t), np.where(t <= 0.5, 1, -1)
    x = {"q": cubic(before), "v": sign * cubic.deriv()(before)}
    verdict = go.verify_trajectory(problem, t, x, {"a": cubic.deriv(2)(before)})
    assert verdict.minimum if share < 1 else [c.name for c in verdict.failed] == ["second order"]


@pytest.mark.parametrize("width", [1e-3, 1e-5])
@pytest.mark.parametrize("depth", [2.0, 8.0])
def test_curvature_in_a_time_shorter_than_the_samples(depth: float, width: float) -> None:
    """u^2 - depth d(t - s) (x^2 - x^4) from 0 to 0: x(s)^2 <= s (1 - s) int u^2, so x = 0 is best for depth < 4."""
    problem, leg = one_state(lambda x, u: u)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=0.0)
    x, u = leg.model.symbol("x"), leg.model.symbol("u")
    pulse = ca.exp(-(((leg.model.time - 0.5137) / width) ** 2)) / width / np.sqrt(np.pi)
    problem.minimize(leg.integral(u**2 + 1 - depth * pulse * (x**2 - x**4)))
    t = np.linspace(0.0, 1.0, 61)
    verdict = go.verify_trajectory(problem, t, 0 * t, 0 * t)
    assert verdict.minimum if depth < 4 else [c.name for c in verdict.failed] == ["second order"]


@pytest.mark.parametrize("width", [1e-3, 1e-5])
def test_a_price_in_a_time_shorter_than_the_samples(width: float) -> None:
    """u^2 + 4 d(t - s) (x - t) from 0 to 1: x = t costs 1, and less with a kink at s."""
    problem, leg = one_state(lambda x, u: u)
    leg.time(0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    x, u, time = leg.model.symbol("x"), leg.model.symbol("u"), leg.model.time
    pulse = ca.exp(-(((time - 0.5137) / width) ** 2)) / width / np.sqrt(np.pi)
    problem.minimize(leg.integral(u**2 + 4 * pulse * (x - time)))
    t = np.linspace(0.0, 1.0, 61)
    assert "stationarity" in failed(problem, (t, t, 1 + 0 * t))


def test_a_limit_relative_to_an_uncontrolled_target() -> None:
    """Both fly at 1000 m/s for 500 s, and meet after z = 12 amp s (1 - s)^2 - amp (1 + 2 s) (1 - s)^2 passed 1077 m."""
    size, last, speed = 1000.0, 500.0, 1000.0
    model, *_ = dynamics("target", "x v y", "a", lambda x, v, y, a: {x: v, v: a, y: speed + 0 * y})
    problem, leg = one_phase("target", model, 0.0, (50.0, 2000.0))
    leg.initial(x=-size, v=speed + 12 * size / last, y=0.0)
    leg.final(v=speed)
    x, y, a = (leg.model.symbol(name) for name in "xya")
    problem.constrain("meet", leg.final_state("x") - leg.final_state("y"), equals=0.0)
    leg.path("corridor", x - y, upper=1077.0)
    s = np.polynomial.Polynomial([0.0, 1.0])
    z = size * (1 - s) ** 2 * (10 * s - 1)
    energy = (z.deriv(2) ** 2).integ()(1.0) / last**3
    growth = (-36 + 24 * 12 - 4 * 144) * size**2 / last**4  # of the least energy, with the duration
    problem.minimize((leg.integral(a**2) - leg.final_time * growth) / energy)
    t = np.linspace(0.0, last, 121)
    at = t / last
    states = [z(at) + speed * t, z.deriv()(at) / last + speed, speed * t]
    assert failed(problem, (t, states, z.deriv(2)(at) / last**2)) == {"limits"}


@pytest.mark.parametrize(("power", "off"), [(1, 1e-4), (3, 0.02), (4, 0.03), (5, 0.1)])
def test_powers_of_a_condition_are_as_far_as_the_condition(power: int, off: float) -> None:
    """x stays at 1 - off, and x(1) = 1 is asked as (x(1) - 1)^power = 0."""
    problem, leg = one_state(lambda x, u: u)
    leg.time(0.0, 1.0)
    problem.constrain("end", (leg.final_state("x") - 1.0) ** power, equals=0.0)
    problem.minimize(leg.integral(leg.model.symbol("u") ** 2 + 1.0))
    t = np.linspace(0.0, 1.0, 21)
    assert "boundary conditions" in failed(problem, (t, 1 - off + 0 * t, 0 * t))


@pytest.mark.parametrize("speed", [0.0, 7500.0])
@pytest.mark.parametrize("bend", [1.0, 3.0])
def test_the_duration_of_a_short_way_in_a_fast_frame(bend: float, speed: float) -> None:
    """12 k d^2 / T^3 + T - bend (T - T_0)^2 / T_0 is stationary at T_0 and least there for bend < 2."""
    last, way = 500.0, 100.0
    model, *_ = dynamics("frame", "x v y", "a", lambda x, v, y, a: {x: v, v: a, y: speed + 0 * y})
    problem, leg = one_phase("frame", model, 0.0, (50.0, 2000.0))
    leg.initial(x=0.0, v=speed, y=way)
    leg.final(v=speed)
    problem.constrain("meet", leg.final_state("x") - leg.final_state("y"), equals=0.0)
    effort = leg.integral(model.symbol("a") ** 2) * last**4 / 36 / way**2
    problem.minimize(effort + leg.final_time - bend * (leg.final_time - last) ** 2 / last)
    t, s = np.linspace(0.0, last, 121), np.linspace(0.0, 1.0, 121)
    x = [speed * t + way * (3 * s**2 - 2 * s**3), speed + way * (6 * s - 6 * s**2) / last, way + speed * t]
    verdict = go.verify_trajectory(problem, t, x, way * (6 - 12 * s) / last**2)
    assert verdict.minimum if bend < 2 else [c.name for c in verdict.failed] == ["second order"]
