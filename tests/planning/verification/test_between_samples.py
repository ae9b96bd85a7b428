"""What is narrow in time or place is seen although no sample of the phase has a hint of it."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.models import one_phase

import gnc_opt as go


def cart(gust: Any = None, spike: Any = None, limit: Any = None, upper: float = 0.5) -> go.Problem:
    """Rest to rest over 1 m in 1 s with the least effort; each narrow thing is a function of (t, q)."""
    model = go.Model("cart")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a + (0.0 if gust is None else gust(model.time, q))})
    problem, leg = one_phase("narrow", model, 0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    if limit is not None:
        leg.path("limit", limit(model.time, q), upper=upper)
    problem.minimize(leg.integral(a**2 + (0.0 if spike is None else spike(model.time, q))))
    return problem


def judged(**narrow: Any) -> go.Verdict:
    """Check 41 samples of the optimum."""
    t = np.linspace(0.0, 1.0, 41)
    return go.verify_trajectory(cart(**narrow), t, [3 * t**2 - 2 * t**3, 6 * t - 6 * t**2], 6 - 12 * t)


def bell(at: float) -> Any:
    """A peak of 1 when the cart is at a place, a ten-thousandth of the way wide."""
    return lambda t, q: ca.exp(-(((q - at) / 1e-4) ** 2))


@pytest.mark.parametrize("at", [0.1973, 0.8089])
def test_a_limit_that_is_flat_but_for_a_narrow_peak(at: float) -> None:
    verdict = judged(limit=bell(at))
    assert [c.name for c in verdict.failed] == ["limits"]
    assert judged(limit=bell(1.1)).minimum


@pytest.mark.parametrize(
    "wall",
    [lambda d: -1 / ca.sqrt(d**2 + 1e-10), lambda d: ca.fmin(d**2 / 1e-8, 4.0)],
    ids=["inverse distance", "cut off"],
)
def test_one_wall_in_any_formula(wall: Any) -> None:
    """What must stay off 0.5187 by 1e-4."""
    least = float(ca.DM(wall(ca.DM(1e-4))))
    verdict = judged(limit=lambda t, q: -wall(q - 0.5187), upper=-least)
    assert "limits" in {c.name for c in verdict.failed}
    assert judged(limit=lambda t, q: -wall(q - 1.1), upper=-least).minimum


def test_a_gust_between_samples() -> None:
    """The speed would change by 0.05 m/s within 1/2000 s."""
    verdict = judged(gust=lambda t, q: 100 * ca.exp(-(((t - 0.4125) / 3e-4) ** 2)))
    assert "dynamics" in {c.name for c in verdict.failed}
    assert judged(gust=lambda t, q: 100 * ca.exp(-(((t - 1.1) / 3e-4) ** 2))).minimum


def test_a_cost_between_samples() -> None:
    """It amounts to 0.05 beside the 12 of the effort."""
    verdict = judged(spike=lambda t, q: 100 * ca.exp(-(((t - 0.4109) / 3e-4) ** 2)))
    assert "cost" in {c.name for c in verdict.failed}
    assert judged(spike=lambda t, q: 100 * ca.exp(-(((t - 1.1) / 3e-4) ** 2))).minimum


@pytest.mark.parametrize("width", [1e-8])
@pytest.mark.parametrize("kind", ["gust", "price", "window", "place"])
def test_a_feature_of_any_width_is_found_at_the_constants_of_the_problem(kind: str, width: float) -> None:
    """A gust of 1 at t = 0.5137; a price or a limit of x then, or a limit at x = 0.5137, none of them heeded."""
    model = go.Model("narrow")
    x, u, t = model.state("x"), model.control("u"), model.time
    bell = ca.exp(-(((t - 0.5137) / width) ** 2))
    density = bell / (width * np.sqrt(np.pi))
    model.ode({x: u + density if kind == "gust" else u})
    problem, leg = one_phase("narrow", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    if kind == "window":
        leg.path("window", ca.if_else(ca.fabs(t - 0.5137) < width, x, 0.0), upper=0.4)
    if kind == "place":
        leg.path("place", ca.exp(-(((x - 0.5137) / width) ** 2)) * (1 + t), upper=1.2)
    price = density * (x - 0.2) ** 2 if kind == "price" else 0.0
    problem.minimize(leg.integral(u**2 + price))
    times = np.linspace(0.0, 1.0, 61)
    assert not go.verify_trajectory(problem, times, {"x": times}, {"u": 1 + 0 * times}).ok


def with_error_of_area(error: np.ndarray) -> go.ConditionResult:
    """The dynamics condition of the optimum with the area below q as a third state, which has an error (n,)."""
    model = go.Model("cart")
    q, v, area, a = model.state("q"), model.state("v"), model.state("area"), model.control("a")
    model.ode({q: v, v: a, area: q})
    problem, leg = one_phase("area", model, 0.0, 1.0)
    leg.initial(q=0.0, v=0.0, area=0.0)
    leg.final(q=1.0, v=0.0)
    problem.minimize(leg.integral(a**2))
    t = np.linspace(0.0, 1.0, error.size)
    x = [3 * t**2 - 2 * t**3, 6 * t - 6 * t**2, t**3 - t**4 / 2 + error]
    return go.verify_trajectory(problem, t, x, 6 - 12 * t)["dynamics"].result


def test_a_defect_that_denser_samples_remove_does_not_fail() -> None:
    """A wave of the area, as between the nodes of a mesh."""
    waves = [5e-6 * np.sin(16 * np.pi * np.linspace(0.0, 1.0, n)) for n in (81, 641)]
    assert [with_error_of_area(w).value for w in waves] == ["INCONCLUSIVE", "PASS"]


@pytest.mark.parametrize("n", [81, 321])
def test_a_sample_that_is_off_fails_at_any_density(n: int) -> None:
    error = np.where(np.arange(n) == n // 4 * 2, 5e-6, 0.0)
    assert with_error_of_area(error) is go.ConditionResult.FAIL
