"""The import contracts of pyproject.toml, and no import circle of files."""

from __future__ import annotations

import ast
import graphlib
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import grimp
import pytest
from testing.source_files import source_files, walk_statements

ROOT = Path(__file__).parents[2]

MANY = 7
"""Parameters of a function; of more, those that belong together are a frozen dataclass."""

DESIGNS = """
    design_feedback_linearization design_integral_sliding_mode design_lqr design_mpc
    design_neighbouring_optimal design_sliding_mode design_tvlqr
"""
STATEMENTS = "continuation from_casadi from_functions monte_carlo multistart solve write_campaign_report"
WITH_MANY = {*DESIGNS.split(), *STATEMENTS.split()}
"""Functions with more: their keywords are independent of each other, and are read best where they are called."""


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    """Every import of every file, those inside functions and those for types alone included."""
    return grimp.build_graph("gnc_opt", exclude_type_checking_imports=False, cache_dir=None)


def circle(graph: grimp.ImportGraph) -> list[str]:
    """A circle of files, or nothing."""
    below = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    try:
        tuple(graphlib.TopologicalSorter(below).static_order())
    except graphlib.CycleError as error:
        return list(error.args[1])
    return []


def test_no_circle_of_files(graph: grimp.ImportGraph) -> None:
    assert circle(graph) == []


def test_a_circle_of_files_would_be_found(graph: grimp.ImportGraph) -> None:
    crooked = grimp.build_graph("gnc_opt", exclude_type_checking_imports=False, cache_dir=None)
    crooked.add_import(importer="gnc_opt.planning.problem.phase", imported="gnc_opt.planning.problem.problem")
    assert {"gnc_opt.planning.problem.phase", "gnc_opt.planning.problem.problem"} <= set(circle(crooked))


def test_packages_import_downwards_only() -> None:
    """The contracts of pyproject.toml; what they break is named in import-linter's own words.

    It comes with the extra ``dev``, since it needs a newer rich than gnc_opt does.
    """
    pytest.importorskip("importlinter")
    program = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    command = [sys.executable, "-c", program, "--no-cache", "--no-logo"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 broken" in done.stdout


def test_no_two_classes_have_one_name() -> None:
    """But for helpers of a file, whose names begin with an underscore."""
    homes = defaultdict(list)
    for file in source_files("gnc_opt"):
        for node in walk_statements(file):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes[node.name].append(str(file.relative_to(ROOT)))
    assert len(homes) > 100
    assert {name: files for name, files in homes.items() if len(files) > 1} == {}


def test_few_functions_have_many_parameters() -> None:
    """Who takes one from the list has grouped what belongs together; who adds one says in the commit why not."""
    found = {
        node.name
        for file in source_files("gnc_opt")
        for node in walk_statements(file)
        if isinstance(node, ast.FunctionDef)
        and len([a for a in (*node.args.args, *node.args.kwonlyargs) if a.arg not in ("self", "cls")]) > MANY
    }
    assert found == WITH_MANY


def assigned_attributes(node: ast.AST, of: str = "") -> set[str]:
    """Names x in assignments to ``of.x`` and ``of.x[...]``; of any object by default."""
    stores = [n for n in ast.walk(node) if isinstance(getattr(n, "ctx", None), ast.Store)]
    places = [n.value if isinstance(n, ast.Subscript) else n for n in stores]
    return {n.attr for n in places if isinstance(n, ast.Attribute) and of in ("", ast.unparse(n.value))}


def test_dataclasses_that_nothing_assigns_to_are_frozen() -> None:
    """They cannot be changed by accident, and several threads may share them."""
    found = []
    for file in source_files("gnc_opt"):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        for node in (n for n in ast.walk(tree) if isinstance(n, ast.ClassDef)):
            decorators = [
                text for text in map(ast.unparse, node.decorator_list) if text.startswith("dataclass")
            ]
            fields = {ast.unparse(n.target) for n in node.body if isinstance(n, ast.AnnAssign)}
            changes = fields & assigned_attributes(tree) or assigned_attributes(node, "self")
            if decorators and "frozen=True" not in decorators[0] and not changes:
                found.append(f"{file.relative_to(ROOT)}: {node.name}")
    assert found == []
