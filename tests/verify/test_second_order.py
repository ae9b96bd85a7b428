"""Second-order conditions of bang-bang solutions, and the structure loop that prepares them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.problem.arc import ArcKind
from gnc_opt.refine.refine import refine
from gnc_opt.verify import Result


def oscillator(control_bound: float = 1.0) -> go.Problem:
    """Undamped oscillator to rest in minimum time: several switches, one costate dof each."""
    model = go.Model("oscillator")
    x, v = model.state("x"), model.state("v")
    u = model.control("u")
    model.ode({x: v, v: -x + u})
    problem = go.Problem("oscillator to rest")
    leg = problem.phase("leg", model)
    leg.time(0.0, (0.1, 30.0))
    # A straight line leads to t = pi, where the miss is least locally; a decaying oscillation does not.
    leg.guess(
        time=[0.0, 8.0],
        x=lambda t: 5 * np.cos(t) * (1 - t / 8),
        v=lambda t: -5 * np.sin(t) * (1 - t / 8),
    )
    leg.initial(x=5.0, v=0.0)
    leg.final(x=0.0, v=0.0)
    leg.bounds(u=(-control_bound, control_bound))
    problem.minimize(leg.final_time)
    return problem


@pytest.fixture(scope="module")
def refined() -> go.Solution:
    return refine(go.solve(oscillator(), mesh="20x3"))


def test_switches_are_half_periods_apart(refined: go.Solution) -> None:
    """The switching function is a sinusoid of period 2 pi (Pontryagin et al. 1962), so inner arcs last pi."""
    inner = [arc.end - arc.start for arc in refined.structure[1:-1]]
    assert len(refined.structure) >= 3
    np.testing.assert_allclose(inner, np.pi, atol=1e-9)
    kinds = [arc.kind for arc in refined.structure]
    assert all(kind in (ArcKind.LOWER, ArcKind.UPPER) for kind in kinds)
    assert all(a is not b for a, b in itertools.pairwise(kinds))


def test_verdict_includes_second_order(refined: go.Solution) -> None:
    verdict = go.verify(refined, tol=1e-8)
    assert verdict.proven, verdict.explain()
    assert verdict["strict switches"].result is Result.PASS
    assert verdict["second order"].result is Result.PASS


def test_induced_gradient_vanishes_and_hessian_matches_finite_differences(refined: go.Solution) -> None:
    from gnc_opt.solution.samples import PhaseSamples
    from gnc_opt.verify.second_order import induced_problem
    from gnc_opt.verify.verify import _ends

    leg = refined.phase()
    samples = PhaseSamples.of(leg, refined.functions("leg"))
    induced = induced_problem(refined, samples, _ends(refined))
    np.testing.assert_allclose(induced.gradient, 0.0, atol=1e-6)
    np.testing.assert_allclose(induced.hessian, induced.hessian.T, atol=1e-12)
    # Final state of the oscillator in closed form: turning about (u, 0) at unit rate from switch to switch.
    knots = leg.breaks[list(leg.mesh.anchors)]
    controls = leg.flown(0.5 * (knots[1:] + knots[:-1]))[0]

    def final_state(times: np.ndarray) -> np.ndarray:
        z = complex(5.0, 0.0)
        for left, right, u in zip(times[:-1], times[1:], controls, strict=True):
            z = u + (z - u) * np.exp(-1j * (right - left))
        return np.array([z.real, z.imag])

    step = 1e-6
    columns = []
    for k in range(1, knots.size):
        shift = np.zeros(knots.size)
        shift[k] = step
        columns.append((final_state(knots + shift) - final_state(knots - shift)) / (2 * step))
    np.testing.assert_allclose(induced.jacobian, np.stack(columns, axis=1), atol=1e-6)


def test_structure_survives_a_file(refined: go.Solution, tmp_path: object) -> None:
    path = refined.save(f"{tmp_path}/solution.npz")
    assert go.load(path).structure == refined.structure
