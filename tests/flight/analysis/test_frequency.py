"""Loops in the frequency domain: LQR's own margins, delays, python-control, instability where margins say, figures."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.models import dynamics
from testing.sled import DT, loop_of, regulator, sled

import gnc_opt as go
from gnc_opt.analysis import loop_response
from gnc_opt.errors import ArgumentError
from gnc_opt.plot import plot_response
from gnc_opt.simulation import Delay, Event, Lag, Saturation, ScaleFactor, ZeroOrderHold

HERE = {"x0": [0.0, 0.0], "tf": 1.0}


def bare(*actuators, sensors=()) -> go.ClosedLoop:
    model = sled()
    return go.ClosedLoop(model, regulator(model), actuators, sensors)


def test_without_anything_else_margins_are_those_of_the_design():
    told = regulator(sled()).explain()
    found = loop_response(bare(), **HERE).margins()
    assert found.gain_up == pytest.approx(told["gain margin up"], rel=1e-9)
    assert np.degrees(found.phase) == pytest.approx(told["phase margin"], rel=1e-9)
    assert found.delay == pytest.approx(told["delay margin"], rel=1e-9)
    assert found.disk == pytest.approx(told["disk margin"], rel=1e-9)


def test_the_open_loop_is_that_of_the_sampled_plant():
    model = sled()
    K = regulator(model).explain()["gain"]
    A, B = np.array([[0, 1], [0, 0.0]]), np.array([[0.0], [0.5]])
    P = scipy.linalg.expm(np.block([[A, B], [np.zeros((1, 3))]]) * DT)
    omega = np.array([0.3, 2.0, 11.0])
    found = loop_response(bare(), **HERE)
    expected = [
        (K @ np.linalg.solve(np.exp(1j * w * DT) * np.eye(2) - P[:2, :2], P[:2, 2:]))[0, 0] for w in omega
    ]
    assert found.open_loop(omega)[:, 0, 0] == pytest.approx(np.array(expected), rel=1e-9)
    assert found.channel_open_loop(omega, "F") == pytest.approx(np.array(expected), rel=1e-9)
    assert found.sensitivity(omega)[:, 0, 0] == pytest.approx(1 / (1 + np.array(expected)), rel=1e-9)


@pytest.mark.parametrize("frequency", [20.0, 45.0])
def test_a_light_mode_is_followed_where_the_nominal_run_rests(frequency):
    """One integration step did for the run at rest, and made of the mode an unstable one, or a heavily damped one."""
    rigid, hub = go.Model("rigid"), go.Model("hub with a boom")
    a, w, T = rigid.state("a"), rigid.state("w"), rigid.control("T")
    rigid.ode({a: w, w: T})
    law = go.design_lqr(rigid, [0, 0], Q=1, R=1, dt=DT)
    a, w, q, r, T = *(hub.state(name) for name in ("a", "w", "q", "r")), hub.control("T")
    hub.ode({a: w, w: T, q: r, r: -(frequency**2) * q - 0.01 * frequency * r + 0.3 * T})
    A, B = hub.linearize(0.0, np.zeros(4), [0.0])
    P = scipy.linalg.expm(np.block([[A, B], [np.zeros((1, 5))]]) * DT)
    K = np.hstack([law.explain()["gain"], np.zeros((1, 2))])
    expected = np.sort_complex(np.linalg.eigvals(P[:4, :4] - P[:4, 4:] @ K))
    response = loop_response(go.ClosedLoop(hub, law, dt=DT), x0=np.zeros(4), tf=1.0)
    poles = response.poles()
    nearest = [poles[np.argmin(np.abs(poles - z))] for z in expected]
    assert nearest == pytest.approx(expected, abs=1e-6) and response.is_stable()


@pytest.mark.parametrize("steps", [1, 3])
def test_a_late_sample_takes_its_delay_from_the_delay_margin(steps):
    before = loop_response(bare(), **HERE).margins()
    after = loop_response(bare(sensors=[Delay("bus", steps * DT)]), **HERE).margins()
    assert before.delay - after.delay == pytest.approx(steps * DT, rel=1e-6)
    assert after.disk < before.disk


@pytest.mark.parametrize("steps", [0, 2])
def test_a_statically_unstable_plant_has_the_gain_margin_down_of_its_response_at_rest(steps):
    """-1 / L(z = 1) of the sampled pendulum about its upper rest, whatever delays: constants in the loop hid it."""
    pole, *_ = dynamics("pole", "q v", "a", lambda q, v, a: {q: v, v: 4.0 * q + a})
    law = go.design_lqr(pole, [0.0, 0.0], Q=1, R=1, dt=DT)
    loop = go.ClosedLoop(pole, law, sensors=[Delay("bus", steps * DT)] if steps else [])
    response = loop_response(loop, x0=[0.0, 0.0], tf=10 * DT, at=[5 * DT])
    at_rest = -0.25 * law.explain()["gain"][0, 0]
    assert response.open_loop([0.0])[0, 0, 0] == pytest.approx(at_rest, rel=1e-9)
    assert response.margins(0).gain_down == pytest.approx([-1 / at_rest], rel=1e-9)
    assert law.explain()["gain margin down"] == pytest.approx([-1 / at_rest], rel=1e-9)


def test_the_loop_is_lost_where_the_gain_margin_says():
    """A lag and a delay, and the gain of the actuator beyond and below the margin: the loop flown, not linearized."""
    parts, sensors = [Lag("motor", 0.15)], [Delay("bus", 2 * DT)]
    limit = loop_response(bare(*parts, sensors=sensors), **HERE).margins().gain_up[0]
    for factor, grows in ((0.97, False), (1.03, True)):
        loop = bare(ScaleFactor("gain", factor * limit), *parts, sensors=sensors)
        run = loop.simulate([0.1, 0.0], tf=60.0)
        early, late = np.abs(run.states[0, 100:200]).max(), np.abs(run.states[0, -100:]).max()
        assert bool(late > early) is grows
        assert loop_response(loop, **HERE).is_stable() is not grows


def test_disk_margins_hold_for_all_commands_at_once():
    """Two coupled axes: any gains of both within the disk margin leave the loop stable; the worst one is near it."""
    model = go.Model("two axes")
    x, u = model.state("x", 4), model.control("u", 2)
    A = np.array([[0, 1, 0, 0], [1, 0, 0.5, 0], [0, 0, 0, 1], [-0.5, 0, 0, -0.1]])
    B = np.array([[0, 0], [1, 0.4], [0, 0], [0.2, 1]])
    model.ode({x: A @ x + ca.DM(B) @ u})
    law = go.design_lqr(model, np.zeros(4), Q=np.ones(4), R=np.ones(2), dt=DT)
    loop = go.ClosedLoop(model, law)
    here = {"x0": np.zeros(4), "tf": 1.0}
    response = loop_response(loop, **here)
    alpha = response.margins().disk
    omega = response.frequencies
    worst = np.max(np.linalg.norm(response.sensitivity(omega) - 0.5 * np.eye(2), 2, axis=(1, 2)))
    assert alpha == pytest.approx(1 / worst, rel=1e-3)
    low, high = (2 - alpha) / (2 + alpha), (2 + alpha) / (2 - alpha)
    for gains in ((low, low), (low, high), (high, low), (high, high)):
        changed = replace(loop, actuators=[ScaleFactor("gains", 0.999 * np.array(gains) + 0.001)])
        assert loop_response(changed, **here).is_stable()


def test_along_a_trajectory_margins_change_with_the_plant():
    """A wagon that loses its load: at each instant the loop of a sled of that mass."""
    wagon, *_ = dynamics("wagon", "q v m", "F", lambda q, v, m, F: {q: v, v: F / m, m: -0.1})
    loop = go.ClosedLoop(wagon, regulator(sled()))
    response = loop_response(loop, x0=[0, 0, 2.0], tf=10.0, at=[0.0, 5.0, 9.0])
    assert response.times == pytest.approx([0.0, 5.0, 9.0])
    for k, mass in enumerate((2.0, 1.5, 1.1)):
        model = sled().with_parameters(m=mass)
        law = replace(regulator(sled()), name="same gain")
        frozen = loop_response(go.ClosedLoop(model, law), **HERE)
        assert response.margins(k).disk == pytest.approx(frozen.margins().disk, rel=0.02)
    assert np.all(np.diff(response.disk_margins) > 0)


def test_where_all_commands_are_at_their_limits_the_loop_is_open_and_has_no_margins():
    """Beyond the limit nothing comes through; feedforward alone, which is open too, may change as it likes."""
    limited = bare(Saturation("limit", -0.2, 0.2))
    response = loop_response(limited, x0=[3.0, 0.0], tf=20.0, at=[0.0, 19.0])
    assert not np.any(response.open_loop([1.0], 0))
    with pytest.raises(ArgumentError, match=r"linearised at 0 s is open: its commands have no effect"):
        response.margins(0)
    free = loop_response(bare(), x0=[0.0, 0.0], tf=1.0)
    assert response.disk_margins == pytest.approx([np.nan, free.disk_margins[0]], nan_ok=True)
    assert plot_response(response, "margins") and plot_response(response, "nyquist")
    model = sled()
    still = go.feedforward(go.Reference.constant(model, [0.0, 0.0]))
    assert loop_response(go.ClosedLoop(model, still, dt=DT), x0=[0, 0], tf=1.0).margins().disk == 2.0


def test_figures_show_what_they_say():
    response = loop_response(bare(Lag("motor", 0.3)), **HERE, at=[0.0, 0.5])
    gain, phase = plot_response(response).axes
    omega = response.frequencies
    assert gain.lines[0].get_ydata() == pytest.approx(np.abs(response.channel_open_loop(omega, "F")))
    crossing = np.argmin(np.abs(np.log(gain.lines[0].get_ydata())))
    margin = np.degrees(response.margins().phase[0])
    assert phase.lines[0].get_ydata()[crossing] == pytest.approx(-180 + margin, abs=1.0)
    (plane,) = plot_response(response, "nyquist").axes
    (disk,) = plane.patches
    line = plane.lines[0]
    apart = np.hypot(line.get_xdata() - disk.center[0], line.get_ydata()) / disk.radius
    assert 1 - 1e-3 < apart.min() < 1.01  # it touches the disk
    left, right = plot_response(response, "sensitivity").axes
    s, alpha = response.sensitivity(omega)[:, 0, 0], response.disk_margins
    assert left.lines[0].get_ydata() == pytest.approx(np.abs(s)) and left.get_ylim() == (1e-3, 10.0)
    assert right.lines[0].get_ydata() == pytest.approx(np.abs(1 - s)) and right.get_ylim() == (1e-3, 10.0)
    known = {gain: 1.0, phase: -180.0, left: 1.0, right: 1.0}
    assert {ax: ax.lines[-1].get_ydata()[0] for ax in known} == known
    assert {ax.get_xlim() for ax in known} == {(omega[0], omega[-1])}
    margins = [ax.lines[0].get_ydata() for ax in plot_response(response, "margins").axes]
    factor, angle = (2 + alpha) / (2 - alpha), np.degrees(2 * np.arctan(alpha / 2))
    assert np.allclose(margins, [alpha, 20 * np.log10(factor), angle])


@pytest.mark.parametrize("kind", ["bode", "nyquist", "sensitivity"])
def test_the_legend_covers_no_title_or_label(kind):
    figure = plot_response(loop_response(bare(), **HERE, at=[0.1 * k for k in range(7)]), kind)
    figure.draw_without_rendering()
    legend = figure.axes[0].get_legend().get_window_extent()
    texts = [
        text for ax in figure.axes for text in (ax.title, ax.xaxis.label, ax.yaxis.label) if text.get_text()
    ]
    assert not [text for text in texts if legend.overlaps(text.get_window_extent())]
    assert legend.x0 >= 0 and legend.y1 <= figure.bbox.y1


def test_mistakes_are_refused():
    response = loop_response(bare(), **HERE)
    with pytest.raises(go.ArgumentError, match="before its end"):
        loop_response(bare(), **HERE, at=[1.0])
    with pytest.raises(go.ArgumentError, match="loop of two rates"):
        loop_response(bare(sensors=[ZeroOrderHold("slow", 3 * DT)]), **HERE)
    model = sled()
    ends = go.ClosedLoop(model, regulator(model), events=[Event("gate", model.symbol("q"))])
    with pytest.raises(go.ArgumentError, match="has events"):
        loop_response(ends, **HERE)
    with pytest.raises(go.ArgumentError, match="no command 'G': give one of F"):
        response.channel_open_loop([1.0], "G")
    with pytest.raises(go.ArgumentError, match=r"between 0 and pi / dt"):
        response.open_loop([40.0])
    wild = loop_response(bare(ScaleFactor("gain", 30.0)), **HERE)
    with pytest.raises(go.ArgumentError, match="is unstable"):
        wild.margins()
    assert wild.disk_margins.tolist() == [0.0]
    with pytest.raises(go.ArgumentError, match="too many for one figure"):
        plot_response(loop_response(loop_of(), **HERE, at=[0.1 * k for k in range(8)]))
    with pytest.raises(go.ArgumentError, match="give a ClosedLoop"):
        loop_response(model, **HERE)
