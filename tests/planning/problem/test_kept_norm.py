"""Bounds that a vector keeps by its length: dropped where the dynamics keep that length, and nowhere else."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from testing.internals import find_implied_bounds
from testing.models import one_phase

import gnc_opt as go

ANGLE, TIME = 1.2, 3.0


def slew(rate: str = "kept", scalars: bool = False, size: float = 1.0) -> go.Problem:
    """A body of inertia 1 turned about its third axis from rest to rest; its quaternion has length `size` at first."""
    model = go.Model("body")
    q = ca.vertcat(*(model.state(f"q_{i}") for i in range(4))) if scalars else model.state("q", 4)
    w, u = model.state("w", 3, unit="rad/s"), model.control("u", 3, unit="rad/s^2")
    turned = 0.5 * ca.vertcat(-ca.dot(q[1:], w), q[0] * w + ca.cross(q[1:], w))
    if rate == "pulled to 1":
        turned += (1.0 - ca.sumsqr(q)) * q
    elif rate == "fast":
        turned *= 1e9
    elif rate == "grows":
        turned += 1e-6 * w[0] * q
    names = [f"q_{i}" for i in range(4)]
    model.ode({**(dict(zip(names, ca.vertsplit(turned), strict=True)) if scalars else {"q": turned}), w: u})
    problem, leg = one_phase("rest to rest", model, initial=0.0, final=TIME, name="turn")
    first, last = size * np.eye(4)[0], [np.cos(ANGLE / 2), 0.0, 0.0, np.sin(ANGLE / 2)]
    leg.initial(**(dict(zip(names, first, strict=True)) if scalars else {"q": first}), w=[0.0, 0.0, 0.0])
    leg.final(**(dict(zip(names, last, strict=True)) if scalars else {"q": last}), w=[0.0, 0.0, 0.0])
    leg.bounds(**(dict.fromkeys(names, (-1.0, 1.0)) if scalars else {"q": (-1.0, 1.0)}), w=(-2.0, 2.0))
    problem.minimize(leg.integral(ca.sumsqr(u)))
    return problem


def idle(problem: go.Problem) -> tuple[list[int], list[int]]:
    """Places of the states whose lower, and whose upper, bounds are idle."""
    lower, upper = find_implied_bounds(problem, problem.get_phase())
    return list(np.flatnonzero(lower)), list(np.flatnonzero(upper))


@pytest.mark.parametrize("scalars", [False, True])
@pytest.mark.parametrize("rate", ["kept", "fast", "pulled to 1"])
def test_bounds_of_a_unit_quaternion_say_nothing_and_those_of_rates_do(rate: str, scalars: bool) -> None:
    # The rates w are zero at both ends, where anything times them is zero: they are no vector of kept length.
    assert idle(slew(rate, scalars)) == ([0, 1, 2, 3], [0, 1, 2, 3])


def test_only_what_is_the_length_is_idle() -> None:
    upright = slew()
    upright.get_phase().bounds(q=([0.0, -1.0, -0.5, -1.0], [1.0, 0.4, 1.0, 1.1]))
    assert idle(upright) == ([1, 3], [0, 2])


@pytest.mark.parametrize("problem", [slew("grows"), slew("pulled to 1", size=0.5)], ids=["grows", "shorter"])
def test_a_length_that_changes_leaves_the_bounds(problem: go.Problem) -> None:
    assert idle(problem) == ([], [])


def test_a_quaternion_that_begins_on_its_bounds_is_no_harder_and_right() -> None:
    # About a principal axis the turn is a double integrator: the least integral of u^2 is 12 angle^2 / T^3.
    bounded = go.solve(slew(), tol=None)
    assert abs(bounded.objective - 12.0 * ANGLE**2 / TIME**3) < 1e-6
    assert bounded.statistics.iterations <= 12  # on the bounds 21, and no solution of many others
    assert not [c for c in go.verify(bounded).open_conditions if c.name == "limits"]
