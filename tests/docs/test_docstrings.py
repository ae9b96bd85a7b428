"""The examples of docstrings run and print what they say.

Besides ``go`` and ``np`` they know what the README states: ``cart``, ``problem`` and its ``solution``, refined.
"""

from __future__ import annotations

import doctest
import importlib
import pkgutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gnc_opt as go

MODULES = [
    m.name
    for m in pkgutil.walk_packages(go.__path__, "gnc_opt.")
    if ".templates." not in m.name and ".shipped" not in m.name
]
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def examples() -> list[doctest.DocTest]:
    finder = doctest.DocTestFinder(exclude_empty=True)
    found = [t for name in MODULES for t in finder.find(importlib.import_module(name), name) if t.examples]
    return sorted(found, key=lambda test: test.name)


@pytest.fixture(scope="module")
def names() -> dict[str, Any]:
    cart = go.Model("double integrator")
    q, v = cart.state("q", unit="m"), cart.state("v", unit="m/s")
    a = cart.control("a", unit="m/s^2")
    cart.ode({q: v, v: a})
    problem = go.Problem("rest to rest in minimum time")
    leg = problem.phase("leg", cart)
    leg.time(initial=0.0, final=(0.1, 10.0))
    leg.initial(q=1.0, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    return {"go": go, "np": np, "cart": cart, "problem": problem, "solution": go.solve(problem)}


@pytest.mark.parametrize("example", examples(), ids=lambda example: example.name)
def test_examples_of_docstrings(
    example: doctest.DocTest, names: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # for those that write files
    example.globs |= names
    told: list[str] = []
    result = doctest.DocTestRunner(optionflags=FLAGS).run(example, out=told.append)
    assert result.attempted and not result.failed, "".join(told)
