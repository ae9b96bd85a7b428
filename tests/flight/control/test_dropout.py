"""Lost samples: bridged, then the safe command and an alarm, by every law, in Python and in C alike."""

import numpy as np
import pytest
from testing.c_compiler import compiled, needs_compiler, python, run

import gnc_opt as go
from gnc_opt.control import (
    ConstantRate,
    Reference,
    SaturationLayer,
    Sign,
    SuperTwisting,
    design_feedback_linearization,
    design_integral_sliding_mode,
    design_lqr,
    design_mpc,
    design_sliding_mode,
    design_tvlqr,
    export_c,
    with_dropout_handling,
)
from gnc_opt.errors import ArgumentError
from gnc_opt.simulation import ClosedLoop, RunStatus, SensorOutage

DT = 0.05
LOST = [np.nan, 0.0]


def cart() -> go.Model:
    model = go.Model("cart")
    q, v, F = model.state("q", unit="m"), model.state("v", unit="m/s"), model.control("F", unit="N")
    model.ode({q: v, v: F / 2})
    return model


def regulator(**options):
    return design_lqr(cart(), [0, 0], Q=1, R=1, dt=DT, **options)


def slider(reaching, boundary):
    return design_sliding_mode(
        cart(), [0, 0], outputs="q", slopes=1.0, reaching=reaching, boundary=boundary, dt=DT
    )


def along():
    return Reference.constant(cart(), [0, 0])


LAWS = {
    "LQR": regulator,
    "integral action": lambda: regulator(integral={"q": 1.0}, limits=(-1, 1)),
    "TVLQR": lambda: design_tvlqr(cart(), along(), Q=1, R=1, dt=DT),
    "constant rate": lambda: slider(ConstantRate(1.0), SaturationLayer(0.2)),
    "super-twisting": lambda: slider(SuperTwisting(3.0, 2.0), Sign()),
    "integral sliding mode": lambda: design_integral_sliding_mode(
        cart(), [0, 0], nominal=regulator(), reaching=ConstantRate(1.0), boundary=SaturationLayer(0.2), dt=DT
    ),
    "feedback linearisation": lambda: design_feedback_linearization(
        cart(), [0, 0], outputs="q", poles=[-1, -2], dt=DT
    ),
    "MPC": lambda: design_mpc(cart(), along(), Q=1, R=1, horizon=0.5, dt=DT, limits=(-1, 1), rate_limits=5.0),
}
GOOD = np.array([[0.3 * np.cos(0.2 * k), 0.2 * np.sin(0.2 * k)] for k in range(30)])


def fly(controller, samples):
    commands, memories, z = [], [], None
    for k, x in enumerate(samples):
        u, z = controller(DT * k, x, z)
        commands.append(u)
        memories.append(z)
    return np.array(commands), np.array(memories)


@pytest.fixture(scope="module", params=LAWS)
def controller(request):
    return LAWS[request.param]()


def invalid(controller, memories):
    return memories[:, controller.memory.slice("invalid")][:, 0]


def test_long_dropouts_end_in_the_safe_command_and_an_alarm_and_the_law_comes_back(controller):
    lost = GOOD.copy()
    lost[10:16] = LOST
    found, memories = fly(controller, lost)
    assert np.array_equal(found[13:16, 0], np.zeros(3))  # the feedforward of rest
    assert np.array_equal(invalid(controller, memories), np.arange(30) >= 13)
    assert np.all(np.isfinite(memories))
    own = slice(0, controller.without_dropout_handling.memory.size)
    assert np.array_equal(memories[12, own], memories[15, own])  # the law's own memory stands still
    again, _ = controller.without_dropout_handling(16 * DT, GOOD[16], memories[15, own])
    assert np.array_equal(found[16], again) and abs(again[0]) > 1e-3


def test_a_law_begins_with_the_first_good_sample(controller):
    late = np.vstack([[LOST, LOST], GOOD])
    found, memories = fly(controller, late)
    assert np.array_equal(found[:2, 0], np.zeros(2))
    assert np.all(invalid(controller, memories) == 1)
    u, z = controller.without_dropout_handling(2 * DT, GOOD[0])
    assert np.array_equal(found[2], u)
    assert np.array_equal(memories[2, : z.size], z)


def test_bridge_and_safe_command_are_as_told():
    controller = with_dropout_handling(regulator(), hold=0, safe=0.7)
    found, _ = fly(controller, [GOOD[0], LOST, GOOD[1]])
    assert found[1] == 0.7
    assert np.array_equal(found[[0, 2]], fly(regulator(), GOOD[:2])[0])
    assert controller.explain()["dropouts"] == "0"
    with pytest.raises(ArgumentError, match="safe command"):
        with_dropout_handling(regulator(), safe=np.nan)
    with pytest.raises(ArgumentError, match="lost samples"):
        with_dropout_handling(regulator(), hold=-1)
    with pytest.raises(ArgumentError, match="design function"):
        with_dropout_handling(cart())


def test_a_command_that_is_no_number_is_not_given():
    model = cart()
    model.difference("q", lambda x, ref: (x - ref) / (x - 5.0))
    controller = design_lqr(model, [0, 0], Q=1, R=1, dt=DT)
    found, memories = fly(controller, [[4.0, 0.0], [5.0, 0.0], [4.0, 0.0]])
    assert found[0] == found[2] != 0
    assert found[1] == 0
    assert list(invalid(controller, memories)) == [0, 1, 1]


@needs_compiler
@pytest.mark.parametrize("name", [n for n in LAWS if n != "MPC"])
def test_python_and_c_do_the_same(tmp_path, name):
    controller = LAWS[name]()
    program = compiled(export_c(controller, tmp_path, name="dropout"))
    rng = np.random.default_rng(3)
    samples = np.where(rng.random((80, 1)) < 0.4, LOST, rng.normal(size=(80, 2)))
    samples[:2] = LOST
    times = DT * np.arange(80)
    expected = python(controller, times, samples, DT)
    assert np.all(np.isfinite(expected)) and np.any(expected[2:] == 0)
    assert np.allclose(run(program, times, samples), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("end", "status"), [(0.62, RunStatus.OK), (0.8, RunStatus.CONTROLLER_ALARM)])
def test_an_outage_in_the_loop_is_bridged_or_raises_the_alarm(end, status):
    loop = ClosedLoop(cart(), regulator(integral={"q": 1.0}), sensors=[SensorOutage("gap", 0.5, end, on="q")])
    outcome = loop.simulate([1.0, 0.0], tf=10.0).outcome
    assert outcome.status is status
    if status is RunStatus.CONTROLLER_ALARM:
        assert (outcome.what, outcome.time) == ("invalid", pytest.approx(0.65))
