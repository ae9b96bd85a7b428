"""Assertions on the errors for bad input, and correct problems to make mistakes in."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import pytest

import gnc_opt as go
from testing.models import dynamics, one_phase

LONGEST = 420
"""A message is one sentence: no more characters than this."""


@contextlib.contextmanager
def refused(error: type[go.GncOptError], *fragments: str) -> Iterator[None]:
    """Check that the block raises ``error``, and that its message holds all fragments and is clear."""
    with pytest.raises(error) as caught:
        yield
    assert_clear(str(caught.value), *fragments)


def assert_clear(message: str, *fragments: str) -> None:
    """Check the form of a message and that it names what it should."""
    for fragment in fragments:
        assert fragment in message, message
    assert "\n" not in message and len(message) <= LONGEST, message
    assert message.endswith((".", "?")), message
    assert ":" in message or "," in message, f"no remedy: {message}"


def cart() -> go.Model:
    """Double integrator."""
    model, *_ = dynamics("cart", "q v", "a", lambda q, v, a: {q: v, v: a})
    return model


def ship() -> go.Model:
    """A model with vectors of two and three components and a parameter."""
    model = go.Model("ship")
    r, w = model.state("r", 3), model.state("w", 2)
    force, tilt = model.control("force", 3), model.control("tilt", 2)
    mass = model.parameter("mass", 2.0)
    model.ode({r: force / mass, w: tilt})
    return model


def rest_to_rest(time: tuple[float, float] | float = 1.0) -> tuple[go.Problem, go.Phase]:
    """Return a problem that solves, and its only phase "leg"."""
    model = cart()
    problem, leg = one_phase("rest to rest", model, initial=0.0, final=time)
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-10.0, 10.0))
    problem.minimize(leg.integral(model.symbol("a") ** 2, name="effort"))
    return problem, leg


def voyage() -> tuple[go.Problem, go.Phase]:
    """Return an unfinished problem on `ship`, and its phase "leg"."""
    problem = go.Problem("voyage")
    return problem, problem.phase("leg", ship())


def scalar(name: str = "decay") -> tuple[go.Model, go.Problem, go.Phase]:
    """Return dx/dt = u with a phase from 0 to 1 s that starts at x = 1."""
    model, *_ = dynamics(name, "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase(name, model, 0.0, 1.0)
    leg.initial(x=1.0)
    return model, problem, leg
