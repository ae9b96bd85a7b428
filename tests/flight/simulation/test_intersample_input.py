"""Waves piece by piece: what they are at a time, how they are stacked, cut, bent, averaged and integrated."""

import itertools
from decimal import Decimal, localcontext

import casadi as ca
import numpy as np
import pytest
from testing.internals import Part, Wave, stacked
from testing.loops import controller, feedback, scheduled

from gnc_opt.model import Model
from gnc_opt.simulation import ClosedLoop, Delay, RateLimit

H = 2.0
NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)
NODES, WEIGHTS = 0.5 * (NODES + 1), 0.5 * WEIGHTS


def sx(*values):
    return ca.SX(list(map(float, values)))


def number(expression):
    return ca.evalf(ca.SX(expression)).full().ravel()


def curve(parts, tau, s):
    """The values at a time: of each component by its last part that has begun."""
    out = np.zeros(len(parts[0][0]))
    for begin, value, slope, decay in parts:
        late = s - np.array(begin)
        here = np.array(value) + np.array(slope) * late
        if tau is not None:
            here = here + np.array(decay) * np.exp(-late / np.array(tau))
        out = np.where(late >= 0, here, out)
    return out


TWO = (
    ((0.0, 0.0), (1.0, -2.0), (0.5, 0.0), (0.3, 4.0)),
    ((0.5, 0.25), (3.0, 1.0), (-1.0, 2.0), (-0.7, 0.0)),
    ((1.5, 0.25), (0.5, 1.0), (0.0, 2.0), (2.0, 0.0)),
)
TAU = (0.2, 0.6)
BREAKS = (0.5, 1.5, 0.25)


def wave(parts=TWO, tau=TAU, breaks=BREAKS, **more):
    """Its mean is that over the minor step."""
    edges = [0.0, *sorted(breaks), H]
    mean = sum(
        w * (b - a) * curve(parts, tau, a + (b - a) * n)
        for a, b in itertools.pairwise(edges)
        for n, w in zip(NODES, WEIGHTS, strict=True)
    )
    return Wave(
        sx(*(mean / H)), tuple(Part(*(sx(*entry) for entry in part)) for part in parts),
        None if tau is None else sx(*tau), tuple(ca.SX(b) for b in breaks), **more,
    )  # fmt: skip


LINES = tuple((b, v, g, (0.0,) * len(b)) for b, v, g, _ in TWO)
STEPS = tuple((b, v, (0.0,) * len(b), (0.0,) * len(b)) for b, v, _, _ in TWO)


def held(*values):
    return Wave(sx(*values))


def moments(given, begin, end, steps):
    """Mean, first and second moment over every integration step (n, 3) each."""
    value = given.input(ca.SX(begin), ca.SX(end), steps)
    found = []
    for k in range(steps):
        at = np.array([number(value(k, float(n))) for n in NODES])
        found.append(np.array([(WEIGHTS * NODES**j) @ at for j in range(3)]).T)
    return np.array(found)


def expected(curve_at, begin, end, steps):
    sigma = (end - begin) / steps
    found = []
    for k in range(steps):
        at = np.array([curve_at(begin + sigma * (k + n)) for n in NODES])
        found.append(np.array([(WEIGHTS * NODES**j) @ at for j in range(3)]).T)
    return np.array(found)


# --- integration ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("steps", [1, 3])
@pytest.mark.parametrize(("begin", "end"), [(0.0, 0.25), (0.25, 0.5), (0.5, 1.5), (1.5, 2.0)])
@pytest.mark.parametrize(("parts", "tau"), [(TWO, TAU), (TWO, (0.05, 50.0)), (LINES, None), (STEPS, None)])
def test_an_integration_step_sees_three_moments_of_the_wave(parts, tau, begin, end, steps):
    found = moments(wave(parts, tau), begin, end, steps)
    wanted = expected(lambda s: curve(parts, tau, s), begin, end, steps)
    assert found == pytest.approx(wanted, abs=1e-9)


def test_within_a_step_the_projection_of_a_slow_decay_is_the_decay():
    value = wave(TWO, (5.0, 5.0)).input(ca.SX(0.5), ca.SX(1.5), 4)
    for k in range(4):
        for node in (0.0, 0.5, 0.9):
            s = 0.5 + 0.25 * (k + node)
            assert number(value(k, node)) == pytest.approx(curve(TWO, (5.0, 5.0), s), abs=3e-5)


# --- together and apart -----------------------------------------------------------------------------------


def test_stacked_waves_keep_their_own_times():
    """A held one, one that lags and one of straight lines, whose parts change at other times."""
    third = ((0.0,), (5.0,), (1.0,), (0.0,)), ((1.0,), (-1.0,), (0.5,), (0.0,))
    own = wave(third, None, (1.0,))
    whole = stacked([held(7.0), wave(), own], H)
    assert number(whole.mean) == pytest.approx([7.0, *number(wave().mean), *number(own.mean)])
    assert [float(b) for b in whole.breaks] == [0.5, 1.5, 0.25, 1.0]
    edges = [0.0, 0.25, 0.5, 1.0, 1.5, 2.0]
    for begin, end in itertools.pairwise(edges):

        def at(s):
            return np.array([7.0, *curve(TWO, TAU, s), *curve(third, None, s)])

        assert moments(whole, begin, end, 2) == pytest.approx(expected(at, begin, end, 2), abs=1e-9)
    lines = stacked([wave(LINES, None), own], H)
    assert lines.tau is None and lines.straight
    mixed = stacked([wave(LINES, None), wave()], H)  # what does not lag has any time constant, and no decay
    assert number(mixed.tau)[2:].tolist() == list(TAU) and mixed.tau.shape == mixed.mean.shape == (4, 1)
    one = wave()
    assert stacked([one], H) is one


# --- blocks without memory --------------------------------------------------------------------------------


def test_where_waves_of_several_actuators_break_the_integration_begins_anew():
    """Two delays and a rate limit on three controls: held, then held, then a ramp, in one step of 1 s."""
    plant = Model("impulses")
    x = plant.state("x", 3)
    a, b, c = (plant.control(name) for name in "abc")
    plant.ode({x: ca.vertcat(a, b, c)})
    law = scheduled(plant, lambda t: np.tile([[2.0], [3.0], [4.0]], t.size))
    chain = [Delay("late", 0.25, on="a"), Delay("later", 0.75, on="b"), RateLimit("slew", 8.0, on="c")]
    run = ClosedLoop(plant, law, chain, dt=1.0).simulate(np.zeros(3), tf=1.0)
    assert run.applied[:, 0] == pytest.approx([2 * 0.75, 3 * 0.25, 4 * (1 - 0.25)], rel=1e-13)
    assert run.states[:, -1] == pytest.approx(run.applied[:, 0], rel=1e-13)
    assert run.outcome.ok


@pytest.mark.parametrize("options", [{"substeps": 1}, {"accuracy": 0.1}])
def test_the_printed_error_is_that_of_the_end_where_errors_grow(options):
    """x' = 4 x from 1/2 exp(-16), to 1/2 after 4 s: errors of the first steps are multiplied by millions."""
    plant = Model("growing")
    x, u = plant.state("x"), plant.control("u")
    plant.ode({x: 4 * x + u})
    loop = ClosedLoop(plant, feedback(plant, [[0.0]]), dt=0.5, **options)
    flight = loop.compile([0.5 * np.exp(-16.0)], tf=4.0)
    ending = flight.final(flight.nominal[:, None], [0])
    assert 1.0 < ending.integration_error[0] / abs(ending.states[0, 0] - 0.5) < 1.4


@pytest.mark.parametrize(
    ("dt", "tf", "accuracy"), [(0.02, 10.0, 1e-6), (0.02, 10.0, 1e-8), (0.1, 40.0, 1e-6)]
)
def test_a_relay_on_an_unstable_plant_is_no_run_that_passes(dt, tf, accuracy):
    """x' = 2 x - sign(x) of the samples: exactly x E - sign(x) (E - 1) / 2 after each, E = exp(2 dt), with 60 digits.

    Nothing damps the difference of two runs whose relay turns at the same samples: it grows as exp(2 t), rounding, too;
    over 40 s by 5e34, and the relays turn at other samples.
    """
    plant = Model("unstable")
    x, u = plant.state("x"), plant.control("u")
    plant.ode({x: 2 * x + u})
    relay = controller(plant, lambda t, x, r, z: (-ca.sign(x), z))
    start = 0.3
    run = ClosedLoop(plant, relay, dt=dt, accuracy=accuracy).simulate([start], tf=tf)
    with localcontext() as context:
        context.prec = 60
        growth, exact = (2 * Decimal(dt)).exp(), Decimal(start)
        for _ in range(run.commands.shape[1]):
            exact = growth * exact - (growth - 1) / 2 * (1 if exact > 0 else -1)
        error = abs(float(Decimal(float(run.states[0, -1])) - exact))
    assert run.outcome.ok == (run.integration_error <= accuracy)
    assert error <= accuracy or not run.outcome.ok
