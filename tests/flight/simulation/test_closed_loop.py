"""The closed loop against exact solutions, against SciPy, and its handling of what goes wrong."""

import pickle

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete
from testing.loops import controller, double_integrator, feedback, scheduled

from gnc_opt.control import Reference, design_lqr, feedforward
from gnc_opt.errors import ArgumentError, UnknownNameError
from gnc_opt.model import Layout, Model, Variable
from gnc_opt.simulation import (
    Bias,
    ClosedLoop,
    ConstantDisturbance,
    ExpressionDisturbance,
    Lag,
    Noise,
    PiecewiseConstantNoise,
    Quantisation,
    RunStatus,
    Saturation,
    SensorOutage,
    SinusoidalDisturbance,
)
from problems.rendezvous import chaser_model

GAIN = [[2.0, 1.5]]


def linear_plant():
    """An oscillator with two inputs, one of which is pushed."""
    plant = Model("oscillator")
    x = plant.state("x", 2)
    u = plant.control("u")
    a = np.array([[0.0, 1.0], [-3.0, -0.2]])
    b = np.array([[0.1], [1.0]])
    plant.ode({x: ca.DM(a) @ x + ca.DM(b) * u})
    return plant, a, b


def test_constant_force_on_a_double_integrator_is_exact():
    plant = double_integrator()
    loop = ClosedLoop(plant, scheduled(plant, lambda t: 3.0 + 0 * t), dt=0.25)
    run = loop.simulate([1.0, -2.0], tf=10.0, parameters={"plant.m": 1.5})
    t = run.times
    assert run.states == pytest.approx(np.vstack([1 - 2 * t + t**2, -2 + 2 * t]), rel=1e-13, abs=1e-13)
    assert run.integration_error < 1e-13 and run.outcome.ok


def test_linear_loop_equals_the_exact_discrete_solution():
    plant, a, b = linear_plant()
    gain = np.array([[1.2, 0.8]])
    loop = ClosedLoop(plant, feedback(plant, gain), dt=0.1, accuracy=1e-12)
    run = loop.simulate([1.0, -0.5], tf=10.0)
    ad, bd, *_ = cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), 0.1)
    x = np.array([1.0, -0.5])
    for k in range(101):
        assert run.states[:, k] == pytest.approx(x, abs=1e-12)
        x = (ad - bd @ gain) @ x


@pytest.mark.parametrize("accuracy", [1e-4, 1e-6, 1e-8])
def test_accuracy_is_kept(accuracy):
    plant = Model("pendulum")
    q, v = plant.state("q"), plant.state("v")
    u = plant.control("u")
    plant.ode({q: v, v: -9.81 * ca.sin(q) + u})
    loop = ClosedLoop(plant, scheduled(plant, lambda t: np.sin(t)), dt=0.2, accuracy=accuracy)
    run = loop.simulate([1.0, 0.0], tf=5.0)
    fine = ClosedLoop(plant, loop.controller, dt=0.2, substeps=60, accuracy=accuracy).simulate(
        [1.0, 0.0], tf=5.0
    )
    end, truth = run.states[:, -1], fine.states[:, -1]
    apart = np.max(np.abs(end - truth) / np.maximum(1.0, np.abs(truth)))
    assert apart < run.integration_error <= accuracy
    assert run.outcome.ok


def rendezvous_loop(**options):
    chaser = chaser_model()
    gain = np.zeros((6, 12))
    gain[:3, :3], gain[:3, 3:6] = np.diag([3000, 2500, 1200]), np.diag([2000, 2000, 1200])
    gain[3:, 6:9], gain[3:, 9:] = 1600 * np.eye(3), 400 * np.eye(3)
    blocks = [Saturation("limits", [-50] * 3 + [-320] * 3, [50] * 3 + [320] * 3), Quantisation("steps", 0.5)]
    return ClosedLoop(chaser, feedback(chaser, gain), [*blocks, Lag("lag", 0.15)], dt=0.1, **options), gain


def test_rendezvous_equals_scipy():
    loop, gain = rendezvous_loop(accuracy=1e-10)
    x = np.array([0.02, -0.01, 0.01, 0.1, -0.1, 0.2, 0.1, 0.0, -0.1, 4.0, 1.0, -2.0])
    run = loop.simulate(x, tf=10.0)
    plant, tau, dt, y = loop.plant, 0.15, 0.1, np.zeros(6)
    limit = np.array([50.0] * 3 + [320.0] * 3)
    for k in range(100):
        assert run.states[:, k] == pytest.approx(x, abs=1e-8)
        u = np.clip(-gain @ x, -limit, limit)
        u = 0.5 * np.floor(u / 0.5 + 0.5)

        def rate(t, s, u=u, gap=y - u):
            return plant.f(t, s, u + gap * np.exp(-t / tau))

        y = u + (y - u) * np.exp(-dt / tau)
        x = solve_ivp(rate, (0, dt), x, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    assert np.linalg.norm(run.states[9:, -1]) < 0.5 * np.linalg.norm(run.states[9:, 0])  # it does something


def test_disturbances_on_states_and_controls():
    plant = double_integrator()
    silent = scheduled(plant, lambda t: 0 * t)
    w, m = 2.0, 2.0
    pushes = [
        ConstantDisturbance("drag", -0.3, on="v"),
        SinusoidalDisturbance("slosh", 1.0, w, 0.4, on="a"),
        ExpressionDisturbance("spring", lambda t, x, p: -p["k"] * x["q"], {"k": 0.0}, on="v"),
    ]
    run = ClosedLoop(plant, silent, disturbances=pushes, dt=0.1, accuracy=1e-11).simulate(
        [0.0, 0.0], tf=5.0, parameters={"plant.m": m}
    )
    t = run.times
    assert run.states[1] == pytest.approx(-0.3 * t + (np.cos(0.4) - np.cos(w * t + 0.4)) / (w * m), abs=1e-10)
    assert np.all(run.applied == 0)
    sprung = ClosedLoop(plant, silent, disturbances=pushes[2:], dt=0.1, accuracy=1e-11).simulate(
        [1.0, 0.0], tf=5.0, parameters={"spring.k": 4.0}
    )
    assert sprung.states[0] == pytest.approx(np.cos(2 * sprung.times), abs=1e-10)


def test_random_hold_is_held_and_has_its_spread():
    plant = double_integrator()
    loop = ClosedLoop(
        plant, scheduled(plant, lambda t: 0 * t),
        disturbances=[PiecewiseConstantNoise("gust", 0.5, 0.3, on="a")], dt=0.1,
    )  # fmt: skip
    run = loop.simulate([0.0, 0.0], tf=900.0, seed=3)
    push = np.diff(run.states[1]) / 0.1
    triples = push.reshape(-1, 3)
    assert np.ptp(triples, axis=1) == pytest.approx(0.0, abs=1e-10)
    assert np.std(triples[:, 0]) == pytest.approx(0.5, rel=4 / np.sqrt(2 * 3000))
    assert abs(np.mean(triples[:, 0])) < 4 * 0.5 / np.sqrt(3000)


def noisy_loop():
    plant = double_integrator()
    return ClosedLoop(
        plant, feedback(plant, GAIN), [Lag("lag", 0.1)], [Noise("sensor", 0.01)],
        [PiecewiseConstantNoise("gust", 0.1, on="a")], dt=0.1, minor_steps=2,
    )  # fmt: skip


def test_same_seed_same_bits_and_other_seeds_differ():
    loop = noisy_loop()
    a, b, c = (loop.simulate([1.0, 0.0], tf=5.0, seed=s) for s in (7, 7, 8))
    assert np.array_equal(a.states, b.states) and not np.array_equal(a.states, c.states)


def test_final_has_the_bits_of_the_run_also_after_pickling():
    flight = noisy_loop().compile([1.0, 0.0], tf=5.0)
    P = np.tile(flight.nominal[:, None], 4)
    P[flight.layout.slice("plant.m")] = [[0.9, 1.0, 1.1, 1.2]]
    seeds = [[5, i] for i in range(4)]
    ending = flight.final_values(P, seeds)
    other = pickle.loads(pickle.dumps(flight)).final_values(P, seeds)
    assert np.array_equal(ending.states, other.states)
    for i in range(4):
        run = flight.run(P[:, i], seeds[i])
        assert np.array_equal(run.states[:, -1], ending.states[:, i])
        assert np.array_equal(run.effort, ending.effort[:, i])


def test_feedforward_flies_its_reference():
    plant = double_integrator()
    # accelerate for 1 s, brake for 1 s: a jump of the control within a step keeps the impulse
    reference = Reference.from_functions(
        plant, lambda t: [t**2 / 2 if t < 1 else 1 - (2 - t) ** 2 / 2, t if t < 1 else 2 - t],
        lambda t: [1.0 if t < 1 else -1.0], 0.0, 2.0, jumps=[1.0],
    )  # fmt: skip
    run = ClosedLoop(plant, feedforward(reference), dt=0.3).simulate([0.0, 0.0], tf=2.1)
    assert run.command("a")(0.95) == pytest.approx((0.1 - 0.2) / 0.3)
    exact = ClosedLoop(plant, feedforward(reference), dt=0.25).simulate([0.0, 0.0], tf=2.0)
    assert exact.miss("q") < 1e-12 and exact.miss("v") < 1e-12
    assert exact.control_effort("a")[0] == pytest.approx(2.0) and exact.delta_v("a", 2.0) == pytest.approx(
        1.0
    )
    off = ClosedLoop(plant, feedforward(reference), dt=0.25).simulate([0.1, 0.0], tf=2.0)
    assert off.error("q").values == pytest.approx(0.1) and off.miss("q", 0.0) == pytest.approx(1.1)


def test_a_measurement_that_is_no_number_is_named_with_its_time():
    plant = double_integrator(2)
    gain = np.hstack([np.eye(2), np.eye(2)])
    loop = ClosedLoop(
        plant, feedback(plant, gain), sensors=[SensorOutage("blind", 1.3, 1.6, on="v")], dt=0.1, accuracy=1e-8
    )
    run = loop.simulate([1.0, 0.0, 0.0, 0.0], tf=3.0)
    assert run.outcome.status is RunStatus.NOT_FINITE
    assert run.outcome.what == "measured 'v[0]'" and run.outcome.time == pytest.approx(1.3)
    assert np.all(np.isfinite(run.states[:, :14])) and "at 1.3 s" in str(run)
    flight = loop.compile([1.0, 0.0, 0.0, 0.0], tf=3.0)
    P = np.tile(flight.nominal[:, None], 3)
    P[flight.layout.slice("blind.begin")] = [[9.0, 0.5, np.nan]]
    statuses = [o.status for o in flight.final_values(P, [0, 1, 2]).outcomes]
    assert statuses == [RunStatus.OK, RunStatus.NOT_FINITE, RunStatus.INVALID_PARAMETERS]


@pytest.mark.parametrize(
    ("where", "words"),
    [
        (lambda t, x: x["rate"], r"cannot be evaluated: KeyError.*rate.*plant's states by name, q, v"),
        (lambda t, x: x["v"], r"returns the shape \(2, 1\)"),
    ],
)
def test_an_outage_where_there_is_no_such_state_is_refused_with_the_loop(where, words):
    plant = double_integrator(2)
    with pytest.raises(ArgumentError, match=words):
        ClosedLoop(
            plant, feedback(plant, np.hstack([np.eye(2), np.eye(2)])),
            sensors=[SensorOutage("b", where=where)], dt=0.1,
        )  # fmt: skip


def test_an_unstable_loop_ends_and_is_flagged():
    plant = double_integrator()
    run = ClosedLoop(plant, feedback(plant, [[-1e4, -1e4]]), dt=1.0, substeps=1).simulate(
        [1.0, 0.0], tf=200.0
    )
    assert run.outcome.status is RunStatus.NOT_FINITE and 0 < run.outcome.time < 200


def unstable() -> Model:
    """dx/dt = x beside dy/dt = 0."""
    plant = Model("unstable")
    x, y, u = plant.state("x", 2, unit="m"), plant.state("y"), plant.control("u")
    plant.ode({x: x, y: 0 * u})
    return plant


def test_a_state_beyond_its_plausible_size_has_diverged():
    """e^t passes 1e15 at 34.54 s: in the step that begins at 34 s; a run that ends before it is all right."""
    plant = unstable()
    idle, x0 = feedback(plant, [[0.0] * 3]), [0.0, -1.0, 2.0]
    loop = ClosedLoop(plant, idle, dt=1.0, accuracy=1e-7)
    assert loop.simulate(x0, tf=34.0).outcome.ok
    run = loop.simulate(x0, tf=40.0)
    assert run.outcome.status is RunStatus.DIVERGED
    assert str(run.outcome) == "diverged: state 'x[1]' beyond 1e+15 at 34 s"
    assert run.states[1, -1] == pytest.approx(-np.exp(40.0), rel=1e-7)


def test_plausible_sizes_are_given_by_name_or_for_all_states():
    plant = unstable()
    idle, x0 = feedback(plant, [[0.0] * 3]), [0.5, -1.0, 2.0]

    def outcome(divergence_limits):
        loop = ClosedLoop(plant, idle, dt=1.0, accuracy=1e-7, divergence_limits=divergence_limits)
        return loop.simulate(x0, tf=40.0).outcome

    assert outcome(np.inf).ok and outcome({"x": 1e18}).ok
    first = outcome({"x": [10.0, 1e18]})
    assert (first.what, first.time) == ("state 'x[0]' beyond 10", 2.0)
    assert outcome({"y": 1.0}).what == "state 'y' beyond 1"  # the others keep the default: x diverges later
    assert outcome(3.0).time == 1.0
    with pytest.raises(UnknownNameError, match="'z'"):
        outcome({"z": 1.0})
    for bad in (0.0, {"x": [1.0, np.nan]}, {"x": [1.0, 2.0, 3.0]}):
        with pytest.raises(ArgumentError, match="plausible size"):
            outcome(bad)


def test_a_diverging_run_is_no_plant_too_fast_for_its_step():
    """No number of integration steps gives a run that has left all scales its accuracy."""
    plant = Model("stiffening")
    x, u = plant.state("x"), plant.control("u")
    plant.ode({x: u})
    cubic = controller(plant, lambda t, x, r, z: (-3 * x**3, z))
    run = ClosedLoop(plant, cubic, dt=0.5).simulate([2.0], tf=2.5)
    assert run.outcome.status is RunStatus.DIVERGED


@pytest.mark.parametrize("symbols", [ca.SX, ca.MX])
def test_alarms_of_the_controller_are_reported(symbols):
    plant = double_integrator()

    def expression(t, x, r, z):
        return -2 * x[0] - 2 * x[1], ca.if_else(t > 0.95, 3.0, z)

    cautious = controller(
        plant, expression, memory=Layout("memory", (Variable("guard"),)), alarms=("guard",), symbols=symbols
    )
    run = ClosedLoop(plant, cautious, dt=0.1).simulate([1.0, 0.0], tf=2.0)
    assert (run.outcome.status, run.outcome.what) == (RunStatus.CONTROLLER_ALARM, "guard")
    assert run.outcome.time == pytest.approx(1.0)


def test_an_inaccurate_run_is_flagged():
    plant, *_ = linear_plant()
    loop = ClosedLoop(plant, feedback(plant, [[0.0, 0.0]]), dt=1.0, substeps=1, accuracy=1e-9)
    assert loop.simulate([1.0, 0.0], tf=20.0).outcome.status is RunStatus.INTEGRATION_ERROR


def test_a_plant_too_fast_for_the_step_is_refused():
    plant = Model("stiff")
    x, u = plant.state("x"), plant.control("u")
    plant.ode({x: -1e5 * x + u})
    with pytest.raises(ArgumentError, match=r"'stiff' is too fast for minor steps of 0\.1 s"):
        ClosedLoop(plant, feedback(plant, [[0.0]]), dt=0.1).simulate([1.0], tf=1.0)


def test_too_many_minor_steps_are_refused():
    plant = double_integrator()
    loop = ClosedLoop(plant, feedback(plant, GAIN), dt=0.1, minor_steps=3000)
    with pytest.raises(
        ArgumentError, match="3000 minor steps of 1 integration steps each has more than 2000"
    ):
        loop.simulate([0.0, 0.0], tf=1.0)


def test_what_does_not_fit_is_refused_by_name():
    plant, other = double_integrator(), Model("other")
    x = other.state("x")
    other.ode({x: other.control("u")})
    law = feedback(plant, GAIN)
    with pytest.raises(ArgumentError, match="measures 'q', which the plant 'other' does not have"):
        ClosedLoop(other, law, dt=0.1)
    with pytest.raises(ArgumentError, match="give dt"):
        ClosedLoop(plant, law)
    with pytest.raises(ArgumentError, match=r"two blocks .* 'lag'"):
        ClosedLoop(plant, law, [Lag("lag", 0.1), Lag("lag", 0.1)], dt=0.1)
    with pytest.raises(UnknownNameError, match="no command 'b'"):
        ClosedLoop(plant, law, [Lag("lag", 0.1, on="b")], dt=0.1)
    with pytest.raises(UnknownNameError, match="no state or control 'w'"):
        ClosedLoop(plant, law, disturbances=[ConstantDisturbance("push", 1.0, on="w")], dt=0.1)
    loop = ClosedLoop(plant, law, sensors=[Bias("gyro", 0.1, on="v")], dt=0.1)
    with pytest.raises(UnknownNameError, match=r"no parameter 'gyro\.bais': did you mean 'gyro\.bias'"):
        loop.simulate([0.0, 0.0], tf=1.0, parameters={"gyro.bais": 0.0})
    with pytest.raises(ArgumentError, match="initial state of a run lacks 'v'"):
        loop.simulate({"q": 1.0}, tf=1.0)
    with pytest.raises(ArgumentError, match="tf > t0"):
        loop.simulate([0.0, 0.0], tf=-1.0)
    with pytest.raises(ArgumentError, match="the bias of 'gyro' is given 2 values"):
        ClosedLoop(plant, law, sensors=[Bias("gyro", [0.1, 0.2], on="v")], dt=0.1).layout  # noqa: B018


def test_attitude_error_at_a_time_is_that_of_the_nearest_sample():
    """Turning at 0.2 rad/s about an axis, logged every 0.1 s: 0.1 s is the nearest to 0.14 s."""
    plant = Model("turntable")
    sigma, rate = plant.state("sigma", 3), plant.control("rate")
    axis = ca.DM([0.0, 0.6, 0.8])
    plant.ode({sigma: (1 + ca.dot(sigma, sigma)) / 4 * rate * axis})
    reference = Reference.from_functions(plant, lambda t: np.zeros(3), lambda t: [0.2], 0.0, 0.0, tail="hold")
    run = ClosedLoop(plant, feedforward(reference), dt=0.1).simulate(np.zeros(3), tf=1.0)
    for at, angle in ((0.0, 0.0), (0.14, 0.02), (0.5, 0.1), (0.86, 0.18), (1.0, 0.2), (None, 0.2)):
        assert run.attitude_error("sigma", at=at) == pytest.approx(angle, abs=1e-9)


@pytest.mark.parametrize(
    ("units", "culprit"),
    [
        (("km", "km/s", "N"), r"state 'q' is in km in the plant 'cart' and in m in controller 'LQR'"),
        (("m", "m/s", "kN"), r"control 'F' is in kN in the plant 'cart' and in N in controller 'LQR'"),
        (("m", " m / s", "N"), None),
        (("", "", ""), None),
    ],
)
def test_a_plant_in_other_units_than_the_controller_is_refused(units, culprit):
    def cart(q_unit, v_unit, f_unit):
        model = Model("cart")
        q, v, F = (
            model.state("q", unit=q_unit), model.state("v", unit=v_unit), model.control("F", unit=f_unit),
        )  # fmt: skip
        model.ode({q: v, v: F})
        return model

    regulator = design_lqr(cart("m", "m/s", "N"), [0, 0], Q=1, R=1, dt=0.1)
    if culprit is None:
        ClosedLoop(cart(*units), regulator, [Lag("lag", 0.1)])
        return
    with pytest.raises(ArgumentError, match=culprit):
        ClosedLoop(cart(*units), regulator, [Lag("lag", 0.1)])
