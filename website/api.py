"""The API reference: a page per package with every public name, each documented once, below its module."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import gnc_opt
from website.sphinx_math import dollars, module_page

TITLES = {
    "model": "Model",
    "planning.problem": "Problem and phases",
    "planning": "Solve",
    "planning.solution": "Solution",
    "planning.verification": "Verify",
    "planning.refinement": "Refine",
    "planning.study": "Sweeps and searches",
    "control": "Controllers",
    "estimation": "Filters",
    "guidance": "Guidance",
    "simulation": "Simulation and campaigns",
    "analysis": "Analysis",
    "spacecraft": "Spacecraft equations",
    "plot": "Figures",
    "report": "Reports",
    "planning.nlp": "Solver of nonlinear programs",
    "workers": "Worker processes",
}
"""Packages in reading order with their tasks; names of `gnc_opt` that belong to none of them are on its own page."""

LISTED = 3
"""Number of names above which a page begins with a table of them."""

FIRST = ("Model", "Problem", "solve", "Solution", "verify")
"""Names that the index lists first."""


INTERNAL = {
    "Problem": "with_fixed_arcs frozen fingerprint require_mutable clear_cache check_foreign_symbols clone",
    "Phase": " ".join(set(vars(gnc_opt.Phase)) - set(gnc_opt.Phase.__dir__(None))),  # type: ignore[arg-type]
    "Model": "express_in_other_controls with_states composed_controls algebraic_equations state_error_expression "
    "retraction_expression state_derivative find_lookup_table_calls output_expression symbolic_arguments "
    "forbid_further_declarations",
    "Solution": "phase_functions samples outside_tables trajectory_phases with_verdict need_problem "
    "need_solved_problem",
    "ClosedLoop": "kernel",
    "Controller": "without_dropout_handling codegen_law unconstrained_law reference_layout schedule_row step_length",
}
"""Members of classes that other modules need and users do not."""


@dataclass(frozen=True)
class Entry:
    """A public name: where it is imported from, and the module that it is written in."""

    name: str
    path: str
    module: str


def title(package: str) -> str:
    """Return the task of a package, such as "Figures" for ``gnc_opt.plot``."""
    return TITLES.get(package.removeprefix("gnc_opt."), "Exceptions and warnings")


def package_names() -> dict[str, tuple[str, ...]]:
    """Return the packages that declare public names, with these names."""
    folders = {path.parent.name for path in Path(gnc_opt.__file__).parent.glob("*/__init__.py")}
    names = sorted(folders | set(TITLES))
    packages = {"gnc_opt": gnc_opt} | {f"gnc_opt.{f}": import_module(f"gnc_opt.{f}") for f in names}
    return {name: tuple(package.__all__) for name, package in packages.items() if hasattr(package, "__all__")}


def entries() -> dict[str, list[Entry]]:
    """Return the entries of each package's page, each public object on one page only."""
    pages: dict[str, dict[str, Entry]] = {name: {} for name in (*(f"gnc_opt.{p}" for p in TITLES), "gnc_opt")}
    for package, names in package_names().items():
        for name in names:
            entry = _entry(package, name)
            pages[_page_of(entry.module, package, pages)].setdefault(entry.path, entry)
    return {package: list(found.values()) for package, found in pages.items() if found}


def _page_of(module: str, package: str, pages: Iterable[str]) -> str:
    """Return the innermost package with a page that contains the module, or else the one that exports the name."""
    inside = [page for page in pages if page != "gnc_opt" and f"{module}.".startswith(f"{page}.")]
    return max(inside, key=len, default=package)


def _entry(package: str, name: str) -> Entry:
    value = getattr(import_module(package), name)
    if inspect.isclass(value) or inspect.isfunction(value):
        return Entry(name, f"{value.__module__}.{value.__qualname__}", value.__module__)
    return Entry(name, f"{package}.{name}", _defining(import_module(package), name))


def _defining(package: ModuleType, name: str) -> str:
    """Return the module below a package in which a constant is written."""
    for path in sorted(Path(inspect.getfile(package)).parent.glob("*.py")):
        module = import_module(f"{package.__name__}.{path.stem}") if path.stem != "__init__" else package
        if any(line.startswith((f"{name} =", f"{name}:")) for line in inspect.getsource(module).splitlines()):
            return module.__name__
    return package.__name__


def pages() -> dict[str, str]:
    """Return the Markdown of every page by its place in the site."""
    found = {f"api/{package}.md": "\n".join(_page(package, names)) for package, names in entries().items()}
    return {"api/index.md": "\n".join(_index())} | found


def _page(package: str, names: list[Entry]) -> Iterator[str]:
    yield f"# {package}\n"
    yield f"{_docstring(import_module(package))}\n"
    names = sorted(names, key=lambda entry: entry.name not in FIRST)
    modules = list(dict.fromkeys(entry.module for entry in names))
    if len(names) > LISTED:
        yield from _table(entry for module in modules for entry in names if entry.module == module)
        yield ""
    for module in modules:
        heading, described = _titled(_docstring(import_module(module)))
        yield f"## {heading}\n"
        if module != package:
            yield f"{described}\n"
        yield from (
            f"::: {entry.path}\n{_hidden_members(entry.name)}" for entry in names if entry.module == module
        )


def _hidden_members(name: str) -> str:
    """Return the option of mkdocstrings that leaves out the internal members of a class."""
    names = [member for member in INTERNAL.get(name, "").split() if not member.startswith("_")]
    return f'    options:\n      filters: ["!^_", "!^({"|".join(sorted(names))})$"]\n' * bool(names)


def _titled(text: str) -> tuple[str, str]:
    """Return the title of a module, with which its docstring begins, and the text after a title that is a sentence."""
    heading = re.split("[:;,.]", text)[0]
    described = text.removeprefix(f"{heading}: ").removeprefix(f"{heading}.").lstrip()
    heading = heading.replace("_", " ")
    return heading[0].upper() + heading[1:], described[:1].upper() + described[1:]


def _index() -> Iterator[str]:
    yield "# API reference\n"
    yield "This page lists every public name by task; `go` stands for `import gnc_opt as go`. Begin with:\n"
    known = {entry.name: entry for found in entries().values() for entry in found}
    yield from _table(known[name] for name in FIRST)
    yield "\nThe examples of the reference use these names:\n"
    _, _, begin = (Path(__file__).parent / "before_examples.py").read_text(encoding="utf-8").partition("\n\n")
    yield f"```python\n{begin}```\n"
    short = set(gnc_opt.__all__)
    for package, names in entries().items():
        yield f"## [{title(package)}]({package}.md)\n\nPackage `{package}`:\n"
        yield from _table(
            sorted(names, key=lambda e: (e.name not in FIRST, e.name not in short, e.name.lower()))
        )
        yield ""


def _table(names: Iterable[Entry]) -> Iterator[str]:
    """Yield the rows of a table of names, which lead to their descriptions."""
    yield "| | |\n|---|---|"
    for entry in names:
        shown = f"go.{entry.name}" if entry.name in gnc_opt.__all__ else entry.name
        yield f"| [`{shown}`][{entry.path}] | {_first_line(entry)} |"


def _first_line(entry: Entry) -> str:
    """Return what the docstring begins with, of a constant the one below it, for the cell of a table."""
    module = import_module(entry.module)
    value = getattr(module, entry.name, None)
    if inspect.isclass(value) or inspect.isfunction(value):
        text = inspect.getdoc(value) or ""
    else:
        found = re.search(rf'(?m)^{entry.name}\b.*\n"""(.*?)(?:"""|$)', inspect.getsource(module))
        text = found[1] if found else ""
    return dollars(text.partition("\n")[0]).replace("|", "&#124;")


def _docstring(module: ModuleType) -> str:
    text: Any = inspect.getdoc(module)
    return module_page(text or "")
