"""Problems that cannot be solved as stated, or only just."""

from __future__ import annotations

from typing import Any

import casadi as ca

import gnc_opt as go
from testing.models import dynamics, one_phase
from testing.wrong_arguments import cart


def _integrator(
    name: str, rate: Any = None, *, u: Any = None, x: Any = None, final: Any = None
) -> tuple[go.Problem, go.Phase, Any, Any]:
    """Return dx/dt = rate(x, u), x(0) = 1, over 1 s, without a cost."""
    model = go.Model(name)
    state, control = model.state("x"), model.control("u")
    model.ode({state: control if rate is None else rate(state, control)})
    problem, leg = one_phase(name, model, 0.0, 1.0)
    leg.initial(x=1.0)
    leg.bounds(u=u, x=x)
    leg.final(x=final)
    return problem, leg, state, control


def too_little_time() -> go.Problem:
    """Rest to rest over 1 m in half the least time, 2 s."""
    model = cart()
    problem, leg = one_phase("too little time", model, 0.0, 1.0)
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.integral(model.symbol("a") ** 2))
    return problem


def windows_apart() -> go.Problem:
    """Three linked phases: between the ends of the outer ones lies 1 s at least, and the middle one takes half of it.

    No link is impossible by itself.
    """
    model, _x, u = dynamics("drift", "x", "u", lambda x, u: {x: u})
    problem = go.Problem("windows apart")
    first, middle, last = (problem.phase(name, model) for name in ("first", "middle", "last"))
    first.time(0.0, (0.5, 1.0))
    first.initial(x=0.0)
    middle.time(None, None, duration=(0.1, 0.5))
    last.time((2.0, 3.0), 4.0)
    last.final(x=1.0)
    for leg in (first, middle, last):
        leg.bounds(u=(-1.0, 1.0))
    problem.link(first, middle)
    problem.link(middle, last)
    problem.minimize(first.integral(u**2) + last.integral(u**2))
    return problem


def overdetermined() -> go.Problem:
    """dx/dt = -x without a control, both ends given and not on one trajectory."""
    model = go.Model("decay")
    x = model.state("x")
    model.ode({x: -x})
    problem, leg = one_phase("overdetermined", model, 0.0, 1.0)
    leg.initial(x=1.0)
    leg.final(x=0.5)
    problem.minimize(leg.final_state("x"))
    return problem


def path_out_of_reach() -> go.Problem:
    """A path constraint that no control can satisfy."""
    problem, leg, _, u = _integrator("path out of reach", u=(-1.0, 1.0))
    leg.path("ceiling", u**2 - 2 * u, upper=-1.5)
    problem.minimize(leg.integral(u**2))
    return problem


def free_ride() -> go.Problem:
    """Maximise x(1) with an unbounded control."""
    problem, leg, _, _ = _integrator("free ride")
    problem.maximize(leg.final_state("x"))
    return problem


def concave() -> go.Problem:
    """Minimise the integral of x^2 - u^2 between fixed ends."""
    problem, leg, x, u = _integrator("concave", final=0.0)
    problem.minimize(leg.integral(x**2 - u**2))
    return problem


def endless() -> go.Problem:
    """Maximise a final time that has no upper limit."""
    problem, leg, _, _ = _integrator("endless", u=(-1.0, 1.0))
    leg.time(0.0, (0.1, None))
    problem.maximize(leg.final_time)
    return problem


def slowly_growing() -> go.Problem:
    """Maximise the integral of log x: unbounded, but the objective never gets large."""
    problem, leg, x, _ = _integrator("slowly growing", u=(0.0, None), x=(0.1, None))
    problem.maximize(leg.integral(ca.log(x)))
    return problem


def root_of_clipped_state() -> go.Problem:
    """sqrt(max(x, 0)) is finite; its derivative is 0 * inf where x < 0, which the solver tries."""
    problem, leg, _, u = _integrator(
        "root of clipped state", lambda x, u: u + ca.sqrt(ca.fmax(x, 0.0)), u=(-5.0, 5.0)
    )
    problem.minimize(leg.final_state("x") + leg.integral(0.01 * u**2))
    return problem


def clipped_cost() -> go.Problem:
    """The same in an integrand."""
    problem, leg, x, u = _integrator("clipped cost", u=(-5.0, 5.0))
    loss = leg.integral(0.01 * u**2 + ca.sqrt(ca.fmax(x, 0.0)), name="loss")
    problem.minimize(leg.final_state("x") + loss)
    return problem


def undefined_at_guess() -> go.Problem:
    """dx/dt = u x^1.5 / sqrt(x), guessed at negative x; the optimum is ln(2)^2 / 2."""
    problem, leg, _, u = _integrator(
        "undefined at guess", lambda x, u: u * x**1.5 / ca.sqrt(x), u=(-10.0, 10.0), final=0.5
    )
    problem.minimize(leg.integral(0.5 * u**2))
    leg.guess(x=(-1.0, -0.5))
    return problem


def going_nowhere(cost: str = "time", start: float = 0.0) -> go.Problem:
    """Minimum time between coincident end points: the phase shrinks to nothing."""
    model = cart()
    problem, leg = one_phase("going nowhere", model, start, (start, start + 10.0))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=1.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    effort = leg.integral(model.symbol("a") ** 2, name="effort")
    problem.minimize({"time": leg.duration, "both": leg.duration + effort}[cost])
    return problem
