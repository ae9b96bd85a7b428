"""Families of problems with known answers."""

import gnc_opt as go
from testing.models import dynamics, one_phase


def stiff(k: float = 1.0, target: float = 1.0) -> go.Problem:
    """x' = u, least integral of u^2 + k x^2 from 1 s, x free at the end: J = sqrt(k) target^2 tanh(sqrt(k))."""
    model = go.Model("stiff")
    x, u, weight = model.state("x"), model.control("u"), model.parameter("k", k)
    model.ode({x: u})
    problem, leg = one_phase("stiff", model, 0.0, 1.0)
    leg.initial(x=target)
    problem.minimize(leg.integral(u**2 + weight * x**2))
    return problem


def rest_to_rest(duration: float = 4.0) -> go.Problem:
    """1 m from rest to rest, |u| <= 1, least integral of u^2: 12 / T^3 while 6 / T^2 <= 1; impossible for T < 2."""
    model, _x, _v, u = dynamics("cart", "x v", "u", lambda x, v, u: {x: v, v: u})
    problem, leg = one_phase("rest to rest", model, 0.0, duration)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.integral(u**2))
    return problem
