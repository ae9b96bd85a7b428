"""First and second derivatives of bang-bang flows in switch times and start values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
import scipy
from testing.internals import PhaseSamples

import gnc_opt as go
from gnc_opt.arrays import Array, Indices
from gnc_opt.planning.optimality.bang_bang_flow import ORDER, BangBangFlow, PiecewiseControl, bang_bang_flow
from problems import rendezvous

DIFFERENCES = {
    1: {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12},
    2: {-2: -1 / 12, -1: 4 / 3, 0: -5 / 2, 1: 4 / 3, 2: -1 / 12},
}
"""Weights of the central differences of fourth order, by order of the derivative."""


@dataclass
class Case:
    """A solution on a mesh of pieces, and which start values are unknowns."""

    solution: go.Solution
    free_start: Indices

    def __post_init__(self) -> None:
        leg = self.solution.phase()
        self.leg, self.functions = leg, self.solution.functions(leg.name)
        self.samples = PhaseSamples.of(leg, self.functions)
        self.times = leg.breaks
        self.controls = leg.flown(0.5 * (self.times[1:] + self.times[:-1]))
        self.unknowns = np.concatenate([self.times, leg.x(self.times[0])[self.free_start]])

    def flow(self, refinement: int = 4) -> BangBangFlow:
        assert self.solution.problem is not None
        pieces = PiecewiseControl(self.times, self.controls, np.arange(self.times.size))
        return bang_bang_flow(self.solution.problem, self.samples, pieces, self.free_start, refinement)

    def flown_end(self, unknowns: Array) -> Array:
        """States, integrals and time at the end by DOP853."""
        times, start = np.split(unknowns, [self.times.size])
        y = np.concatenate([self.leg.x(self.times[0]), np.zeros(self.leg.integrals.size)])
        y[self.free_start] = start
        n, rates = self.leg.states.size, self.functions.fast_rates()
        for k, (left, right) in enumerate(pairwise(times)):

            def rate(t: float, y: Array, u: Array = self.controls[:, k]) -> Array:
                costs = self.functions.integrands(t, y[:n], u) if y.size > n else y[n:]
                return np.concatenate([rates(t, y[:n], u), costs])

            run = scipy.integrate.solve_ivp(rate, (left, right), y, method="DOP853", rtol=1e-12, atol=1e-9)
            y = run.y[:, -1]
        return np.append(y, times[-1])

    def derivative(self, order: int, direction: Array, step: float = 5e-3) -> Array:
        weights = DIFFERENCES[order]
        ends = [w * self.flown_end(self.unknowns + i * step * direction) for i, w in weights.items()]
        return np.asarray(np.sum(ends, axis=0) / step**order)


def van_der_pol() -> Case:
    """Van der Pol's oscillator with a slow drive, a cost that depends on time and a free start value."""
    model = go.Model("driven oscillator")
    x, v, u = model.state("x"), model.state("v"), model.control("u")
    model.ode({x: v, v: (1 - x**2) * v - x + u + 0.2 * model.time * x})
    problem = go.Problem("driven oscillator")
    leg = problem.phase("leg", model)
    leg.time(0.5, 2.5)
    leg.initial(x=1.0)
    leg.bounds(u=(-1.0, 1.0), v=(-0.5, 0.5))
    problem.minimize(leg.integral(x**2 + leg.model.time * v) + leg.final_state("v"))
    mesh = go.Mesh.at_times([0.5, 1.1, 1.6, 2.5], 6)
    return Case(any_point(problem.with_fixed_arcs(arcs=[[-1, 1, -1]]), mesh), np.array([1]))


def double_integrator() -> Case:
    model = go.Model("double integrator")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a})
    problem = go.Problem("rest to rest")
    leg = problem.phase("leg", model)
    leg.time(0.0, (0.1, 100.0))
    leg.initial(q=100.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    mesh = go.Mesh.at_times([0.0, 10.0, 20.0], 5)
    return Case(go.solve(problem.with_fixed_arcs(arcs=[[-1, 1]]), mesh=mesh, tol=None), np.array([0, 1]))


def six_degrees_of_freedom() -> Case:
    arcs, mesh = rendezvous.switch_arcs(1), rendezvous.switch_mesh(1)
    return Case(any_point(rendezvous.build(1).with_fixed_arcs(arcs=arcs), mesh), np.array([1, 11]))


def any_point(problem: go.Problem, mesh: go.Mesh) -> go.Solution:
    """The derivatives belong to the flow, optimal or not."""
    return go.solve(problem, mesh=mesh, options=go.SolverOptions(max_iterations=1), throw=False, tol=None)


def test_double_integrator_in_closed_form() -> None:
    """With a = -1 until s, then 1: v = v0 - (s - t0) + (tf - s), q = q0 + v0 T - T^2 / 2 + (tf - s)^2."""
    flow = double_integrator().flow()
    np.testing.assert_allclose(flow.final, [0.0, 0.0, 20.0], atol=1e-9)
    slopes = [[20.0, -20.0, 0.0, 1.0, 20.0], [1.0, -2.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0, 0.0]]
    np.testing.assert_allclose(flow.final_sensitivity, slopes, atol=1e-9)
    position = [
        [-1.0, 0.0, 1.0, 0.0, -1.0],
        [0.0, 2.0, -2.0, 0.0, 0.0],
        [1.0, -2.0, 1.0, 0.0, 1.0],
        [0.0, 0.0, 0.0, 0.0, 0.0],
        [-1.0, 0.0, 1.0, 0.0, 0.0],
    ]
    np.testing.assert_allclose(flow.curvature(np.array([1.0, 0.0, 0.0])), position, atol=1e-9)
    np.testing.assert_allclose(flow.curvature(np.array([0.0, 1.0, 1.0])), 0.0, atol=1e-9)


@pytest.mark.parametrize("build", [van_der_pol, six_degrees_of_freedom])
def test_derivatives_are_those_of_an_independent_integration(build: Callable[[], Case]) -> None:
    """Differences of DOP853 along a random direction in all unknowns, to 1e-6 of the largest derivative."""
    case, random = build(), np.random.default_rng(3)
    flow, adjoint = case.flow(), random.normal(size=case.flow().final.size)
    assert flow.initial_sensitivity.shape == (flow.final.size, case.unknowns.size)
    direction = random.normal(size=case.unknowns.size)
    direction /= np.linalg.norm(direction)
    slope, curvature = flow.final_sensitivity, flow.curvature(adjoint)
    np.testing.assert_allclose(flow.final, case.flown_end(case.unknowns), atol=1e-6)
    first, second = case.derivative(1, direction), adjoint @ case.derivative(2, direction)
    np.testing.assert_allclose(slope @ direction, first, atol=1e-6 * np.max(np.abs(slope)))
    np.testing.assert_allclose(
        direction @ curvature @ direction, second, atol=1e-6 * np.max(np.abs(curvature))
    )
    np.testing.assert_allclose(
        flow.gradient(adjoint), adjoint @ slope, rtol=1e-10, atol=1e-12 * np.max(np.abs(slope))
    )


def test_half_the_width_of_steps_leaves_a_256th_of_the_error() -> None:
    """On two grids that are not yet at rounding; half an order either way."""
    case = van_der_pol()
    coarse, fine, best = (case.flow(n).final for n in (1, 2, 8))
    ratio = np.linalg.norm(coarse - best) / np.linalg.norm(fine - best)
    assert 2 ** (ORDER - 0.7) < ratio < 2 ** (ORDER + 1.5)
