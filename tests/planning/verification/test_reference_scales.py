"""Reference magnitudes do not depend on how a problem is written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import gnc_opt as go
from gnc_opt.planning.optimality.reference_scales import Scales
from gnc_opt.planning.optimality.trajectory_fit import Samples
from gnc_opt.planning.solution.polynomial import PiecewisePolynomial
from gnc_opt.planning.verification.recomputed import from_problem
from gnc_opt.planning.verification.verify_trajectory import _solution

Array = NDArray[np.float64]
PHASES = (Phase.explicit, Phase.reuse, Phase.generate)
TIMES = np.linspace(0.0, 1.0, 41)


@dataclass(frozen=True)
class System:
    """Dynamics and integrand of plain numbers or symbols, and a control over 1 s."""

    rates: Callable[[Any, Any], list[Any]]
    integrand: Callable[[Any, Any], Any]
    start: tuple[float, ...]
    control: Callable[[Array], list[Array]]


def _wave(t: Array) -> list[Array]:
    return [1.0 + np.sin(5 * t)]


SYSTEMS = {
    "integrator": System(lambda x, u: [u[0]], lambda x, u: u[0] ** 2, (0.0,), _wave),
    "lag": System(lambda x, u: [u[0] - 2 * x[0]], lambda x, u: u[0] ** 2 + x[0] ** 2, (1.0,), _wave),
    "cart": System(lambda x, u: [x[1], u[0]], lambda x, u: u[0] ** 2, (0.0, 0.0), lambda t: [6 - 12 * t]),
    "oscillator": System(lambda x, u: [x[1], u[0] - 4 * x[0]], lambda x, u: u[0] ** 2, (1.0, 0.0), _wave),
    "three integrators": System(
        lambda x, u: [x[1], x[2], u[0]], lambda x, u: u[0] ** 2, (0.0, 0.0, 1.0), _wave
    ),
    "pendulum": System(
        lambda x, u: [x[1], u[0] - 9.81 * ca.sin(x[0])], lambda x, u: u[0] ** 2, (1.0, 0.0), _wave
    ),
    "van der Pol": System(
        lambda x, u: [x[1], (1 - x[0] ** 2) * x[1] - x[0] + u[0]],
        lambda x, u: x[0] ** 2 + u[0] ** 2,
        (1.0, 0.0),
        _wave,
    ),
    "cubic": System(lambda x, u: [u[0] - x[0] ** 3], lambda x, u: u[0] ** 2, (1.5,), _wave),
    "bilinear": System(lambda x, u: [x[0] * u[0]], lambda x, u: u[0] ** 2, (1.0,), _wave),
    "two carts": System(
        lambda x, u: [x[2], x[3], u[0], u[1]],
        lambda x, u: u[0] ** 2 + 5 * u[1] ** 2,
        (0.0, 1.0, 0.0, 0.0),
        lambda t: [6 - 12 * t, np.cos(3 * t)],
    ),
    "unicycle": System(
        lambda x, u: [u[0] * ca.cos(x[2]), u[0] * ca.sin(x[2]), u[1]],
        lambda x, u: u[0] ** 2 + u[1] ** 2,
        (0.0, 0.0, 0.3),
        lambda t: [1 + t, np.cos(4 * t)],
    ),
    "rocket": System(
        lambda x, u: [x[1], 20 * u[0] / x[2] - 1, -u[0]],
        lambda x, u: u[0],
        (0.0, 0.0, 20.0),
        lambda t: [2 - t],
    ),
}


@dataclass(frozen=True)
class Frame:
    """x' = A x + b + v t, v along the first state, u' = k u + d, t' = c t, J' = g J + h; ranges of states, controls."""

    mixture: Array | None = None
    origin: float = 0.0
    drift: float = 0.0
    control: tuple[float, float] = (1.0, 0.0)
    time: float = 1.0
    cost: tuple[float, float] = (1.0, 0.0)
    bound: float | None = None
    units: tuple[float, ...] = field(default=())

    def matrix(self, n: int) -> Array:
        """A."""
        own = np.diag(np.resize(self.units or (1.0,), n))
        return own if self.mixture is None else own @ self.mixture[:n, :n]


@cache
def trajectory(name: str) -> tuple[Array, Array]:
    """States and controls at the times."""
    system = SYSTEMS[name]

    def rate(t: float, x: Array) -> Array:
        u = [float(v[0]) for v in system.control(np.array([t]))]
        return np.array([float(v) for v in system.rates(list(x), u)])

    run = solve_ivp(rate, (0.0, 1.0), system.start, t_eval=TIMES, rtol=1e-11, atol=1e-12)
    return np.asarray(run.y), np.stack([v + 0 * TIMES for v in system.control(TIMES)])


def plain_costates(t: Array, n: int) -> Array:
    """Costates of the plain frame: of no extremal, as those of a wrong answer, and the same in every frame."""
    return np.cos(np.arange(1.0, n + 1)[:, None] + 2 * t)


def ends_of_segments(polynomial: PiecewisePolynomial) -> tuple[Array, Array]:
    return polynomial.breaks[:-1], polynomial.breaks[1:]


def measured(
    name: str, frame: Frame, costates: Callable[[Array, int], Array] = plain_costates
) -> tuple[float, float, float]:
    """Cost scale, a displacement of the end and the change of a quantity over the reach, all of the plain frame."""
    system, (x, u) = SYSTEMS[name], trajectory(name)
    n, m = x.shape[0], u.shape[0]
    a, inverse = frame.matrix(n), np.linalg.inv(frame.matrix(n))
    b, v = np.full(n, frame.origin), frame.drift * np.eye(n)[0]
    model = go.Model(name)
    states = [model.state(f"x{i}") for i in range(n)]
    controls = [model.control(f"u{i}") for i in range(m)]
    time = model.time / frame.time
    plain = ca.mtimes(ca.DM(inverse), ca.vertcat(*states) - ca.DM(b) - ca.DM(v) * time)
    applied = [(c - frame.control[1]) / frame.control[0] for c in controls]
    split = [plain[i] for i in range(n)]
    rates = ca.mtimes(ca.DM(a), ca.vertcat(*system.rates(split, applied))) + ca.DM(v)
    model.ode({s: rates[i] / frame.time for i, s in enumerate(states)})
    problem = go.Problem(name)
    leg = problem.phase("leg", model)
    leg.time(0.0, frame.time)
    moved = a @ x + b[:, None] + v[:, None] * TIMES
    leg.initial(**{f"x{i}": float(moved[i, 0]) for i in range(n)})
    leg.final(**{f"x{i}": float(moved[i, -1]) for i in range(n)})
    if frame.bound is not None:
        leg.bounds(**{f"x{i}": (-frame.bound, frame.bound) for i in range(n)})
        leg.bounds(**{f"u{i}": (-frame.bound, frame.bound) for i in range(m)})
    problem.minimize(
        frame.cost[0] * leg.integral(system.integrand(split, applied) / frame.time) + frame.cost[1]
    )
    given = Samples(frame.time * TIMES, moved, frame.control[0] * u + frame.control[1])
    solution = from_problem(_solution(problem, {"leg": given}, np.zeros(0)))
    leg_solution = solution.phases["leg"]
    values = [
        frame.cost[0] * inverse.T @ costates((0.5 * (a + b) + 0.5 * (b - a) * nodes) / frame.time, n)
        for a, b, nodes in zip(*ends_of_segments(leg_solution.lam), leg_solution.lam.nodes, strict=True)
    ]
    lam = replace(leg_solution.lam, values=tuple(values))
    solution = replace(solution, phases={"leg": replace(leg_solution, lam=lam)})
    scales = Scales.of(solution, list(solution.samples().values()))
    own = scales.phases["leg"]
    displacement, gradient = np.linspace(0.3, -0.2, n), np.linspace(1.0, 2.0, n)
    return (
        scales.cost / frame.cost[0],
        float(own.end.displacement(a @ displacement)),
        float(own.along.change(inverse.T @ gradient)),
    )


def decades(most: float) -> Any:
    """Factors by up to so many powers of ten."""
    return st.floats(-most, most).map(lambda e: float(10.0**e))


@settings(max_examples=5, deadline=None, phases=PHASES)
@pytest.mark.parametrize("name", SYSTEMS)
@given(
    units=st.tuples(*[decades(4)] * 4),
    origin=st.floats(-100.0, 100.0),
    control=st.tuples(decades(4), st.floats(-10.0, 10.0)),
    time=decades(3),
    cost=st.tuples(decades(4), st.floats(-100.0, 100.0)),
    bound=st.sampled_from([None, 1e7, 1e9]),
)
def test_units_origins_and_ranges_do_not_matter(name: str, **frame: Any) -> None:
    found, plain = measured(name, Frame(**frame)), measured(name, Frame())
    np.testing.assert_allclose(found, plain, rtol=1e-6)


@settings(max_examples=2, deadline=None, phases=PHASES)
@pytest.mark.parametrize("name", [name for name in SYSTEMS if name != "rocket"])
@given(drift=st.floats(1.0, 1e3), mixture=st.integers(0, 99))
def test_moving_frames_and_mixtures_hardly_matter(name: str, drift: float, mixture: int) -> None:
    """The bound by what a state moves is one of its components; the cost scale does not depend on either.

    Not so for the rocket, whose H is affine: its pull asks for ten times the deviation, which that bound limits.
    """
    random = np.random.default_rng(mixture)
    rotation = np.linalg.qr(random.standard_normal((4, 4)))[0]
    n = len(SYSTEMS[name].start)
    mixed = np.eye(4)
    mixed[:n, :n] = np.linalg.qr(rotation[:n, :n])[0] * random.uniform(0.5, 2.0, n)
    plain = measured(name, Frame())
    for frame in (Frame(drift=drift), Frame(mixture=mixed)):
        found = measured(name, frame)
        assert found[0] == pytest.approx(plain[0], rel=1e-2)
        np.testing.assert_array_less(np.abs(np.log(np.array(found[1:]) / plain[1:])), np.log(6.0))


def test_closed_form_of_a_cart() -> None:
    """a = 6 - 12 t moves the end by (1, 3/2) at most, which are its principal sizes; the cost of it is 12."""
    x, u = trajectory("cart")
    assert x[:, -1] == pytest.approx([1.0, 0.0], abs=1e-8) and u.shape == (1, 41)
    cost, displacement, _ = measured("cart", Frame(), lambda t, n: np.stack([-24.0 + 0 * t, 24 * t - 12]))
    assert cost == pytest.approx(12.0, rel=1e-2)
    assert 0.3 < displacement < 3.0
