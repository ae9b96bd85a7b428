"""A plant that is a Python object."""

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.models import dynamics

import gnc_opt as go
from gnc_opt.estimation import Measurement
from gnc_opt.simulation import simulate_external_plant

DT = 0.1


def pendulum() -> go.Model:
    model, *_ = dynamics("pendulum", "q v", "a", lambda q, v, a: {q: v, v: a - ca.sin(q)})
    return model


class Integrated:
    """The pendulum by SciPy; deaf from the second given time to the third."""

    def __init__(self, x, deaf=(9e9, 9e9), seen=2):
        self.x, self.deaf, self.seen = np.array(x, dtype=float), deaf, seen

    def measure(self, t):
        return np.full(self.seen, np.nan) if self.deaf[0] <= t < self.deaf[1] else self.x[: self.seen]

    def step(self, t, u, dt):
        flow = scipy.integrate.solve_ivp(
            lambda s, x: [x[1], u[0] - np.sin(x[0])], (t, t + dt), self.x, rtol=1e-11, atol=1e-12
        )
        self.x = flow.y[:, -1]


def regulator():
    return go.design_lqr(pendulum(), [0.4, 0.0], Q=1, R=1, dt=DT, integral={"q": 0.5})


def test_it_flies_as_the_compiled_loop_does():
    law = regulator()
    run = go.ClosedLoop(pendulum(), law, dt=DT, accuracy=1e-10).simulate([1.0, 0.0], tf=6.0)
    flight = simulate_external_plant(law, Integrated([1.0, 0.0]), tf=6.0)
    assert np.allclose(flight.times, run.times)
    assert np.allclose(flight.measured, run.states, atol=1e-8)
    assert np.allclose(flight.commands, run.commands[:, : flight.commands.shape[1]], atol=1e-8)
    assert flight.alarms == () and np.ptp(flight.commands) > 0.5


def test_lost_samples_are_those_of_the_law():
    flight = simulate_external_plant(regulator(), Integrated([1.0, 0.0], deaf=(1.95, 2.55)), tf=3.0)
    assert flight.alarms == ("invalid",)
    lost = np.isnan(flight.measured[0])
    assert list(np.flatnonzero(lost)) == [20, 21, 22, 23, 24, 25]
    assert np.all(
        flight.commands[0, 23:26] == pytest.approx(np.sin(0.4))
    )  # the feedforward, after three held


def test_an_estimator_may_stand_between():
    model = pendulum()
    told = {"sigma0": {"q": 0.1, "v": 0.1}, "process_noise": {"v": 0.1}, "dt": DT}
    law = go.output_feedback(regulator(), go.design_ekf(model, [1.0, 0.0], [Measurement("q", 1e-3)], **told))
    flight = simulate_external_plant(law, Integrated([1.0, 0.0], seen=1), tf=10.0)
    assert flight.measured.shape == (1, 101)
    assert flight.measured[0, -1] == pytest.approx(0.4, abs=0.01)


def test_what_cannot_be_flown_is_refused():
    law = regulator()
    with pytest.raises(go.ArgumentError, match="type 'int' cannot be flown: give it the methods measure"):
        simulate_external_plant(law, 3, tf=1.0)
    with pytest.raises(
        go.ArgumentError, match="the plant measures 1 numbers, and 'LQR' feeds back 2: return q, v"
    ):
        simulate_external_plant(law, Integrated([1.0, 0.0], seen=1), tf=1.0)
    with pytest.raises(
        go.ArgumentError, match=r"0 to 1\.05 s are no whole number of control steps of 0\.1 s"
    ):
        simulate_external_plant(law, Integrated([1.0, 0.0]), tf=1.05)
    with pytest.raises(go.ArgumentError, match="the duration of simulate_external_plant"):
        simulate_external_plant(law, Integrated([1.0, 0.0]), tf=-1.0)
    with pytest.raises(go.ArgumentError, match="what simulate_external_plant\\(\\) flies with"):
        simulate_external_plant(pendulum(), Integrated([1.0, 0.0]), tf=1.0)
