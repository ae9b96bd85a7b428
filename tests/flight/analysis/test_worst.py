"""Worst cases: a corner that is known, an inner maximum that is known, refusals."""

import numpy as np
import pytest
from testing.sled import loop_of

import gnc_opt as go
from gnc_opt.analysis import worst_case
from gnc_opt.simulation import Choice, Normal, SinusoidalDisturbance, Uniform, UniformInBall


def test_of_a_linear_loop_it_is_a_corner():
    loop = loop_of()
    bounds = {"initial.q": Uniform(-0.2, 0.3), "initial.v": Uniform(-0.1, 0.1)}
    mission = {"x0": [0.0, 0.0], "tf": 0.5}
    found = worst_case(go.Scenario(loop, **mission, dispersions=bounds), "q", generations=8)
    corners = [[q, v] for q in (-0.2, 0.3) for v in (-0.1, 0.1)]
    flight = loop.compile([0.0, 0.0], tf=0.5)
    quiet = np.zeros((flight.n_steps, 3))
    ends = [abs(flight.run(loop.parameters(x), quiet).states[0, -1]) for x in corners]
    assert found.value == pytest.approx(max(ends), rel=1e-9)
    assert [found.parameters[n][0] for n in bounds] == pytest.approx(corners[int(np.argmax(ends))], abs=1e-9)
    assert found.nominal == 0.0 and found.run.miss("q") == found.value
    assert "initial.v" in str(found)


def test_an_inner_maximum_is_the_resonance():
    """q'' + 0.2 q' + 4 q = sin(w t): after the transient the largest energy of q is at w^2 = 4 - 0.02."""
    spring = go.Model("spring")
    q, v, a = spring.state("q"), spring.state("v"), spring.control("a")
    e = spring.state("e")
    spring.ode({q: v, v: a - 0.2 * v - 4 * q, e: q**2})
    law = go.feedforward(go.Reference.constant(spring, [0, 0, 0], [0.0]))
    shaker = SinusoidalDisturbance("shaker", 1.0, 1.0, on="a")
    loop = go.ClosedLoop(spring, law, disturbances=[shaker], dt=0.2, accuracy=1e-6)
    bounds = {"shaker.frequency": Uniform(-0.9, 2.0), "shaker.phase": Uniform(-0.1, 0.1)}
    found = worst_case(
        go.Scenario(
            loop,
            x0=[0, 0, 0],
            tf=100.0,
            dispersions=bounds,
            measures={"energy": lambda runs: runs.state("e")[0]},
        ),
        "energy",
        generations=8,
    )
    w = np.sqrt(4 - 0.2**2 / 2)
    assert found.parameters["shaker.frequency"][0] == pytest.approx(w, rel=0.01)
    steady = 0.5 / ((4 - w**2) ** 2 + (0.2 * w) ** 2)  # mean square, less what (1 - e^(-0.1 t))^2 takes away
    assert found.value == pytest.approx(steady * (100 - 2 / 0.1 + 1 / 0.2), rel=0.01)


def test_directions_and_choices_are_searched_too():
    loop = loop_of()
    bounds = {"initial.q": UniformInBall(0.3), "plant.m": Choice([1.0, 2.0, 4.0])}
    found = worst_case(go.Scenario(loop, x0=[0.5, 0.0], tf=1.0, dispersions=bounds), "q", generations=6)
    assert found.parameters["plant.m"][0] == 4.0  # what is slow to brake
    assert found.parameters["initial.q"][0] == pytest.approx(0.8, abs=1e-6)


def test_what_has_no_bounds_is_refused():
    loop, mission = loop_of(), {"x0": [0.0, 0.0], "tf": 0.5}
    with pytest.raises(go.ArgumentError, match=r"'initial\.q' has no bounds: give Uniform"):
        worst_case(go.Scenario(loop, **mission, dispersions={"initial.q": Normal(0.1)}), "q")
    with pytest.raises(go.ArgumentError, match="nothing is dispersed"):
        worst_case(go.Scenario(loop, **mission, dispersions={}), "q")
    with pytest.raises(go.ArgumentError, match="number of generations"):
        worst_case(
            go.Scenario(loop, **mission, dispersions={"initial.q": UniformInBall(0.1)}), "q", generations=0
        )
