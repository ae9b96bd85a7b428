"""Shortest paths on a sphere: minima up to half a great circle."""

from __future__ import annotations

import itertools

import casadi as ca
import numpy as np

import gnc_opt as go
from testing.models import one_phase


def great_circle(arc: float, phases: int = 1) -> go.Problem:
    """Along the equator of a sphere, which is shortest up to half of it (Bryson & Ho 1975, sec. 6.3)."""
    model = go.Model("sphere")
    theta, phi = model.state("theta"), model.state("phi")
    a, b = model.control("a"), model.control("b")
    model.ode({theta: a, phi: b})
    problem = go.Problem("great circle")
    legs = [problem.phase(f"leg_{k}", model) for k in range(phases)]
    for k, leg in enumerate(legs):
        leg.time(k / phases, (k + 1) / phases)
        ends = np.array([k, k + 1]) / phases
        leg.guess(time=ends, theta=0.5 * np.pi + 0 * ends, phi=arc * ends)
    legs[0].initial(theta=0.5 * np.pi, phi=0.0)
    legs[-1].final(theta=0.5 * np.pi, phi=arc)
    for first, second in itertools.pairwise(legs):
        problem.link(first, second, time=False)
    problem.minimize(sum(leg.integral(0.5 * (a**2 + ca.sin(theta) ** 2 * b**2)) for leg in legs))
    return problem


def regulator(weight: float) -> go.Problem:
    """Least integral of u^2 - weight x^2 from 0 to 0 within 1 s: x = 0 up to weight = pi^2, unbounded beyond."""
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    k = model.parameter("k", weight)
    model.ode({x: u})
    problem, leg = one_phase("past its conjugate point", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=0.0)
    leg.scale(x=1.0, u=1.0)
    problem.minimize(leg.integral(u**2 - k * x**2))
    return problem
