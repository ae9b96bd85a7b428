"""The gallery: a page per problem with its statement, its known answer, its picture and its code."""

from __future__ import annotations

import ast
import io
import re
from collections.abc import Callable, Iterator
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any

import gnc_opt as go
from gnc_opt.plot import plot_controls, plot_run, plot_states
from gnc_opt.problem_files_and_examples import Example, list_examples
from problems._example import Reference
from website.sphinx_math import module_page
from website.thumbnails import describe_axes, superscripts

ROOT = Path(__file__).parents[1]

SYSTEMS = "Systems"

SHOWN_OPTIONS = {"hypersensitive": {"duration": 40.0}}
"""Options of `build` for figures that would be unreadable with the default ones."""


CHECKS = {"optimum": "strict local optimum", "necessary conditions": "the necessary conditions pass"}
"""Results of the optimality check in words, by those of the tables."""


def reference(example: Example) -> Reference | None:
    """Return the reference value; systems compare themselves with their publications instead."""
    found = getattr(example.module, "REFERENCE", None)
    return found if isinstance(found, Reference) else None


def result(example: Example) -> tuple[str, str]:
    """Return objective and result of the optimality check, as the tables of ``docs/problems.md`` show them."""
    lines = (ROOT / "docs" / "problems.md").read_text(encoding="utf-8").splitlines()
    row = next(line for line in lines if line.startswith(f"| [![{example.name}]"))
    cells = row.strip("| ").split(" | ")
    return cells[2], cells[5]


def heading(example: Example) -> str:
    """Return what the title says before the colon, or all of it."""
    return example.title.partition(":")[0]


def by_trade() -> dict[str, list[Example]]:
    """Return the examples by trade, the published systems first; a trade is named by the docstring of its folder."""
    found: dict[str, list[Example]] = {SYSTEMS: [e for e in list_examples() if e.is_package]}
    for example in sorted(list_examples(), key=lambda e: (e.path.parent.name, e.name)):
        if not example.is_package:
            trade = import_module(example.module_name.rpartition(".")[0]).__doc__ or example.path.parent.name
            found.setdefault(trade.partition(":")[0], []).append(example)
    return found


def pages(pictures: bool) -> dict[str, str]:
    """Return the Markdown of every example by its place in the site."""
    return {f"gallery/{e.name}.md": "\n".join(_page(e, pictures)) for e in list_examples()}


def _page(example: Example, pictures: bool) -> Iterator[str]:
    yield f"# {heading(example)}\n"
    statement = raise_exponents(module_page(example.module_docstring)).removeprefix(f"{heading(example)}: ")
    subtitle, _, text = statement.partition("\n")
    yield f"*{subtitle[0].upper()}{subtitle[1:]}*\n{text}\n"
    known = reference(example)
    if known is not None:
        value = f"{known.value:.10g} {known.unit} ({known.source})"
        accepted = superscripts(f"{known.tolerance:.0e} {known.unit}").rstrip()
        yield f"**Reference**: {superscripts(value)}. Tolerance: {accepted}.\n"
    if known is not None and not example.is_package:
        objective, check = result(example)
        found = re.sub("^max ", "the maximum ", objective).replace(", **", ", which **")
        yield f"`go.solve` finds {found}. [Optimality check](../problems.md): {CHECKS.get(check, check)}.\n"
    if (ROOT / "docs" / f"{example.name}.md").exists():
        yield f"The page [{example.name.replace('_', ' ')}](../{example.name}.md) describes the results.\n"
    command = f"`gnc-opt examples {example.name}`, or in the repository `python -m {example.module_name}`"
    yield f"To run it, enter {command}.\n"
    if pictures:
        if options := SHOWN_OPTIONS.get(example.name):
            yield f"The figures show `build({', '.join(f'{k}={v:g}' for k, v in options.items())})`.\n"
        files = {kind: f"{example.name}_{kind}.svg" for kind in shown(example)}
        yield "".join(
            f"[![{heading(example)}: {kind}]({f})]({f})\n\n" for kind, f in files.items()
        )  # to look closer
    elif (ROOT / "docs" / "pictures" / f"{example.name}.png").exists():
        yield f"![{heading(example)}: {describe_axes(example.name)}](../pictures/{example.name}.png)\n"
    for path in (
        sorted(example.path.glob("*.py"), key=_order_of_files) if example.is_package else [example.path]
    ):
        place = path.relative_to(ROOT)
        code = path.read_text(encoding="utf-8")
        if example.is_package:
            body = "\n".join(f"    {line}".rstrip() for line in code.splitlines())
            yield f'??? example "`{place}`"\n\n    ```python\n{body}\n    ```\n'
        else:
            yield f'```python title="{place}"\n{_without_docstring(code)}```\n'


def _order_of_files(path: Path) -> tuple[bool, str]:
    """Return the key by which the modules of a package come before ``__init__`` and ``__main__``."""
    return path.name.startswith("__"), path.name


def raise_exponents(text: str) -> str:
    """Return Markdown with the exponents of units as raised digits, outside of formulas and code."""
    parts = re.split(r"(```.*?```|\$\$.*?\$\$|\$[^$]*\$|`[^`]*`)", text, flags=re.DOTALL)
    return "".join(part if k % 2 else superscripts(part) for k, part in enumerate(parts))


def _without_docstring(code: str) -> str:
    """Return the code of a module after its docstring, which the page shows as text."""
    first = ast.parse(code).body[0]
    return "".join(code.splitlines(keepends=True)[first.end_lineno or 0 :]).lstrip("\n")


# --- pictures -----------------------------------------------------------------------------------------


@cache
def shown(example: Example) -> tuple[str, ...]:
    """Return what there is a picture of."""
    module = example.module
    controlled = not hasattr(module, "build") or any(
        p.model.controls.size for p in module.build().phases.values()
    )
    return ("states", "controls") if controlled else ("states",)


def pictures(example: Example) -> dict[str, bytes]:
    """Return figures as SVG by their place in the site: of the certified answer, or of a run if there is no problem."""
    module = example.module
    if hasattr(module, "build"):
        problem = module.build(**SHOWN_OPTIONS.get(example.name, {}))
        answer = go.solve(problem, mesh=getattr(module, "MESH", None), throw=False)
        draw: dict[str, Callable[[Any], Any]] = {"states": plot_states, "controls": plot_controls}
    else:
        answer, draw = (
            module.example_run(),
            {kind: partial(plot_run, kind=kind) for kind in ("states", "controls")},
        )
    return {f"gallery/{example.name}_{kind}.svg": _svg(draw[kind](answer)) for kind in shown(example)}


def _svg(figure: object) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="svg", metadata={"Date": None})  # type: ignore[attr-defined]
    return stream.getvalue()
