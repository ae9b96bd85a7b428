"""A crane in least time whose swing (order 2) and speed (order 1) are limited in turn, against arcs put together."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import fsolve
from testing.models import one_phase

import gnc_opt as go
from gnc_opt.array_types import Array

GRAVITY, LENGTH, SWING, FASTEST, WAY = 9.81, 10.0, 0.08, 3.0, 20.0

RATES = np.zeros((5, 5))
"""Of place, speed, swing, its rate and the acceleration, constant along an arc."""
RATES[0, 1] = RATES[1, 4] = RATES[2, 3] = 1.0
RATES[3, 2], RATES[3, 4] = -GRAVITY / LENGTH, -1 / LENGTH


def after(state: Array, acceleration: float, duration: float) -> Array:
    return np.asarray((expm(RATES * duration) @ np.append(state, acceleration))[:4])


def by_hand() -> Array:
    """Lengths of the arcs up to the middle, about which the motion is symmetric."""

    def to_limit(t: Array) -> Array:
        return after(after(np.zeros(4), 1.0, t[0]), -1.0, t[1])

    bangs = fsolve(lambda t: to_limit(t)[2:] - [-SWING, 0.0], [1.1, 0.5], xtol=1e-12)
    held = GRAVITY * SWING
    hanging = (FASTEST - to_limit(bangs)[1]) / held
    fast = after(to_limit(bangs), held, hanging)

    def middle(t: Array) -> Array:
        return after(after(fast, 0.0, t[0]), -1.0, t[1])

    last = fsolve(lambda t: middle(t)[[0, 2]] - [WAY / 2, 0.0], [0.5, 0.75], xtol=1e-12)
    return np.array([*bangs, hanging, *last])


@pytest.mark.slow
def test_bangs_between_arcs_on_limits_are_no_noise() -> None:
    """They are shorter than two segments of the mesh, and their switching functions small."""
    model = go.Model("crane")
    x, v, swing, rate = (model.state(name) for name in ("x", "v", "swing", "rate"))
    a = model.control("a")
    model.ode({x: v, v: a, swing: rate, rate: -(GRAVITY * swing + a) / LENGTH})
    problem, leg = one_phase("crane", model, initial=0.0, final=(5.0, 40.0))
    leg.initial(x=0.0, v=0.0, swing=0.0, rate=0.0)
    leg.final(x=WAY, v=0.0, swing=0.0, rate=0.0)
    leg.bounds(a=(-1.0, 1.0), swing=(-SWING, SWING), v=(-FASTEST, FASTEST))
    problem.minimize(leg.final_time)

    solution = go.solve(problem)

    lengths = by_hand()
    assert solution.converged and go.verify(solution).ok
    assert solution.objective == pytest.approx(2 * lengths.sum(), rel=1e-9)
    ends = np.unique([t for arc in solution.structure for t in (arc.start, arc.end)])
    half = np.cumsum([0.0, *lengths])
    assert ends == pytest.approx([*half, *(2 * half[-1] - half[-2::-1])], abs=1e-6)
