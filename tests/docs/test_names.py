"""Whatever a page names exists: files, public names and their arguments, options and commands, links."""

from __future__ import annotations

import ast
import contextlib
import importlib
import inspect
import io
import re
import shlex
from collections import Counter
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from itertools import pairwise

import pytest
from testing.documented_names import Span, resolve
from testing.pages import CONTRIBUTING, DOCS, FENCE, PAGES, ROOT, Page, doc, documented, options, subparsers

import gnc_opt
from gnc_opt.cli import _build_argument_parser

page_by_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)

NOT_OURS = {
    "README.md": {"report/report.html"},  # what a command writes
    "docs/coming_from/casadi_opti.md": {"Opti"},
    "docs/reference/command_line.md": {"report.html"},
    "docs/howto/results.md": {"report.html"},
    "docs/reference/solver_options.md": {"nlpsol"},
    "docs/howto/limits.md": {"u_rate"},  # of the control u
    "docs/start/installation.md": {"cc", "data", "dev", "docs", "report", "test"},
    "docs/learn/reading_the_verdict.md": {"also"},  # a printed line
    "docs/learn/campaigns.md": {"plant.mass", "initial.q"},  # what a dispersion is called
    "docs/control/campaigns.md": {"plant.mass", "initial.q", "motor.tau", "SeedSequence([seed, i])"},
    "docs/control/sliding_mode.md": {"switching_gain_exceeded"},
    "docs/control/fmu.md": {"fmi2DoStep(t, h)"},
    "docs/control/linear.md": {"StateSpace", "control.feedback(plant, law.linearize(z, x), sign=1)"},
    "docs/theory/simulation_accuracy.md": {"SeedSequence([seed, i])"},
    "docs/formation_flying.md": {"J2 = 0"},
    "docs/rendezvous.md": {"minima.txt"},  # what a command writes
    "docs/reference/json_summary.md": set(documented(doc("json_summary").text)),  # compared with the JSON
    "docs/rendezvous_tracking.md": {"solve_ivp"},
}
"""Inline code that names other people's things, or data."""

SYSTEMS = [page.path.stem for page in DOCS if find_spec(f"problems.{page.path.stem}")]
"""What NAME stands for in ``python -m problems.NAME``."""


def names_in(page: Page) -> frozenset[str]:
    """Every name that occurs in the page's own Python blocks."""
    trees = [ast.parse(block.code) for block in page.code("python")]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    return frozenset({node.id for node in nodes if isinstance(node, ast.Name)})


@page_by_page
def test_inline_code_names_what_exists(page: Page) -> None:
    if page.name == "docs/reference/renamed.md":
        pytest.skip("names that no longer exist: see tests/api/test_renamed_public_names.py")
    known = names_in(page)
    spans = (Span(text, known) for text in page.spans if text not in NOT_OURS.get(page.name, ()))
    mistakes = [f"`{span.text}`: {span.mistake}" for span in spans if span.mistake]
    assert not mistakes, f"{page.name}:\n" + "\n".join(mistakes)


def test_texts_of_the_package_have_no_names_of_functions_in_place_of_words() -> None:
    code = [path.read_text(encoding="utf-8") for path in (ROOT / "gnc_opt").rglob("*.py")]
    nodes = [node for text in code for node in ast.walk(ast.parse(text))]
    names = {node.name for node in nodes if isinstance(node, ast.FunctionDef)} - set(dir(gnc_opt))
    texts = {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    words = {
        (word, text) for text in texts for word in re.findall(r"(?:^|(?<=[a-z] ))([a-z_]+)(?= [a-z]|$)", text)
    }
    verbs = ("from_", "build_", "compute_", "find_", "read_", "format_", "list_", "select_", "evaluate_")
    known = {("read_solver_status",) * 2}  # in `__all__`
    assert {(word, text) for word, text in words if word in names and word.startswith(verbs)} == known


@pytest.mark.parametrize(
    "text",
    [
        "go.solv", "go.solve(problem, tolerance=1e-8)", "solution.costates", "Solution.structured",
        "phase().path_multiplierz", "Problem.with_arcs(arc=2)", "gnc_opt.planning.refinement.eror",
        'structure="bang-bong"', 'taill="trim"', "gnc_opt/nowhere.py", "no_such_word_anywhere",
        "WheelArray(balanced=True)",
    ],
)  # fmt: skip
def test_wrong_names_are_found(text: str) -> None:
    assert Span(text).mistake


@pytest.mark.parametrize(
    "text",
    [
        "go.solve(problem, tol=1e-8)", 'solution.costate("q")(0.0)', "phase().path_multipliers",
        'structure="bang-bang"', "Mesh(..., movable=...)", "(t, x, r, z) -> (u, z_next)",
    ],
)  # fmt: skip
def test_right_names_pass(text: str) -> None:
    assert Span(text).mistake == ""


@page_by_page
def test_links_and_their_files_exist(page: Page) -> None:
    for target in page.links:
        assert (page.path.parent / target).resolve().exists(), f"{page.name} links to {target}"


@page_by_page
def test_no_phrase_is_said_again_and_again(page: Page) -> None:
    """A careless replacement leaves the same words in many places."""
    lines = FENCE.sub("", page.text).splitlines()
    prose = [
        line for line in lines if not line.startswith(("|", "Measured by"))
    ]  # without tables and their origin
    words = re.findall(r"[^\W_]+", "\n".join(prose))
    phrases = Counter(" ".join(words[i : i + 7]) for i in range(len(words) - 6))
    often = {phrase: n for phrase, n in phrases.items() if n > 3}
    assert not often, f"{page.name}: {often}"


@cache
def subcommands() -> dict[str, str]:
    """The help of every subcommand of gnc-opt."""
    return {name: parser.format_help() for name, parser in subparsers(_build_argument_parser()).items()}


def _program(module: str) -> str:
    """The module that ``python -m`` runs: of a package its ``__main__``."""
    is_package = getattr(importlib.import_module(module), "__path__", None)
    return f"{module}.__main__" if is_package else module


@cache
def help_of(module: str) -> str:
    """What ``python -m MODULE --help`` prints."""
    stream = io.StringIO()
    with contextlib.redirect_stdout(stream), pytest.raises(SystemExit) as leaving:
        importlib.import_module(_program(module)).main(["--help"])
    assert not leaving.value.code
    return stream.getvalue()


def programs(command: str) -> Iterator[tuple[str, str]]:
    """Yield name and help of the programs that a command line may mean."""
    if command.startswith("gnc-opt"):
        subcommand = command.split()[1]
        if subcommand.startswith("-"):
            yield "gnc-opt", _build_argument_parser().format_help()
        else:
            assert subcommand in subcommands(), f"gnc-opt has no command '{subcommand}'"
            yield f"gnc-opt {subcommand}", subcommands()[subcommand]
        return
    module = command.split(" -m ")[1].split()[0]
    for name in SYSTEMS if module == "problems.NAME" else [module.removeprefix("problems.")]:
        full = name if name.startswith("benchmarks.") else f"problems.{name}"
        assert find_spec(full), f"there is no module {full}"
        yield full, help_of(full)


@page_by_page
def test_commands_have_the_options_that_the_page_gives_them(page: Page) -> None:
    for command in page.commands:
        for name, usage in programs(command):
            unknown = options(command) - options(usage)
            assert not unknown, f"{page.name}: {name} has no {unknown}"


@page_by_page
def test_options_alone_belong_to_a_program_of_the_page(page: Page) -> None:
    known = {option for usage in subcommands().values() for option in options(usage)} | {"--version"}
    known |= {o for command in page.commands for _, usage in programs(command) for o in options(usage)}
    for span in page.spans:
        if span.startswith("--"):
            assert options(span) <= known, f"{page.name}: `{span}`"


@pytest.mark.parametrize("page", [p for p in PAGES if p.code("sh")], ids=lambda page: page.name)
def test_shell_blocks_can_be_run(page: Page) -> None:
    """gnc-opt understands its arguments, its files exist, and pip knows the extras."""
    extras = re.search(
        r"optional-dependencies\]\n(.*?)\n\n", (ROOT / "pyproject.toml").read_text(), re.DOTALL
    )
    for block in page.code("sh"):
        for command in re.split(r"&&|\n", block.code):
            words = [word for word in shlex.split(command) if "=1" not in word or "case" in word]
            program = words[0].rpartition("/")[2] if words else ""
            if program == "gnc-opt" and words[1] != "--version":
                _build_argument_parser().parse_args(words[1:])
                assert (ROOT / words[2]).exists()
            for extra in re.findall(r"\.\[(\w+)\]", command):
                assert extras and re.search(rf"(?m)^{extra} = ", extras[1])


def test_contributing_lists_every_package() -> None:
    """Those of gnc_opt, and those of planning."""
    root = ROOT / "gnc_opt"
    folders = [path.parent for pattern in ("*", "planning/*") for path in root.glob(f"{pattern}/__init__.py")]
    packages = [folder.relative_to(ROOT) for folder in folders if folder.name != "planning"]
    assert len(packages) > 15
    assert not [package for package in packages if f"`{package}/`" not in CONTRIBUTING.text]


def test_contributing_draws_the_order_of_the_contracts() -> None:
    """From the bottom up, as the import contracts list it from the top down."""
    contracts = re.findall(
        r"(?s)\nlayers = \[(.*?)\n\]", (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    )
    assert len(contracts) == 2
    drawn = CONTRIBUTING.code("text")[0].code
    for contract in contracts:
        layers = [re.findall(r"gnc_opt\.(?:\w+\.)?(\w+)", line) for line in contract.splitlines()[::-1]]
        found = [[re.search(rf"\b{name}\b", drawn) for name in layer] for layer in layers]
        places = [[match.start() for match in layer if match] for layer in found]
        places = [layer for layer in places if layer]
        assert len(places) >= 6
        assert all(max(below) < min(above) for below, above in pairwise(places)), places


def test_the_resolver_sees_the_public_names() -> None:
    """Not a vacuous check: what the README calls is followed to functions of the library."""
    things = resolve(ast.parse("go.solve", mode="eval").body)
    assert things and inspect.isfunction(things[0].value)
