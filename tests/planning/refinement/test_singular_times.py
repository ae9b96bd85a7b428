"""Switch times of bang-singular solutions against independent calculations that know the singular feedback law."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve
from testing.models import one_phase

import gnc_opt as go
from problems.classics import van_der_pol

TIGHT = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14}


def starts(solution: go.Solution) -> list[tuple[str, float]]:
    assert solution.structure
    return [(arc.kind.value, arc.start) for arc in solution.structure]


def van_der_pol_residual(times: np.ndarray) -> list[float]:
    """Shooting with u = -1, +1 and the singular law x' = y, y' = x: y ends at zero, lam_y switches at zero."""
    first, entry = times

    def bang(u: float, span: tuple[float, float], state: list[float]) -> np.ndarray:
        flow = solve_ivp(lambda _, s: [s[1], -s[0] + s[1] * (1 - s[0] ** 2) + u], span, state, **TIGHT)
        return np.asarray(flow.y[:, -1])

    x, y = bang(1.0, (first, entry), list(bang(-1.0, (0.0, first), [0.0, 1.0])))
    left = 4.0 - entry
    end = x * np.sinh(left) + y * np.cosh(left)

    def back(_: float, s: np.ndarray) -> list[float]:
        x, y, lam_x, lam_y = s
        return [y, -x + y * (1 - x**2) + 1, -(x - lam_y * (1 + 2 * x * y)), -(y + lam_x + lam_y * (1 - x**2))]

    lam_y = solve_ivp(back, (entry, first), [x, y, -y, 0.0], **TIGHT).y[3, -1]
    return [float(end), float(lam_y)]


def test_van_der_pol_against_shooting() -> None:
    exact, _, found, _ = fsolve(van_der_pol_residual, [1.367, 2.461], xtol=1e-14, full_output=True)
    assert found == 1 and np.max(np.abs(van_der_pol_residual(exact))) < 1e-13
    np.testing.assert_allclose(exact, van_der_pol.SWITCH_TIMES, atol=1e-10)
    kinds = starts(go.solve(van_der_pol.build(), tol=1e-8, check=False))
    assert [kind for kind, _ in kinds] == ["lower", "upper", "singular"]
    np.testing.assert_allclose([time for _, time in kinds[1:]], exact, atol=1e-8)


def catalyst() -> go.Problem:
    """Catalyst mixing (Jackson 1968; COPS 3.0): u = 1, singular with a constant mixture, u = 0."""
    model = go.Model("catalyst")
    a, b = model.state("a"), model.state("b")
    u = model.control("u")
    model.ode({a: u * (10 * b - a), b: u * (a - 10 * b) - (1 - u) * b})
    problem, bed = one_phase("catalyst mixing", model, initial=0.0, final=1.0, name="bed")
    bed.initial(a=1.0, b=0.0)
    bed.bounds(u=(0.0, 1.0))
    problem.maximize(1 - bed.final_state("a") - bed.final_state("b"))
    return problem


def catalyst_optimum() -> tuple[float, float, float, float]:
    """Both switch times, singular control and yield: on the singular arc b/a = y is constant, the rest is algebra."""
    y, exit_ = ca.SX.sym("y"), ca.SX.sym("exit")
    decay = (1 - 10 * y) / (1 + y)  # exp(-11 t) when b/a has become y under u = 1
    entry, a = -ca.log(decay) / 11, (10 + decay) / 11
    mixture = y / (1 - 8 * y - 10 * y**2)  # keeps y constant
    left = ca.log(a) + mixture * (10 * y - 1) * (exit_ - entry) + ca.log(1 + y * ca.exp(exit_ - 1))
    free = ca.vertcat(y, exit_)
    gradient = ca.Function("gradient", [free], [ca.gradient(left, free)])
    best = fsolve(lambda v: gradient(v).full()[:, 0], [0.07, 0.72], xtol=1e-13)
    assert np.max(np.abs(gradient(best).full())) < 1e-13
    value = ca.Function("value", [free], [entry, mixture, 1 - ca.exp(left)])(best)
    return float(value[0]), float(best[1]), float(value[1]), float(value[2])


def test_catalyst_mixing_against_algebra() -> None:
    entry, exit_, mixture, gain = catalyst_optimum()
    solution = go.solve(catalyst(), tol=1e-8, check=False)
    kinds = starts(solution)
    assert [kind for kind, _ in kinds] == ["upper", "singular", "lower"]
    assert kinds[1][1] == pytest.approx(entry, abs=1e-8)
    assert kinds[2][1] == pytest.approx(exit_, abs=1e-8)
    assert solution.objective == pytest.approx(gain, abs=1e-12)
    middle = np.linspace(entry, exit_, 22)[1:-1]
    np.testing.assert_allclose(solution.control("u")(middle), mixture, atol=1e-5)
