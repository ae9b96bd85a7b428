"""Problems with the same fingerprint have the same answers; what only helps to find them does not count."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import gnc_opt as go


def cart(
    *,
    free: str | None = None,
    size: int = 1,
    cost: str = "time",
    labels: tuple[str, str, str] = ("power", "effort", "late"),
    nominal: float | None = None,
    unit: str = "m",
) -> go.Problem:
    """A cart of some mass on a spring, pushed to q = 1; ``free`` is the parameter that may be chosen."""
    model = go.Model("cart")
    q, v, u = model.state("q", unit=unit, nominal=nominal), model.state("v"), model.control("u")
    mass, spring = model.parameter("mass", 2.0), model.parameter("spring", 3.0)
    model.ode({q: v, v: (u - spring * q) / mass})
    problem = go.Problem("cart")
    if free is not None:
        problem.parameter(free, size, lower=1.0, upper=4.0)
    leg = problem.phase("leg", model)
    leg.time(0.0, (0.1, 5.0))
    leg.initial(q=0.0, v=0.0)
    leg.final(q=1.0)
    leg.bounds(u=(-9.0, 9.0))
    path, integral, constraint = labels
    leg.path(path, u * v, upper=8.0)
    effort = leg.integral(u**2, integral)
    problem.constrain(constraint, leg.final_time, upper=4.0)
    problem.minimize(effort if cost == "effort" else leg.final_time)
    return problem


DIFFERENT = {
    "a parameter is free": lambda: cart(free="mass"),
    "another one is": lambda: cart(free="spring"),
    "one that the model does not have is": lambda: cart(free="stretch"),
    "of another size": lambda: cart(free="stretch", size=2),
    "another cost": lambda: cart(cost="effort"),
    "an integral that is called like the final time, as the cost": lambda: cart(
        cost="effort", labels=("power", "final_time", "late")
    ),
    "an integral that is called like the final time": lambda: cart(labels=("power", "final_time", "late")),
    "another name of a path constraint": lambda: cart(labels=("strength", "effort", "late")),
    "another name of a constraint": lambda: cart(labels=("power", "effort", "slow")),
    "another mass": lambda: cart().with_parameters(mass=2.1),
    "other limits": lambda: cart().with_bounds(u=(-9.0, 9.1)),
    "another end": lambda: cart().with_final(q=1.1),
    "another time": lambda: cart().with_time(final=(0.1, 5.1)),
    "nothing": cart,
}


def test_every_difference_that_moves_the_answer_is_seen() -> None:
    prints = {what: build().fingerprint() for what, build in DIFFERENT.items()}
    assert len(set(prints.values())) == len(prints), prints


@pytest.mark.parametrize(
    "change",
    [
        lambda p: p.with_guess(q=(0.0, 2.0)),
        lambda p: p.with_scale(q=10.0),
        lambda p: p.with_fixed_arcs(arcs=[[-1, 1]]),
        lambda p: cart(nominal=7.0),
        lambda p: cart(unit="km"),
    ],
    ids=["guess", "scale", "held arcs", "nominal magnitude", "unit's name"],
)
def test_what_only_helps_to_find_the_answer_does_not_count(change: Callable[[Any], go.Problem]) -> None:
    assert change(cart()).fingerprint() == cart().fingerprint()


def test_value_of_a_parameter_that_is_optimised_does_not_count() -> None:
    one = cart(free="mass")
    assert one.with_parameters(mass=9.0).fingerprint() == one.fingerprint()
    assert one.with_parameter_guess(mass=3.3).fingerprint() == one.fingerprint()
    assert one.with_parameters(spring=3.1).fingerprint() != one.fingerprint()


def test_answer_for_one_free_parameter_is_not_joined_to_the_problem_with_another(tmp_path: Any) -> None:
    """The mass that is best for a given spring says nothing about the spring that is best for a given mass."""
    solution = go.solve(cart(free="spring"), mesh="4x5", throw=False, tol=None)
    file = solution.save(tmp_path / "cart.npz")
    assert np.isfinite(go.load(file, problem=cart(free="spring")).objective)
    for other in (cart(free="mass"), cart()):
        with pytest.raises(go.ProblemError, match="is not the one that this solution of 'cart' solves"):
            go.load(file, problem=other)
