"""Every public name has an example in its docstring, which runs and prints what it says.

But for errors and enumerations: an example would only repeat what is on the pages of those that raise or return them.
What the examples begin with stands on the first page of the reference.
"""

from __future__ import annotations

import doctest
import enum
import importlib
import inspect
import pkgutil
import runpy
from pathlib import Path
from typing import Any

import pytest
from testing.pages import ROOT

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


def public_names() -> list[str]:
    """Paths of the public classes and functions, errors and enumerations left out."""
    rooms = [importlib.import_module(name) for name in MODULES if name.count(".") == 1]
    found = [getattr(room, name) for room in (go, *rooms) for name in getattr(room, "__all__", ())]
    kinds = (BaseException, enum.Enum)
    shown = [
        value
        for value in found
        if inspect.isfunction(value) or (inspect.isclass(value) and not issubclass(value, kinds))
    ]
    return sorted({f"{value.__module__}.{value.__qualname__}" for value in shown})


def test_every_public_name_has_an_example() -> None:
    assert len(public_names()) > 180
    assert not set(public_names()) - {example.name for example in examples()}


@pytest.fixture(scope="module")
def names() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "website" / "before_examples.py"))


@pytest.mark.usefixtures("blank_figures")
@pytest.mark.parametrize("example", examples(), ids=lambda example: example.name)
def test_examples_of_docstrings(
    example: doctest.DocTest, names: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # for those that write files
    example.globs |= names
    told: list[str] = []
    result = doctest.DocTestRunner(optionflags=FLAGS).run(example, out=told.append)
    assert result.attempted and not result.failed, "".join(told)
