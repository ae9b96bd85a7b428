"""Random linear-quadratic problems on random meshes, against Riccati equations solved by exponentials."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from testing.models import one_phase
from testing.nonlinear_problems import SCHEMES

import gnc_opt as go


@st.composite
def meshes(draw: st.DrawFn) -> go.Mesh:
    """Two to four segments, the widest at most three times as wide as the narrowest, of 8 to 10 points."""
    segments = draw(st.integers(2, 4))
    widths = np.array([draw(st.floats(1.0, 3.0)) for _ in range(segments)])
    degrees = tuple(draw(st.integers(8, 10)) for _ in range(segments))
    breaks = np.concatenate([[0.0], np.cumsum(widths) / np.sum(widths)])
    return go.Mesh(tuple(breaks), degrees)


def regulator(rng: np.random.Generator, n: int, m: int) -> tuple[go.Problem, dict[str, np.ndarray]]:
    """min 1/2 x(T)'S x(T) + 1/2 int x'Q x + u'R u, x' = A x + B u, T = 1, with eigenvalues of order one."""
    a, b = rng.normal(size=(n, n)) / np.sqrt(n), rng.normal(size=(n, m))
    b /= np.linalg.norm(b, 2)
    roots = [rng.normal(size=(n, n)) / np.sqrt(n) for _ in range(2)]
    q, s = (root @ root.T for root in roots)
    r = np.diag(rng.uniform(0.5, 2.0, m))
    start = rng.normal(size=n)
    model = go.Model("linear")
    x, u = model.state("x", n), model.control("u", m)
    model.ode({x: ca.DM(a) @ x + ca.DM(b) @ u})
    problem, leg = one_phase("regulator", model, initial=0.0, final=1.0)
    leg.initial(x=start)
    end = leg.final_state("x")
    running = leg.integral((x.T @ ca.DM(q) @ x + u.T @ ca.DM(r) @ u) / 2)
    problem.minimize(end.T @ ca.DM(s) @ end / 2 + running)
    return problem, {"a": a, "b": b, "q": q, "r": r, "s": s, "start": start}


def riccati(data: dict[str, np.ndarray], t: float) -> np.ndarray:
    """P(t) from the Hamiltonian matrix: [x; lam](1) = expm(M (1 - t)) [x; lam](t) and lam(1) = S x(1)."""
    a, b, q, r, s = (data[k] for k in "abqrs")
    n = a.shape[0]
    flow = expm(np.block([[a, -b @ np.linalg.solve(r, b.T)], [-q, -a.T]]) * (1 - t))
    return np.linalg.solve(flow[n:, n:] - s @ flow[:n, n:], s @ flow[:n, :n] - flow[n:, :n])


@pytest.mark.slow
@settings(max_examples=5, derandomize=True)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(1, 4),
    m=st.integers(1, 2),
    mesh=meshes(),
    scheme=st.sampled_from(SCHEMES),
)
def test_costates_are_riccati_times_state(seed: int, n: int, m: int, mesh: go.Mesh, scheme: str) -> None:
    """lam(t) = P(t) x(t), u = -R^-1 B' lam and J = x0' P(0) x0 / 2, everywhere and not only at the points."""
    problem, data = regulator(np.random.default_rng(seed), n, m)
    solution = go.solve(problem, mesh=mesh, scheme=scheme, tol=None)
    start = data["start"]
    cost = start @ riccati(data, 0.0) @ start / 2
    assert abs(solution.objective - cost) <= 1e-9 * max(1.0, cost)
    leg = solution.phase()
    for t in (0.0, 0.21, 0.5, 0.83, 1.0):
        wanted = riccati(data, t) @ leg.x(t)
        size = max(1.0, float(np.max(np.abs(start))))
        np.testing.assert_allclose(leg.lam(t), wanted, atol=1e-7 * size)
        feedback = -np.linalg.solve(data["r"], data["b"].T @ wanted)
        np.testing.assert_allclose(leg.u(t), feedback, atol=1e-5 * size)


@settings(max_examples=3, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), mesh=meshes(), scheme=st.sampled_from(SCHEMES))
def test_hamiltonian_is_constant(seed: int, mesh: go.Mesh, scheme: str) -> None:
    """H of an autonomous regulator does not change along the trajectory."""
    problem, _ = regulator(np.random.default_rng(seed), 3, 2)
    solution = go.solve(problem, mesh=mesh, scheme=scheme, tol=None)
    values = np.asarray(solution.hamiltonian(np.linspace(0.0, 1.0, 21)))
    size = max(1.0, float(np.abs(values).max()))
    np.testing.assert_allclose(values, values[0], atol=1e-6 * size)
