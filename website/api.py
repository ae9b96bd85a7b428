"""The API reference: a page per room with every public name, each documented once, below its module's own page."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import gnc_opt
from website.sphinx_math import dollars, module_page

ROOMS = (
    *("model", "problem", "solution", "verify", "refine", "study", "control", "simulation", "analysis"),
    *("spacecraft", "plot", "report", "nlp", "transcription", "workers"),
)
"""In the order in which one meets them; what of `gnc_opt` belongs to none of them is on its own page."""


@dataclass(frozen=True)
class Entry:
    """A public name: where it is imported from, and the module that it is written in."""

    name: str
    path: str
    module: str


def room_names() -> dict[str, tuple[str, ...]]:
    """Return the packages that declare public names, with these names."""
    folders = sorted(path.parent.name for path in Path(gnc_opt.__file__).parent.glob("*/__init__.py"))
    rooms = {"gnc_opt": gnc_opt} | {f"gnc_opt.{f}": import_module(f"gnc_opt.{f}") for f in folders}
    return {name: tuple(room.__all__) for name, room in rooms.items() if hasattr(room, "__all__")}


def entries() -> dict[str, list[Entry]]:
    """Return the entries of each room's page, each public object on one page only."""
    pages: dict[str, dict[str, Entry]] = {"gnc_opt": {}} | {f"gnc_opt.{room}": {} for room in ROOMS}
    for room, names in room_names().items():
        for name in names:
            entry = _entry(room, name)
            home = ".".join(entry.module.split(".")[:2])
            page = pages[home if home in pages else room]
            page.setdefault(entry.path, entry)
    return {room: list(found.values()) for room, found in pages.items() if found}


def _entry(room: str, name: str) -> Entry:
    value = getattr(import_module(room), name)
    if inspect.isclass(value) or inspect.isfunction(value):
        return Entry(name, f"{value.__module__}.{value.__qualname__}", value.__module__)
    return Entry(name, f"{room}.{name}", _defining(import_module(room), name))


def _defining(room: ModuleType, name: str) -> str:
    """Return the module below a room in which a constant is written."""
    for path in sorted(Path(inspect.getfile(room)).parent.glob("*.py")):
        module = import_module(f"{room.__name__}.{path.stem}") if path.stem != "__init__" else room
        if any(line.startswith((f"{name} =", f"{name}:")) for line in inspect.getsource(module).splitlines()):
            return module.__name__
    return room.__name__


def pages() -> dict[str, str]:
    """Return the Markdown of every page by its place in the site."""
    found = {f"api/{room}.md": "\n".join(_page(room, names)) for room, names in entries().items()}
    return {"api/index.md": "\n".join(_index())} | found


def _page(room: str, names: list[Entry]) -> Iterator[str]:
    yield f"# {room}\n"
    yield f"{_docstring(import_module(room))}\n"
    modules = dict.fromkeys(entry.module for entry in names)
    for module in modules:
        heading = module.removeprefix(f"{room}.").replace("_", " ")
        yield f"## {heading} {{ data-toc-label='{heading}' }}\n"
        if module != room:
            yield f"{_docstring(import_module(module))}\n"
        yield from (f"::: {entry.path}\n" for entry in names if entry.module == module)


def _index() -> Iterator[str]:
    yield "# API reference\n"
    yield "Every public name, by the room that it lives in; `go` is `import gnc_opt as go`.\n"
    yield "All have an example, but for errors and enumerations. What the examples begin with:\n"
    _, _, begin = (Path(__file__).parent / "before_examples.py").read_text(encoding="utf-8").partition("\n\n")
    yield f"```python\n{begin}```\n"
    short = set(gnc_opt.__all__)
    for room, names in entries().items():
        yield f"## [{room}]({room}.md)\n\n| | |\n|---|---|"
        for entry in sorted(names, key=lambda entry: entry.name.lower()):
            shown = f"go.{entry.name}" if entry.name in short else entry.name
            yield f"| [`{shown}`][{entry.path}] | {_first_line(entry)} |"
        yield ""


def _first_line(entry: Entry) -> str:
    """Return what the docstring of a class or function begins with, for the cell of a table."""
    value = getattr(import_module(entry.module), entry.name, None)
    described = inspect.isclass(value) or inspect.isfunction(value)
    text = (inspect.getdoc(value) or "") if described else ""
    return dollars(text.partition("\n")[0]).replace("|", "&#124;")


def _docstring(module: ModuleType) -> str:
    text: Any = inspect.getdoc(module)
    return module_page(text or "")
