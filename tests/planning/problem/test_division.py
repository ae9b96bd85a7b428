"""Constraints during a window of a phase, which is divided for them, against closed forms."""

import numpy as np
import pytest
from testing.models import one_phase

import gnc_opt as go


def ride(final_time: object = 1.0) -> tuple[go.Problem, object, object]:
    model = go.Model("cart")
    q, v, a = model.state("q", unit="m"), model.state("v", unit="m/s"), model.control("a", unit="m/s^2")
    model.ode({q: v, v: a})
    problem, leg = one_phase("window", model, 0.0, final_time)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    return problem, leg, a


def effort(span: float, start: float, end: float, distance: float) -> float:
    """Least integral of a^2 from one speed to another over a distance."""
    return 12.0 * (distance - 0.5 * (start + end) * span) ** 2 / span**3 + (end - start) ** 2 / span


@pytest.mark.slow
@pytest.mark.parametrize("how", [{"times": [0.3, 0.6]}, {"fractions": [0.3, 0.6]}])
def test_speed_limit_during_a_window(how: dict[str, list[float]]) -> None:
    """The speed stays at its limit in the window; what lies before and after shares the distance that is left."""
    problem, leg, a = ride()
    first, window, last = problem.divide(leg, **how)
    window.bounds(v=(None, 1.2))
    problem.minimize(sum(part.integral(a**2) for part in (first, window, last)))
    found = go.solve(problem)
    ways = np.linspace(0.1, 0.3, 200001)
    expected = np.min(effort(0.3, 0.0, 1.2, ways) + effort(0.4, 1.2, 0.0, 1.0 - 0.36 - ways))
    assert found.objective == pytest.approx(expected, rel=1e-8)
    assert go.verify(found).ok
    assert [found.phase(name).final_time for name in ("leg", "leg_2", "leg_3")] == [0.3, 0.6, 1.0]


def test_fractions_of_a_free_duration() -> None:
    """Without a limit the division changes nothing: the least of 12 / T^3 + T is at T = 6^(1/2)."""
    problem, leg, a = ride((0.5, 5.0))
    parts = problem.divide(leg, fractions=[0.25])
    problem.minimize(sum(part.integral(a**2) for part in parts) + parts[-1].final_time)
    found = go.solve(problem, check=False)
    span = 36.0**0.25
    assert found.objective == pytest.approx(12.0 / span**3 + span, rel=1e-8)
    assert found.phase("leg").final_time == pytest.approx(0.25 * span, rel=1e-6)


def test_limits_of_the_duration_are_of_all_parts() -> None:
    problem, leg, a = ride((0.5, 5.0))
    leg.time(1.0, (1.5, 6.0), duration=(0.0, 2.0))
    parts = problem.divide(leg, fractions=[0.25])
    problem.minimize(sum(part.integral(a**2) for part in parts))
    found = go.solve(problem, check=False)
    assert found.objective == pytest.approx(12.0 / 8.0, rel=1e-8)
    assert found.phase("leg").final_time == pytest.approx(1.5, rel=1e-8)


def test_wrong_uses_are_named() -> None:
    problem, leg, a = ride()
    with pytest.raises(go.ProblemError, match="either times or fractions"):
        problem.divide(leg)
    with pytest.raises(go.ProblemError, match="increasing ones between 0 and 1"):
        problem.divide(leg, fractions=[0.5, 1.5])
    with pytest.raises(go.ProblemError, match="increasing ones between 0 and 1"):
        problem.divide(leg, times=[0.6, 0.3])
    leg.integral(a**2)
    with pytest.raises(go.ProblemError, match=r"call divide\(\) first"):
        problem.divide(leg, times=[0.5])
