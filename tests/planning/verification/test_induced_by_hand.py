"""Where the switching-time problem decides, and how finely its flow is integrated."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from testing import constructed_solutions as by_hand
from testing.models import one_phase

import gnc_opt as go
from gnc_opt.planning import ConditionResult
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.verification import bang_bang_second_order_conditions as second_order
from gnc_opt.planning.verification.bang_bang_second_order_conditions import explain_why_not_bang_bang

Array = NDArray[np.float64]


def cart() -> go.Problem:
    problem = by_hand.cart()
    problem.get_phase().bounds(a=(-1.0, 1.0))
    return problem


def bang(**changes: Any) -> PhaseSamples:
    """One arc of a = 1 from rest; lam = (-1, t - 1), path "pure" of q."""
    box = by_hand.interval(-1.0, 1.0)
    return by_hand.samples(
        cart(),
        lambda t, k: np.array([t**2 / 2, t]),
        lambda t, k: np.array([1 + 0 * t]),
        **({"control_bounds": box, "lam": lambda t, k: np.array([-1 + 0 * t, t - 1])} | changes),
    )


def test_an_obstacle_needs_a_multiplier_that_counts() -> None:
    """A millionth of H for paths; a ten-thousandth of the cost for states over the phase's length."""
    base = bang()
    assert explain_why_not_bang_bang([base]) == ""
    least = 1e-6 * base.hamiltonian_scale
    for factor, told in ((0.9, False), (1.1, True)):
        for sign in (1.0, -1.0):
            pushed = bang(paths=lambda t, k, m=sign * factor * least: np.array([0 * t, m + 0 * t]))
            assert explain_why_not_bang_bang([base, pushed]) == (
                "phase leg: a path constraint is active" if told else ""
            )
    span = 1e-4 * base.cost_scale / base.phase.duration
    for factor, told in ((0.9, False), (1.1, True), (-0.9, False), (-1.1, True)):
        for i in (0, 1):
            rows = np.zeros((2, 1))
            rows[i] = factor * span / base.state_scale[i]
            pushed = bang(states=lambda t, k, m=rows: m + 0 * t)
            assert explain_why_not_bang_bang([pushed]) == (
                "phase leg: a state bound is active" if told else ""
            )
            rows *= base.phase.duration
            jumping = bang(lam=lambda t, k, m=rows: np.array([-1 + 0 * t, t - 1]) + k * m)
            assert bool(explain_why_not_bang_bang([jumping])) is told


def test_a_control_between_its_bounds_is_an_obstacle_at_its_first_sample() -> None:
    inside = bang(control_bounds=by_hand.interval(-1.0, 2.0))
    assert explain_why_not_bang_bang([inside]) == "phase leg, t = 0 s, a: the control is between its limits"
    assert not second_order.is_bang_bang([bang(), inside]) and second_order.is_bang_bang([bang()])
    assert not second_order.is_bang_bang([])
    vanished = replace(bang().phase, final_time=0.0, final_time_bounds=by_hand.interval(0.0, 0.0))
    none = PhaseSamples.from_phase(vanished, bang().functions)
    assert explain_why_not_bang_bang([none]) == "phase leg has no length"


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "told"), [(3e2, ConditionResult.PASS), (1e4, ConditionResult.INCONCLUSIVE)])
def test_dynamics_that_are_fast_for_the_steps_are_resolved_or_not_judged(
    rate: float, told: ConditionResult
) -> None:
    """A filter beside a bang-bang move: explicit steps must be shorter than a few of its time constants."""
    cart = go.Model("cart with a filter")
    q, v, w, a = cart.state("q"), cart.state("v"), cart.state("w"), cart.control("a")
    cart.ode({q: v, v: a, w: rate * (q - w)})
    problem, leg = one_phase("filtered", cart, 0.0, (0.1, 10.0))
    leg.initial(q=1.0, v=0.0, w=1.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    verdict = go.verify(go.solve(problem))
    assert verdict["dynamics"].result is ConditionResult.PASS
    assert {verdict[name].result for name in ("second order", "second order")} == {told}
    if told is ConditionResult.INCONCLUSIVE:
        assert "too fast" in verdict["second order"].where
