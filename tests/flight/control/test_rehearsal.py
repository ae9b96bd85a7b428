"""A start and limits are judged together: against an own loop by SciPy, from both sides."""

import re
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
import scipy

import gnc_opt as go
from gnc_opt.control import (
    ConstantRate,
    ExponentialRate,
    SaturationLayer,
    design_feedback_linearization,
    design_sliding_mode,
    rehearsal,
)
from gnc_opt.errors import DesignError

GRAVITY = 9.81


def pendulum() -> go.Model:
    model = go.Model("pendulum")
    th, w, T = model.state("th", unit="rad"), model.state("w", unit="rad/s"), model.control("T", unit="N m")
    model.ode({th: w, w: GRAVITY * ca.sin(th) + T})
    return model


def slider(**options):
    return design_sliding_mode(
        pendulum(),
        [0, 0],
        outputs="th",
        slopes=2.0,
        reaching=ConstantRate(1.0),
        boundary=SaturationLayer(0.05),
        bound=0.2,
        dt=0.01,
        **options,
    )


def linearised(**options):
    return design_feedback_linearization(pendulum(), [0, 0], outputs="th", poles=[-2, -2], dt=0.01, **options)


def fly(controller, start, limit, tf=8.0):
    """Return commands and states (2, n + 1) of the pendulum under the cut command, by an integrator of SciPy."""
    x, z, commands, states = np.array(start, dtype=float), None, [], [np.array(start)]
    for k in range(round(tf / 0.01)):
        u, z = controller(0.01 * k, x, z)
        cut = float(np.clip(u[0], -limit, limit))
        rate = lambda t, y, cut=cut: [y[1], GRAVITY * np.sin(y[0]) + cut]  # noqa: E731
        x = scipy.integrate.solve_ivp(rate, (0, 0.01), x, rtol=1e-9, atol=1e-11).y[:, -1]
        commands.append(u[0])
        states.append(x)
    return np.array(commands), np.array(states).T


@pytest.mark.parametrize("design", [slider, linearised])
def test_a_start_that_the_limits_cannot_hold_is_refused(design):
    """The torque of 5 N m holds the pendulum up to asin(5 / 9.81) = 0.535 rad."""
    _, states = fly(design(limits=(-5, 5)), [1.2, 0.0], 5.0)
    assert np.max(np.abs(states[0])) > 3  # so it is: it falls
    with pytest.raises(
        DesignError, match=r"limits keep th from coming down: .*'T' for -1\d.* limits are -5 and 5"
    ):
        design(limits=(-5, 5), start=[1.2, 0.0])


@pytest.mark.parametrize("design", [slider, linearised])
def test_a_start_that_the_limits_hold_passes_and_the_time_at_the_limits_is_told(design):
    controller = design(limits=(-5, 5), start=[0.5, 0.0])
    commands, states = fly(controller, [0.5, 0.0], 5.0)
    assert abs(states[0, -1]) < 0.01
    at_limits = 0.01 * np.sum(np.abs(commands) > 5)
    assert at_limits > 0
    assert controller.explain()["limits act for"] == pytest.approx(at_limits, abs=0.011)


def path(outputs, wanted=((0.0,),)):
    outputs, wanted = np.array(outputs, dtype=float), np.array(wanted, dtype=float)
    times = 0.1 * np.arange(outputs.shape[1])
    return rehearsal.Path(times, np.zeros((1, times.size)), wanted, np.zeros((0, times.size)), outputs)


def test_what_is_left_of_an_error_is_its_largest_in_the_last_tenth():
    """In shares of the largest of all; of few steps the last one counts, and what is zero all along has come down."""
    ten = [8.0, -4.0, *[1.0] * 15, 0.0, 2.0, -1.0]
    found = path([ten, [0.0] * 20, [-v for v in ten]])
    assert rehearsal._left(found, 20).tolist() == [2 / 8, 0.0, 2 / 8]
    assert rehearsal._left(found, 19).tolist() == [1 / 8, 0.0, 1 / 8] == rehearsal._left(found, 5).tolist()
    assert rehearsal._left(found, 30).tolist() == [2 / 8, 0.0, 2 / 8]


def test_a_command_is_cut_beyond_its_limits_but_for_rounding():
    limits = (np.array([-1.0, -4.0]), np.array([1.0, 4.0]))
    wanted = [[1.0, 1.1, -1.1, 0.0, 0.0, 1 + 1e-14], [0.0, 0.0, 0.0, -4.1, 4.1, -4 - 1e-14]]
    found = path([[1.0] * 7], wanted)
    assert found.cut(limits).tolist() == [False, True, True, True, True, False]
    assert found.cut(None).tolist() == [False] * 6
    (fact,) = rehearsal.limit_facts(found, limits, 0.25)
    assert fact.value == 1.0 and fact.unit == "s" and rehearsal.limit_facts(found, None, 0.25) == []


def test_what_the_limits_keep_up_is_named_with_its_first_and_largest_excess():
    limits = (np.array([-1.0, -4.0]), np.array([1.0, 4.0]))
    wanted = [[0.0, 3.0, 0.0, 9.0], [0.0, -4.5, 0.0, 0.0]]
    found = path([[1.0, 1.0, 1.0, 1.0, 0.2], [1.0, 1.0, 1.0, 2.0, -1.5]], wanted)
    model = go.Model("two")
    model.control("F"), model.control("T")
    errors = SimpleNamespace(labels=["q", "th"], pair=SimpleNamespace(model=model))
    told = rehearsal._stuck(found, errors, limits, 10)
    assert "keep th from coming down: the law asks control 'F' for 3 at t = 0.1 s" in told
    assert "limits are -1 and 1, and the error is still -1.5 at t = 0.4 s" in told
    other = rehearsal._stuck(path([[1.0] * 3], [[1.2, 0.0], [-4.5, 0.0]]), errors, limits, 10)
    assert "control 'T' for -4.5 at t = 0 s, where its limits are -4 and 4" in other


@pytest.mark.parametrize(("rate", "steps"), [(0.5, 2), (3.01, 4), (100.0, 50)])
def test_integration_steps_follow_the_fastest_mode(rate, steps):
    """A tenth of its time constant, 0.1 s here; at least two and at most fifty."""
    model = go.Model("mode")
    x, u = model.state("x"), model.control("u")
    model.ode({x: -rate * x + u})
    errors = SimpleNamespace(pair=SimpleNamespace(t=model.time, x=x, u=u, f=model.derivative()))
    assert rehearsal._inner_steps(errors, go.Reference.constant(model, [0.0]), 0.1, np.zeros(1)) == steps


def test_reaching_time_is_that_of_the_limited_command():
    free = slider(start=[0.5, 0.0]).explain()["reaching time"][0]
    assert free == pytest.approx(1.0 / 0.8)
    told = slider(limits=(-5, 5), start=[0.5, 0.0]).explain()["reaching time"][0]
    _, states = fly(slider(limits=(-5, 5)), [0.5, 0.0], 5.0)
    s = states[1] + 2 * states[0]
    assert told == pytest.approx(0.01 * np.argmax(np.abs(s) <= 0.05), abs=0.021)


def cubic(sign: float) -> go.Model:
    """Zero dynamics +-eta^3 with an eigenvalue of zero: from eta_0 they are eta_0 / sqrt(1 -+ 2 eta_0^2 t)."""
    model = go.Model("cubic")
    x1, eta, u = model.state("x1"), model.state("eta"), model.control("u")
    model.ode({x1: u, eta: sign * eta**3 + x1})
    return model


def held(sign: float, start: list[float], **options):
    law = {"reaching": ExponentialRate(1.0, 1.0), "boundary": SaturationLayer(0.1), "dt": 0.01} | options
    return design_sliding_mode(cubic(sign), [0, 0], outputs="x1", start=start, **law)


def test_zero_dynamics_that_blow_up_from_a_start_are_refused():
    """eta' = eta^3 + x1 is critical at rest and escapes in finite time from x1 = 0.5."""
    with pytest.raises(DesignError, match=r"runs away: 'eta' leaves all bounds at t = \d"):
        design_feedback_linearization(cubic(1), [0, 0], outputs="x1", poles=[-1.0], start=[0.5, 0.0], dt=0.01)
    with pytest.raises(DesignError, match="runs away: 'eta'"):
        held(1, [1.5, 0.0], reaching=ConstantRate(1.0))


def test_what_a_run_takes_for_diverged_is_refused_though_it_comes_back():
    """Zero dynamics that grow by exp(3 t) for 20 s and decay afterwards: eta passes 1e25."""
    model = go.Model("unstable in the middle")
    y, eta, phase, u = model.state("y"), model.state("eta"), model.state("phase"), model.control("u")
    model.ode({y: u, eta: (3 - 4 * phase) * eta + y, phase: phase * (1 - phase)})
    rise = lambda t: 1 / (1 + np.exp(20 - t))  # noqa: E731
    reference = go.Reference.from_functions(model, lambda t: [0.0, 0.0, rise(t)], lambda t: [0.0], 0.0, 60.0)
    start = [0.1, 0.0, rise(0.0)]
    task = {"outputs": "y", "poles": [-1.0], "dt": 0.05}
    run = go.ClosedLoop(model, design_feedback_linearization(model, reference, **task)).simulate(
        start, tf=60.0
    )
    assert run.outcome.diverged
    with pytest.raises(DesignError, match=r"'eta' leaves all bounds at t = 12"):
        design_feedback_linearization(model, reference, **task, start=start)


@pytest.mark.parametrize("eta", [0.3, 0.1])
def test_a_rehearsal_lasts_until_zero_dynamics_have_blown_up(eta):
    """They escape at 1 / (2 eta^2) = 5.56 s and 50 s, however soon the output is where it belongs."""
    with pytest.raises(DesignError, match="runs away: 'eta'") as refused:
        held(1, [0.0, eta])
    told = float(re.search(r"t = ([\d.]+) s", str(refused.value))[1])
    assert told == pytest.approx(0.5 / eta**2, abs=0.02)


def test_what_moves_away_too_slowly_to_be_seen_out_is_told():
    found = held(1, [0.0, 0.01]).explain()
    (fact,) = [fact for fact in found.facts if fact.name == "still moving away"]
    at = float(re.search(r"t = ([\d.]+) s", fact.remark)[1])
    assert fact.value == pytest.approx(0.01 / np.sqrt(1 - 2e-4 * at), rel=1e-5) and "'eta'" in fact.remark
    assert at > 100


@pytest.mark.parametrize("start", [[0.5, 0.0], [0.0, 20.0]])
def test_zero_dynamics_that_come_back_are_not_refused(start):
    """eta' = -eta^3 + x1 decays; at eta = 20 its slope is -1200 1/s, at the reference 0."""
    found = held(-1, start).explain()
    assert "still moving away" not in str(found) and "reaching time" in str(found)


@pytest.mark.parametrize("tail", ["hold", "none"])
def test_a_reference_that_does_not_rest_is_rehearsed_to_its_end(tail):
    """A car at 10 m/s: what is held after its end, a place that moves on, would stop it, where it cannot be steered."""
    model = go.Model("car")
    x, y, heading, v, wheel, pull = (model.state(k) for k in ("x", "y", "heading", "v", "wheel", "pull"))
    jerk, steer = model.control("jerk"), model.control("steer")
    turn = {heading: v * ca.tan(wheel), wheel: steer, v: pull, pull: jerk}
    model.ode({x: v * ca.cos(heading), y: v * ca.sin(heading)} | turn)
    straight = go.Reference.from_functions(
        model, lambda t: [10 * t, 0, 0, 10, 0, 0], lambda t: [0, 0], 0.0, 6.0, tail=tail
    )
    start = [2.0, -1.0, 0.05, 9.5, 0.0, 0.0]
    task = {"outputs": ["x", "y"], "start": start, "limits": ([-20, -1], [20, 1]), "dt": 0.05}
    law = design_feedback_linearization(model, straight, poles=[-1, -1.5, -2], **task)
    run = go.ClosedLoop(model, law).simulate(start, tf=5.9)
    assert run.outcome.ok and np.max(np.abs(run.errors[:2, -1])) < 0.1
    layer = {"reaching": ExponentialRate(2.0, 1.0), "boundary": SaturationLayer(1.0)}
    assert np.all(
        np.isfinite(
            design_sliding_mode(model, straight, slopes=1.5, **layer, **task).explain()["reaching time"]
        )
    )
    with pytest.raises(DesignError, match=r"limits keep \w from coming down: .* at t = 6 s"):
        design_feedback_linearization(
            model, straight, poles=[-1, -1.5, -2], **task | {"limits": (-0.02, 0.02)}
        )


def test_a_long_way_at_the_limits_is_no_failure():
    """1000 m at 0.01 m/s^2 take 2 sqrt(1000 / 0.01) = 632 s, where the poles say 20 s."""
    model = go.Model("cart")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a})
    law = design_feedback_linearization(
        model, [0, 0], outputs="q", poles=[-0.1, -0.1], start=[1000.0, 0.0], limits=(-0.5, 0.5), dt=0.1
    )
    assert law.explain()["limits act for"] > 50
