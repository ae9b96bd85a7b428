"""Path constraints of any order on trajectories without multipliers: arcs, touches, and limits met at free ends."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.array_types import Array

Trajectory = tuple[Array, Array, Array]


def chain(
    order: int, limit: float, start: dict[str, float], end: dict[str, float], last: float, how: str
) -> Any:
    """An integrator chain with the least effort below a limit on its first state, stated in one of three ways."""
    model = go.Model("chain")
    x = [model.state(name) for name in "qva"[:order]]
    u = model.control("u")
    model.ode(dict(zip(x, [*x[1:], u], strict=True)))
    problem, leg = one_phase("chain", model, 0.0, last)
    leg.initial(**start)
    leg.final(**end)
    if how == "path":
        leg.path("ceiling", x[0], upper=limit)
    elif how == "curved path":
        leg.path("ceiling", x[0] + 5 * x[0] ** 3, upper=limit + 5 * limit**3)
    else:
        leg.bounds(q=(None, limit))
    problem.minimize(leg.integral(u**2))
    return problem


def below(limit: float, how: str) -> go.Problem:
    """Thrown up, and back after 1 s (Bryson, Denham & Dreyfus 1963): an arc below 1/6, a touch up to 1/4."""
    return chain(2, limit, {"q": 0.0, "v": 1.0}, {"q": 0.0, "v": -1.0}, 1.0, how)


def arc(height: float) -> Trajectory:
    rise = 3 * height
    t = np.concatenate([np.linspace(a, b, 11) for a, b in ((0, rise), (rise, 1 - rise), (1 - rise, 1))])
    part = np.repeat([0, 1, 2], 11)
    left = np.choose(part, [1 - t / rise, 0 * t, 1 - (1 - t) / rise])
    states = [height * (1 - left**3), left**2 * np.choose(part, [1, 0, -1])]
    return t, np.array(states), -2 / rise * left


def touch(height: float) -> Trajectory:
    """Cubics from (0, 1) to rest at the height, and back."""
    t = np.concatenate([np.linspace(0, 0.5, 13), np.linspace(0.5, 1, 13)])
    tau, sign = np.minimum(t, 1 - t), np.repeat([1, -1], 13)
    b, c = np.linalg.solve([[1 / 4, 1 / 8], [1, 3 / 4]], [height - 1 / 2, -1])
    return (
        t,
        np.array([tau + b * tau**2 + c * tau**3, sign * (1 + 2 * b * tau + 3 * c * tau**2)]),
        2 * b + 6 * c * tau,
    )


def touch_of_order_three(height: float, n: int = 13) -> Trajectory:
    """Quintics from (0, 1, 0) to the height at 1 s, where speed and jerk vanish, and back; free it is 5/8 high."""
    t = np.concatenate([np.linspace(0, 1, n), np.linspace(1, 2, n)])
    tau, sign = np.minimum(t, 2 - t), np.repeat([1, -1], n)
    b, c, d = np.linalg.solve([[1, 1, 1], [3, 4, 5], [6, 24, 60]], [height - 1, -1, 0])
    states = [
        tau + b * tau**3 + c * tau**4 + d * tau**5,
        sign * (1 + 3 * b * tau**2 + 4 * c * tau**3 + 5 * d * tau**4),
        6 * b * tau + 12 * c * tau**2 + 20 * d * tau**3,
    ]
    return t, np.array(states), sign * (6 * b + 24 * c * tau + 60 * d * tau**2)


@pytest.mark.parametrize("how", ["curved path", "bound"])
@pytest.mark.parametrize(("height", "trajectory"), [(0.15, arc), (0.18, touch)])
def test_arcs_and_touches_of_order_two(height: float, trajectory: Any, how: str) -> None:
    verdict = go.verify_trajectory(below(height, how), *trajectory(height))
    assert verdict.minimum, verdict.explain()


@pytest.mark.slow
@pytest.mark.parametrize(("height", "trajectory"), [(0.1, arc), (0.3, touch)])
def test_what_keeps_below_a_limit_that_is_higher_is_not_explained_by_it(
    height: float, trajectory: Any
) -> None:
    """0.3 is above the height of a free flight: nothing pushes upwards."""
    assert not go.verify_trajectory(below(1.02 * height, "path"), *trajectory(height)).ok
    assert height < 0.25 or not go.verify_trajectory(below(height, "path"), *trajectory(height)).ok


@pytest.mark.slow
def test_touch_of_order_three() -> None:
    ends = {"q": 0.0, "v": 1.0, "a": 0.0}, {"q": 0.0, "v": -1.0, "a": 0.0}
    verdict = go.verify_trajectory(chain(3, 0.6, *ends, 2.0, "path"), *touch_of_order_three(0.6))
    assert verdict.minimum, verdict.explain()
    # Of samples so fine some beside the touch are as good as on the limit, and must not push.
    fine = go.verify_trajectory(chain(3, 0.55, *ends, 2.0, "bound"), *touch_of_order_three(0.55, 41))
    assert fine.minimum, fine.explain()
    higher = chain(3, 0.66, *ends, 2.0, "path")
    assert not go.verify_trajectory(higher, *touch_of_order_three(0.66)).ok  # pushed upwards


def floor(at: str, moving: float, height: float, kept: float) -> go.Verdict:
    """From 1 to a free end, or from a free end to 1, with a price of 3 on that end and a floor that is met there."""
    model, x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("floor", model, 0.0, 1.0)
    leg.path("floor", x + moving * model.time, lower=height)
    start = at == "start"
    getattr(leg, "final" if start else "initial")(x=1.0)
    end = leg.initial_state("x") if start else leg.final_state("x")
    problem.minimize(leg.integral(u**2 / 2) + 3 * end)
    t = np.linspace(0.0, 1.0, 11)
    way = 1 - kept
    return go.verify_trajectory(
        problem, t, kept + way * t if start else 1 - way * t, 0 * t + (way if start else -way)
    )


@pytest.mark.slow
@pytest.mark.parametrize("at", ["end"])
def test_a_floor_that_is_met_at_a_free_end_pushes_there(at: str) -> None:
    assert floor(at, 0.0, 0.0, 0.0).minimum
    assert not floor(at, 0.0, 0.0, 0.02).ok  # it stops above
    assert not floor(at, 0.0, -3.0, 0.0).ok  # there is no floor


def test_a_moving_floor_that_is_met_at_a_free_end() -> None:
    assert floor("end", 0.5, 0.5, 0.0).minimum
    assert not floor("end", 0.5, 0.5, 0.02).ok


@pytest.mark.slow
def test_atoms_push_a_parameter_that_is_the_limit() -> None:
    """The ceiling is bought: 4 / (9 h) + price h is least for a height of 0.1, with an arc and an atom at each end."""
    height = 0.1
    problem = go.Problem("bought ceiling")
    model, q, _v, u = dynamics("chain", "q v", "u", lambda q, v, u: {q: v, v: u})
    leg = problem.phase("leg", model)
    ceiling = problem.parameter("h", lower=0.01, upper=0.3, guess=0.1)
    leg.time(0.0, 1.0)
    leg.initial(q=0.0, v=1.0)
    leg.final(q=0.0, v=-1.0)
    leg.path("ceiling", q - ceiling, upper=0.0)
    problem.minimize(leg.integral(u**2) / 2 + 4 / (9 * height**2) * ceiling)
    right = go.verify_trajectory(problem, *arc(height), [height])
    assert right.minimum, right.explain()
    wrong = go.verify_trajectory(problem, *arc(1.1 * height), [1.1 * height])
    assert {c.name for c in wrong.failed} >= {"stationarity"}
