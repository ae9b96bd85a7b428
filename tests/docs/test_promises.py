"""A page that promises to list all of something lists all of it, and nothing else."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterable, Iterator
from enum import Enum
from pathlib import Path
from typing import Any

import pytest
from testing.pages import DOCS, ROOT, Page, doc, documented, options, subparsers

import gnc_opt as go
from gnc_opt import cli, control, simulation
from gnc_opt.cli import ExitCode, _build_argument_parser
from gnc_opt.control import reaching_laws as reaching
from gnc_opt.planning import ArcKind
from gnc_opt.report import search_dict, summary_dict
from problems.classics import minimum_fuel

COMMANDS = doc("command_line").text
JSON = doc("json_summary")


@pytest.mark.parametrize("name", sorted(subparsers(_build_argument_parser())))
def test_the_page_lists_every_command_with_every_option(name: str) -> None:
    parser = subparsers(_build_argument_parser())[name]
    usages = re.findall(rf"(?m)^gnc-opt {name} .*(?:\n +.*)*", COMMANDS)
    assert len(usages) == 1, f"the usage of {name} is given {len(usages)} times"
    told = re.findall(r"--[a-z][a-z-]*", usages[0])
    assert len(told) == len(set(told))
    assert set(told) == options(parser.format_help()) - {"--help"}


def test_the_page_lists_no_other_command() -> None:
    assert set(re.findall(r"(?m)^gnc-opt (\w+)", COMMANDS)) == set(subparsers(_build_argument_parser()))
    assert set(subparsers(_build_argument_parser())) <= set(re.findall(r"gnc-opt (\w+)", cli.__doc__ or ""))


def test_choices_are_those_of_the_program() -> None:
    for parser in subparsers(_build_argument_parser()).values():
        for action in parser._actions:
            if action.choices:
                assert f"{action.option_strings[0]} {'|'.join(map(str, action.choices))}]" in COMMANDS


def test_the_page_lists_every_exit_code() -> None:
    listed = [int(code) for code in re.findall(r"^\| (\d+) \|", COMMANDS, re.MULTILINE)]
    assert listed == [int(code) for code in ExitCode]


def keys(value: Any, path: str = "") -> Iterator[str]:
    """Yield the paths of all keys: ``phases[].states[].name``; of mappings by the user's names only their own."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield f"{path}.{key}".lstrip(".")
            if key not in ("parameters", "provenance", "failures"):
                yield from keys(item, f"{path}.{key}".lstrip("."))
    elif isinstance(value, list):
        for item in value:
            yield from keys(item, f"{path}[]")


def row(page: Page, key: str) -> str:
    return next(line for line in page.text.splitlines() if line.startswith(f"| `{key}`"))


def values(page: Page, key: str) -> set[str]:
    """The values that the last column of a key's row lists in inline code."""
    return set(re.findall(r"`([^`]+)`", row(page, key).rstrip("| ").rpartition("| ")[2]))


@pytest.fixture(scope="module")
def solution() -> go.Solution:
    """One with a structure, a history and a bound."""
    return go.lower_bound(go.solve(minimum_fuel.build(), tol=1e-6))


@pytest.fixture(scope="module")
def summary(solution: go.Solution) -> dict[str, Any]:
    return summary_dict(solution, go.verify(solution))


@pytest.fixture(scope="module")
def failure() -> dict[str, Any]:
    return summary_dict(go.solve(minimum_fuel.build(duration=0.5), throw=False, tol=None))


def test_json_summary_lists_every_key(summary: dict[str, Any], failure: dict[str, Any]) -> None:
    assert summary["structure"] and summary["refinement"] and failure["violations"]
    told = documented(JSON.section("Keys"))
    assert len(told) == len(set(told))
    assert set(told) == set(keys(summary)) | set(keys(failure))


def test_json_of_a_search_lists_every_key() -> None:
    found = go.multistart(minimum_fuel.build(), n=2, seed=1, executor="serial", refine=False)
    minima = [
        {key: item for key, item in entry.items() if key != "solution"}
        for entry in search_dict(found)["minima"]
    ]
    used = set(keys(search_dict(found) | {"minima": minima})) | {"minima[].solution"}
    assert minima
    assert set(documented(JSON.section("A search"))) == used


@pytest.mark.parametrize(
    ("key", "kind"),
    [
        ("status", go.Status),
        ("structure[].kind", set(ArcKind) - {ArcKind.RELEASED}),  # of no finished solution
        ("refinement.status", go.RefinementStatus),
        ("verdict.conditions[].result", go.ConditionResult),
    ],
)
def test_json_summary_lists_every_value(key: str, kind: Iterable[Enum]) -> None:
    assert values(JSON, key) == {member.value for member in kind}


def test_json_of_a_problem_file(tmp_path: Path) -> None:
    minimum_fuel.main(["--json", str(tmp_path / "out.json")])
    reference = json.loads((tmp_path / "out.json").read_text())["reference"]
    sentence = re.search(r"\n\n([^|]*?`reference`.*?)(?:\n\n|\Z)", doc("problems").text, re.DOTALL)
    assert sentence
    for key in reference:
        assert f"`{key}`" in sentence[1], key


@pytest.mark.parametrize(
    ("section", "of"),
    [
        ("Arguments of `go.solve`", go.solve),
        ("SolverOptions", go.SolverOptions),
        ("RefinementLimits", go.RefinementLimits),
    ],
)
def test_solver_options_lists_every_argument(section: str, of: Any) -> None:
    assert sorted(documented(doc("solver_options").section(section))) == sorted(
        inspect.signature(of).parameters
    )


def exported(module: Any, base: type | tuple[type, ...] = object) -> set[str]:
    """Public classes of a package below a base class."""
    found = {name for name in module.__all__ if inspect.isclass(getattr(module, name))}
    return {name for name in found if issubclass(getattr(module, name), base)}


def told_in_table(page: Page) -> set[str]:
    """Names in the rows of a page's tables."""
    rows = [line for line in page.text.splitlines() if line.startswith("|")]
    return set(re.findall(r"`(\w+)[^`]*`", "\n".join(rows)))


def test_control_lists_every_design() -> None:
    designs = {name for name in control.__all__ if name.startswith("design_")} | {"feedforward"}
    assert designs <= told_in_table(doc("overview"))


def test_control_lists_everything_a_loop_can_hold() -> None:
    made_of = {name for name in simulation.__all__ if inspect.isclass(getattr(simulation, name))}
    results = {
        "Block", "Campaign", "ClosedLoop", "FinalValues", "CompiledLoop", "Outcome", "Run", "RunStatus",
    }  # fmt: skip
    results |= {"Consistency", "Envelope", "InnovationTest", "EventOccurrence", "Replan", "ExternalPlantRun"}
    told = told_in_table(doc("simulation")) | told_in_table(doc("campaigns", "control"))
    assert made_of - results <= told, made_of - results - told


def test_sliding_mode_lists_every_reaching_law_and_layer() -> None:
    public = {name for name in control.__all__ if getattr(control, name).__module__ == reaching.__name__}
    told = set(re.findall(r"`(\w+)\(", doc("sliding_mode").section("Surfaces and reaching laws")))
    assert public <= told


def test_version_is_the_same_everywhere() -> None:
    """The citation names the last release; the package has the version of the changelog's first heading (PEP 440)."""
    patterns = {
        "pyproject.toml": r'^version = "(.*)"',
        "CITATION.cff": r"^version: (.*)",
        "CHANGELOG.md": r"^## (\d\S+)",
    }
    texts = {name: (ROOT / name).read_text(encoding="utf-8") for name in patterns}
    found = {name: re.findall(pattern, texts[name], re.MULTILINE)[0] for name, pattern in patterns.items()}
    unreleased = re.findall(r"(?m)^## Unreleased \((\S+)\)", texts["CHANGELOG.md"])
    assert found["CITATION.cff"] == found["CHANGELOG.md"], found
    assert found["pyproject.toml"] == (f"{unreleased[0]}.dev0" if unreleased else found["CHANGELOG.md"])


def test_problems_lists_every_file() -> None:
    table = set(
        re.findall(r"(?m)^\| \[!.*?\]\(\.\./problems/(?:\w+/)?(\w+)(?:\.py)?\)", doc("problems").text)
    )
    files = [
        path
        for path in (ROOT / "problems").glob("*/*.py")
        if path.stem != "__main__" and "example_main(build, REFERENCE" in path.read_text()
    ]
    systems = (ROOT / "problems").glob("*/__main__.py")
    assert table == {path.stem for path in files} | {path.parent.name for path in systems}


def test_every_system_is_introduced() -> None:
    """Each page of a published system is linked from the list of problems."""
    from importlib.util import find_spec

    systems = [path.stem for path in (ROOT / "docs").glob("*.md") if find_spec(f"problems.{path.stem}")]
    assert len(systems) >= 5
    for name in systems:
        assert f"{name}.md" in doc("problems").links


def test_every_page_is_in_the_navigation() -> None:
    listed = set(
        re.findall(r"(?m)^ +- (?:[^:\n]+: )?([\w/]+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    )
    there = {str(page.path.relative_to(ROOT / "docs")) for page in DOCS}
    assert listed - {"index.md"} == there
