"""Models and problems that many tests state in one line."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import gnc_opt as go


def dynamics(name: str, states: str, controls: str, rates: Callable[..., dict[Any, Any]]) -> Any:
    """Return a model, its states and its controls, "q v" or "r:3 v:3"; ``rates`` maps them to the equations."""
    model, symbols = go.Model(name), []
    for add, names in ((model.state, states), (model.control, controls)):
        symbols += [add(each.partition(":")[0], int(each.partition(":")[2] or 1)) for each in names.split()]
    model.ode(rates(*symbols))
    return model, *symbols


def one_phase(
    title: str, model: go.Model, *time: Any, name: str = "leg", **more: Any
) -> tuple[go.Problem, go.Phase]:
    """Return a problem of one phase of a model, and that phase; its times are given as to ``Phase.time``."""
    problem = go.Problem(title)
    phase = problem.phase(name, model)
    phase.time(*time, **more)
    return problem, phase


def cart_with_units(name: str = "cart") -> go.Model:
    """Return a double integrator in m and s."""
    model = go.Model(name)
    q, v = model.state("q", unit="m"), model.state("v", unit="m/s")
    a = model.control("a", unit="m/s^2")
    model.ode({q: v, v: a})
    return model


double_integrator = partial(cart_with_units, "double integrator")
