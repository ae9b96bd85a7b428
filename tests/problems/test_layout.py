"""How problems/ is laid out: basic problems in one file each by trade, systems in folders, imports that go one way."""

from __future__ import annotations

import ast
import importlib
import re
import runpy
import sys
from collections.abc import Iterator, Mapping
from importlib.util import resolve_name
from pathlib import Path

import pytest

import problems
from gnc_opt import cli

FOLDER = Path(problems.__file__).parent
SHARED = {"_campaign_table", "_example"}
SYSTEMS = sorted(path.parent.name for path in FOLDER.glob("*/__main__.py"))
TRADES = sorted({path.parent.name for path in FOLDER.glob("*/__init__.py")} - {*SYSTEMS})
BASIC = sorted(
    f"{path.parent.name}.{path.stem}"
    for path in FOLDER.glob("*/*.py")
    if path.parent.name in TRADES and path.stem != "__init__"
)


def sources() -> dict[str, str]:
    """The text of every module of problems/ by its name; a package's is that of its ``__init__``."""
    parts = {path: path.relative_to(FOLDER.parent).with_suffix("").parts for path in FOLDER.rglob("*.py")}
    return {
        ".".join(p for p in names if p != "__init__"): path.read_text("utf-8")
        for path, names in parts.items()
    }


def imports(name: str, texts: Mapping[str, str]) -> set[str]:
    """Which of the modules a module imports: anywhere in it, in functions and for the types as well."""
    package = name if any(other.startswith(f"{name}.") for other in texts) else name.rpartition(".")[0]

    def imported() -> Iterator[str]:
        for node in ast.walk(ast.parse(texts[name])):
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                base = resolve_name("." * node.level + (node.module or ""), package)
                members = (f"{base}.{alias.name}" for alias in node.names)
                yield from (member if member in texts else base for member in members)

    return set(imported()) & set(texts)


def test_shared_files_know_no_problem() -> None:
    texts = sources()
    for name in SHARED:
        assert imports(f"problems.{name}", texts) <= {f"problems.{other}" for other in SHARED}


@pytest.mark.parametrize("name", BASIC)
def test_a_basic_problem_is_one_file(name: str) -> None:
    assert imports(f"problems.{name}", sources()) <= {f"problems.{other}" for other in SHARED}
    module = importlib.import_module(f"problems.{name}")
    assert callable(module.build) and callable(module.main) and module.REFERENCE.source
    assert name.partition(".")[2] not in TRADES


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_system_is_a_folder_that_says_in_which_order_to_read_it(name: str) -> None:
    """Every file is named, and none before those that it imports."""
    folder, texts = f"problems.{name}", sources()
    written = texts[folder]
    order = re.findall(r"`(\w+)`", written[written.index("in this order") : written.index('"""', 3)])
    assert sorted(order) == sorted(
        {path.stem for path in (FOLDER / name).glob("*.py")} - {"__init__", "__main__"}
    )
    for place, file in enumerate(order):
        own = {
            other.rpartition(".")[2] for other in imports(f"{folder}.{file}", texts) if f"{folder}." in other
        }
        assert own <= set(order[:place]), f"{file} comes too early"


@pytest.mark.parametrize("name", sorted({*SYSTEMS} - {"rendezvous_tracking"}))
def test_the_command_line_takes_a_systems_folder_or_a_file_of_its_name(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert not (FOLDER / f"{name}.py").exists()
    for path in (FOLDER / name, FOLDER / f"{name}.py"):
        assert cli.main(["check", str(path)]) == 0
    assert capsys.readouterr().out.count("no error in the statement") == 2


def test_the_index_lists_every_system() -> None:
    index = (FOLDER.parent / "docs" / "problems.md").read_text("utf-8")
    assert sorted(set(re.findall(r"\(\.\./problems/(\w+)\)", index))) == SYSTEMS


@pytest.mark.filterwarnings("ignore:.*found in sys.modules:RuntimeWarning")
@pytest.mark.parametrize("name", [*BASIC, *SYSTEMS])
def test_every_problem_runs_by_its_name(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["problem", "--help"])
    with pytest.raises(SystemExit) as left:
        runpy.run_module(f"problems.{name}", run_name="__main__", alter_sys=True)
    assert left.value.code == 0
    assert capsys.readouterr().out.split("\n")[0].startswith(f"usage: python -m problems.{name}")
