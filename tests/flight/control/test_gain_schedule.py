"""Gains interpolated between operating points."""

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.c_compiler import compiled, needs_compiler, python, run
from testing.models import dynamics

import gnc_opt as go
from gnc_opt.control import design_gain_schedule
from gnc_opt.errors import ArgumentError, DesignError, UnknownNameError

DT = 0.1
GRID = [20.0, 30.0, 45.0]


def aircraft() -> go.Model:
    """Short period whose stiffness, damping and control power grow with the speed squared."""
    model = go.Model("short period")
    alpha, q, speed = model.state("alpha"), model.state("q", unit="rad/s"), model.state("speed", unit="m/s")
    elevator, thrust = model.control("elevator"), model.control("thrust", unit="m/s^2")
    pressure = (speed / 30) ** 2
    rate = -2 * alpha - 0.8 * q - 4 * elevator
    model.ode({alpha: q - 0.9 * alpha, q: pressure * rate, speed: thrust - 0.01 * speed})
    model.output("pressure", pressure)
    return model


def level(speed):
    return [0.0, 0.0, speed], [0.0, 0.01 * speed]


def schedule(model=None, **options):
    model = model or aircraft()
    path = go.Reference.constant(model, [0.0, 0.0, 33.0])
    given = {"over": {"speed": GRID}, "at": level, "Q": [4.0, 1.0, 0.1], "R": 1.0, "dt": DT} | options
    return design_gain_schedule(model, path, **given)


def gain(law, speed):
    """The gain in force at a speed, by differences of commands."""
    at = np.array([0.0, 0.0, speed])
    rest = law(0.0, at)[0]
    ends = [law(0.0, at + 1e-6 * step)[0] for step in np.eye(3)]
    return -(np.array(ends) - rest).T[:, :2] / 1e-6


def regulator(speed):
    model = aircraft()
    law = go.design_lqr(model, [0.0, 0.0, speed], Q=[4.0, 1.0, 0.1], R=1.0, dt=DT)
    return np.asarray(law.explain()["gain"])[:, :2]


def test_at_the_points_it_is_the_regulator_of_each_and_between_them_their_mean():
    law = schedule()
    for speed in GRID:
        assert np.allclose(gain(law, speed), regulator(speed), atol=1e-5)
    third = (2 * regulator(30.0) + regulator(45.0)) / 3
    assert np.allclose(gain(law, 35.0), third, atol=1e-5)
    assert np.max(np.abs(third - regulator(35.0))) > 1e-3  # not the regulator of that speed
    assert np.allclose(gain(law, 90.0), regulator(45.0), atol=1e-5)  # held at the ends
    assert np.allclose(gain(law, 5.0), regulator(20.0), atol=1e-5)


def test_over_two_variables_the_interpolation_is_bilinear():
    model = aircraft()
    law = schedule(
        model, over={"speed": [20.0, 40.0], "alpha": [-0.1, 0.3]}, at=lambda v, a: ([a, 0.0, v], [0.0, 0.0])
    )
    x = np.array([0.0, 0.05, 25.0])
    parts = []
    for v, a in ((20.0, -0.1), (40.0, -0.1), (20.0, 0.3), (40.0, 0.3)):
        one = schedule(model, over={"speed": [v, v + 1e-9]}, at=lambda s, a=a: ([a, 0.0, s], [0.0, 0.0]))
        parts.append(one(0.0, x)[0])
    expected = 0.75 * (0.75 * parts[0] + 0.25 * parts[1]) + 0.25 * (0.75 * parts[2] + 0.25 * parts[3])
    assert np.allclose(law(0.0, x)[0], expected, rtol=1e-9)


def test_an_output_schedules_and_slowest_poles_are_told():
    law = schedule(over={"pressure": [0.4, 1.0, 2.5]}, at=lambda p: level(30 * np.sqrt(p)))
    assert np.allclose(gain(law, 30.0), regulator(30.0), atol=1e-4)
    told = schedule().explain()
    assert told["operating points"] == 3
    model, poles = aircraft(), []
    for speed in GRID:
        a, b = go.control.ErrorDynamics(model).linearize(0.0, *level(speed))
        k = np.asarray(go.design_lqr(model, [0, 0, speed], Q=[4.0, 1.0, 0.1], R=1.0, dt=DT).explain()["gain"])
        flow = scipy.linalg.expm(DT * np.block([[a, b], [np.zeros((2, 5))]]))
        poles.append(np.max(np.log(np.abs(np.linalg.eigvals(flow[:3, :3] - flow[:3, 3:] @ k)))) / DT)
    assert told["slowest pole at the points"] == pytest.approx(max(poles), rel=1e-9)
    assert told["slowest pole between them"] < 0


def autopilot(mach=None) -> go.Model:
    """Pitch of a missile; the Mach number is a state that falls by itself, or a number."""
    model = go.Model("pitch")
    alpha, q, fin = model.state("alpha"), model.state("q"), model.control("fin")
    free = mach is None
    m = model.state("mach") if free else mach
    stiffness, power = 12 - 6 * m, 9 * m**2
    motion = {alpha: q - 0.3 * m * (alpha + 0.2 * fin), q: stiffness * m**2 * alpha - q - power * fin}
    model.ode(motion | ({m: -0.05 * m} if free else {}))
    model.output("pressure", 0.7 * m**2)
    return model


@pytest.mark.parametrize("over", ["mach", "pressure"])
def test_what_no_control_moves_is_taken_as_given(over):
    """Its Mach number is no affair of an autopilot: gains are those of the pitch alone, and none answers to it."""
    grid = [1.5, 2.5, 4.0]
    values = grid if over == "mach" else [0.7 * m**2 for m in grid]
    back = (lambda m: m) if over == "mach" else (lambda p: np.sqrt(p / 0.7))
    at = lambda v: ([0.0, 0.0, back(v)], [0.0])  # noqa: E731
    model, weights = autopilot(), {"R": 1.0, "dt": 0.02}
    glide = lambda t: [0.0, 0.0, 4 * np.exp(-0.05 * t)]  # noqa: E731
    path = go.Reference.from_functions(model, glide, lambda t: [0.0], 0.0, 15.0)
    law = design_gain_schedule(model, path, over={over: values}, at=at, Q=[20, 1, 5], **weights)
    for m in grid:
        alone = go.design_lqr(autopilot(m), [0.0, 0.0], Q=[20, 1], **weights).explain()["gain"]
        state = np.array([0.1, -0.2, m])
        assert law(0.0, state)[0] == pytest.approx(-np.asarray(alone) @ state[:2], rel=1e-9)
        assert law(0.0, [0.0, 0.0, m])[0] == pytest.approx([0.0], abs=1e-15)
    assert law.explain()["taken as given"] == "mach"
    run = go.ClosedLoop(model, law).simulate([0.2, 0.0, 4.0], tf=15.0)
    assert run.states[2, -1] == pytest.approx(4 * np.exp(-0.75), rel=1e-9)
    assert np.max(np.abs(run.states[:2, -1])) < 1e-9


def test_given_states_that_do_not_schedule_are_refused():
    model = go.Model("drifting")
    x, w, m, u = model.state("x"), model.state("w"), model.state("m"), model.control("u")
    model.ode({x: m * u + w, w: 0.1 * w, m: 0})
    task = {"over": {"m": [1, 2]}, "Q": 1, "R": 1, "dt": DT, "at": lambda m: ([0, 0, m], [0])}
    with pytest.raises(DesignError, match=r"no control reaches the mode with eigenvalue 0\.1 1/s in 'w'"):
        design_gain_schedule(model, [0.0, 0.0, 1.0], **task)
    still, m, u = dynamics("still", "m", "u", lambda m, u: {m: -m})
    with pytest.raises(DesignError, match="no control moves a state of model 'still'"):
        design_gain_schedule(still, [0.0], **task | {"at": lambda m: ([m], [0])})


@needs_compiler
def test_compiled_schedule_agrees_with_python(tmp_path):
    law = schedule()
    states = np.random.default_rng(2).normal(size=(30, 3)) * [0.2, 0.3, 12.0] + [0, 0, 33.0]
    states[7] = np.nan
    times = DT * np.arange(30)
    found = run(compiled(go.export_c(law, tmp_path), "-O0"), times, states)
    assert np.allclose(found, python(law, times, states, DT), rtol=1e-12, atol=1e-12)


def test_a_grid_that_is_too_coarse_is_refused():
    """The control's sign changes between the points: no mean of gains steers both sides, nor the middle."""
    model = go.Model("reversal")
    x, speed = model.state("x"), model.state("speed")
    u, w = model.control("u"), model.control("w")
    model.ode({x: x + ca.tanh(20 * (speed - 0.3)) * u, speed: w})
    path = [0.0, 0.0]  # a state to keep
    given = {"at": lambda s: ([0.0, s], [0.0, 0.0]), "Q": 1, "R": 1, "dt": DT}
    with pytest.raises(
        DesignError, match=r"at the operating point \(0\) the interpolated gain leaves a pole"
    ):
        design_gain_schedule(model, path, over={"speed": [-1.0, 1.0]}, **given)
    with pytest.raises(DesignError, match=r"at the operating point \(0\.3\): .*stabilis"):
        design_gain_schedule(model, path, over={"speed": [0.3, 1.0]}, **given)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"over": {"sped": GRID}}, UnknownNameError, "no state or output 'sped': did you mean 'speed'"),
        ({"over": {}}, ArgumentError, "names no scheduling variable"),
        ({"over": {"speed": [30.0]}}, ArgumentError, "the grid of 'speed' does not increase"),
        ({"over": {"speed": [30.0, 20.0]}}, ArgumentError, "the grid of 'speed' does not increase"),
        ({"at": lambda v: ([0.0, v], [0.0, 0.0])}, ArgumentError, r"the state at the operating point \(20\)"),
        ({"dt": 0.0}, ArgumentError, "control step"),
    ],
)
def test_what_cannot_be_meant_is_refused(change, error, message):
    with pytest.raises(error, match=message):
        schedule(**change)


def test_a_vector_is_no_scheduling_variable():
    model, _r, _u = dynamics("plane", "r:2", "u:2", lambda r, u: {r: u})
    path = go.Reference.constant(model, [0, 0])
    with pytest.raises(ArgumentError, match="'r' has 2 components"):
        design_gain_schedule(model, path, over={"r": [0, 1]}, at=lambda v: ([0, v], [0, 0]), Q=1, R=1, dt=DT)
