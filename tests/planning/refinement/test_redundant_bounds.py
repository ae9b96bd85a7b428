"""Powers of controls that have no value beyond a bound: errors are numbers where polynomials swing past it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import fsolve
from testing.internals import estimate_segment_errors
from testing.models import dynamics, one_phase

import gnc_opt as go

TIME, DISTANCE, WEIGHT, SPEED = 4.0, 0.7, 0.5, 1.0


def hop(power: float = 1.5) -> go.Problem:
    """A rotor's lift, 0 to 1, pays by its power 3/2 (induced power): from a speed to rest, in given time."""
    model, _h, _v, lift = dynamics("hop", "h v", "lift", lambda h, v, lift: {h: v, v: lift - WEIGHT})
    problem, leg = one_phase("hop", model, initial=0.0, final=TIME)
    leg.initial(h=0.0, v=SPEED)
    leg.final(h=DISTANCE, v=0.0)
    leg.bounds(lift=(0.0, 1.0))
    problem.minimize(leg.integral(lift**power))
    return problem


def by_shooting() -> float:
    """The root of the lift is what a line says, between 0 and 1: dH/dlift = 1.5 lift^0.5 + lam_v, lam_v a line."""

    def lift(t: float, a: float, b: float) -> float:
        return float(np.clip(a + b * t, 0.0, 1.0)) ** 2

    def kinks(a: float, b: float) -> list[float]:
        return [t for t in (-a / b, (1.0 - a) / b) if 0 < t < TIME]

    def misses(line: np.ndarray) -> list[float]:
        places = kinks(*line)
        push = quad(lift, 0, TIME, args=tuple(line), points=places or None)[0]
        moved = quad(lambda t: (TIME - t) * lift(t, *line), 0, TIME, points=places or None)[0]
        return [SPEED + push - WEIGHT * TIME, SPEED * TIME + moved - WEIGHT * TIME**2 / 2 - DISTANCE]

    line = fsolve(misses, [0.0, 0.3], xtol=1e-13)
    assert np.max(np.abs(misses(line))) < 1e-10
    return quad(lambda t: lift(t, *line) ** 1.5, 0, TIME, points=kinks(*line) or None)[0]


def test_a_polynomial_beyond_its_bound_has_an_error_and_refines_to_the_optimum() -> None:
    coarse = go.solve(hop(), mesh="5x4", tol=None)
    (error,) = estimate_segment_errors(coarse).values()
    low = error.samples.u_polynomial < 0
    assert np.any(low) and np.any(np.isnan(error.samples.functions.integrands(*_at(error, low))))
    assert np.all(np.isfinite(error.largest_segment_errors))
    refined = go.solve(hop())
    assert go.verify(refined).ok and refined.objective == pytest.approx(by_shooting(), rel=1e-6)


def _at(error: object, low: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    s, at = error.samples, low[0]  # type: ignore[attr-defined]
    return s.times[at], s.x[:, at], s.u_polynomial[:, at]
